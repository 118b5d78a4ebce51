"""Drawn histories of modes against all of them; exactness and inputs are in test_filter.py."""

import numpy as np
import pytest
import sympy

from oracles.linear import histories
from seedslib.filters import KnownModeFilter, RaoBlackwellFilter
from seedslib.models import Noise, SwitchingSystem
from seedslib.zoo import manoeuvring_target
from systems import INPUTS, TIMES, linear_numbers, record, switching_numbers, switching_system

x, v, w = sympy.symbols("x v w", real=True)
SHORT = [0, 4, 2, 5]
SHOWN = np.array([0, -1, 1, 0])


@pytest.mark.parametrize("drives", ["old", "new"])
def test_likelihood_of_drawn_histories_is_unbiased(drives):
    """Over 1500 runs of 5 histories, for each of two courses of the inputs; so are the means."""
    y = record(linear_numbers())[1][SHORT]
    factors = np.repeat([1.0, -0.5], 1500)
    inputs = {u: values[:4, None] * factors for u, values in INPUTS.items()}
    filter = RaoBlackwellFilter(switching_system(drives), 5)
    many, shown = np.repeat(y[..., None], 3000, axis=-1), np.repeat(SHOWN[:, None], 3000, axis=1)
    estimates = filter.run(TIMES[:4], many, indicators=shown, inputs=inputs, seed=3)
    for part, factor in ((slice(0, 1500), 1.0), (slice(1500, 3000), -0.5)):
        given = {u: values * factor for u, values in INPUTS.items()}
        dist = histories(switching_numbers(TIMES, given), y, SHOWN, 3, 3, drives)
        ratio = np.exp(estimates.loglik[:, part].sum(axis=0) - dist.loglik)
        assert ratio.std() > 0.01
        assert abs(ratio.mean() - 1) < 4 * ratio.std() / np.sqrt(1500)
        weights = ratio / ratio.sum()
        error = 5 * np.sqrt((weights**2).sum()) * estimates.mean[3, :, part].std(axis=-1)
        assert (np.abs(estimates.mean[3, :, part] @ weights - dist.mean) < error).all()
        assert (np.abs(estimates.mode_prob[3, :, part] @ weights - dist.mode_prob) < 0.05).all()
    assert estimates.mode_prob.sum(axis=1) == pytest.approx(1.0)
    assert not estimates.diverged.any()


def test_exact_indicator_gives_the_filter_with_known_modes():
    """Also of a mode without probability, in which nothing is known."""
    system, times = manoeuvring_target("exact"), np.arange(12.0)
    data = system.simulate(times, 40, 6)
    given = {"indicators": data.indicators}
    estimates = RaoBlackwellFilter(system, 3).run(times, data.measurements, seed=1, **given)
    known = KnownModeFilter(system).run(times, data.measurements, modes=data.modes, **given)
    np.testing.assert_allclose(estimates.mean, known.mean, atol=1e-9)
    np.testing.assert_allclose(estimates.cov, known.cov, atol=1e-9)
    np.testing.assert_array_equal(estimates.modes, data.modes)


def test_threads_and_streams_of_drawn_histories():
    system, y = switching_system(), record(linear_numbers())[1]
    filter, many = RaoBlackwellFilter(system, 100), np.repeat(y[..., None], 20, axis=-1)
    filter.block = lambda *_: 7
    shown = np.zeros((7, 20), int)
    one, two, other = (
        filter.run(TIMES, many, indicators=shown, inputs=INPUTS, seed=seed, workers=count)
        for seed, count in ((7, 1), (7, 2), (8, 1))
    )
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(one.mean, other.mean)
    few = RaoBlackwellFilter(system, 4)
    state = few.initial((20,), seed=7)
    for k, now in enumerate(TIMES):
        ahead = few.forecast(state, now, inputs=dict.fromkeys(INPUTS, 0.5))
        state = few.step(state, now, many[k], shown[k], inputs=dict.fromkeys(INPUTS, 0.5))
        assert ahead.mode_prob.sum(axis=0) == pytest.approx(1.0)
    later = (
        few.step(state, 5.0, many[1], shown[1], inputs=dict.fromkeys(INPUTS, 0.5)) for _ in range(2)
    )
    np.testing.assert_array_equal(*(each.mean for each in later))


def test_indicator_that_no_mode_shows_is_marked_for_good():
    """In a run and step by step; the estimate stays a number."""
    system = SwitchingSystem(
        (x,),
        [[x / 2 + v]] * 2,
        Noise((v,)),
        [[1, 0], [0, 1]],
        [[x + w]] * 2,
        Noise((w,)),
        [(1, [0], [[1]]), (0, [0], [[1]])],
        indicator=[[1, 0], [0.5, 0.5]],
    )
    filter, y = RaoBlackwellFilter(system, 5), np.ones((3, 1, 2))
    shown = np.array([[0, 0], [0, 1], [-1, 0]])
    estimates = filter.run(range(3), y, indicators=shown)
    assert estimates.diverged.tolist() == [False, True]
    assert np.isneginf(estimates.loglik[1, 1])
    assert np.isfinite(estimates.mean).all()
    state = filter.initial((2,))
    for k in range(3):
        ahead = filter.predict(state, k)
        state = filter.correct(ahead, y[k], shown[k])
        assert filter.report(state).diverged.tolist() == [False, k > 0]
        if k == 1:  # of what no mode shows nothing is kept: all is as it was forecast
            for part, before in zip(
                (state.mean, state.cov, state.means, state.covs),
                (ahead.mean, ahead.cov, ahead.means, ahead.covs),
                strict=True,
            ):
                np.testing.assert_array_equal(part[..., 1], before[..., 1])
        np.testing.assert_allclose(state.mean, estimates.mean[k])


def test_log_odds_of_histories_may_be_of_any_size():
    """Eight histories of three steps are all kept; their weights differ by e to the 1400."""
    system = SwitchingSystem(
        (x,),
        [[v]] * 2,
        Noise((v,), cov=[[1e-6]]),
        [[0.5, 0.5]] * 2,
        [[x + w], [40 + x + w]],
        Noise((w,)),
        [(0.5, [0], [[1e-6]])] * 2,
    )
    filter = RaoBlackwellFilter(system, 100)
    state = filter.initial()
    for k in range(3):
        state = filter.step(state, float(k), [0.0])
    total = np.logaddexp.reduce(state.log_prob[1], axis=None)
    np.testing.assert_allclose(total, -800 / 1.000001, rtol=1e-9)
