"""References of the exact switching filter that were typed from elsewhere, computed again."""

from pathlib import Path

import numpy as np
import pytest

from bookkit.claims import LEDGER, read_ledger
from oracles.exact_order_one import errors

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
