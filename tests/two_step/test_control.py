"""The control of example 2: I1 where the larger component exceeds a level, I2 elsewhere."""

import numpy as np
import pytest

from seedslib.gaussian import bivariate_normal_cdf, max_moments
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion

PAIR = LinearDiffusion(
    [[-1, 0.3], [-0.3, -0.5]], 0.5 * np.eye(2), np.eye(2), 0.2 * np.eye(2), [0, 0], 0.5 * np.eye(2)
)
LEVEL, HIGH, LOW = 0.5, 1.0, -1.0


def probability_above(mean, cov):
    deviations = np.sqrt(np.diag(cov))[:, None]
    h, k = (LEVEL - mean) / deviations
    return 1 - bivariate_normal_cdf(h, k, cov[0, 1] / deviations.prod())


def test_probability_of_the_maximum_against_draws():
    cov = np.array([[0.3, 0.12], [0.12, 0.2]])
    mean = np.array([[0.2, 1.0, -0.4], [0.4, -1.0, 0.5]])
    draws = np.random.default_rng(0).multivariate_normal([0, 0], cov, 200_000).T
    seen = (mean[:, :, None] + draws[:, None]).max(axis=0) > LEVEL
    error = np.sqrt(seen.mean(axis=1) * (1 - seen.mean(axis=1)) / 200_000)
    assert np.all(np.abs(seen.mean(axis=1) - probability_above(mean, cov)) < 4 * error)


def test_mean_control_on_paths():
    """E[u|y] is nearest in the mean square, and its distance is (I1 - I2)² E p(1 - p)."""
    times = np.linspace(0, 3, 151)
    sample = PAIR.simulate(times, 8000, 4)
    run = KalmanBucyFilter(PAIR).run(times, sample.increments)
    mean, cov = run.mean[-1], run.cov[-1]
    ideal = np.where(sample.states[-1].max(axis=0) > LEVEL, HIGH, LOW)
    p = probability_above(mean, cov)
    switched = np.where(max_moments(mean, cov).mean > LEVEL, HIGH, LOW)
    squares = {"mean": (LOW + (HIGH - LOW) * p - ideal) ** 2, "switched": (switched - ideal) ** 2}
    error = {name: s.std() / np.sqrt(s.size) for name, s in squares.items()}
    wanted = {"mean": (HIGH - LOW) ** 2 * p * (1 - p)}
    wanted["switched"] = (HIGH - LOW) ** 2 * np.where(switched > 0, 1 - p, p)
    for name, value in wanted.items():
        assert abs(squares[name].mean() - value.mean()) < 4 * error[name]
    gap = squares["switched"] - squares["mean"]
    assert gap.mean() > 4 * gap.std() / np.sqrt(gap.size)
    assert np.mean(LOW + (HIGH - LOW) * p) == pytest.approx(ideal.mean(), abs=0.04)
