"""The library's values lie as near to the exact ones as has been proved."""

import json

import pytest

from certified.comparison import errors, rows
from certified.enclosures import Fraction, exact

BOUNDS = {row["function"]: float(row["largest proved error"]) for row in rows("functions.csv")}
STORED = rows("enclosures.csv")


def test_no_error_is_larger_than_has_been_proved():
    """Another processor adds in another order: twice the stored error, or four last places."""
    found = list(errors())
    assert len(found) == len(STORED)
    worse = [row for row in found if not row[-1] <= max(2 * BOUNDS[row[0]], 2.0**-50)]
    assert not worse, worse
    assert {function for function, *_ in found} == set(BOUNDS)


@pytest.mark.parametrize("function", BOUNDS)
def test_the_stored_numbers_are_those_of_the_program(function):
    """Balls for the last case, made again: the exact values are within the stored radius."""
    from certified import enclosures

    last = max(int(row["case"]) for row in STORED if row["function"] == function)
    case = [row for row in STORED if (row["function"], row["case"]) == (function, str(last))]
    found = getattr(enclosures, function)(**json.loads(case[0]["arguments"]))
    assert [*found] == [row["quantity"] for row in case]
    for row in case:
        values, _ = found[row["quantity"]]
        radius = exact(row["radius"])
        assert Fraction(row["radius"]) < 1e-23
        for text, value in zip(row["values"].split(), values, strict=True):
            assert abs(value - exact(text)) < radius
