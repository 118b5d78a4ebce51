"""A design that is stopped and goes on: same numbers, and no other design's file is taken."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Affine, Continuous, Polynomial, synthesize
from seedslib.design.paths.checkpoint import Checkpoint
from seedslib.design.paths.walk import Walk
from seedslib.designed import Memory, load, save
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

TACTS = np.arange(4) * 0.5
BASE = {"paths": 9000, "seed": 5, "step": 0.05, "nodes": 1}


class Stopped(Exception):
    """The run ends here."""


@pytest.fixture
def stop(monkeypatch):
    """Make the design stop after a number of steps, once."""
    write = Checkpoint.write

    def after(steps):
        done = []

        def writing(self, forward, last):
            write(self, forward, last)
            done.append(last)
            if len(done) == steps:
                monkeypatch.setattr(Checkpoint, "write", write)
                raise Stopped

        monkeypatch.setattr(Checkpoint, "write", writing)

    return after


KINDS = {
    "affine": (Memory(2), Affine(), {}),
    "mixed memory": (Memory(1, 1), Affine(), {"components": 1}),
    "finite memory": (Memory(0, 2), Affine(), {"horizon": 1.7}),
    "measured nodes": (Memory(1), Affine(), {"measured_nodes": True}),
    "polynomial": (Memory(1), Polynomial(2, 2), {}),
    "continuous": (Memory(1), Continuous(), {"horizon": 1.7}),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("steps", [1, 2])
def test_a_stopped_design_goes_on_to_the_same_numbers(
    oscillator, tmp_path, stop, kind, steps, same
):
    memory, predictor, options = KINDS[kind]
    options = BASE | options | {"predictor": predictor}
    path = tmp_path / "design.part.npz"
    whole = synthesize(oscillator, memory, ExactGaussian(), TACTS, **options)
    stop(steps)
    with pytest.raises(Stopped):
        synthesize(oscillator, memory, ExactGaussian(), TACTS, checkpoint=path, **options)
    found = synthesize(
        oscillator, memory, ExactGaussian(), TACTS, checkpoint=path, workers=2, **options
    )
    assert same(whole, found)


@pytest.fixture
def moved(monkeypatch):
    """Times from which the design paths were moved on; the held-out ones are others."""
    starts, advance = [], Walk.advance

    def counted(self, start, stop):
        if sum(map(sum, self.counts)) == BASE["paths"]:
            starts.append(start)
        return advance(self, start, stop)

    monkeypatch.setattr(Walk, "advance", counted)
    return starts


def test_only_what_is_left_is_simulated(oscillator, tmp_path, stop, moved):
    path = tmp_path / "design"
    stop(2)
    with pytest.raises(Stopped):
        synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=path, **BASE)
    moved.clear()
    synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=path, **BASE)
    assert moved == [1.0, 1.25]


def test_a_finished_design_is_given_at_once(oscillator, tmp_path, moved, same):
    path = tmp_path / "design"
    whole = synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=path, **BASE)
    assert same(whole, synthesize(oscillator, Memory(1), Taylor(), TACTS, **BASE))
    # the states of 9000 paths are no longer in it, their marks are
    assert path.stat().st_size < 60_000
    before = path.read_bytes()
    moved.clear()
    assert same(whole, synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=path, **BASE))
    assert moved == []
    assert path.read_bytes() == before


SCRIPT = """
import time

import numpy as np
from seedslib.linearization import Taylor
from seedslib.designed import Memory, load, save
from seedslib.design import synthesize
from seedslib.models import JumpDiffusion
from seedslib import zoo

advance = JumpDiffusion.advance


def slow(*arguments, **options):
    time.sleep(0.1)
    return advance(*arguments, **options)


JumpDiffusion.advance = slow
synthesize(
    zoo.van_der_pol(), Memory(2), Taylor(), np.arange(24) * 0.5, paths=20_000, seed=3, nodes=0,
    step=0.05, checkpoint={path!r}, workers={workers},
)
"""


@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_process_loses_at_most_a_step(oscillator, tmp_path, workers, same):
    path = tmp_path / "design"
    running = subprocess.Popen(
        [sys.executable, "-c", SCRIPT.format(path=str(path), workers=workers)]
    )
    try:
        waited = time.monotonic() + 60
        while not path.exists() and time.monotonic() < waited:
            time.sleep(0.01)
        time.sleep(0.15)
    finally:
        os.kill(running.pid, signal.SIGKILL)
    assert running.wait() == -signal.SIGKILL
    with np.load(path) as file:
        assert "states/0" in file
        header = json.loads(file["header"].tobytes().decode())
    assert len(header["progress"]["found"]["node_fits"]) in range(1, 23)
    options = {"paths": 20_000, "seed": 3, "nodes": 0, "step": 0.05, "workers": workers}
    times = np.arange(24) * 0.5
    found = synthesize(oscillator, Memory(2), Taylor(), times, checkpoint=path, **options)
    assert same(found, synthesize(oscillator, Memory(2), Taylor(), times, **options))


def test_paths_that_were_left_out_stay_left_out(tmp_path, stop, same):
    x, v = sympy.symbols("x v")
    system = JumpDiffusion((x,), [x**3 - x], [[0.1]], [x + v], Noise((v,)), [0], [[0.09]])
    options = {"paths": 5000, "seed": 1, "bound": 5.0}
    times, path = np.arange(9) * 0.5, tmp_path / "design"
    with pytest.warns(UserWarning, match="diverged"):
        whole = synthesize(system, Memory(1), ExactGaussian(), times, **options)
    stop(7)
    with pytest.raises(Stopped):
        synthesize(system, Memory(1), ExactGaussian(), times, checkpoint=path, **options)
    with pytest.warns(UserWarning, match=f"{whole.design.diverged} of 5000"):
        found = synthesize(system, Memory(1), ExactGaussian(), times, checkpoint=path, **options)
    assert same(whole, found)


def test_layouts_of_array_functions_survive(tmp_path, stop, same):
    """States that are views with gaps: sums must run in the same order after a file."""

    def turned(t, x, v):
        wide = np.empty((x.shape[1], 4))
        wide[:, ::2] = (0.9 * x + np.array([[0.1], [-0.2]]) * np.sin(x[::-1]) + v).T
        return wide.T[::2]

    dynamics = StochasticMap.from_functions(2, 2, turned, Noise(2))
    sensor = StochasticMap.from_functions(2, 1, lambda t, x, v: x[:1] + v, Noise(1))
    system = DiscreteSystem(dynamics, sensor, [0, 0], np.eye(2))
    options, path = {"paths": 20_000, "seed": 1}, tmp_path / "design"
    whole = synthesize(system, Memory(1), Cubature(), np.arange(5), **options)
    stop(2)
    with pytest.raises(Stopped):
        synthesize(system, Memory(1), Cubature(), np.arange(5), checkpoint=path, **options)
    found = synthesize(system, Memory(1), Cubature(), np.arange(5), checkpoint=path, **options)
    assert same(whole, found)


@pytest.fixture
def begun(oscillator, tmp_path, stop):
    """File of a design with one step done."""
    path = tmp_path / "begun"
    stop(1)
    with pytest.raises(Stopped):
        synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=path, **BASE)
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"paths": 9001}, r"differs in paths \(9000 there, 9001 here\); remove"),
        ({"seed": 6}, r"differs in seed \(5 there, 6 here\); remove"),
        ({"seed": np.random.SeedSequence(5).spawn(1)[0]}, "differs in spawn_key"),
        ({"step": 0.04}, "differs in options; remove"),
        ({"nodes": 2}, r"differs in nodes; remove"),
        ({"times": TACTS[:3]}, r"differs in times .*, nodes .*; remove"),
        ({"memory": Memory(2)}, "differs in memory; remove"),
        ({"linearization": ExactGaussian()}, "differs in linearization"),
        ({"predictor": Polynomial(1, 0)}, "differs in predictor"),
        ({"components": 1}, r"components \(2 there, 1 here\)"),
        ({"bound": 50.0}, r"bound \(inf there, 50.0 here\)"),
        ({"measured_nodes": True}, "measured_nodes"),
        ({"system": zoo.van_der_pol("H")}, "differs in system"),
        ({"system": zoo.van_der_pol("C")}, "differs in system"),
    ],
)
def test_another_design_is_refused(oscillator, begun, changes, message):
    before = begun.read_bytes()
    given = {
        "system": oscillator, "memory": Memory(1), "linearization": Taylor(), "times": TACTS
    } | BASE | changes  # fmt: skip
    first = [given.pop(name) for name in ("system", "memory", "linearization", "times")]
    with pytest.raises(ValueError, match=message):
        synthesize(*first, checkpoint=begun, **given)
    assert begun.read_bytes() == before


def test_a_parameter_that_differs_in_its_last_digits_is_noticed(tmp_path):
    x, v, a = sympy.symbols("x v a")

    def model(value):
        return JumpDiffusion(
            (x,), [-a * x], [[1]], [x + v], Noise((v,)), [0], [[1]], parameters={a: value}
        )

    options = {"paths": 500, "seed": 1, "checkpoint": tmp_path / "design"}
    synthesize(model(1.0), Memory(1), Taylor(), [0, 0.5], **options)
    with pytest.raises(ValueError, match="differs in system"):
        synthesize(model(1.0 + 1e-13), Memory(1), Taylor(), [0, 0.5], **options)


def test_a_damaged_file_is_refused(oscillator, begun, same):
    """Every kind of damage is either noticed or without effect."""
    content = begun.read_bytes()
    whole = synthesize(oscillator, Memory(1), Taylor(), TACTS, **BASE)
    rng = np.random.default_rng(1)
    refused = 0
    for place in rng.integers(0, len(content), 24):
        flipped = bytearray(content)
        flipped[place] ^= 0x40
        begun.write_bytes(flipped)
        try:
            found = synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=begun, **BASE)
        except ValueError as error:
            assert "begun is damaged or something else" in str(error)  # noqa: PT017
            refused += 1
        else:
            assert same(whole, found)
    assert refused > 20
    for other in (content[: len(content) // 2], b"", b"PK\3\4", b"a text"):
        begun.write_bytes(other)
        with pytest.raises(ValueError, match="damaged or something else"):
            synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=begun, **BASE)


def test_another_archive_is_refused(oscillator, begun, rewrite):
    odd = begun.with_name("odd.npz")
    np.savez(odd, x=np.zeros(3))
    with pytest.raises(ValueError, match=r"odd.npz is damaged or something else"):
        synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=odd, **BASE)
    save(synthesize(oscillator, Memory(1), Taylor(), TACTS, **BASE), odd)
    with pytest.raises(ValueError, match="not a seedslib design in progress"):
        synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=odd, **BASE)
    with pytest.raises(ValueError, match="not a seedslib designed filter"):
        load(begun, oscillator)
    rewrite(begun, **{"filters/1/mean": None})
    with pytest.raises(ValueError, match=r"damaged or something else \('filters/1/mean'\)"):
        synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=begun, **BASE)


def test_what_a_killed_writer_left_is_no_obstacle(oscillator, begun, same):
    whole = synthesize(oscillator, Memory(1), Taylor(), TACTS, **BASE)
    left = begun.with_name(".begun.0123456789ab.part")
    left.write_bytes(b"half a file")
    found = synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=begun, **BASE)
    assert same(whole, found)
    assert set(begun.parent.iterdir()) == {begun, left}


def test_the_folder_must_exist(oscillator, tmp_path):
    for path in (tmp_path, tmp_path / "none" / "design"):
        with pytest.raises(ValueError, match="checkpoint: wanted a file in a folder that exists"):
            synthesize(oscillator, Memory(1), Taylor(), TACTS, checkpoint=path, **BASE)
