"""Branches that are cut, and the bound of what that can have cost."""

import numpy as np
import pytest

from oracles.piecewise import TIMES, panels, product_parts, start_nodes, tent
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem

INF = np.inf
PARTS = product_parts()[1]


def pruned(y, prune):
    """Means, variances, sorted weights and dropped shares of a scalar system without noise.

    A branch is an itinerary, so that the starting points of a dropped one are dropped.
    """
    x, weight = start_nodes(PARTS, TIMES)
    edges, group, found = PARTS["regions"][1:-1], np.zeros(x.size, int), []
    for k, t in enumerate(TIMES):
        if k:
            offset, matrix = (np.asarray(part) for part in PARTS["dynamics"](TIMES[k - 1]))
            x = offset[0, cell] + matrix[0, 0, cell] * x  # noqa: F821
        cell = np.searchsorted(edges, x, side="right")
        group = 2 * group + cell
        if not np.isnan(y[k, 0]):
            b, B = (np.asarray(part)[..., cell] for part in PARTS["sensor"](t))
            weight = weight * np.exp(-0.5 * ((y[k, 0] - b[0] - B[0, 0] * x) / 0.4) ** 2)
            weight = weight / weight.sum()
        labels, index = np.unique(group, return_inverse=True)
        shares = np.bincount(index, weight)
        order = np.argsort(shares)
        drop = np.zeros(labels.size, bool)
        drop[order] = np.cumsum(shares[order]) <= prune
        share = shares[drop].sum()
        weight = np.where(drop[index], 0.0, weight) / (1 - share)
        mean = weight @ x
        found.append((mean, weight @ (x - mean) ** 2, np.sort(shares[~drop]) / (1 - share), share))
    return found


@pytest.mark.parametrize("prune", [0.05, 0.02])
def test_pruned_posteriors_are_those_of_the_kept_itineraries(prune):
    system = PiecewiseLinearSystem(**PARTS)
    y = system.simulate(TIMES, 3, 4).measurements
    y[2, 0, 1] = np.nan
    states = list(PiecewiseLinearFilter(system, prune=prune).states(TIMES, y))
    for n in range(3):
        for state, route in zip(states, pruned(y[..., n], prune), strict=True):
            mean, var, weights, share = route
            assert state.mean[0, n] == pytest.approx(mean, abs=1e-9)
            assert state.cov[0, 0, n] == pytest.approx(var, abs=1e-9)
            assert state.dropped[n] == pytest.approx(share, rel=1e-8, abs=1e-12)
            kept = np.sort(state.weights[:, n])[-len(weights) :]
            np.testing.assert_allclose(kept, weights, rtol=1e-8)


def test_of_equal_weights_the_first_branch_is_dropped():
    """Two cells of one half each: the lower one goes, and half of the distribution is lost."""
    filter_ = PiecewiseLinearFilter(tent(mean0=[0.0]), prune=0.6)
    state = filter_.step(filter_.initial(), 0.0, [0.3])
    np.testing.assert_allclose(state.mode_prob, [0.0, 1.0], atol=1e-15)
    assert state.dropped == pytest.approx(0.5, rel=1e-12)


def density(state, points, n):
    """Density of a scalar state from its branches."""
    branches, regions = state.branches, state.branches.regions
    alive = np.flatnonzero(branches.log_unit[:, n] > -INF)
    var = np.broadcast_to(branches.cov[0, 0], branches.mean[0].shape)[alive, n, None]
    gap = points - branches.mean[0, alive, n, None]
    inside = (regions[0, alive, None] <= points) & (points < regions[1, alive, None])
    dist = np.exp(branches.log_unit[alive, n, None] - 0.5 * gap**2 / var) / np.sqrt(2 * np.pi * var)
    return np.where(inside, dist, 0.0).sum(axis=0)


def nodes_of(*states):
    """Nodes and weights between the ends of all regions."""
    ends = np.concatenate([state.branches.regions for state in states], axis=1)
    ends = np.unique(np.clip([*ends.ravel(), *np.linspace(-9.0, 4.0, 40)], -9.0, 4.0))
    return panels(ends[np.append(True, np.diff(ends) > 1e-12)], 24)


def test_the_bound_of_the_error_is_never_violated():
    """lost <- (lost J / c + delta) / (1 - delta), and lost / (1 + lost) bounds the variation."""
    system, prune = tent(), 1e-2
    y = system.simulate(6, 5, 11).measurements
    exact = list(PiecewiseLinearFilter(system).states(6, y))
    cut = list(PiecewiseLinearFilter(system, prune=prune).states(6, y))
    lost, tight = np.zeros(5), []
    for full, less in zip(exact[1:], cut[1:], strict=True):
        assert (less.dropped <= prune).all()
        growth = 1.0 / (np.sqrt(2 * np.pi) * 0.2) / np.exp(less.loglik)
        lost = (lost * growth + less.dropped) / (1.0 - less.dropped)
        points, weights = nodes_of(full, less)
        for n, bound in enumerate(lost / (1.0 + lost)):
            gap = np.abs(density(full, points, n) - density(less, points, n))
            variation = 0.5 * gap @ weights
            assert variation <= bound * (1 + 1e-5) + 1e-9
            tight.append(variation / bound if bound > 1e-8 else 0.0)
    assert ((less.weights > 0).sum(axis=0) < (full.weights > 0).sum(axis=0)).all()
    assert max(tight) > 0.1
