"""Switching filters, computed again by programs that do not use the library.

`oracles/exact_switching.py` has the exact filter of order 1 on grids, `oracles/switching_design.py`
and `oracles/dependent_noises.py` filters with Gaussian functions, designed on simulated paths.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bookkit.claims import LEDGER, read_ledger
from bookkit.recording import read_verdicts
from oracles import dependent_noises
from oracles.exact_switching import errors
from oracles.switching_design import Filter, Scalar, Target, averages, scores, simulated
from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter, finite_memory
from seedslib.linearization import ExactGaussian

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = {claim.id: claim for claim in read_ledger(ROOT / LEDGER)}
BEYOND = 4.0  # standard errors


@pytest.mark.parametrize(
    ("sensor", "place", "grid"),
    [("A1H", 0, (65, 181, 81)), ("A1L", 2, (81, 201, 101)), ("A2", 4, (81, 201, 151))],
)
def test_errors_of_the_exact_filter_of_order_one(sensor, place, grid):
    squares, wrong = errors(sensor, 31, *grid)
    found = np.sqrt(squares[10:].mean()), wrong[10:].mean()
    wanted = CLAIMS["SW-X1"].reference[place : place + 2]
    assert np.allclose(found, wanted, rtol=0, atol=CLAIMS["SW-X1"].widths[0])


def test_errors_at_the_first_two_measurements():
    found = [np.sqrt(errors(sensor, 1)[0][0]) for sensor in ("A1H", "A1L", "A2")]
    found.append(np.sqrt(errors("A1H", 2, estimates=321)[0][1]))
    assert np.allclose(found, CLAIMS["SW-X4"].reference, rtol=0, atol=CLAIMS["SW-X4"].widths[0])


def test_errors_with_dependent_noises():
    data = dependent_noises.simulated(21, 2000, 4)
    fits = dependent_noises.run(dependent_noises.simulated(21, 2000, 5), design=True)[2]
    runs = [
        dependent_noises.bayes(data),
        dependent_noises.run(data, printed=True),
        dependent_noises.run(data),
        dependent_noises.run(data, fits=fits),
    ]
    value, doubt = np.array([averages(scores(found, data, 5)) for found in runs]).swapaxes(0, 1)
    (entry,) = read_verdicts(ROOT)["SW-X10"].values()
    for wanted in (CLAIMS["SW-X10"].reference, entry["computed"]):
        assert np.all(np.abs(value.ravel() - wanted) < BEYOND * np.sqrt(2) * doubt.ravel())


FILTERS = {
    "IMM": ({}, None),
    "order 1": ({"estimates": 1}, Memory(1)),
    "two measurements": ({"measurements": 2}, finite_memory(2)),
    "order 1, log-odds": ({"estimates": 1, "odds": True}, Memory(1, log_odds=True)),
}


@cache
def compared(name):
    """Squared errors and wrong modes of filters by both programs, on the same 2000 paths."""
    if name == "target":
        theirs, ours = Target("noisy"), zoo.manoeuvring_target("noisy")
    else:
        theirs, ours = Scalar(name), zoo.scalar_switching(name)
    times = np.arange(21)
    modes, x, y, told = simulated(theirs, len(times), 2000, 21)
    found = {}
    for label, (kept, memory) in FILTERS.items():
        other = Filter(theirs, **kept)
        if memory is None:
            mine = SwitchingFilter(ours, ExactGaussian())
        else:
            if name == "target" and memory.measurements:
                memory = Memory(0, 2, 2)  # with the indicators of both
            other = other.designed(5000, 24, len(times))
            mine = synthesize(ours, memory, ExactGaussian(), times, nodes=0, paths=5000, seed=5)
        result = mine.run(times, y[:, None], indicators=told if name == "target" else None)
        pairs = [(result.mean, result.modes), other.run((modes, x, y, told))[1::-1]]
        found[label] = [
            (((mean - x) ** 2)[5:].sum(axis=1).mean(axis=0), (mode != modes)[5:].mean(axis=0))
            for mean, mode in pairs
        ]
    return found


@pytest.mark.filterwarnings("ignore::UserWarning")  # modes that few paths of a design are in
@pytest.mark.parametrize("name", ["A1H", "A2", "target"])
@pytest.mark.parametrize("label", FILTERS)
def test_filters_with_gaussian_functions(name, label):
    """Paired; each design has random numbers of its own, which are worth as much as the paths."""
    mine, theirs = compared(name)[label]
    for a, b in zip(mine, theirs, strict=True):
        apart = a - b
        width = BEYOND * np.sqrt(2) * max(apart.std(), 0.1 * a.std()) / np.sqrt(len(a))
        assert abs(apart.mean()) < width


def test_filters_with_another_memory_are_told_apart():
    found = compared("target")
    for label, other in (("order 1", "two measurements"), ("order 1", "IMM")):
        a, b = found[label][0][0], found[other][1][0]
        assert abs((a - b).mean()) > BEYOND * (a - b).std() / np.sqrt(len(a))
