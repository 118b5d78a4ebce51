"""Branches that are cut or merged, and the bound of what that can have cost."""

import numpy as np
import pytest

from oracles.piecewise import TIMES, panels, product_parts, start_nodes, tent
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem

INF = np.inf
PARTS = product_parts()[1]


def pruned(y, prune, keep, neglect=0.0):
    """Means, variances, sorted weights before pruning and bounds of a scalar system without noise.

    A branch is an itinerary, so that the starting points of a dropped one are dropped.
    """
    x, weight = start_nodes(PARTS, TIMES)
    edges, group, lost, found = PARTS["regions"][1:-1], np.zeros(x.size, int), 0.0, []
    for k, t in enumerate(TIMES):
        if k:
            offset, matrix = (np.asarray(part) for part in PARTS["dynamics"](TIMES[k - 1]))
            x = offset[0, cell] + matrix[0, 0, cell] * x  # noqa: F821
        cell = np.searchsorted(edges, x, side="right")
        group, peak, total = 2 * group + cell, 1.0, 1.0
        if not np.isnan(y[k, 0]):
            b, B = (np.asarray(part)[..., cell] for part in PARTS["sensor"](t))
            peak = 1.0 / 0.4 / np.sqrt(2 * np.pi)
            weight = weight * peak * np.exp(-0.5 * ((y[k, 0] - b[0] - B[0, 0] * x) / 0.4) ** 2)
            total = weight.sum()
            weight = weight / total
        labels, index = np.unique(group, return_inverse=True)
        shares = np.bincount(index, weight)
        order = np.argsort(shares)
        drop = np.zeros(labels.size, bool)
        drop[order] = np.cumsum(shares[order]) <= prune
        if keep is not None:
            drop[order[: max(0, labels.size - keep)]] = True
        share = shares[drop].sum()
        weight = np.where(drop[index], 0.0, weight) / (1 - share)
        share += neglect
        lost = (lost * peak / total + share) / (1 - share)
        mean = weight @ x
        found.append((mean, weight @ (x - mean) ** 2, np.sort(shares[~drop]) / (1 - share), lost))
    return found


@pytest.mark.parametrize(
    "options",
    [{"prune": 0.05}, {"keep": 3}, {"prune": 0.02, "keep": 5}, {"keep": 4, "neglect": 1e-3}],
)
def test_pruned_posteriors_are_those_of_the_kept_itineraries(options):
    system = PiecewiseLinearSystem(**PARTS)
    y = system.simulate(TIMES, 3, 4).measurements
    y[2, 0, 1] = np.nan
    states = list(PiecewiseLinearFilter(system, **options).states(TIMES, y))
    for n in range(3):
        neglect = options.get("neglect", 0.0)
        route = pruned(y[..., n], options.get("prune", 0.0), options.get("keep"), neglect)
        for state, (mean, var, weights, lost) in zip(states, route, strict=True):
            assert state.mean[0, n] == pytest.approx(mean, abs=1e-9)
            assert state.cov[0, 0, n] == pytest.approx(var, abs=1e-9)
            assert state.lost[n] == pytest.approx(lost, rel=1e-8, abs=1e-12)
            kept = np.sort(state.weights[:, n])[-len(weights) :]
            np.testing.assert_allclose(kept, weights, rtol=2e-3 if neglect else 1e-8)
            top = state.weights[:, n].max()
            for threshold in (0.1, 0.5):
                assert (
                    state.noticeable(threshold)[n] == (state.weights[:, n] >= threshold * top).sum()
                )
                count = state.noticeable(threshold, relative=False)[n]
                assert count == (state.weights[:, n] >= threshold).sum()
    np.testing.assert_allclose(state.error_bound, 1 - 1 / (1 + state.lost), rtol=1e-12)
    forward = PiecewiseLinearFilter(system, **options).predict(state, 5.0)
    np.testing.assert_array_equal(forward.lost, state.lost)


def test_of_equal_weights_the_first_branch_is_dropped():
    """Two cells of one half each: the lower one goes, and half of the law is lost."""
    system = tent(mean0=[0.0])
    for options in ({"keep": 1}, {"prune": 0.6}):
        filter_ = PiecewiseLinearFilter(system, **options)
        state = filter_.step(filter_.initial(), 0.0, [0.3])
        np.testing.assert_allclose(state.mode_prob, [0.0, 1.0], atol=1e-15)
        assert state.lost == pytest.approx(1.0, rel=1e-12)
    kept = PiecewiseLinearFilter(system, keep=2)
    state = kept.step(kept.initial(), 0.0, [0.3])
    np.testing.assert_allclose(state.mode_prob, [0.5, 0.5], rtol=1e-12)


def density(state, points, n):
    """Density of a scalar state from its branches."""
    branches, regions = state.branches, state.branches.regions
    alive = np.flatnonzero(branches.log_unit[:, n] > -INF)
    var = np.broadcast_to(branches.cov[0, 0], branches.mean[0].shape)[alive, n, None]
    gap = points - branches.mean[0, alive, n, None]
    inside = (regions.lower[alive, None] <= points) & (points < regions.upper[alive, None])
    law = np.exp(branches.log_unit[alive, n, None] - 0.5 * gap**2 / var) / np.sqrt(2 * np.pi * var)
    return np.where(inside, law, 0.0).sum(axis=0)


def chords(cells=21):
    """A fine interpolation of a smooth map: neighbours are on adjoining intervals."""
    edges = np.linspace(-2, 2, cells)
    value = 0.9 * edges + np.sin(edges) / 5
    slope = np.diff(value) / np.diff(edges)
    return PiecewiseLinearSystem(
        np.concatenate([[-INF], edges[1:-1], [INF]]),
        ((value[:-1] - slope * edges[:-1])[None], slope[None, None]),
        ([0.0], [[1.0]]), [[1.0]], [0.3], [[0.16]],
    )  # fmt: skip


def nodes_of(*states):
    """Nodes and weights between the ends of all regions."""
    ends = np.concatenate([[s.branches.regions.lower, s.branches.regions.upper] for s in states], 1)
    ends = np.unique(np.clip([*ends.ravel(), *np.linspace(-9.0, 4.0, 40)], -9.0, 4.0))
    return panels(ends[np.append(True, np.diff(ends) > 1e-12)], 24)


@pytest.mark.parametrize(
    ("system", "merge", "share"), [(tent(), 0.3, 0.01), (chords(), 0.02, 0.7), (chords(), 0.3, 0.7)]
)
def test_one_merging_is_bounded_by_its_distance(system, merge, share):
    """Hilbert's distance of the laws before and after, by their densities; estimates stay.

    The bound is loose where laws on one interval are merged, and good for adjoining intervals.
    """
    y = system.simulate(4, 6, 3).measurements
    plain, merging = PiecewiseLinearFilter(system), PiecewiseLinearFilter(system, merge=merge)
    state, ratios = plain.initial((6,)), []
    for k in range(5):
        state, before = plain.step(state, k, y[k]), state
        merged = merging.step(before, k, y[k])
        for field in ("mean", "cov", "mode_prob", "loglik"):
            np.testing.assert_allclose(getattr(merged, field), getattr(state, field), atol=1e-12)
        np.testing.assert_allclose(merged.weights.sum(axis=0), 1.0, rtol=1e-12)
        points, weights = nodes_of(state, merged)
        for n in range(6):
            one, other = density(state, points, n), density(merged, points, n)
            assert other @ weights == pytest.approx(1.0, abs=1e-5)
            assert 0.5 * np.abs(one - other) @ weights <= merged.error_bound[n] + 1e-9
            there = (one > 1e-250) & (other > 1e-250)
            log_ratio = np.log(one[there] / other[there])
            variation = np.ptp(log_ratio)
            assert variation <= merged.distance[n] * (1 + 1e-6) + 1e-9
            if merged.distance[n] > 1e-3:
                ratios.append(variation / merged.distance[n])
    assert merged.noticeable(0.0).sum() == merged.weights.size
    assert ((merged.weights > 0).sum(axis=0) < (state.weights > 0).sum(axis=0)).any()
    assert len(ratios) > 3
    assert max(ratios) > share
    assert (merged.distance <= 20 * merge).all()


@pytest.mark.parametrize(
    "options", [{"prune": 1e-2}, {"merge": 0.1}, {"prune": 1e-3, "merge": 0.05}]
)
def test_the_bound_of_the_error_is_never_violated(options):
    system = tent()
    y = system.simulate(6, 5, 11).measurements
    exact = list(PiecewiseLinearFilter(system).states(6, y))
    cut = list(PiecewiseLinearFilter(system, **options).states(6, y))
    tight = []
    for full, less in zip(exact[1:], cut[1:], strict=True):
        points, weights = nodes_of(full, less)
        for n in range(5):
            gap = np.abs(density(full, points, n) - density(less, points, n))
            variation = 0.5 * gap @ weights
            assert variation <= less.error_bound[n] * (1 + 1e-5) + 1e-9
            tight.append(variation / less.error_bound[n] if less.error_bound[n] > 1e-8 else 0.0)
    assert (cut[-1].noticeable(1e-300) < exact[-1].noticeable(1e-300)).all()
    assert max(tight) > (0.1 if "prune" in options else 1e-4)
    kept = 1 - 1 / (1 + less.lost) + np.tanh(less.distance / 4)
    np.testing.assert_allclose(less.error_bound, kept, rtol=1e-12)
    assert (less.distance > 0).all() == ("merge" in options)


def test_losses_grow_by_the_distance_of_merging():
    """lost <- (lost J e^d / c + delta e^d) / (1 - delta e^d), d before the step."""
    system, prune = tent(sensor_noise=[[0.6]]), 0.02
    y = system.simulate(6, 8, 11).measurements
    cut, whole = (
        PiecewiseLinearFilter(system, prune=prune, merge=0.5),
        PiecewiseLinearFilter(system),
    )
    state, lost = cut.step(cut.initial((8,)), 0.0, y[0]), np.zeros(8)
    for k in range(1, 7):
        weights = whole.step(state, float(k), y[k]).weights
        rising = np.cumsum(np.sort(weights, axis=0), axis=0)
        share, factor = np.where(rising <= prune, rising, 0.0).max(axis=0), np.exp(state.distance)
        state = cut.step(state, float(k), y[k])
        growth = factor / (np.sqrt(2 * np.pi) * 0.6) / np.exp(state.loglik)
        lost = (lost * growth + share * factor) / (1 - share * factor)
        np.testing.assert_allclose(state.lost, lost, rtol=1e-9, atol=1e-25)
    assert (state.lost > 0.01).all()
    assert (state.distance > 0.1).any()
