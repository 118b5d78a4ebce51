"""References of the exact switching filter that were typed from elsewhere, computed again."""

from pathlib import Path

import numpy as np
import pytest

from bookkit.claims import LEDGER, read_ledger
from oracles.exact_order_one import errors, remembered

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = {claim.id: claim for claim in read_ledger(ROOT / LEDGER)}


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


@pytest.mark.parametrize("length", [1, 2])
@pytest.mark.parametrize(("sensor", "place"), [("A1H", 0), ("A1L", 2), ("A2", 4)])
def test_errors_of_the_exact_filters_that_remember_measurements(sensor, place, length):
    """By sums over all measurements; from k = 20 to 30 nothing changes."""
    place += 6 * (length - 1)
    nodes = 61 if sensor == "A1H" else 81
    course = np.array([remembered(sensor, length, k, measurements=nodes) for k in range(10, 21)])
    square, wrong = np.average(course, axis=0, weights=[1] * 10 + [11])
    found = np.sqrt(square), wrong
    wanted = CLAIMS["SW-X3"].reference[place : place + 2]
    assert np.allclose(found, wanted, rtol=0, atol=CLAIMS["SW-X3"].widths[0])
