"""The check cell of a notebook: bad parameters are refused before anything is computed."""

import math

import numpy as np
import pytest

from bookkit import check, choice, flag, integer, real, reals

FIELDS = {
    "a": real(lt=0),
    "n": integer(ge=1),
    "kind": choice("exact", "approximate"),
    "quick": flag(),
    "q": reals(gt=0),
}


def test_good_parameters_pass():
    space = {"a": -1, "n": 3, "kind": "exact", "quick": True, "q": [0.1, 2], "other": object()}
    assert check(space, **FIELDS) is None


def test_all_faults_stand_in_one_message():
    space = {"a": 0.5, "n": 2.0, "kind": "guess", "quick": 1, "q": [0.1, -2.0]}
    with pytest.raises(ValueError, match="bad parameters") as caught:
        check(space, absent=real(), **FIELDS)
    for part in ("a = 0.5", "n = 2.0", "kind = 'guess'", "quick = 1", "q.1 = -2.0", "absent"):
        assert part in str(caught.value)
    with pytest.raises(ValueError, match="at least one"):
        check(space)


@pytest.mark.parametrize("bad", [math.nan, math.inf, True, "1.0", None, np.array([1.0])])
def test_what_is_not_a_finite_number_is_refused(bad):
    for kind in (real(), integer()):
        with pytest.raises(ValueError, match="a = "):
            check({"a": bad}, a=kind)
