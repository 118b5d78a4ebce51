"""Sections 1 and 2: the two steps and what can be stored, against routes of their own."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import quad, solve_ivp

from seedslib.two_step import KalmanBucyFilter, LinearDiffusion, TwoStepEstimator

X, A = sp.symbols("x a", real=True)
SIGNAL = LinearDiffusion(-1, 0.5, 1, 0.1, [0.7], 4)
NOISE, PRIOR = [[0.4, 0.1], [0.1, 0.2]], [[0.5, 0.1], [0.1, 0.3]]
PLANAR = LinearDiffusion([[0.2, 1], [-2, -0.3]], NOISE, [[1, 0.5]], 0.2, [1, -1], PRIOR)


def midpoint_law(times):
    """Mean and covariance of (x(T), increments) of the scalar signal, by the midpoint rule.

    The autocovariance of the signal is ``C(s) exp(-(t - s))``, which owes nothing to a filter.
    """
    step, middle = times[1], times[:-1] + 0.5 * times[1]
    grid = np.append(middle, times[-1])
    early = np.minimum.outer(grid, grid)
    cov = np.exp(-np.abs(np.subtract.outer(grid, grid))) * (0.25 + 3.75 * np.exp(-2 * early))
    scale = np.append(np.full(middle.size, step), 1.0)
    cov = cov * np.outer(scale, scale)
    cov[:-1, :-1] += 0.1 * step * np.eye(middle.size)
    return 0.7 * np.exp(-grid) * scale, cov


def test_first_step_is_the_regression_on_the_measurements():
    times = np.linspace(0, 1, 401)
    increments = SIGNAL.simulate(times, 5, 2).increments
    mean, cov = midpoint_law(times)
    gain = np.linalg.solve(cov[:-1, :-1], cov[:-1, -1])
    best = mean[-1] + gain @ (increments[:, 0] - mean[:-1, None])
    run = KalmanBucyFilter(SIGNAL).run(times, increments)
    np.testing.assert_allclose(run.mean[-1, 0], best, rtol=2e-4)
    rest = cov[-1, -1] - gain @ cov[:-1, -1]
    assert KalmanBucyFilter(SIGNAL).moments([1.0]).error_cov[0, 0, 0] == pytest.approx(
        rest, rel=1e-4
    )


def test_moments_obey_their_equations():
    """(2.1) and (3.10), integrated as they are printed."""
    F, Q, H, R = (np.array(m) for m in PLANAR.matrices(0.0))

    def slope(_, y):
        mu, C, P = y[:2], y[2:6].reshape(2, 2), y[6:].reshape(2, 2)
        gain = P @ H.T / R
        growth = [M @ F.T + F @ M + Q for M in (C, P)]
        return np.concatenate([F @ mu, growth[0].ravel(), (growth[1] - gain @ H @ P).ravel()])

    start = np.concatenate([PLANAR.mean0, PLANAR.cov0.ravel(), PLANAR.cov0.ravel()])
    end = solve_ivp(slope, (0, 1.5), start, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    mean, cov, error_cov = KalmanBucyFilter(PLANAR).moments([1.5])
    ours = np.concatenate([mean[0], cov[0].ravel(), error_cov[0].ravel()])
    np.testing.assert_allclose(ours, end, rtol=1e-9)


@pytest.mark.parametrize(
    "f", [X**4 - X, sp.exp(X / 2) * sp.sin(X), sp.Abs(X - A), (X - A) ** 2 + A]
)
def test_second_step_is_the_integral_against_the_conditional_law(f):
    """(2.2) and, with the estimate a of the state in f, (2.3) and (2.4)."""
    both = {"variables": [X], "estimate_variables": [A]}
    estimator = TwoStepEstimator(SIGNAL, f, **both)
    number = sp.lambdify((X, A), f, "numpy")
    for xhat, var in ((0.4, 0.3), (-1.2, 1.5)):
        root = np.sqrt(var)

        def weighted(s, xhat=xhat, root=root):
            return number(xhat + root * s, xhat) * np.exp(-0.5 * s * s) / np.sqrt(2 * np.pi)

        exact = quad(weighted, -12, 0)[0] + quad(weighted, 0, 12)[0]
        assert estimator.estimate([xhat], [[var]]) == pytest.approx(exact, rel=1e-8)


def test_nothing_stored_depends_on_the_data():
    """Section 2.5: two records, one table; the stored coefficients are those of x̂² + P."""
    times = np.linspace(0, 1, 51)
    power = TwoStepEstimator(SIGNAL, X**2, variables=[X])
    table, stored = power.table(times), KalmanBucyFilter(SIGNAL).moments(times).error_cov[:, 0, 0]
    powers = [int(k) for (k,) in table.exponents]
    np.testing.assert_allclose(table.mean_coefficients[:, 0, powers.index(2)], 1.0)
    np.testing.assert_allclose(table.mean_coefficients[:, 0, powers.index(0)], stored, rtol=1e-12)
    for seed in (0, 1):
        increments = SIGNAL.simulate(times, 1, seed).increments
        state = table.start[:, None]
        for k in range(50):
            state = table.update(k, state, increments[k])
        run = power.run(times, increments)
        np.testing.assert_allclose(table.estimate(50, state)[0], run.mean[50], rtol=1e-12)
