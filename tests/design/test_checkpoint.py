"""A design that is stopped and goes on: the same numbers, and no other design's file is taken."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import Affine, Continuous, Crew, Polynomial, synthesize
from seedslib.designed import Memory, load, save
from seedslib.linearization import ExactGaussian, Taylor

TIMES = np.arange(4) * 0.5
BASE = {"paths": 9000, "seed": 5, "step": 0.1, "nodes": 1}


@pytest.fixture
def same():
    """Whether two designs agree bit by bit."""

    def agree(one, two):
        parts = []
        for filter in (one, two):
            fits = [*filter.fits, *(fit for row in filter.node_fits for fit in row)]
            parts.append(
                [filter.start.mean, filter.start.cov, *filter.start.moments, *filter.predicted]
                + [np.asarray(part) for fit in fits for part in fit]
                + [part for part in filter.held_out or () if part is not None]
            )
        equal = (np.array_equal(a, b) for a, b in zip(*parts, strict=True))
        return all(equal) and one.design == two.design

    return agree


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


KINDS = [
    (Memory(1, 1), Affine(), {"measured_nodes": True}),
    (Memory(0, 2), Polynomial(2, 2), {"components": 1}),
    (Memory(1), Continuous(), {"horizon": 1.7}),
]


@pytest.mark.parametrize(("memory", "predictor", "options"), KINDS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_stopped_design_goes_on_to_the_same_numbers(
    oscillator, tmp_path, memory, predictor, options, same
):
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
        ({"step": 0.04}, "options"),
        ({"linearization": ExactGaussian()}, "linearization"),
        ({"predictor": Polynomial(1, 0)}, "predictor"),
        ({"bound": 50.0}, "bound"),
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


def test_damaged_and_other_files_are_refused(oscillator, started, tmp_path):
    content, odd = started.read_bytes(), tmp_path / "odd.npz"
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 0x40
    save(synthesize(oscillator, Memory(1), Taylor(), TIMES, **BASE), odd)
    for other in (bytes(flipped), content[: len(content) // 2], b"a text", odd.read_bytes()):
        odd.write_bytes(other)
        with pytest.raises(ValueError, match="checkpoint"):
            synthesize(oscillator, Memory(1), Taylor(), TIMES, checkpoint=odd, **BASE)
    with pytest.raises(ValueError, match="seedslib"):
        load(started, oscillator)
    with pytest.raises(ValueError, match="checkpoint"):
        synthesize(oscillator, Memory(1), Taylor(), TIMES, checkpoint=tmp_path, **BASE)
