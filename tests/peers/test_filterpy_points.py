"""Extended, unscented and cubature filters of filterpy 1.4.5 on random models with sines.

It corrects with the points that came through the dynamics. They have the spread of what was
moved, without the noise of the step, so on a linear model that is not the Kalman filter. Drawn
anew from the forecast, as ours are and as dynamax does it, its points give our numbers.
"""

import numpy as np
import pytest
from filterpy import kalman
from filterpy.kalman.CubatureKalmanFilter import spherical_radial_sigmas

from peers.models import bent, late, linear, system
from seedslib.filters import (
    KalmanFilter,
    cubature_kalman,
    extended_kalman,
    smooth,
    unscented_kalman,
)

MODELS = {"one state": (1, 1, 1), "two": (2, 2, 1), "three": (3, 3, 2), "four": (4, 4, 3, 1.02)}
POINTS = {
    "Merwe(.5, 2, 1)": (lambda n: kalman.MerweScaledSigmaPoints(n, 0.5, 2.0, 1.0), (0.5, 2.0, 1.0)),
    "Merwe(1, 0, .5)": (lambda n: kalman.MerweScaledSigmaPoints(n, 1.0, 0.0, 0.5), (1.0, 0.0, 0.5)),
    "Julier(1)": (lambda n: kalman.JulierSigmaPoints(n, 1.0), (1.0, 0.0, 1.0)),
}


def peer(model, points, move=None, see=None):
    """filterpy's unscented filter."""
    n, m = len(model.mean), len(model.R)
    move, see = move or model.move, see or model.see
    made = kalman.UnscentedKalmanFilter(n, m, 1.0, see, lambda x, dt: move(x), points(n))
    made.x, made.P, made.Q, made.R = model.mean.copy(), model.cov.copy(), model.Q, model.R
    return made


def drawn(made):
    """Points of the forecast."""
    if isinstance(made, kalman.UnscentedKalmanFilter):
        made.compute_process_sigmas(1.0, lambda x, dt: x)
    else:
        made.sigmas_f = spherical_radial_sigmas(made.x, made.P)


def looped(made, y, anew=True):
    """Means, covariances and log-likelihoods; a row with NaN is missing."""
    found = []
    for row in y:
        made.predict()
        if anew:
            drawn(made)
        seen = np.isfinite(row).all()
        column = row[:, None] if isinstance(made, kalman.CubatureKalmanFilter) else row
        made.update(column if seen else None)
        loglik = made.log_likelihood if seen else 0.0
        found.append((made.x.reshape(-1).copy(), made.P.copy(), loglik))
    return [np.array(part) for part in zip(*found, strict=True)]


def pairs(found, theirs):
    """Ours, which begins with a gap, beside theirs."""
    return [(part[1:], other) for part, other in zip(found, theirs, strict=True)]


def taken(estimates):
    return estimates.mean, estimates.cov, estimates.loglik


@pytest.mark.parametrize("points", POINTS)
@pytest.mark.parametrize("case", MODELS)
def test_unscented_filter_and_smoother(case, points, held):
    model, (made, values) = bent(*MODELS[case]), POINTS[points]
    alpha, beta, kappa = values
    filter = unscented_kalman(system(model), alpha=alpha, beta=beta, kappa=kappa)
    times = np.arange(len(model.y) + 1.0)
    y = model.y.copy()
    y[7] = np.nan
    means, covs, logliks = looped(peer(model, made), y)
    found = filter.run(times, late(y))
    held(
        "filterpy",
        f"UnscentedKalmanFilter, {points.split('(')[0]} points drawn anew",
        *pairs(taken(found), (means, covs, logliks)),
    )
    smoothed = smooth(filter, times, late(y))
    late_mean, late_cov, _ = peer(model, made).rts_smoother(means, covs)
    held(
        "filterpy",
        "UnscentedKalmanFilter.rts_smoother",
        *pairs(taken(smoothed)[:2], (late_mean, late_cov)),
    )


def test_points_close_together_cost_digits(held):
    """With alpha = .001 weights are of the order of a million, and so is what rounding becomes."""
    model = bent(2, 2, 1)
    filter = unscented_kalman(system(model), alpha=1e-3, beta=2.0, kappa=0.0)
    found = filter.run(np.arange(len(model.y) + 1.0), late(model.y))
    theirs = looped(
        peer(model, lambda n: kalman.MerweScaledSigmaPoints(n, 1e-3, 2.0, 0.0)), model.y
    )
    what, reason = "UnscentedKalmanFilter, alpha = .001", "weights of 1e6, digits of 1e-10 in both"
    held("filterpy", what, *pairs(taken(found), theirs), bound=1e-8, reason=reason)


@pytest.mark.parametrize("kind", ["Merwe", "cubature"])
def test_points_that_came_through_the_dynamics(kind, held, apart):
    """On a linear model: theirs drawn anew are the Kalman filter to the last digits, reused not."""
    model = linear(2, 3, 2)
    exact = KalmanFilter(system(model)).run(np.arange(26.0), late(model.y))

    def made():
        if kind == "cubature":
            return cubature(model, lambda x: model.F @ x, lambda x: model.H @ x)
        points = POINTS["Merwe(.5, 2, 1)"][0]
        return peer(model, points, lambda x: model.F @ x, lambda x: model.H @ x)

    name = "CubatureKalmanFilter" if kind == "cubature" else "UnscentedKalmanFilter"
    theirs = looped(made(), model.y)
    held("filterpy", f"{name} of a linear model, points drawn anew", *pairs(taken(exact), theirs))
    reused, _, _ = looped(made(), model.y, anew=False)
    reason = "points moved by the dynamics lack the noise of the step: not the Kalman filter"
    apart("filterpy", f"{name} of a linear model as it comes", reason, exact.mean[1:], reused, 0.1)


def cubature(model, move=None, see=None):
    """filterpy's cubature filter."""
    n, m = len(model.mean), len(model.R)
    move, see = move or model.move, see or model.see
    made = kalman.CubatureKalmanFilter(n, m, 1.0, see, lambda x, dt: move(x))
    made.x, made.P, made.Q, made.R = model.mean[:, None], model.cov.copy(), model.Q, model.R
    return made


@pytest.mark.parametrize("case", MODELS)
def test_cubature_filter(case, held):
    model = bent(*MODELS[case])
    found = cubature_kalman(system(model)).run(np.arange(len(model.y) + 1.0), late(model.y))
    what = "CubatureKalmanFilter, points drawn anew"
    held("filterpy", what, *pairs(taken(found), looped(cubature(model), model.y)))


class Extended(kalman.ExtendedKalmanFilter):
    """It leaves the move of the mean to a subclass."""

    def predict_x(self, u=0):
        self.x, self.F = self.model.move(self.x), self.model.move_slope(self.x)


def extended(model):
    made = Extended(len(model.mean), len(model.R))
    made.x, made.P, made.Q, made.R = model.mean.copy(), model.cov.copy(), model.Q, model.R
    made.model = model
    return made


@pytest.mark.parametrize("case", MODELS)
def test_extended_filter(case, held):
    model, rows = bent(*MODELS[case]), []
    made = extended(model)
    for row in model.y:
        made.predict()
        made.update(row, model.see_slope, model.see)
        rows.append((made.x.copy(), made.P.copy(), made.log_likelihood))
    theirs = [np.array(part) for part in zip(*rows, strict=True)]
    found = extended_kalman(system(model)).run(np.arange(len(model.y) + 1.0), late(model.y))
    held("filterpy", "ExtendedKalmanFilter, predict and update", *pairs(taken(found), theirs))


def test_extended_step_at_once(held, apart):
    """`predict_update` takes the slope of the sensor where the state was before it moved."""
    model = bent(2, 2, 1)
    model = model._replace(B=0 * model.B)  # it moves by a matrix only
    found = extended_kalman(system(model)).run(np.arange(len(model.y) + 1.0), late(model.y))

    def means(slope):
        made = extended(model)
        made.F = model.A
        for row in model.y:
            made.predict_update(row, slope, model.see)
            yield made.x.copy()

    what = "ExtendedKalmanFilter.predict_update"
    reason = "takes the sensor's slope before the move"
    apart("filterpy", what, reason, found.mean[1:], [*means(model.see_slope)], 1e-3)
    mended = [*means(lambda x: model.see_slope(model.A @ x))]
    held("filterpy", f"{what}, given the slope after the move", (found.mean[1:], mended))


def test_a_batch_is_their_loop(held):
    model = bent(3, 3, 2)
    y = np.stack([model.y, model.y[::-1], model.y + 0.1], axis=-1)
    made, (alpha, beta, kappa) = POINTS["Merwe(.5, 2, 1)"]
    filter = unscented_kalman(system(model), alpha=alpha, beta=beta, kappa=kappa)
    found = filter.run(np.arange(len(y) + 1.0), late(y))
    theirs = [looped(peer(model, made), y[..., j]) for j in range(3)]
    whole = [np.stack(part, axis=-1) for part in zip(*theirs, strict=True)]
    held("filterpy", "UnscentedKalmanFilter in a loop over records", *pairs(taken(found), whole))
