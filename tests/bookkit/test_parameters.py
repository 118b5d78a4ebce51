import math

import numpy as np
import pytest

from bookkit import check, choice, flag, integer, real, reals


def test_good_parameters_pass_silently():
    space = {"a": -1.0, "n": 3, "kind": "exact", "quick": True, "q": [0.1, 2], "other": object()}
    fields = {
        "a": real(lt=0),
        "n": integer(ge=1),
        "kind": choice("exact", "approximate"),
        "quick": flag(),
        "q": reals(gt=0),
    }
    assert check(space, **fields) is None


def test_a_whole_number_is_a_real_one():
    check({"a": 2}, a=real(gt=0))


def test_all_faults_stand_in_one_message():
    space = {"a": 0.5, "n": 2.0, "kind": "guess", "quick": 1, "q": [0.1, -2.0]}
    with pytest.raises(ValueError, match="bad parameters") as caught:
        check(
            space,
            a=real(lt=0),
            n=integer(ge=1),
            kind=choice("exact"),
            quick=flag(),
            q=reals(gt=0),
            absent=real(),
        )
    message = str(caught.value)
    for part in ("a = 0.5", "less than 0", "n = 2.0", "kind = 'guess'", "quick = 1", "q.1 = -2.0"):
        assert part in message
    assert "absent is not set" in message


@pytest.mark.parametrize("bad", [math.nan, math.inf, True, "1.0", None, np.array([1.0])])
def test_what_is_not_a_finite_real_is_refused(bad):
    with pytest.raises(ValueError, match="a = "):
        check({"a": bad}, a=real())


@pytest.mark.parametrize("bad", [1.5, True, "3"])
def test_what_is_not_a_whole_number_is_refused(bad):
    with pytest.raises(ValueError, match="n = "):
        check({"n": bad}, n=integer())


def test_a_check_of_nothing_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        check({"a": 1.0})
