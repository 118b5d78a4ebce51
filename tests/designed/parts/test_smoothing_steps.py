"""Steps back of the switching smoother: limits where they are known, and their small parts."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from seedslib.designed import SwitchingFilter
from seedslib.designed.switching.lemmas import ModeLaw
from seedslib.designed.switching.smoothing import SwitchingSmoother, _corrected, _solved
from seedslib.filters import smooth
from seedslib.linearization import GaussHermite, Taylor
from seedslib.models import Noise, SwitchingSystem

X, V, W = sympy.symbols("x v w", real=True)
MOVES = [[0.9 * X + 0.4 + 0.3 * V], [0.5 * X - 0.7 + 0.8 * V]]
SEES = [[X + 0.5 * W], [1.3 * X + 0.7 * W]]
LAWS = [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])]
TIMES = np.arange(4.0)
rng = np.random.default_rng(6)


def system(switch, indicator=None):
    return SwitchingSystem(
        (X,), MOVES, Noise((V,)), switch, SEES, Noise((W,)), LAWS, indicator=indicator
    )


SWITCH = [[0.85, 0.15], [0.3, 0.7]]


@pytest.fixture(scope="module")
def hardly_seeing():
    """An indicator of mode and state, of which the state's part is next to nothing."""
    faint = 1e-11 * X / (1 + X**2)
    return SwitchingFilter(system(SWITCH, [[0.8 + faint, 0.2 - faint], [0, 1]]), GaussHermite(3))


def test_forward_substitution_of_a_semidefinite_factor():
    """L u = v by numbers; a column of zeros, whose entry of v is left over, has the value zero."""
    lower = np.tril(rng.normal(size=(3, 3))) + 2.0 * np.eye(3)
    value = rng.normal(size=(3, 2))
    whole = np.repeat(lower[..., None], 2, axis=-1)
    assert_allclose(_solved(whole, value), np.linalg.solve(lower, value), rtol=1e-13)
    for j in range(3):
        flat = whole.copy()
        flat[:, j, 0] = 0.0
        kept = [k for k in range(3) if k != j]
        found = _solved(flat, value)
        assert found[j, 0] == 0.0
        wanted = np.linalg.solve(lower[np.ix_(kept, kept)], value[kept, 0])
        assert_allclose(found[kept, 0], wanted, rtol=1e-13)
        assert_allclose(found[:, 1], np.linalg.solve(lower, value[:, 1]), rtol=1e-13)


def joint(n, *batch):
    root = rng.normal(size=(2 * n, 2 * n + 1, *batch))
    return np.einsum("ia...,ja...->ij...", root, root)


@pytest.mark.parametrize("n", [1, 2])
def test_one_pair_takes_the_step_back_of_rauch(n):
    both, spread = rng.normal(size=(2 * n, 1, 3)), joint(n, 1, 3)
    late, full = rng.normal(size=(n, 3)), spread[n:, n:, 0]
    later = ModeLaw(np.log([0.2, 0.5, 1.0]), late, 0.3 * full)
    log_prob, mean, cov = _corrected(np.full((1, 3), -0.7), both, spread, later)
    assert_allclose(log_prob[0], later.log_prob, atol=1e-12)
    for path in range(3):
        p = spread[..., 0, path]
        gain = p[:n, n:] @ np.linalg.inv(p[n:, n:])
        moved = both[:n, 0, path] + gain @ (late[:, path] - both[n:, 0, path])
        less = p[:n, :n] + gain @ (0.3 * p[n:, n:] - p[n:, n:]) @ gain.T
        assert_allclose(mean[:, 0, path], moved, rtol=1e-8, atol=1e-10)
        assert_allclose(cov[..., 0, path], less, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("n", [1, 2])
def test_what_a_smoothed_law_is_wider_than_its_forecast_is_added(n):
    """No likelihood makes it so; with one pair it is the step of Rauch all the same."""
    both, spread = rng.normal(size=(2 * n, 1, 3)), joint(n, 1, 3)
    later = ModeLaw(np.zeros(3), both[n:, 0], 1.3 * spread[n:, n:, 0])
    _, mean, cov = _corrected(np.zeros((1, 3)), both, spread, later)
    assert_allclose(mean, both[:n], rtol=1e-12)
    for path in range(3):
        p = spread[..., 0, path]
        gain = p[:n, n:] @ np.linalg.inv(p[n:, n:])
        assert_allclose(cov[..., 0, path], p[:n, :n] + 0.3 * gain @ p[n:, n:] @ gain.T, rtol=1e-9)


def test_pairs_without_later_measurements_stay_as_they_are():
    """Where the smoothed law is the forecast mixture itself; a pair of no mass keeps none."""
    logs = np.log(np.array([[0.5], [0.3], [0.2], [1.0]]))
    logs[3] = -np.inf
    both, spread = rng.normal(size=(2, 4, 1)), joint(1, 4, 1)
    share = np.exp(logs)
    middle = (share * both[1]).sum(axis=0)
    whole = (share * (spread[1, 1] + (both[1] - middle) ** 2)).sum(axis=0)
    later = ModeLaw(np.log([0.4]), middle[None], whole[None, None])
    log_prob, mean, cov = _corrected(logs, both, spread, later)
    assert_allclose(np.exp(log_prob), 0.4 * share, rtol=1e-12)
    assert_allclose(mean[:, :3], both[:1, :3], rtol=1e-10)
    assert_allclose(cov[:, :, :3], spread[:1, :1, :3], rtol=1e-9)


def test_an_indicator_that_hardly_sees_the_state_is_one_that_does_not(hardly_seeing):
    """Forecasts are split by its value, and put together again, also where it is missing."""
    y = rng.normal(size=(4, 1, 5))
    shown = rng.integers(0, 2, size=(4, 5))
    shown[1, 2] = shown[3, 4] = -1
    y[2, 0, 1] = np.nan
    one = hardly_seeing
    two = SwitchingFilter(system(SWITCH, [[0.8, 0.2], [0, 1]]), GaussHermite(3))
    assert one.rules.split is True
    assert two.rules.split is False
    for run in (
        lambda f: f.run(TIMES, y, indicators=shown, covariances=True),
        lambda f: smooth(f, TIMES, y, indicators=shown),
        lambda f: smooth(f, TIMES, y, indicators=shown, lag=1),
    ):
        found, wanted = run(one), run(two)
        for name in ("mean", "cov", "mode_prob", "loglik"):
            assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-8, atol=1e-9)


def test_parts_are_what_one_value_of_the_indicator_goes_with(hardly_seeing):
    """Those of the value seen; all, where none of them can have shown it, or none was seen."""
    filter = hardly_seeing
    smoother = SwitchingSmoother(filter)
    state = filter.step(filter.initial((2,)), 0.0, np.array([[0.3, -0.2]]), np.array([0, 1]))
    pairs = list(smoother._pairs(filter.rules.rows, 0.0, state.law, np.array([0, -1])))
    # parts by old mode, value and path
    told, both, spread = pairs[0]
    assert told.shape == (4, 2)
    assert both.shape == (2, 4, 2)
    assert spread.shape == (2, 2, 4, 2)
    moved = state.law.prob * np.array([[0.85], [0.3]])
    told = np.exp(told).reshape(2, 2, 2)
    assert_allclose(told[:, 0], 0.8 * moved, rtol=1e-8)
    assert_allclose(told[:, 1], 0.2 * moved * [0, 1], rtol=1e-8)
    # mode 1 always shows 1: of neither path a part goes with 0
    moved = state.law.prob * np.array([[0.15], [0.7]])
    told = np.exp(pairs[1][0]).reshape(2, 2, 2)
    assert_allclose(told[:, 1], moved, rtol=1e-8)
    assert_array_equal(told[:, 0], 0.0)


def test_pairs_are_those_of_the_branches():
    """Old and new state of each pair of modes, by the formulas of the moves."""
    for rule in (Taylor(), GaussHermite(3)):
        filter = SwitchingFilter(system(SWITCH), rule)
        state = filter.step(filter.initial((3,)), 0.0, rng.normal(size=(1, 3)))
        pairs = SwitchingSmoother(filter)._pairs(filter.rules.rows, 0.0, state.law, None)
        for l, (log_prob, both, spread) in enumerate(pairs):
            for i, (slope, push, noise) in enumerate(((0.9, 0.4, 0.09), (0.5, -0.7, 0.64))):
                m, p = state.law.mean[0, i], state.law.cov[0, 0, i]
                assert_allclose(np.exp(log_prob[i]), state.law.prob[i] * SWITCH[i][l], rtol=1e-12)
                assert_allclose(both[:, i], [m, slope * m + push], rtol=1e-11)
                wanted = [[p, slope * p], [slope * p, slope**2 * p + noise]]
                assert_allclose(spread[:, :, i], wanted, rtol=1e-11)


def test_records_that_no_mode_explains_are_told():
    filter = SwitchingFilter(system(np.eye(2).tolist(), [[1, 0], [0, 1]]), Taylor())
    y, shown = np.zeros((3, 1, 2)), np.array([[0, 0], [0, 1], [0, 1]])
    found = smooth(filter, TIMES[:3], y, indicators=shown)
    assert found.diverged.tolist() == [False, True]
    assert np.isfinite(found.mean).all()
    assert_array_equal(found.modes[:, 0], 0)


def test_what_a_smoothed_law_says():
    filter = SwitchingFilter(system(SWITCH), Taylor())
    prob, mean = np.array([[0.3, 0.5], [0.7, 0.5]]), np.array([[[1.0, 0.0], [2.0, 4.0]]])
    cov = np.array([[[[0.5, 1.0], [0.2, 3.0]]]])
    said = SwitchingSmoother(filter).report(ModeLaw.of(prob, mean, cov))
    assert_allclose(said.mean, [[1.7, 2.0]], rtol=1e-14)
    assert_allclose(said.cov, [[[0.15 + 0.14 + 0.21, 2.0 + 4.0]]], rtol=1e-13)
    assert_allclose(said.mode_prob, prob, rtol=1e-14)
    assert said.modes.tolist() == [1, 0]
    assert said.loglik is said.diverged is None
