"""Section 2.3: other filters of the pair (x, z) for the power z = x² of example 6."""

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import cubature, gauss_hermite, mean_of, mean_square_errors
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion

X = sp.Symbol("x", real=True)
SIGNAL = LinearDiffusion(-1, 0.5, 1, 0.1, [0], 4)


def rates(mean, cov, through_z):
    """Rates of mean (2,) and covariance (2, 2) of (x, z) under a normal law, in closed form.

    Drift ``(-x, -2z + 0.5)`` or ``(-x, -2x² + 0.5)``, noise ``(1, 2x)`` of intensity 0.5. The mean
    of ``(x, z) x²`` has degree three, so that sigma points of the third degree give the same.
    """
    m, z = mean
    p, mixed, spread = cov[0, 0], cov[0, 1], cov[1, 1]
    pulls = (2 * mixed, 2 * spread) if through_z else (4 * m * p, 4 * m * mixed)
    growth = [-2 * p + 0.5, -mixed - pulls[0] + m, -2 * pulls[1] + 2 * (m * m + p)]
    level = z if through_z else m * m + p
    drift = np.stack([-m, -2 * level + 0.5])
    return drift, np.stack([np.stack(growth[:2]), np.stack(growth[1:])])


def sigma_point_filter(times, increments, through_z):
    """Estimates (K+1, 2, N) and covariances (K+1, 2, 2, N) of the pair."""
    paths = increments.shape[-1]
    mean = np.stack([np.zeros(paths), np.full(paths, 4.0)])
    cov = np.multiply.outer(np.diag([4.0, 32.0]), np.ones(paths))
    means, covs = [mean], [cov]
    for step, dy in zip(np.diff(times), increments[:, 0], strict=True):
        gain = cov[:, 0] / (cov[0, 0] + 0.1 / step)
        mean = mean + gain * (dy / step - mean[0])
        cov = cov - gain[:, None] * cov[:, 0]
        drift, growth = rates(mean, cov, through_z)
        mean, cov = mean + step * drift, cov + step * growth
        means.append(mean)
        covs.append(cov)
    return np.stack(means), np.stack(covs)


@pytest.mark.parametrize("through_z", [True, False])
def test_rates_are_those_of_sigma_points(through_z):
    mean, cov = np.array([0.7, -0.3]), np.array([[0.5, 0.2], [0.2, 0.9]])

    def parts(points):
        x, z = points
        drift = np.stack([-x, (-2 * z if through_z else -2 * x * x) + 0.5])
        gap = points - mean[:, None]
        mixed = gap[:, None] * drift + drift[:, None] * gap
        one = np.ones_like(x)
        noise = 0.5 * np.stack([one, 2 * x, 2 * x, 4 * x * x])
        return np.concatenate([drift, mixed.reshape(4, -1) + noise])

    got = mean_of(parts, mean, cov, cubature(2))
    drift, growth = rates(mean, cov, through_z)
    np.testing.assert_allclose(got, [*drift, *growth.ravel()], rtol=1e-12)


@pytest.fixture(scope="module")
def record():
    times = np.linspace(0, 6, 1201)
    sample = SIGNAL.simulate(times, 400, 0)
    return times, sample.states[:, 0] ** 2, sample.increments


def test_sigma_point_filter_keeps_its_initial_error(record):
    """Nothing restores z when its drift is written through x; through z it is forgotten."""
    times, truth, increments = record
    late = times >= 4
    steady = {}
    for through_z in (True, False):
        means, _ = sigma_point_filter(times, increments, through_z)
        steady[through_z] = ((means[:, 1] - truth)[late] ** 2).mean()
    assert steady[False] > 10
    assert 0.08 < steady[True] < 0.16


def test_covariance_of_the_stacked_filter_depends_on_the_data(record):
    """n + 1 estimates and (n + 1)(n + 2)/2 covariances online; the state's own do not depend."""
    times, _, increments = record
    _, covs = sigma_point_filter(times[:101], increments[:100, :, :20], True)
    spread = covs[-1].std(axis=-1) / np.abs(covs[-1]).mean(axis=-1)
    assert spread[0, 0] < 1e-12
    assert min(spread[0, 1], spread[1, 1]) > 0.05
    exact = KalmanBucyFilter(SIGNAL).moments(times[100:101]).error_cov[0, 0, 0]
    assert covs[-1, 0, 0, 0] == pytest.approx(exact, rel=0.02)
    for n in range(1, 6):
        assert (n + 1) + (n + 1) * (n + 2) / 2 == (n + 1) * (n + 4) / 2


def least_squares_error(f, structure, mean, cov, error_cov):
    """Error of the best ``α + β'φ(x̂)``, its moments by Gauss-Hermite over (x̂, e)."""
    joint = np.diag([cov - error_cov, error_cov])
    rule, size = gauss_hermite(2, 40), 1 + len(structure)

    def values(points):
        return np.stack([f(points[0] + points[1]), *(phi(points[0]) for phi in structure)])

    first = mean_of(values, [mean, 0], joint, rule)

    def products(points):
        gap = values(points) - first[:, None]
        return (gap[:, None] * gap).reshape(size * size, -1)

    second = mean_of(products, [mean, 0], joint, rule).reshape(size, size)
    return second[0, 0] - second[0, 1:] @ np.linalg.solve(second[1:, 1:], second[1:, 0])


@pytest.mark.parametrize("mean", [0.0, 0.8])
def test_conditionally_optimal_filter_with_a_linear_structure(mean):
    """Its error is Var f - D1 (C - P) D1', for a square and for a sine."""
    cov, error_cov = 1.7, 0.4
    laws = {
        "square": (np.square, 2 * cov**2 + 4 * mean**2 * cov, 2 * mean),
        "sine": (
            np.sin,
            0.5 * (1 - np.exp(-2 * cov) * np.cos(2 * mean))
            - np.exp(-cov) * np.sin(mean) ** 2,
            np.exp(-cov / 2) * np.cos(mean),
        ),
    }  # fmt: skip
    for name, (f, variance, slope) in laws.items():
        found = least_squares_error(f, [lambda x: x], mean, cov, error_cov)
        assert found == pytest.approx(variance - slope**2 * (cov - error_cov), rel=1e-9), name
        symbolic = X**2 if name == "square" else sp.sin(X)
        best = mean_square_errors(symbolic, [X])([mean], [[cov]], [[error_cov]]).optimal
        assert best < found


def test_conditionally_optimal_filter_that_contains_the_optimal_estimate():
    mean, cov, error_cov = 0.8, 1.7, 0.4
    best = mean_square_errors(X**2, [X])([mean], [[cov]], [[error_cov]]).optimal
    found = least_squares_error(np.square, [lambda x: x, np.square], mean, cov, error_cov)
    assert found == pytest.approx(float(best), rel=1e-9)
    wrong = least_squares_error(np.square, [lambda x: x, np.abs], mean, cov, error_cov)
    assert wrong > 1.001 * best
