import numpy as np
import pytest

from seedslib.gaussian import elevation_moments
from seedslib.gaussian.errors.elevation import _wide


def draws(mean, cov, count=400_000):
    x = np.random.default_rng(3).multivariate_normal(mean, cov, count).T
    return np.arctan2(x[2], np.hypot(x[0], x[1]))


LAWS = [
    ([1.0, 2.0, 3.0], np.diag([1.0, 2.0, 3.0])),
    ([2.0, 1.0, -3.0], [[1.0, 0.3, 0.1], [0.3, 2.0, -0.4], [0.1, -0.4, 0.5]]),
    ([0.0, 0.0, 5.0], np.diag([1.0, 4.0, 0.2])),
    ([0.0, 0.0, 1000.0], np.eye(3)),
    ([20.0, 0.0, 3.0], np.diag([1.0, 0.5, 2.0])),
    ([10.0, 10.0, 5.0], np.diag([1.0, 1.0, 0.0])),
]


@pytest.mark.parametrize(("mean", "cov"), LAWS)
def test_against_simulation(mean, cov):
    angle = draws(mean, cov)
    ours = elevation_moments(mean, cov)
    assert abs(angle.mean() - ours.mean) < 4 * angle.std() / np.sqrt(angle.size)
    squares = (angle - angle.mean()) ** 2
    assert abs(squares.mean() - ours.var) < 4 * squares.std() / np.sqrt(angle.size)


def test_the_two_regimes_agree_where_both_hold():
    mean, cov = np.array([8.0, 2.0, 3.0]), 0.9 * np.eye(3)
    ours = elevation_moments(mean, cov)
    np.testing.assert_allclose(np.array(ours), _wide(mean, cov), rtol=1e-11)


def test_symmetry_and_limits():
    assert elevation_moments([0, 0, 0], np.eye(3)).mean == pytest.approx(0.0, abs=1e-15)
    # uniform direction: E φ² = (π² - 8)/4
    assert elevation_moments([0, 0, 0], 2 * np.eye(3)).var == pytest.approx((np.pi**2 - 8) / 4)
    point = elevation_moments([1.0, 0.0, 1.0], np.zeros((3, 3)))
    assert point.mean == pytest.approx(np.pi / 4, rel=1e-15)
    assert point.var == 0.0
    # small noise: variance of the angle is the gradient's quadratic form
    small = elevation_moments([3.0, 4.0, 5.0], 1e-8 * np.eye(3))
    assert small.var == pytest.approx(1e-8 / 50, rel=1e-6)


def test_batch():
    mean = np.array([[20.0, 1.0, 0.0], [0.0, 2.0, 0.0], [3.0, 3.0, 9.0]])
    ours = elevation_moments(mean, np.eye(3))
    assert ours.mean.shape == (3,)
    assert ours.mean[1] == pytest.approx(float(elevation_moments(mean[:, 1], np.eye(3)).mean))


def test_bad_input():
    with pytest.raises(ValueError, match="wanted shapes"):
        elevation_moments([0.0, 1.0], np.eye(2))
    with pytest.raises(ValueError, match="nonsingular covariance"):
        elevation_moments([0.0, 0.0, 1.0], np.diag([1.0, 1.0, 0.0]))
    with pytest.raises(ValueError, match="elevation of the origin"):
        elevation_moments([0.0, 0.0, 0.0], np.zeros((3, 3)))
    with pytest.raises(ValueError, match="density of the direction"):
        elevation_moments([0.0, 0.0, 0.0], np.diag([1.0, 1.0, 1e-12]))
