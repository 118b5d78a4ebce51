"""The Kalman-Bucy smoother and its second step: Rauch's equations, dense records, Monte Carlo."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from seedslib.gaussian.quadrature import gauss_hermite
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion, TwoStepEstimator

X, Z = sp.symbols("x z", real=True)
DRIFT, NOISE = np.array([[0.2, 1], [-2, -0.3]]), np.array([[0.4, 0.1], [0.1, 0.2]])
SENSOR, PRIOR = np.array([[1, 0.5]]), np.array([[0.5, 0.1], [0.1, 0.3]])
PLANAR = LinearDiffusion(DRIFT, NOISE, SENSOR, 0.2, [1, -1], PRIOR)
VARYING = LinearDiffusion(
    lambda t: DRIFT * (1 + 0.3 * np.sin(t)), NOISE, lambda t: SENSOR * np.cos(t), 0.2, [1, -1],
    PRIOR,
)  # fmt: skip


def rauch(system, times):
    """Error covariances by the two equations of Rauch, Tung and Striebel, forward and back."""

    def forward(t, p):
        f, q, h, r = system.matrices(t)
        p = p.reshape(2, 2)
        return (f @ p + p @ f.T + q - p @ h.T @ h @ p / r[0, 0]).ravel()

    options = {"rtol": 1e-11, "atol": 1e-13, "method": "DOP853"}
    run = solve_ivp(forward, (0, times[-1]), PRIOR.ravel(), dense_output=True, **options)

    def backward(t, p):
        f, q, _, _ = system.matrices(t)
        p = p.reshape(2, 2)
        gain = f + q @ np.linalg.inv(run.sol(t).reshape(2, 2))
        return (gain @ p + p @ gain.T - q).ravel()

    back = solve_ivp(backward, (times[-1], times[0]), run.y[:, -1], t_eval=times[::-1], **options)
    return back.y.T[::-1].reshape(-1, 2, 2)


@pytest.mark.parametrize("system", [PLANAR, VARYING])
def test_errors_obey_the_equations_of_rauch(system):
    times = np.array([0.0, 0.3, 0.35, 1.2])
    found = KalmanBucyFilter(system).smoothed_moments(times)
    np.testing.assert_allclose(found.error_cov, rauch(system, times), rtol=1e-8)
    lagged = KalmanBucyFilter(system).smoothed_moments(times, lag=2)
    for k in range(3):  # of the last time alone there is nothing to integrate
        exact = rauch(system, times[: min(k + 3, 4)])[k]
        np.testing.assert_allclose(lagged.error_cov[k], exact, rtol=1e-8)
    plain = KalmanBucyFilter(system).moments(times)
    assert np.array_equal(found.mean, plain.mean)
    assert np.array_equal(found.cov, plain.cov)


def dense(times, seen):
    """Regression of the state on the rates over all steps, by the exact law of state and record.

    Rates are those at the middles of the steps, so the law is one of second order in the step.
    """
    step = times[1] - times[0]
    fine = np.arange(2 * times.size - 1) * step / 2
    move, noise = PLANAR.transition(0.0, step / 2)
    count = fine.size
    cov = np.zeros((count, 2, count, 2))
    mean = np.zeros((count, 2))
    cov[0, :, 0], mean[0] = PRIOR, [1, -1]
    for k in range(1, count):
        mean[k] = move @ mean[k - 1]
        cov[k, :, :k] = np.einsum("ij,jkl->ikl", move, cov[k - 1, :, :k])
        cov[:k, :, k] = np.moveaxis(cov[k, :, :k], 0, -1)
        cov[k, :, k] = move @ cov[k - 1, :, k - 1] @ move.T + noise
    middles = np.arange(1, count, 2)[seen]
    across = np.einsum("kiaj,mj->kiam", cov[::2][:, :, middles], SENSOR)[..., 0] * step
    square = np.einsum("mi,aibj,nj->manb", SENSOR, cov[np.ix_(middles, range(2), middles)], SENSOR)
    square = square[0, :, 0] * step**2 + 0.2 * step * np.eye(len(middles))
    return mean[::2], cov[::2][:, :, ::2], across, square, (mean[middles] @ SENSOR[0]) * step


@pytest.mark.parametrize("lag", [None, 40])
def test_estimates_are_the_regression_on_the_whole_record(lag):
    """With a gap; the discretisation of the record is of first order."""
    worst = []
    for count in (100, 200):
        times = np.linspace(0, 2, count + 1)
        dy = PLANAR.simulate(times, 3, 5).increments
        dy[count // 4 : count // 3] = np.nan
        found = KalmanBucyFilter(PLANAR).smooth(times, dy, lag=lag and lag * count // 100)
        seen = np.isfinite(dy[:, 0, 0])
        mean, cov, across, square, expected = dense(times, seen)
        gaps = []
        for k in (0, count // 5, count // 2, count):
            end = count if lag is None else min(count, k + lag * count // 100)
            part = slice(0, seen[:end].sum())
            gain = np.linalg.solve(square[part, part], across[k][:, part].T).T
            best = mean[k][:, None] + gain @ (dy[seen][part, 0] - expected[part, None])
            rest = cov[k, :, k] - gain @ across[k][:, part].T
            np.testing.assert_allclose(found.cov[k], rest, atol=2e-4 * (100 / count))
            gaps.append(np.abs(found.mean[k] - best).max())
        worst.append(max(gaps))
    assert worst[0] < 0.02
    assert worst[1] < 0.75 * worst[0]


def test_the_last_estimates_are_those_of_the_filter():
    times = np.linspace(0, 1, 51)
    dy = PLANAR.simulate(times, 4, 1).increments
    filter = KalmanBucyFilter(PLANAR)
    one, two = filter.run(times, dy), filter.smooth(times, dy)
    assert np.array_equal(one.mean[-1], two.mean[-1])
    np.testing.assert_allclose(one.cov[-1], two.cov[-1], atol=1e-15)
    np.testing.assert_allclose(two.cov, filter.smoothed_moments(times).error_cov, atol=1e-13)
    single = filter.smooth(times, dy[..., 0])
    np.testing.assert_allclose(single.mean, two.mean[..., 0], atol=1e-14)
    nothing = filter.smooth(times, np.full_like(dy, np.nan))
    np.testing.assert_allclose(nothing.mean, filter.run(times, np.full_like(dy, np.nan)).mean)


@pytest.mark.parametrize(
    "estimator",
    [
        TwoStepEstimator(PLANAR, X**2 + X * Z, variables=[X, Z]),
        TwoStepEstimator(PLANAR, sp.exp(X / 2) * sp.cos(Z), variables=[X, Z]),
        TwoStepEstimator(PLANAR, [X**3, sp.sin(Z)], variables=[X, Z]),
        TwoStepEstimator(
            PLANAR, lambda x: np.tanh(x[0]) + x[1], quadrature=gauss_hermite(2, 6)
        ),
    ],
    ids=["polynomial", "exponential", "vector", "quadrature"],
)  # fmt: skip
@pytest.mark.parametrize("lag", [None, 10])
def test_exact_errors_are_those_on_paths(estimator, lag):
    times = np.linspace(0, 1.5, 51)
    paths = PLANAR.simulate(times, 600, 7)
    found = estimator.smooth(times, paths.increments, lag=lag)
    exact = estimator.smoothed_errors(times, lag=lag)
    plain = estimator.errors(times)
    for k in (0, 20, 40):
        truth = np.moveaxis(estimator.plugin(paths.states[k]), -1, 0)
        for got, wanted in ((found.mean, exact.optimal), (found.plugin, exact.plugin)):
            error = np.moveaxis(got[k], -1, 0) - truth
            square = error**2 if error.ndim == 1 else error[:, :, None] * error[:, None, :]
            deviation = square.std(axis=0) / np.sqrt(600)
            assert (np.abs(square.mean(axis=0) - wanted[k]) < 4 * deviation + 2e-3).all()
        assert np.trace(np.atleast_2d(plain.optimal[k] - exact.optimal[k])) > 0


def test_the_power_of_a_scalar_signal_by_hand():
    """x² under N(x̂, P) has the mean x̂² + P and the variance 2 P² + 4 x̂² P, on average over x̂."""
    signal = LinearDiffusion(-1, 0.5, 1, 0.1, [0.7], 4)
    times = np.array([0.0, 0.2, 0.5, 1.0])
    mean, cov, error = KalmanBucyFilter(signal).smoothed_moments(times)
    mu, c, p = mean[:, 0], cov[:, 0, 0], error[:, 0, 0]
    exact = TwoStepEstimator(signal, X**2, variables=[X]).smoothed_errors(times)
    np.testing.assert_allclose(exact.optimal, 2 * p**2 + 4 * p * (mu**2 + c - p), rtol=1e-12)
    np.testing.assert_allclose(exact.plugin - exact.optimal, p**2, rtol=1e-10)
    assert (p < KalmanBucyFilter(signal).moments(times).error_cov[:, 0, 0])[:-1].all()


def test_what_is_refused():
    ahead = TwoStepEstimator(PLANAR, X * Z, variables=[X, Z], lead=0.5)
    with pytest.raises(ValueError, match=r"lead: wanted 0 of a smoothed estimate, got 0\.5"):
        ahead.smoothed_errors([0, 1])
    with pytest.raises(ValueError, match="lead: wanted 0"):
        ahead.smooth([0, 0.1], np.zeros((1, 1)))
    with pytest.raises(ValueError, match="lag: wanted at least 1, got 0"):
        KalmanBucyFilter(PLANAR).smoothed_moments([0, 1], lag=0)
