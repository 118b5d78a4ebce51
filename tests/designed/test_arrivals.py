"""Classes of histories and gaps, each rule by itself on small tables."""

from types import SimpleNamespace

import numpy as np
import pytest

from seedslib.designed.arrivals import Arrivals, check_arrivals, number_of, ways
from seedslib.designed.gaps import (
    check_schedule,
    dropouts,
    expected,
    law_unclaimed,
    missing,
    step_unclaimed,
    unclaimed,
    unexpected,
)
from seedslib.filters.estimates import Estimates
from seedslib.linearization import Moments

NAN = np.nan


def cov(*deviations):
    d = np.array(deviations)
    return np.outer(d, d) * (0.3 + 0.7 * np.eye(len(d)))


def arrivals():
    """Two classes before and three after it, four patterns, two components."""
    after = np.stack([cov(1.0, 3.0), cov(2.0, 5.0), cov(4.0, 7.0)])
    return Arrivals(
        np.array([[2, 1, 1, 0], [2, 2, 1, 0]]),
        np.stack([np.stack([cov(k + 2.0, p + 3.0) for p in range(4)]) for k in range(2)]),
        np.stack([cov(6.0, 5.0), cov(8.0, 9.0)]),
        after, np.array([0.5, 0.3, 0.2]), np.array([[4.0, 9.0], [1.0, 0.0], [8.0, 7.0]]),
    )  # fmt: skip


def test_classes_that_fit_pass():
    arrivals().check("name", 2, 4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"prob": np.ones((3, 1))}, "name.prob: wanted shape"),
        ({"prob": np.ones(2)}, "name.after: wanted shape"),
        ({"after": np.ones((3, 3, 2))}, "name.after: wanted shape"),
        ({"after": np.ones((3, 2, 3))}, "name.after: wanted shape"),
        ({"claimed": np.ones((2, 2))}, "name.claimed: wanted shape"),
        ({"claimed": np.ones((3, 3))}, "name.claimed: wanted shape"),
        ({"before": np.ones((2, 3, 2))}, "name.before: wanted shape"),
        ({"before": np.ones((2, 2, 3))}, "name.before: wanted shape"),
        ({"before": np.ones((3, 2, 2))}, "name.covs: wanted shape"),
        ({"covs": np.ones((3, 4, 2, 2))}, "name.covs: wanted shape"),
        ({"covs": np.ones((2, 5, 2, 2))}, "name.covs: wanted shape"),
        ({"covs": np.ones((2, 4, 3, 2))}, "name.covs: wanted shape"),
        ({"covs": np.ones((2, 4, 2, 3))}, "name.covs: wanted shape"),
        ({"table": np.zeros((2, 3), dtype=int)}, "name.table: wanted classes of shape"),
        ({"table": np.zeros((3, 4), dtype=int)}, "name.table: wanted classes of shape"),
        ({"table": np.zeros((2, 4))}, "name.table: wanted classes of shape"),
        ({"table": np.full((2, 4), 3)}, "name.table: wanted classes below 3"),
        ({"table": np.full((2, 4), -1)}, "name.table: wanted classes below 3"),
        ({"covs": -arrivals().covs}, "name: wanted positive semidefinite"),
        ({"before": -arrivals().before}, "name: wanted positive semidefinite"),
        ({"after": -arrivals().after}, "name: wanted positive semidefinite"),
    ],
)
def test_classes_that_do_not_fit_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        arrivals()._replace(**change).check("name", 2, 4)


@pytest.mark.parametrize("name", ["prob", "after", "claimed", "before", "covs"])
def test_classes_are_numbers(name):
    with pytest.raises(TypeError, match=f"name.{name}: wanted an array of float64, got int64"):
        arrivals()._replace(**{name: np.ones(3, dtype=int)}).check("name", 2, 4)


def test_claimed_deviations_are_scaled_to_those_of_the_design():
    """By the root of actual over claimed variance; one where nothing is claimed."""
    found = arrivals().scale(np.array([[0, 2], [1, 1]]))
    wanted = np.array([[0.5, 2.0, np.sqrt(2.0)], [1.0, 1.0, np.sqrt(7.0)]])
    np.testing.assert_allclose(found, wanted[:, [[0, 2], [1, 1]]])
    np.testing.assert_allclose(arrivals().scale(2), wanted[:, 2])


@pytest.mark.parametrize("parts", [0, 1, 3])
def test_classes_have_a_column_for_each_pattern(parts):
    availability = np.array([1.0, *np.full(parts, 0.6), 0.0])
    one = arrivals()
    columns = 2**parts
    one = one._replace(
        table=np.resize(one.table, (2, columns)),
        covs=np.stack([np.stack([cov(2.0, 3.0)] * columns)] * 2),
    )
    steps = (one, one) if parts else ()
    filter = SimpleNamespace(availability=availability, times=np.arange(2.0), arrivals=steps)
    check_arrivals(filter, 2)
    for other in [(one,), (one, one, one)] if parts else [(one,), (one, one)]:
        filter.arrivals = other
        with pytest.raises(ValueError, match="arrivals: wanted those of 2 steps"):
            check_arrivals(filter, 2)
    if parts:
        filter.arrivals = (one, one._replace(covs=one.covs[:, :-1]))
        with pytest.raises(ValueError, match=r"arrivals\[1\].covs: wanted shape"):
            check_arrivals(filter, 2)
    filter.availability, filter.arrivals = None, ()
    check_arrivals(filter, 2)


def test_classes_are_joined_by_the_nearest_covariances():
    first, second = arrivals(), arrivals()
    # the classes after the first one are those before the second, in another order
    other = second._replace(before=first.after[[2, 0, 1]] * 1.01)
    own = first._replace(before=first.after, table=np.array([[0, 1, 2, 0]] * 3))
    near = np.array([1, 2, 0])
    found = ways((first, other), 0)
    np.testing.assert_array_equal(found[0], near[first.table])
    np.testing.assert_array_equal(found[1], other.table)
    found = ways((first, own, other), 2)
    assert len(found) == 3
    np.testing.assert_array_equal(found[0], first.table)  # the same covariances: the same classes
    np.testing.assert_array_equal(found[1], near[own.table])
    np.testing.assert_array_equal(found[2], other.table)  # back to `own`, two before the end
    found = ways((first, own, other), 1)
    np.testing.assert_array_equal(found[2], near[other.table])
    assert ways((), 0) == ways((), 1) == ()


def test_number_of_a_pattern():
    """The sum of 2^i over what is there, of the components that may be missing."""
    filter = SimpleNamespace(availability=np.array([0.5, 1.0, 0.3, 0.9]))
    y = np.array([[1.0, NAN, NAN], [1.0, NAN, 2.0], [NAN, 2.0, NAN], [3.0, 4.0, NAN]])
    assert number_of(filter, y, None).tolist() == [5, 6, 0]
    indicator = np.array([-1, 0, 3])
    assert number_of(filter, y[:3], indicator).tolist() == [1, 6, 4]


# Gaps


def test_where_something_was_missing():
    y = np.ones((4, 2, 3))
    all_there = np.ones(4, dtype=bool)
    assert dropouts(y, all_there, None) is None
    assert dropouts(y, all_there, np.zeros((4, 3), dtype=int)) is None
    y[1, 1, 0] = y[3, 0, 2] = NAN
    lost = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 1]], dtype=bool)
    found = dropouts(y, all_there, None)
    assert found.dtype == bool
    np.testing.assert_array_equal(found, lost)
    told = np.array([[0, 0, 0], [1, 2, 1], [0, -1, 0], [0, 0, 0]])
    lost[2:, 1] = True
    np.testing.assert_array_equal(dropouts(y, all_there, told), lost)
    np.testing.assert_array_equal(dropouts(np.ones_like(y), all_there, told)[:, 1], lost[:, 1])
    # what the design has no measurement of cannot be missing
    lost[1:, 0] = False
    np.testing.assert_array_equal(dropouts(y, np.array([1, 0, 1, 1], dtype=bool), told), lost)


def test_what_may_be_missing_is_no_gap():
    y = np.array([[[1.0, NAN], [NAN, NAN]], [[1.0, 2.0], [NAN, 4.0]], [[NAN, 1.0], [1.0, 1.0]]])
    may = np.array([[True, True], [True, True], [True, True]])
    must = np.array([[True, False], [True, False], [True, True]])
    both = np.stack([may, must])
    measured = np.ones(3, dtype=bool)
    found = dropouts(y, measured, None, both)
    assert found.tolist() == [[False, True], [False, True], [True, True]]
    # of the design's own times only: a row without measurement has nothing to be missing
    found = dropouts(y, np.array([False, True, True]), None, both)
    assert found.tolist() == [[False, False], [False, False], [True, False]]
    assert dropouts(np.ones((3, 2, 2)), measured, None, both).any() == False  # noqa: E712


def test_what_the_schedule_leaves_out_is_refused():
    y = np.array([[[1.0], [NAN]], [[NAN], [2.0]]])
    both = np.array([[[True, False], [True, False]]] * 2)
    with pytest.raises(ValueError, match=r"^y: .* got component 1 of a measurement .* in row 1$"):
        missing("y", y, None, both)
    with pytest.raises(ValueError, match=r"got component 1 of a measurement without it$"):
        missing("y", y[1:], None, both[:, 1:])
    # an indicator is the last component
    assert missing("y", y[:1, :1], np.array([[-1]]), both[:, :1]).tolist() == [[False]]
    with pytest.raises(ValueError, match="got component 1 of"):
        missing("y", y[:1, :1], np.array([[0]]), both[:, :1])


def scheduled(**parts):
    plain = {"measured": None, "availability": None, "schedule": (None, None), "fits": ()}
    return SimpleNamespace(**plain | parts)


def test_what_a_design_expects():
    assert expected(scheduled(), np.arange(3)) is None
    mask = np.array([[True, False, True], [True, True, True]])
    filter = scheduled(measured=mask, schedule=(mask, None), served=lambda k: k % 2)
    found = expected(filter, np.array([0, 1, 3]))
    np.testing.assert_array_equal(found, [mask[[0, 1, 1]]] * 2)
    rate = np.array([0.4, 1.0, 0.0])
    filter = scheduled(availability=rate, schedule=(mask, rate), served=lambda k: k % 2)
    may, must = expected(filter, np.array([2, 1]))
    assert may.tolist() == [[True, False, False], [True, True, False]]
    assert must.tolist() == [[False, False, False], [False, True, False]]


def test_a_mask_of_another_shape_is_refused():
    mask = np.ones((2, 3), dtype=bool)
    check_schedule(scheduled(measured=mask, schedule=(mask, None)))
    with pytest.raises(ValueError, match=r"measured: wanted a mask of shape \(2, 3\)"):
        check_schedule(scheduled(measured=mask[:1], schedule=(mask, None)))


def state(gap, **parts):
    return SimpleNamespace(gap=gap, **parts)


def test_moments_after_a_gap_are_their_mean_alone():
    moments = Moments(np.ones((2, 3)), np.ones((2, 2)), np.ones((2, 2, 3)))
    assert unexpected(moments, state(False)) is moments
    found = unexpected(moments, state(np.array([True, False, True])))
    np.testing.assert_array_equal(found.mean, moments.mean)
    for part in (found.cross, found.cov):
        assert part.shape == (2, 2, 3)
        assert np.isnan(part[..., [0, 2]]).all()
        assert (part[..., 1] == 1.0).all()


class Step(SimpleNamespace):
    def _replace(self, **parts):
        return Step(**{**vars(self), **parts})


@pytest.mark.parametrize("rule", ["step", "law"])
def test_a_gap_takes_the_covariance_now_and_the_likelihood_after_it(rule):
    had, now = np.array([True, False, False]), np.array([False, True, False])
    spread = np.arange(12.0).reshape(2, 2, 3)
    loglik = np.array([0.1, 0.2, 0.3])
    if rule == "step":
        found = Step(cov=spread, loglik=loglik, gap=False)
        assert step_unclaimed(found, state(False), False) is found
        assert step_unclaimed(found, state(had & now), now & had) is found
        made = step_unclaimed(found, state(had), now)
        law = made.cov
    else:
        found = Step(law=Step(cov=spread), loglik=loglik, gap=False)
        assert law_unclaimed(found, state(False), False) is found
        made = law_unclaimed(found, state(had), now)
        law = made.law.cov
    assert np.isnan(law[..., :2]).all()
    np.testing.assert_array_equal(law[..., 2], spread[..., 2])
    np.testing.assert_array_equal(made.loglik, [NAN, 0.2, 0.3])
    np.testing.assert_array_equal(made.gap, had | now)


def test_runs_claim_nothing_from_a_gap_on():
    times = np.array([0.0, 0.5, 2.0])
    lost = np.array([[False, False], [True, False], [True, False]])
    spread, loglik = np.ones((3, 2, 2)), np.ones((3, 2))
    found = Estimates(np.zeros((3, 2, 2)), spread, loglik=loglik)
    assert unclaimed(found, None, times) is found
    with pytest.warns(UserWarning, match=r"1 of 2 records have gaps, from 0.5 on"):
        made = unclaimed(found, lost, times)
    np.testing.assert_array_equal(made.loglik, [[1, 1], [1, 1], [NAN, 1]])
    wanted = np.ones((3, 2, 2, 2))
    wanted[1:, ..., 0] = NAN
    np.testing.assert_array_equal(made.cov, wanted)
    # a gap at the end leaves the likelihoods, and without covariances there is nothing to say
    alone = found._replace(cov=None)
    made = unclaimed(alone, np.array([[False, False]] * 2 + [[False, True]]), times)
    assert made.cov is None
    assert made.loglik is loglik
