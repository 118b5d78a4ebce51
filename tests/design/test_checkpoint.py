"""A design that is stopped and goes on: the same numbers, and no other design's file is taken."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import Input
from seedslib.design import Affine, Continuous, Crew, Polynomial, synthesize
from seedslib.designed import Memory, load, save
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise

x, v, a = sympy.symbols("x v a")
TIMES = np.arange(4) * 0.5
BASE = {"paths": 9000, "seed": 5, "step": 0.1, "nodes": 1}


class Stopped(Exception):
    """The run ends here."""


def stopping(count):
    """Who works on a design until so many pieces of work are done."""
    left = iter(range(count))

    def mapped(work, *lists):
        if next(left, None) is None:
            raise Stopped
        return map(work, *lists)

    return Crew(mapped)


@pytest.fixture(scope="module")
def oscillator():
    return zoo.van_der_pol()


def begun(path, *arguments, **options):
    """Run a design again and again, each time a little further, until its file is there."""
    count = 10
    while not path.exists():
        count += 4
        with pytest.raises(Stopped):
            synthesize(*arguments, checkpoint=path, workers=stopping(count), **options)


KINDS = {
    "mixed memory": (Memory(1, 1), Affine(), {"components": 1}),
    "finite memory": (Memory(0, 2), Affine(), {"horizon": 1.7}),
    "measured nodes": (Memory(1), Affine(), {"measured_nodes": True}),
    "polynomial": (Memory(1), Polynomial(2, 2), {}),
    "continuous": (Memory(1), Continuous(), {"horizon": 1.7}),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_stopped_design_goes_on_to_the_same_numbers(oscillator, tmp_path, kind, same):
    memory, predictor, options = KINDS[kind]
    options = BASE | options | {"predictor": predictor}
    arguments, path = (oscillator, memory, ExactGaussian(), TIMES), tmp_path / "design"
    whole = synthesize(*arguments, **options)
    begun(path, *arguments, **options)
    size = path.stat().st_size
    assert same(whole, synthesize(*arguments, checkpoint=path, workers=2, **options))
    # a finished one has no states of paths any more, and is given at once
    assert path.stat().st_size < size / 4
    before = path.read_bytes()
    assert same(whole, synthesize(*arguments, checkpoint=path, **options))
    assert path.read_bytes() == before


def test_paths_that_were_left_out_stay_left_out(tmp_path, same):
    noise = Noise((v,))
    system = JumpDiffusion((x,), [x**3 - x], [[0.1]], [x + v], noise, [0], [[0.09]], step=0.05)
    arguments = system, Memory(1), ExactGaussian(), np.arange(7) * 0.5
    options = {"paths": 4000, "seed": 1, "bound": 5.0, "nodes": 1}
    with pytest.warns(UserWarning, match="paths"):
        whole = synthesize(*arguments, **options)
    begun(tmp_path / "design", *arguments, **options)
    with pytest.warns(UserWarning, match="paths"):
        found = synthesize(*arguments, checkpoint=tmp_path / "design", **options)
    assert same(whole, found)
    assert found.design.diverged == whole.design.diverged > 0


@pytest.fixture(scope="module")
def started(oscillator, tmp_path_factory):
    """File of a design with a step done."""
    path = tmp_path_factory.mktemp("started") / "begun"
    begun(path, oscillator, Memory(1), Taylor(), TIMES, **BASE)
    return path


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"paths": 9001}, "paths"),
        ({"seed": 6}, "seed"),
        ({"seed": np.random.SeedSequence(5).spawn(1)[0]}, "spawn_key"),
        ({"step": 0.04}, "options"),
        ({"nodes": 2}, "nodes"),
        ({"times": TIMES[:3]}, "times"),
        ({"memory": Memory(2)}, "memory"),
        ({"linearization": ExactGaussian()}, "linearization"),
        ({"predictor": Polynomial(1, 0)}, "predictor"),
        ({"components": 1}, "components"),
        ({"bound": 50.0}, "bound"),
        ({"measured_nodes": True}, "measured_nodes"),
        ({"measured": [0, 2, 3]}, "measured"),
        ({"system": zoo.van_der_pol("H")}, "system"),
    ],
)
def test_the_file_of_another_design_is_refused_and_kept(oscillator, started, changes, name):
    before = started.read_bytes()
    given = {"system": oscillator, "memory": Memory(1), "linearization": Taylor(), "times": TIMES}
    given |= BASE | changes
    first = [given.pop(key) for key in ("system", "memory", "linearization", "times")]
    with pytest.raises(ValueError, match=f"differs in .*{name}"):
        synthesize(*first, checkpoint=started, **given)
    assert started.read_bytes() == before


def test_last_digits_of_parameters_and_inputs_are_noticed(tmp_path):
    u = Input("u")

    def made(value, told):
        system = JumpDiffusion(
            (x,), [u - a * x], [[1]], [x + v], Noise((v,)), [0], [[1]], parameters={a: value},
            step=0.1,
        )  # fmt: skip
        return synthesize(
            system, Memory(1), Taylor(), [0, 0.5], paths=500, seed=1, inputs={u: [1.0, told]},
            checkpoint=tmp_path / "design",
        )  # fmt: skip

    made(1.0, 2.0)
    with pytest.raises(ValueError, match="system"):
        made(1.0 + 1e-13, 2.0)
    with pytest.raises(ValueError, match="input u"):
        made(1.0, 2.0 + 1e-13)


def test_damaged_and_other_files_are_refused(oscillator, started, tmp_path):
    content, path = started.read_bytes(), tmp_path / "design"
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 0x40
    for other in (bytes(flipped), content[: len(content) // 2], b"", b"a text"):
        path.write_bytes(other)
        with pytest.raises(ValueError, match="checkpoint"):
            synthesize(oscillator, Memory(1), Taylor(), TIMES, checkpoint=path, **BASE)
    odd = tmp_path / "odd.npz"
    np.savez(odd, x=np.zeros(3))
    with pytest.raises(ValueError, match="checkpoint"):
        synthesize(oscillator, Memory(1), Taylor(), TIMES, checkpoint=odd, **BASE)
    made = synthesize(oscillator, Memory(1), Taylor(), TIMES, **BASE)
    save(made, odd)
    with pytest.raises(ValueError, match="checkpoint"):
        synthesize(oscillator, Memory(1), Taylor(), TIMES, checkpoint=odd, **BASE)
    with pytest.raises(ValueError, match="seedslib"):
        load(started, oscillator)
    for folder in (tmp_path, tmp_path / "none" / "design"):
        with pytest.raises(ValueError, match="checkpoint"):
            synthesize(oscillator, Memory(1), Taylor(), TIMES, checkpoint=folder, **BASE)
