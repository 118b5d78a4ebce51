"""Mean and variance of the elevation angle of a Gaussian vector."""

import numpy as np
import pytest

from oracles.gaussian import hermite_mean
from seedslib.gaussian import elevation_moments

MEAN, COV = [2.0, 1.0, -3.0], np.array([[1.0, 0.3, 0.1], [0.3, 2.0, -0.4], [0.1, -0.4, 0.5]])


def test_elevation_near_the_axis_against_simulation():
    x = np.random.default_rng(3).multivariate_normal(MEAN, COV, 400_000).T
    angle = np.arctan2(x[2], np.hypot(x[0], x[1]))
    found = elevation_moments(MEAN, COV)
    assert abs(angle.mean() - found.mean) < 4 * angle.std() / np.sqrt(angle.size)
    squares = (angle - angle.mean()) ** 2
    assert abs(squares.mean() - found.var) < 4 * squares.std() / np.sqrt(angle.size)


@pytest.mark.parametrize("distance", [9.0, 11.0, 30.0])
def test_elevation_away_from_the_axis_against_quadrature(distance):
    """On both sides of where the method changes; the angle is smooth in the nodes."""
    mean = distance * np.array([0.8, 0.2, 0.3])
    cov = np.array([[0.5, 0.1, 0.0], [0.1, 0.4, -0.1], [0.0, -0.1, 0.6]])

    def angle(*x):
        return np.arctan2(x[2], np.hypot(x[0], x[1]))

    found = elevation_moments(mean, cov)
    first = hermite_mean(angle, mean, cov, 60)
    assert found.mean == pytest.approx(first, rel=1e-8)
    second = hermite_mean(lambda *x: (angle(*x) - first) ** 2, mean, cov, 60)
    assert found.var == pytest.approx(second, rel=1e-7)


def test_elevation_of_limits():
    """A uniform direction has E phi² = (pi² - 8) / 4, small noise the squared gradient."""
    assert elevation_moments([0, 0, 0], np.eye(3)).mean == pytest.approx(0.0, abs=1e-15)
    assert elevation_moments([0, 0, 0], 2 * np.eye(3)).var == pytest.approx((np.pi**2 - 8) / 4)
    point = elevation_moments([1.0, 0.0, 1.0], np.zeros((3, 3)))
    assert point.mean == pytest.approx(np.pi / 4, rel=1e-15)
    assert point.var == 0.0
    small = elevation_moments([3.0, 4.0, 5.0], 1e-8 * np.eye(3))
    assert small.var == pytest.approx(1e-8 / 50, rel=1e-6)


def test_elevation_does_not_depend_on_the_unit_of_length():
    near = elevation_moments(MEAN, COV)
    for unit in (1e-150, 1e150):
        assert elevation_moments(unit * np.array(MEAN), unit**2 * COV) == pytest.approx(
            near, rel=1e-12
        )


def test_elevation_of_a_batch_is_that_of_its_members():
    mean = np.array([[20.0, 1.0, 0.0], [0.0, 2.0, 0.0], [3.0, 3.0, 9.0]])
    cov = np.diag([1.0, 2.0, 0.5])
    found = elevation_moments(mean, cov)
    for k in range(3):
        alone = elevation_moments(mean[:, k], cov)
        assert (found.mean[k], found.var[k]) == pytest.approx((alone.mean, alone.var), abs=1e-15)
