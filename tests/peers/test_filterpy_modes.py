"""The interacting multiple models of filterpy 1.4.5, whose new mode drives the step.

A switching system whose old mode drives it does the same when its modes are pairs of the mode
that a step leaves and the one that it comes to.
"""

import numpy as np
import pytest
import sympy
from filterpy import kalman

from peers.models import late, linear
from seedslib.designed import SwitchingFilter
from seedslib.linearization import Taylor
from seedslib.models import Noise, SwitchingSystem


@pytest.fixture(scope="module")
def modes():
    """Three linear models with the same sizes, a chain, and a record of the first."""
    models = [linear(seed, 2, 2, radius) for seed, radius in ((30, 0.9), (31, 1.02), (32, 0.6))]
    rng = np.random.default_rng(33)
    chain = rng.dirichlet([8.0, 1.0, 1.0], size=3)
    return models, chain, rng.dirichlet(np.ones(3)), models[0].y


@pytest.fixture(scope="module")
def textbook(modes):
    """Our filter: mode (a, b) shows by the sensor of a, and moves by b."""
    models, chain, start, _ = modes
    pairs = [(a, b) for a in range(3) for b in range(3)]
    x, w, v = (np.array(sympy.symbols(f"{name}1:3", real=True)) for name in "xwv")
    roots = [(np.linalg.cholesky(part.Q), np.linalg.cholesky(part.R)) for part in models]
    first = models[0]
    return SwitchingFilter(
        SwitchingSystem(
            x,
            [list(models[b].F @ x + roots[b][0] @ w) for _, b in pairs],
            Noise(w),
            [[chain[b, c] if b == a else 0.0 for a, c in pairs] for _, b in pairs],
            [list(models[a].H @ x + roots[a][1] @ v) for a, _ in pairs],
            Noise(v),
            [(start[a] * chain[a, b], first.mean, first.cov) for a, b in pairs],
        ),
        Taylor(),
    )


def peer(modes):
    models, chain, start, _ = modes
    filters = []
    for model in models:
        made = kalman.KalmanFilter(2, 2)
        made.x, made.P = models[0].mean.copy(), models[0].cov.copy()
        made.F, made.Q, made.H, made.R = model.F, model.Q, model.H, model.R
        filters.append(made)
    return kalman.IMMEstimator(filters, start.copy(), chain)


def looped(made, y):
    found = []
    for row in y:
        made.predict()
        made.update(row if np.isfinite(row).all() else None)
        found.append((made.x.copy(), made.P.copy(), made.mu.copy()))
    return [np.array(part) for part in zip(*found, strict=True)]


def ours(textbook, y):
    found = textbook.run(np.arange(len(y) + 1.0), late(y), covariances=True)
    return found.mean[1:], found.cov[1:], found.mode_prob[1:].reshape(-1, 3, 3).sum(axis=2)


def test_interacting_models(modes, textbook, held):
    y = modes[-1]
    found = ours(textbook, y)
    assert (
        0.05 < found[2][:, 0].min() < found[2][:, 0].max()
    )  # the modes are not told apart at once
    pairs = zip(found, looped(peer(modes), y), strict=True)
    held("filterpy", "IMMEstimator: means, covariances, probabilities of modes", *pairs)


def test_their_modes_after_a_missing_record(modes, textbook, apart):
    """A gap says nothing of the mode; theirs weighs the modes by the densities of the last S."""
    _, chain, _, y = modes
    y = y.copy()
    y[4] = np.nan
    found = ours(textbook, y)[2]
    assert np.allclose(found[4], found[3] @ chain, rtol=0, atol=1e-12)
    theirs = looped(peer(modes), y)[2]
    assert np.allclose(found[:4], theirs[:4], rtol=0, atol=1e-10)
    reason = "a missing record moves the probabilities, by the densities of the last S at zero"
    apart("filterpy", "IMMEstimator.update(None)", reason, found, theirs, 0.01)
