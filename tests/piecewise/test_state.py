"""What a state tells: bounds of errors, branches that matter; noise that is refused."""

import warnings

import numpy as np
import pytest

from oracles import piecewise_routes as routes
from seedslib.piecewise import PiecewiseLinearFilter
from seedslib.piecewise.coefficients import Coefficients
from seedslib.piecewise.state import check_noise, lost_mass

INF = np.inf


def test_one_step_of_the_lost_mass():
    """(lost e^(r + d) + delta e^d) / (1 - delta e^d), r the logarithm of the ratio J / c."""
    lost, share = np.array([0.0, 0.02, 0.5]), np.array([0.1, 0.0, 0.2])
    distance, ratio = np.array([0.3, 0.2, 1.0]), np.array([5.0, -1.0, 2.0])
    factor = np.exp(distance)
    wanted = (lost * np.exp(ratio) * factor + share * factor) / (1 - share * factor)
    np.testing.assert_allclose(lost_mass(lost, share, distance, ratio), wanted, rtol=1e-14)


@pytest.mark.parametrize(
    ("share", "distance"), [(1.0, 0.0), (0.5, np.log(2.0)), (0.5, 1.0), (0.0, INF), (1e-300, 800.0)]
)
def test_nothing_is_bounded_once_all_may_have_been_dropped(share, distance):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lost_mass(np.array([0.0, 0.1]), np.array(share), np.array(distance), np.zeros(2))
    assert found.tolist() == [INF, INF]


def test_what_was_never_lost_does_not_grow_and_what_was_may_without_bound():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lost_mass(np.array([0.0, 0.1]), np.zeros(2), np.zeros(2), np.full(2, 800.0))
    assert found.tolist() == [0.0, INF]


def state(**changes):
    start = PiecewiseLinearFilter(routes.tent()).initial((2,))
    return start._replace(**{name: np.array(part) for name, part in changes.items()})


def test_the_bound_of_the_error_is_that_of_pruning_and_of_merging():
    """lost / (1 + lost) and tanh(d / 4)."""
    found = state(lost=[0.25, 0.0], distance=[0.0, 2.0]).error_bound
    np.testing.assert_allclose(found, [0.2, np.tanh(0.5)], rtol=1e-15)
    assert state(lost=[3.0, INF], distance=[0.0, 0.0]).error_bound.tolist() == [0.75, 1.0]


def test_branches_whose_weight_reaches_a_threshold():
    found = state(weights=[[0.5, 0.25], [0.25, 0.375], [0.25, 0.375]])
    assert found.noticeable(0.5).tolist() == [3, 3]
    assert found.noticeable(0.75).tolist() == [1, 2]
    assert found.noticeable(0.3, relative=False).tolist() == [1, 2]
    assert found.noticeable(0.25, relative=False).tolist() == [3, 3]


def sensor(*roots):
    """Sensor of two components whose noise has the given root in each cell."""
    noise = np.stack(roots, axis=2)[..., None]
    return Coefficients(np.zeros((2, len(roots), 1)), np.zeros((2, 1, len(roots), 1)), noise)


REGULAR, SINGULAR = np.diag([1.0, 3.3e-7]), np.diag([1.0, 3.0e-7])


@pytest.mark.parametrize("bounded", [True, False])
def test_regular_noise_is_never_refused(bounded):
    check_noise(sensor(np.eye(2), REGULAR), np.zeros((2, 2, 2, 1)), 1.0, bounded)


@pytest.mark.parametrize("turn", [np.eye(2), np.array([[0.6, -0.8], [0.8, 0.6]])])
def test_a_bound_needs_noise_in_every_component_of_every_cell(turn):
    """A ratio of 1e-13 between the least and the largest variance counts as none."""
    told = "prune: the bound needs sensor noise in every component, H H' is singular at t = 12.5$"
    with pytest.raises(ValueError, match=told):
        check_noise(sensor(np.eye(2), turn @ SINGULAR), np.ones((2, 2, 2, 1)), 12.5, True)


def test_without_a_bound_only_predictions_without_spread_are_refused():
    innovation = np.eye(2)[:, :, None, None] * np.ones((3, 4))
    c = sensor(SINGULAR, SINGULAR, SINGULAR)
    check_noise(c, innovation, 1.0, False)
    innovation[:, :, 2, 1] = [[1.0, 1.0 - 1e-14], [1.0 - 1e-14, 1.0]]
    told = (
        r"sensor_noise: a predicted measurement has no spread at t = 7; wanted H H' such that "
        r"B V B' \+ H H' is positive definite on every branch$"
    )
    with pytest.raises(ValueError, match=told):
        check_noise(c, innovation, 7.0, False)
