"""The bound of the mass that pruning drops after merging has falsified the weights.

The filter sees laws through merging: its law q and the right law p of what is kept are at a
projective distance of d at most, that is p / q varies by a factor e^d at most. What it takes for
a share delta may then be up to delta e^d, and what it takes for a likelihood c may be c e^-d.
"""

import numpy as np
import pytest

from oracles import piecewise_routes as routes
from seedslib.piecewise import PiecewiseLinearFilter
from seedslib.piecewise.state import lost_mass

NEARLY = 0.97


def normalised(weights):
    weights = np.asarray(weights, dtype=float)
    return weights / weights.sum()


def true_step(seen, right, lost, likelihood, peak, dropped):
    """Ratio of dropped to kept mass by summing over points, with what the filter takes for it.

    Laws `seen` and `right` of what is kept on finitely many points, the likelihood at each (at
    `peak` where the mass that was dropped before lies), and which points are dropped now.
    """
    density = seen @ likelihood
    share = (seen * likelihood)[dropped].sum() / density
    inside = right * likelihood
    before = lost * peak + inside[dropped].sum()
    return before / inside[~dropped].sum(), share, np.log(peak / density)


@pytest.mark.parametrize("distance", [0.0, 0.3, 1.0, 2.0])
def test_dropped_share_may_be_larger_by_the_distance(distance):
    """All of the difference of the two laws lies between what is dropped and the rest."""
    share = 1e-3
    seen = np.array([share, 1 - share])
    right = normalised(seen * [np.exp(distance), 1.0])
    dropped = np.array([True, False])
    true, seen_share, ratio = true_step(seen, right, 0.0, np.ones(2), 1.0, dropped)
    assert seen_share == pytest.approx(share)
    bound = lost_mass(0.0, seen_share, distance, ratio)
    assert NEARLY * bound < true <= bound * (1 + 1e-12)


@pytest.mark.parametrize("distance", [0.0, 0.3, 1.0, 2.0])
def test_lost_mass_may_grow_more_by_the_distance(distance):
    """The measurement leaves what was dropped and one point, of which too much was thought."""
    lost, little = 1e-4, 1e-3
    seen = np.array([little, 1 - little])
    right = normalised(seen * [np.exp(-distance), 1.0])
    likelihood, nothing = np.array([2.0, 0.0]), np.zeros(2, dtype=bool)
    true, share, ratio = true_step(seen, right, lost, likelihood, 2.0, nothing)
    bound = lost_mass(lost, share, distance, ratio)
    assert NEARLY * bound < true <= bound * (1 + 1e-12)
    assert true == pytest.approx(lost / right[0])


def test_both_at_once_on_random_laws():
    """Any two laws at the distance, any likelihood, anything dropped: never above the bound."""
    rng, closest = np.random.default_rng(0), 0.0
    for _ in range(3000):
        distance = rng.choice([0.0, 0.2, 1.0])
        seen = normalised(rng.exponential(size=4) ** 3)
        right = normalised(seen * np.exp(distance * rng.integers(0, 2, 4)))
        likelihood = rng.choice([1e-3, 1.0], 4) * rng.uniform(0.5, 1, 4)
        lost, dropped = rng.choice([0.0, 1e-3, 0.1]), seen * likelihood < 0.05
        if dropped.all():
            continue
        true, share, ratio = true_step(seen, right, lost, likelihood, 1.0, dropped)
        bound = float(lost_mass(lost, share, distance, ratio))
        assert true <= bound * (1 + 1e-12)
        closest = max(closest, true / bound if bound > 0 and distance > 0 else 0.0)
    assert closest > NEARLY


@pytest.mark.parametrize("merge", [0.0, 0.5])
def test_recursion_of_the_filter(merge):
    """lost <- (lost J e^d / c + delta e^d) / (1 - delta e^d), from the states of the filter.

    delta: the smallest weights before pruning, as the same filter without pruning shows them.
    """
    prune, noise = 0.02, 0.6
    system = routes.tent(sensor_noise=[[noise]])
    y = system.simulate(6, 8, 11).measurements
    cut = PiecewiseLinearFilter(system, prune=prune, merge=merge)
    whole = PiecewiseLinearFilter(system)
    state, lost = cut.step(cut.initial((8,)), 0.0, y[0]), np.zeros(8)
    for k in range(1, 7):
        weights = whole.step(state, float(k), y[k]).weights
        rising = np.cumsum(np.sort(weights, axis=0), axis=0)
        share = np.where(rising <= prune, rising, 0.0).max(axis=0)
        factor = np.exp(state.distance)
        after = cut.step(state, float(k), y[k])
        growth = factor / (np.sqrt(2 * np.pi) * noise) / np.exp(after.loglik)
        lost = (lost * growth + share * factor) / (1 - share * factor)
        np.testing.assert_allclose(after.lost, lost, rtol=1e-9, atol=1e-25)
        state = after
    assert (state.lost > 0.01).all()
    assert (state.distance > 0.1).any() == (merge > 0)
    kept = 1 - 1 / (1 + state.lost) + np.tanh(state.distance / 4)
    np.testing.assert_allclose(state.error_bound, kept, rtol=1e-12)
