"""State-space models of statsmodels 0.15 on random models, gaps, diffuse starts and fits.

Its first distribution is that of the first record, as ours is, and a matrix of time belongs to the
step that leaves. Its log-likelihood of an exact diffuse start is ours too.
"""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from statsmodels.api import tsa
from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

from peers.models import linear, system
from seedslib.base import Input, Parameter
from seedslib.evaluation import fit
from seedslib.filters import KalmanFilter, forecast_measurements, smooth
from seedslib.models import LinearSystem, level, regression, season, trend

CLIMBED = "a maximum is found by steps, and curvatures by differences"


def peer(model, y):
    """Filtered and smoothed results of one record; matrices may have a last axis of time."""
    (m, n), made = model.H.shape[:2], None
    made = KalmanSmoother(k_endog=m, k_states=n, k_posdef=n)
    made.bind(np.array(y, order="C"))
    made["transition"], made["state_cov"], made["selection"] = model.F, model.Q, np.eye(n)
    made["design"], made["obs_cov"] = model.H, model.R
    made.initialize_known(model.mean, model.cov)
    return made.smooth()


def filtered_pairs(found, theirs, since=-1):
    """Means, covariances and log-likelihoods, from the time where the state is known.

    What a diffuse start costs is split between the records up to there in another way; the sums
    are the same.
    """
    covs = np.moveaxis(theirs.filtered_state_cov, -1, 0)
    return (
        (found.mean[max(since, 0) :], theirs.filtered_state.T[max(since, 0) :]),
        (found.cov[max(since, 0) :], covs[max(since, 0) :]),
        (found.loglik[since + 1 :], theirs.llf_obs[since + 1 :]),
        (found.loglik.sum(), theirs.llf_obs.sum()),
    )


def smoothed_pairs(found, theirs):
    covs = np.moveaxis(theirs.smoothed_state_cov, -1, 0)
    return (found.mean, theirs.smoothed_state.T), (found.cov, covs)


MODELS = {
    "one state": (41, 1, 1),
    "stable": (42, 3, 2),
    "unstable": (43, 2, 1, 1.1),
    "singular noise": (44, 4, 3, 0.8, 2),
    "a known component": (45, 5, 2, 1.02, None, 1),
}


@pytest.mark.parametrize("case", MODELS)
def test_filter_and_smoother_with_gaps(case, held):
    model = linear(*MODELS[case])
    y = model.y.copy()
    y[0, 0] = y[5] = y[6, -1] = y[12:14] = np.nan
    filter, times, theirs = KalmanFilter(system(model)), np.arange(25.0), peer(model, y)
    what = "KalmanSmoother, known start, gaps in rows and components"
    held("statsmodels", f"{what}: filter", *filtered_pairs(filter.run(times, y), theirs))
    held("statsmodels", f"{what}: smoother", *smoothed_pairs(smooth(filter, times, y), theirs))


def test_matrices_of_time(held):
    parts = [linear(seed, 3, 2, 1.0) for seed in range(50, 60)]
    first, y = parts[0], np.stack([part.y[0] for part in parts])
    Fs, Qs, Hs, Rs = (np.stack([getattr(p, k) for p in parts], axis=-1) for k in "FQHR")
    made = LinearSystem(
        *(lambda t, part=part: part[..., int(t)] for part in (Fs, Qs, Hs, Rs)),
        first.mean,
        first.cov,
    )
    filter, times = KalmanFilter(made), np.arange(10.0)
    theirs = peer(first._replace(F=Fs, Q=Qs, H=Hs, R=Rs), y)
    held(
        "statsmodels",
        "KalmanSmoother with matrices of time",
        *filtered_pairs(filter.run(times, y), theirs),
        *smoothed_pairs(smooth(filter, times, y), theirs),
    )


def walk(seed, steps=40):
    """A level that wanders, with a season of four."""
    rng = np.random.default_rng(seed)
    level = np.cumsum(0.3 * np.cumsum(0.3 * rng.normal(size=steps)) + rng.normal(size=steps))
    return level + np.tile([3.0, -1.0, -4.0, 2.0], steps // 4) + rng.normal(size=steps)


TREND = np.array([[1.0, 1.0], [0.0, 1.0]])
SEASON = np.block(
    [
        [TREND, np.zeros((2, 3))],
        [np.zeros((3, 2)), np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0]])],
    ]
)


@pytest.mark.parametrize(
    ("season_of", "values"),
    [
        (None, (2.0, 0.7, 0.1)),
        (None, (0.0, 0.7, 0.1)),
        (4, (2.0, 0.7, 0.1, 0.4)),
        (4, (1e-3, 0.7, 0.1, 0.4)),
        (4, (0.0, 0.7, 0.1, 0.4)),
    ],
)
def test_exact_diffuse_start_with_gaps(season_of, values, held):
    """Two gaps fall in the part where the state is not known yet; the sensor may be exact."""
    y, times = walk(60), np.arange(40.0)
    y[[1, 3, 17, 18, 30]] = np.nan
    r, q, s, *w = values
    made = trend(q, s, noise=r)
    if season_of:
        made = made + season(season_of, *w)
    filter, n = KalmanFilter(made), made.state_size
    model = tsa.UnobservedComponents(
        y, "local linear trend", seasonal=season_of, use_exact_diffuse=True
    )
    results = model.smooth(values)
    theirs, found = results.filter_results, filter.run(times, y[:, None])
    ahead = forecast_measurements(filter, np.arange(46.0), np.append(y, [np.nan] * 6)[:, None])
    low, high = results.get_forecast(6).conf_int(alpha=0.2).T
    pairs = zip(ahead.interval(0.8)[:, 40:, 0], (low, high), strict=True)
    held("statsmodels", "UnobservedComponents, intervals of forecasts", *pairs)
    known = int(np.isfinite(found.cov).all(axis=(1, 2)).argmax())
    assert known == theirs.nobs_diffuse - 1 >= n
    what = f"UnobservedComponents, trend{' and season' if season_of else ''}, exact diffuse, gaps"
    held("statsmodels", f"{what}: filter", *filtered_pairs(found, theirs, known))
    held(
        "statsmodels",
        f"{what}: smoother",
        *smoothed_pairs(smooth(filter, times, y[:, None]), theirs),
    )


def test_structural_parts_add_up(held):
    """Level, season and two regressions, whose coefficients are diffuse too; noises add up."""
    y, times = walk(62), np.arange(40.0)
    y[[1, 12, 13]] = np.nan
    known = np.stack([np.sin(1.3 * times), np.cos(0.7 * times)], axis=1)
    u, v, q, w = Input("u"), Input("v"), Parameter("q", 1.0), Parameter("w", 1.0)
    parts = season(4, w, noise=0.2).bind(w=0.4) + regression(u, 2 * v)
    made = level(q, noise=0.3) + parts
    assert made.components == ("level", "season4", "season4_1", "season4_2", "on u", "on 2*v")
    model = tsa.UnobservedComponents(
        y,
        "local level",
        seasonal=4,
        exog=known * [1, 2],
        mle_regression=False,
        use_exact_diffuse=True,
    )
    theirs, filter = model.smooth([0.5, 0.7, 0.4]).filter_results, KalmanFilter(made.bind(q=0.7))
    inputs = {u: known[:, 0], v: known[:, 1]}
    found = filter.run(times, y[:, None], inputs=inputs)
    late = smooth(filter, times, y[:, None], inputs=inputs)
    what = "UnobservedComponents, level, season and regression, exact diffuse, gap"
    known_at = int(np.isfinite(found.cov).all(axis=(1, 2)).argmax())
    held("statsmodels", f"{what}: filter", *filtered_pairs(found, theirs, known_at))
    held("statsmodels", f"{what}: smoother", *smoothed_pairs(late, theirs))


def arma(steps=150):
    rng = np.random.default_rng(61)
    noise, y = rng.normal(size=steps + 50), np.zeros(steps + 50)
    for k in range(2, steps + 50):
        y[k] = 0.6 * y[k - 1] + 0.2 * y[k - 2] + noise[k] + 0.5 * noise[k - 1]
    return y[50:]


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_arma(noise, held):
    """SARIMAX starts from the stationary distribution of its state."""
    y, (a1, a2, b, q) = arma(), (0.5, 0.3, 0.4, 1.2)
    F, Q = np.array([[a1, 1], [a2, 0]]), q * np.array([[1, b], [b, b * b]])
    start = solve_discrete_lyapunov(F, Q)
    filter = KalmanFilter(LinearSystem(F, Q, [[1, 0]], noise, [0, 0], start))
    y[20:23], times = np.nan, np.arange(150.0)
    model = tsa.SARIMAX(y, order=(2, 0, 1), measurement_error=noise > 0)
    values = [a1, a2, b, *([noise] if noise else []), q]
    found, what = filter.run(times, y[:, None]), "SARIMAX(2, 0, 1) with a gap"
    what = f"{what}, {'with' if noise else 'without'} noise of the sensor"
    reason = "its filter takes the covariance for steady when that moves by 1e-19 in a norm"
    theirs = model.smooth(values).filter_results
    held(
        "statsmodels", f"{what}: filter", *filtered_pairs(found, theirs), bound=1e-8, reason=reason
    )
    model.ssm.tolerance = 0
    theirs = model.smooth(values).filter_results
    held("statsmodels", f"{what}: filter to the end", *filtered_pairs(found, theirs))
    late, bound, reason = smooth(filter, times, y[:, None]), 1e-10, ""
    if not noise:  # the state becomes known: each step back multiplies rounding by 1 / b²
        bound, reason = 1e-4, "ours solves with a forecast covariance that becomes singular"
    pairs = smoothed_pairs(late, theirs)
    held("statsmodels", f"{what}: smoother", *pairs, bound=bound, reason=reason)


def errors(model, values, kind):
    """Their standard errors by one of their information matrices."""
    return np.sqrt(np.diagonal(model.smooth(values, cov_type=kind).cov_params()))


def test_maximum_likelihood_of_arma(held, apart):
    """From a known first distribution, which the parameters do not move."""
    y, dist = arma(), np.diag([3.0, 1.0])
    a1, a2, b = Parameter("a1", 0.3), Parameter("a2", 0.1), Parameter("b", 0.2)
    q = Parameter("q", 0.8, positive=True)
    made = LinearSystem(
        [[a1, 1], [a2, 0]], [[q, q * b], [q * b, q * b * b]], [[1, 0]], 0, [0, 0], dist
    )
    best = fit(KalmanFilter(made), np.arange(150.0), y[:, None], [a1, a2, b, q])
    assert best.converged
    model = tsa.SARIMAX(y, order=(2, 0, 1), enforce_stationarity=False, enforce_invertibility=False)
    model.initialize_known(np.zeros(2), dist)
    model.loglikelihood_burn = 0  # it leaves out two records of what it takes for a diffuse start
    theirs = model.fit(best.values * 1.02, disp=0, method="bfgs", gtol=1e-8, cov_type="none")
    what = "SARIMAX(2, 0, 1).fit"
    found = (best.loglik, theirs.llf)
    held("statsmodels", f"{what}: log-likelihood", found, bound=1e-8, reason=CLIMBED)
    found = (best.values, theirs.params)
    held("statsmodels", f"{what}: values", found, bound=1e-5, reason=CLIMBED)
    close = errors(model, theirs.params, "approx")
    what, pair = f"{what}: standard errors", (best.errors, close)
    held("statsmodels", f"{what} of the observed information", pair, bound=1e-5, reason=CLIMBED)
    for kind, reason in (
        ("opg", "outer products of scores, its default; ours is minus the second derivative"),
        ("oim", "Harvey's information, which leaves out second derivatives of the innovations"),
    ):
        apart(
            "statsmodels",
            f"{what}, {kind}",
            reason,
            best.errors,
            errors(model, theirs.params, kind),
            1e-4,
        )


def test_maximum_likelihood_of_a_season(held):
    """Three variances, a diffuse start and gaps."""
    rng, y = np.random.default_rng(62), walk(62, 80)
    y += np.cumsum(rng.normal(size=(20, 4)), axis=0).reshape(-1) + 3 * rng.normal(size=80)
    y[[1, 30, 31]] = np.nan
    free = r, level, season = [
        Parameter(name, value, positive=True)
        for name, value in (("r", 1.0), ("level", 1.0), ("season", 0.5))
    ]
    F, Q = np.delete(np.delete(SEASON, 1, 0), 1, 1), np.zeros((4, 4), dtype=object)
    Q[0, 0], Q[1, 1] = level, season
    made = LinearSystem(
        F, Q, [[1, 1, 0, 0]], r, np.zeros(4), np.zeros((4, 4)), diffuse=tuple(range(4))
    )
    best = fit(KalmanFilter(made), np.arange(80.0), y[:, None], free)
    model = tsa.UnobservedComponents(y, "local level", seasonal=4, use_exact_diffuse=True)
    theirs = model.fit(best.values * 1.05, disp=0, method="bfgs", gtol=1e-7, cov_type="none")
    what = "UnobservedComponents.fit, level and season"
    found = (best.loglik, theirs.llf)
    held("statsmodels", f"{what}: log-likelihood", found, bound=1e-8, reason=CLIMBED)
    found = (best.values, theirs.params)
    held("statsmodels", f"{what}: values", found, bound=1e-5, reason=CLIMBED)
    found = (best.errors, errors(model, theirs.params, "approx"))
    what = f"{what}: standard errors of the observed information"
    held("statsmodels", what, found, bound=1e-5, reason=CLIMBED)
