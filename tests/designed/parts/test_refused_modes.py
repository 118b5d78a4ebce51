"""What does not fit in a filter of modes, by the names of its parts; cells, orders and laws."""

import re

import numpy as np
import pytest

from seedslib import zoo
from seedslib.designed import Memory, SwitchingFilter
from seedslib.designed.arrivals import Arrivals
from seedslib.designed.memory import Past
from seedslib.designed.prediction import Prediction
from seedslib.designed.switching.fits import (
    CellFit,
    ClassFit,
    cell_count,
    cell_number,
    require_memory,
)
from seedslib.linearization import Taylor

TIMES = np.arange(3.0)


def put(parts, k, part):
    return (*parts[:k], part, *parts[k + 1 :])


def refused(message, kind=ValueError):
    return pytest.raises(kind, match=f"^{message}")


def cell_fit(n, d, modes, cells):
    unit = np.ones((modes, cells))
    return CellFit(
        np.log(unit / modes), np.zeros((d, modes, cells)), np.zeros((d, d, modes, cells)),
        np.zeros((n, d, modes, cells)), np.zeros((n, modes, cells)),
        np.eye(n)[:, :, None, None] * unit,
    )  # fmt: skip


TARGET = zoo.manoeuvring_target("noisy")  # two modes, two components, an indicator of two values


def test_laws_of_another_shape():
    """A memory of two estimates with log-odds, one measurement, one indicator, two modes."""
    memory = Memory(2, 1, 1, log_odds=True)
    fits = cell_fit(2, 4, 2, 4), cell_fit(2, 7, 2, 8)
    SwitchingFilter(TARGET, Taylor(), memory, times=TIMES, fits=fits)
    for k, (d, cells) in enumerate(((4, 4), (7, 8))):
        shapes = {
            "gain": (2, d, 2, cells), "offset": (2, 2, cells), "cov": (2, 2, 2, cells),
            "centre": (d, 2, cells), "white": (d, d, 2, cells), "log_weight": (2, cells),
        }  # fmt: skip
        for part, shape in shapes.items():
            bad = put(fits, k, fits[k]._replace(**{part: np.ones((3, 9, 5))}))
            told = re.escape(f"fits[{k}].{part}: wanted shape {shape}, got (3, 9, 5)")
            with refused(told):
                SwitchingFilter(TARGET, Taylor(), memory, times=TIMES, fits=bad)


def test_laws_of_another_number_or_kind():
    memory, fits = Memory(1), (cell_fit(2, 2, 2, 2),) * 2

    def make(fits, **more):
        more = {"memory": memory, "times": TIMES} | more
        return SwitchingFilter(TARGET, Taylor(), fits=fits, **more)

    never = fits[0].log_weight.copy()
    never[1, 0] = -np.inf  # a mode that is never met in a cell
    made = make((fits[0]._replace(log_weight=never), fits[1]))
    assert made.times is not TIMES
    assert not made.times.flags.writeable
    assert not made.fits[1].gain.flags.writeable
    assert made.clock.times == [0.0, 1.0, 2.0]
    bad = fits[0]._replace(cov=-fits[0].cov)
    with refused(r"fits\[1\]: wanted positive semidefinite covariances"):
        make((fits[0], bad))
    with refused(r"fits\[1\]: wanted something with forecast, got float", TypeError):
        make((fits[0], 0.5))
    with refused("fits: wanted 2, got 1"):
        make(fits[:1])
    with refused(r"fits\[1\]: wanted laws of classes for an availability only"):
        make((fits[0], ClassFit(fits[1])))
    with refused("times: wanted strictly increasing"):
        make(fits, times=[0.0, 2.0, 1.0])
    with refused("times: wanted the times of the design with a memory"):
        make(fits, times=None)
    with refused("cycle: wanted 0 to 2 of the steps, got 3"):
        make(fits, cycle=3)
    with refused("memory: wanted a Memory, got 1", TypeError):
        make(fits, memory=1)
    held = Prediction(TIMES, np.ones((3, 1)), np.ones((3, 2)))
    with refused(r"predicted\.error: wanted shape \(3, 1\)"):
        make(fits, predicted=held)
    with pytest.raises(TypeError, match=r"^system: wanted a SwitchingSystem"):
        SwitchingFilter(zoo.linear_gaussian(), Taylor())
    with pytest.raises(TypeError, match=r"^linearization: "):
        SwitchingFilter(TARGET, "taylor")


def test_classes_have_cells_of_their_own():
    """The classes after a measurement times the cells of its memory."""
    spread = np.ones((1, 2, 2, 2)) * np.eye(2)
    two = np.ones((2, 2, 2)) * np.eye(2)
    first = Arrivals(np.array([[1, 0]]), spread, two[:1], two, np.array([0.5, 0.5]),
                     np.ones((2, 2)))  # fmt: skip
    later = Arrivals(np.array([[0, 1], [1, 1]]), np.concatenate([spread, spread]), two, two,
                     np.array([0.5, 0.5]), np.ones((2, 2)))  # fmt: skip
    options = {"times": TIMES, "availability": np.array([0.5, 1.0]), "arrivals": (first, later,
               later)}  # fmt: skip
    # the classes before the next measurement are those after this one
    fits = (ClassFit(cell_fit(2, 2, 2, 4)),) * 2

    def make(fits):
        return SwitchingFilter(TARGET, Taylor(), Memory(1), fits=fits, **options)

    make(fits)
    with refused(r"fits\[1\]: wanted laws of classes for an availability only"):
        make((fits[0], fits[1].fit))
    with refused(re.escape("fits[0].gain: wanted shape (2, 2, 2, 4), got (2, 2, 2, 6)")):
        make((ClassFit(cell_fit(2, 2, 2, 6)), fits[1]))


def test_cells_are_numbered_newest_first():
    """Decided modes as digits to the base of three, then indicators as those of another base."""
    past = Past(modes=(np.array([2, 0]), np.array([1, 2])), indicators=(np.array([3, 1]),))
    number = cell_number(past, 3, 4, (2,))
    assert number.dtype.kind == "i"
    assert number.tolist() == [(2 * 3 + 1) * 4 + 3, (0 * 3 + 2) * 4 + 1]
    none = cell_number(Past(), 3, 4, (2, 3))
    assert none.shape == (2, 3)
    assert none.dtype.kind == "i"
    assert not none.any()
    memory = Memory(2, 0, 3)
    assert [cell_count(memory, TARGET, k) for k in range(4)] == [4, 16, 32, 32]
    assert cell_count(Memory(0, 2), TARGET, 1) == 1
    require_memory(memory, TARGET)
    require_memory(Memory(1, log_odds=True), TARGET)
    plain = zoo.scalar_switching("A1H")
    with refused("memory: wanted no indicators, the system has"):
        require_memory(memory, plain)


def test_orders_count_all_that_is_remembered():
    """Two components, one measured, two modes: numbers, modes and indicators."""
    assert SwitchingFilter(TARGET, Taylor()).order == 2 * (1 + 2 + 3) - 1
    for memory, d, cells, order in (
        (Memory(1), 2, 2, 3),
        (Memory(0, 1, 1), 1, 2, 2),
        (Memory(1, 1, 1, log_odds=True), 4, 4, 6),
    ):
        fits = (cell_fit(2, d, 2, cells),) * 2
        assert SwitchingFilter(TARGET, Taylor(), memory, times=TIMES, fits=fits).order == order


def test_a_law_of_the_memory_for_any_axes_of_paths():
    """(6.32) to (6.34) in numbers: two cells, two modes, two remembered numbers."""
    rng = np.random.default_rng(2)
    fit = CellFit(
        rng.normal(size=(2, 2)), rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 2, 2)),
        rng.normal(size=(1, 2, 2, 2)), rng.normal(size=(1, 2, 2)), rng.uniform(size=(1, 1, 2, 2)),
    )  # fmt: skip
    lone = CellFit(*(part[..., :1] for part in fit))
    for batch in ((), (3,), (2, 3)):
        cell, z = rng.integers(0, 2, batch), rng.normal(size=(2, *batch))
        for law, cells in ((fit.forecast(cell, z), cell), (lone.forecast(cell, z), 0 * cell)):
            assert law.mean.shape == (1, 2, *batch)
            assert law.cov.shape == (1, 1, 2, *batch)
            for path in np.ndindex(*batch):
                c, at = cells[path], z[:, *path]
                score = np.empty(2)
                for i in range(2):
                    apart = fit.white[:, :, i, c] @ (at - fit.centre[:, i, c])
                    score[i] = fit.log_weight[i, c] - 0.5 * apart @ apart
                    mean = fit.gain[0, :, i, c] @ at + fit.offset[0, i, c]
                    assert law.mean[0, i, *path] == pytest.approx(mean, rel=1e-12)
                    assert law.cov[0, 0, i, *path] == fit.cov[0, 0, i, c]
                wanted = np.exp(score) / np.exp(score).sum()
                np.testing.assert_allclose(law.prob[:, *path], wanted, rtol=1e-12)
