"""Kalman filters and smoothers of filterpy 1.4.5 on random linear models.

It moves the first distribution before the first measurement, so our records begin with a gap.
"""

import numpy as np
import pytest
from filterpy import kalman

from peers.models import late, linear, system
from seedslib.filters import KalmanFilter, smooth
from seedslib.models import LinearSystem

MODELS = {
    "one state": (1, 1, 1),
    "stable": (2, 3, 2),
    "unstable": (3, 2, 1, 1.1),
    "singular noise": (4, 4, 3, 0.8, 2),
    "five states, unstable, noise of rank one": (5, 5, 2, 1.05, 1),
}


def peer(model, kind=kalman.KalmanFilter):
    """filterpy's filter of a model."""
    made = kind(dim_x=len(model.F), dim_z=len(model.R))
    made.x, made.P, made.F, made.Q = model.mean.copy(), model.cov.copy(), model.F, model.Q
    made.H, made.R = model.H, model.R
    return made


def looped(model, y, made):
    """Means, covariances and log-likelihoods, record by record; NaN is what was not measured."""
    means, covs, logliks = [], [], []
    for row in y:
        made.predict()
        seen = np.isfinite(row)
        if seen.any():
            made.dim_z = seen.sum()
            made.update(row[seen], R=model.R[np.ix_(seen, seen)], H=model.H[seen])
        means.append(made.x.copy())
        covs.append(made.P.copy())
        logliks.append(made.log_likelihood if seen.any() else 0.0)
    return np.array(means), np.array(covs), np.array(logliks)


def ours(model, y):
    filter, times = KalmanFilter(system(model)), np.arange(len(y) + 1.0)
    return filter.run(times, late(y)), smooth(filter, times, late(y))


@pytest.mark.parametrize("case", MODELS)
def test_filter_and_smoother(case, held):
    model = linear(*MODELS[case])
    filtered, smoothed = ours(model, model.y)
    means, covs, _, _ = peer(model).batch_filter(model.y)
    _, _, logliks = looped(model, model.y, peer(model))
    held(
        "filterpy",
        "KalmanFilter.batch_filter, with log-likelihood",
        (filtered.mean[1:], means),
        (filtered.cov[1:], covs),
        (filtered.loglik[1:], logliks),
    )
    late_mean, late_cov, _, _ = peer(model).rts_smoother(means, covs)
    held(
        "filterpy",
        "KalmanFilter.rts_smoother",
        (smoothed.mean[1:], late_mean),
        (smoothed.cov[1:], late_cov),
    )


def test_singular_covariances(held):
    """A component without noise and with a known first value; theirs wants a pseudo-inverse."""
    model = linear(6, 4, 2, known=1)
    filtered, smoothed = ours(model, model.y)
    means, covs, _, _ = peer(model).batch_filter(model.y)
    with pytest.raises(np.linalg.LinAlgError):
        peer(model).rts_smoother(means, covs)
    late_mean, late_cov, _, _ = peer(model).rts_smoother(means, covs, inv=np.linalg.pinv)
    held(
        "filterpy",
        "KalmanFilter with singular covariances, rts_smoother(inv=pinv)",
        (filtered.mean[1:], means),
        (filtered.cov[1:], covs),
        (smoothed.mean[1:], late_mean),
        (smoothed.cov[1:], late_cov),
    )


@pytest.fixture(scope="module")
def gaps():
    """A model with three records, which miss rows, components, and nothing."""
    model = linear(7, 4, 3, 1.02)
    y = np.stack([model.y, model.y[::-1], 2 * model.y], axis=-1)
    y[[3, 4, 11], :, 0] = np.nan
    y[5, 0, 1] = y[6, 1:, 1] = y[-1, 2, 1] = np.nan
    return model, y


def test_a_batch_with_gaps_is_their_loop(gaps, held):
    model, y = gaps
    filtered, smoothed = ours(model, y)
    pairs = []
    for j in range(3):
        means, covs, logliks = looped(model, y[..., j], peer(model))
        late_mean, late_cov, _, _ = peer(model).rts_smoother(means, covs)
        pairs += [
            (filtered.mean[1:, ..., j], means),
            (filtered.cov[1:, ..., j], covs),
            (filtered.loglik[1:, j], logliks),
            (smoothed.mean[1:, ..., j], late_mean),
            (smoothed.cov[1:, ..., j], late_cov),
        ]
    held(
        "filterpy", "KalmanFilter in a loop over records with gaps, by rows and components", *pairs
    )


def test_their_likelihood_of_a_missing_record(gaps, apart):
    """`update(None)` keeps the last S with an innovation of zero, so that a gap has a density."""
    model, y = gaps
    made, theirs = peer(model), []
    for row in y[..., 0]:
        made.predict()
        made.update(row if np.isfinite(row).all() else None)
        theirs.append(made.log_likelihood)
    found = ours(model, y[..., 0])[0].loglik[1:]
    assert (found[[3, 4, 11]] == 0.0).all()
    rest = np.delete(np.arange(len(y)), [3, 4, 11])
    assert np.allclose(found[rest], np.array(theirs)[rest], rtol=0, atol=1e-10)
    reason = "a missing record gets the density of the last S at zero; ours says nothing"
    apart("filterpy", "log-likelihood of update(None)", reason, found, theirs, 0.1)


def test_matrices_of_time(held, apart):
    """Theirs at step k moves to k; ours take the time that the step leaves."""
    parts = [linear(seed, 3, 2, 1.0) for seed in range(20, 28)]
    first, y = parts[0], np.stack([part.y[0] for part in parts])
    Fs, Qs, Hs, Rs = ([getattr(part, name) for part in parts] for name in "FQHR")
    made = LinearSystem(
        lambda t: Fs[int(t)],
        lambda t: Qs[int(t)],
        lambda t: Hs[max(int(t) - 1, 0)],
        lambda t: Rs[max(int(t) - 1, 0)],
        first.mean,
        first.cov,
    )
    filter, times = KalmanFilter(made), np.arange(9.0)
    filtered, smoothed = filter.run(times, late(y)), smooth(filter, times, late(y))
    their = peer(first)
    means, covs, _, _ = their.batch_filter(y, Fs, Qs, Hs, Rs)
    late_mean, late_cov, _, _ = their.rts_smoother(means, covs, Fs, Qs)
    held(
        "filterpy",
        "KalmanFilter with matrices of time, filter and smoother",
        (filtered.mean[1:], means),
        (filtered.cov[1:], covs),
        (smoothed.mean[1:], late_mean),
        (smoothed.cov[1:], late_cov),
    )
    other, _, _, _ = kalman.rts_smoother(means, covs, Fs, Qs)
    reason = "takes F and Q of the step before the one that the filter made; the method is right"
    apart(
        "filterpy", "function rts_smoother, matrices of time", reason, smoothed.mean[1:], other, 0.1
    )


@pytest.mark.parametrize("case", ["stable", "unstable", "five states, unstable, noise of rank one"])
def test_square_roots_and_information(case, held, apart):
    """They want regular noise."""
    model = linear(*MODELS[case])
    model = model._replace(Q=model.Q + 0.05 * np.eye(len(model.Q)))
    filtered, _ = ours(model, model.y)
    root = peer(model, kalman.SquareRootKalmanFilter)
    inverse = kalman.InformationFilter(len(model.F), len(model.R))
    inverse.x, inverse.P_inv, inverse.F, inverse.Q = (
        model.mean.copy(),
        np.linalg.inv(model.cov),
        model.F,
        model.Q,
    )
    inverse.H, inverse.R_inv = model.H, np.linalg.inv(model.R)
    inverse.compute_log_likelihood = False  # it takes the information matrix for S
    by_root, by_inverse, printed = [], [], []
    for row in model.y:
        for made in (root, inverse):
            made.predict()
            made.update(row)
        by_root.append((root.x.copy(), root.P1_2 @ root.P1_2.T))
        by_inverse.append((inverse.x.copy(), inverse.P))
        printed.append(root.P)
    for name, found in (("SquareRoot", by_root), ("Information", by_inverse)):
        means, covs = zip(*found, strict=True)
        name = name + ("KalmanFilter, P of its factor" if name == "SquareRoot" else "Filter")
        held("filterpy", name, (filtered.mean[1:], means), (filtered.cov[1:], covs))
    reason = "gives L'L where L L' is the covariance"
    apart("filterpy", "SquareRootKalmanFilter.P", reason, filtered.cov[1:], printed, 0.01)


def test_fixed_lag(held, apart):
    """What it means is the smoother of the record up to `lag` later; that ours is."""
    model, lag = linear(8, 3, 2), 3
    filter, times = KalmanFilter(system(model)), np.arange(len(model.y) + 1.0)
    found = smooth(filter, times, late(model.y), lag=lag)
    means, covs, _, _ = peer(model).batch_filter(model.y)
    wanted = []
    for k in range(len(model.y)):
        end = k + lag + 1
        mean, cov, _, _ = peer(model).rts_smoother(means[:end], covs[:end])
        wanted.append((mean[k], cov[k]))
    mean, cov = (np.array(part) for part in zip(*wanted, strict=True))
    held(
        "filterpy",
        "fixed lag, as rts_smoother of the record up to then",
        (found.mean[1:], mean),
        (found.cov[1:], cov),
    )


def test_their_fixed_lag_smoother(held, apart):
    """Where the gains stand still: with the forecast's covariance and F K for K it is right."""
    model, lag, steps = linear(8, 3, 2, steps=150), 3, range(100, 140)
    filter, times = KalmanFilter(system(model)), np.arange(151.0)
    found = smooth(filter, times, late(model.y), lag=lag - 1).mean[1:][steps]
    made = peer(model, lambda dim_x, dim_z: kalman.FixedLagSmoother(dim_x, dim_z, N=lag))
    theirs, _ = made.smooth_batch(model.y, lag)
    reason = "begins with the corrected covariance and leaves F out of its gains"
    apart("filterpy", "FixedLagSmoother", reason, found, theirs[steps], 0.01)
    made, wanted, errors = peer(model), [], []
    for row in model.y:
        made.predict()
        wanted.append(made.x_prior.copy())
        made.update(row)
        spread, loop = made.P_prior, model.F - model.F @ made.K @ model.H
        errors.append(made.SI @ made.y)
        for i in range(min(lag, len(wanted))):
            wanted[-1 - i] = wanted[-1 - i] + spread @ model.H.T @ errors[-1]
            spread = spread @ loop.T
    held("filterpy", "FixedLagSmoother with both put right", (found, np.array(wanted)[steps]))
