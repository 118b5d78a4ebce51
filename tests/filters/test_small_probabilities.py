"""Probabilities of modes too small for numbers, and decisions between equal ones."""

import numpy as np
import pytest
import sympy

from seedslib.designed import SwitchingFilter
from seedslib.designed.switching.lemmas import ModeLaw, decide, propagate
from seedslib.filters import GridBayesFilter, ParticleFilter, RaoBlackwellFilter
from seedslib.filters.weights import most_probable, normalised
from seedslib.linearization import Cubature, ExactGaussian, Gaussian, Moments, Taylor, Weighted
from seedslib.models import Noise, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)


def unknown_constant(switching=((1, 0), (0, 1)), indicator=None):
    """A mode that shifts the sensor by 6 deviations of its noise, for good or nearly so."""
    return SwitchingSystem(
        (x,), [[v]] * 2, Noise((v,), cov=[[1e-6]]), switching, [[x + w], [6 + x + w]], Noise((w,)),
        [(0.5, [0], [[1e-6]])] * 2, indicator=indicator,
    )  # fmt: skip


Y = np.where(np.arange(150) < 50, 0.0, 6.0)[:, None]


@pytest.mark.parametrize(
    "make",
    [
        lambda s: SwitchingFilter(s, Taylor()), lambda s: SwitchingFilter(s, ExactGaussian()),
        lambda s: SwitchingFilter(s, Cubature()), lambda s: GridBayesFilter(s, (-0.01, 0.01, 161)),
    ],
)  # fmt: skip
def test_a_mode_returns_from_e_to_the_minus_900(make):
    """50 measurements for mode 0 and 100 for mode 1, each worth 18 / 1.000001 in log-odds."""
    filter = make(unknown_constant())
    found = filter.run(np.arange(150.0), Y)
    assert not found.diverged
    assert found.mode_prob[49, 0] == found.mode_prob[-1, 1] == 1.0
    np.testing.assert_array_equal(found.modes[[49, 149]], [0, 1])
    for batch in ((), (2,)):
        state = filter.initial(batch)
        for k, y in enumerate(Y):
            state = filter.step(state, float(k), y.reshape(1, *(1,) * len(batch)) + np.zeros(batch))
            if k in (49, 149):
                held = getattr(state.law, "log_prob", getattr(state, "log_prob", None))
                wanted = {49: -900, 149: 900}[k] / 1.000001
                np.testing.assert_allclose(held[1] - held[0], wanted, rtol=1e-9)


def test_histories_that_are_not_drawn_hold_any_log_odds():
    """Eight histories of three steps are all kept; their weights differ by e to the 1400."""
    system = SwitchingSystem(
        (x,), [[v]] * 2, Noise((v,), cov=[[1e-6]]), [[0.5, 0.5]] * 2, [[x + w], [40 + x + w]],
        Noise((w,)), [(0.5, [0], [[1e-6]])] * 2,
    )  # fmt: skip
    filter = RaoBlackwellFilter(system, 100)
    state = filter.initial()
    for k in range(3):
        state = filter.step(state, float(k), np.array([0.0]))
    total = np.logaddexp.reduce(state.log_prob[1], axis=None)
    np.testing.assert_allclose(total, -800 / 1.000001, rtol=1e-9)
    assert np.ptp(state.log_prob) > 2000


def test_a_forecast_of_small_masses_is_formed_by_itself():
    """Next mode 1 comes from mode 1 alone, of probability e to the -2000, or by e to the -690."""
    law = ModeLaw(np.array([0.0, -2000.0]), np.array([[1.0, 3.0]]), np.ones((1, 1, 2)))

    def row(chances):
        def moments(t, mean, cov):
            state, value = Gaussian(mean, cov), Moments(mean, cov, cov)
            return [[c and Weighted(np.array(c), state, value)] for c in chances]

        return moments

    apart = propagate([row([1.0, None]), row([None, 1.0])], 0.0, law)
    np.testing.assert_allclose(apart.log_prob[:, 0], [0, -2000])
    np.testing.assert_array_equal(apart.mean[0, :, 0], [1, 3])
    joint = propagate([row([1.0, 1e-300]), row([None, 1.0])], 0.0, law)
    np.testing.assert_allclose(joint.log_prob[1, 0], np.log(1e-300))
    assert joint.mean[0, 1, 0] == 1.0


def test_an_impossible_indicator_is_flagged_by_all():
    system = unknown_constant(indicator=[[1, 0], [1, 0]])
    y, told = np.zeros((4, 1, 2)), np.zeros((4, 2), dtype=int)
    told[2, 1] = 1
    for filter in (
        SwitchingFilter(system, Taylor()), GridBayesFilter(system, (-0.01, 0.01, 41)),
        ParticleFilter(system, 50), RaoBlackwellFilter(system, 50),
    ):  # fmt: skip
        found = filter.run(np.arange(4.0), y, indicators=told)
        np.testing.assert_array_equal(found.diverged, [False, True])
        assert found.loglik[2, 1] == -np.inf
        assert np.isfinite(found.mean).all()


@pytest.mark.parametrize("push", [-1e-15, 0.0, 1e-15])
def test_equal_probabilities_are_decided_for_the_first(push):
    prob = np.array([0.2, 0.4 + push, 0.4 - push])
    assert most_probable(prob) == 1
    assert decide(ModeLaw.of(prob, np.zeros((1, 3)), np.ones((1, 1, 3))))[0] == 1
    assert most_probable(np.array([0.2, 0.4, 0.4 + 1e-8])) == 2
    np.testing.assert_array_equal(most_probable(np.stack([prob, prob[::-1]]), axis=1), [1, 0])


@pytest.mark.parametrize("push", [-1e-15, 0.0, 1e-15])
def test_filters_decide_equal_modes_for_the_first(push):
    """Two modes in which everything is the same but a last bit of the initial law."""
    system = SwitchingSystem(
        (x,), [[x / 2 + v]] * 2, Noise((v,)), [[0.9, 0.1], [0.1, 0.9]], [[x + w]] * 2, Noise((w,)),
        [(0.5 + push, [0], [[1]]), (0.5 - push, [0], [[1]])],
    )  # fmt: skip
    times, y = np.arange(5.0), np.random.default_rng(0).standard_normal((5, 1, 40))
    for filter in (
        SwitchingFilter(system, Taylor()), GridBayesFilter(system, (-6, 6, 61)),
        RaoBlackwellFilter(system, 50),
    ):  # fmt: skip
        assert (filter.run(times, y).modes == 0).all()
    filter = SwitchingFilter(system, Taylor())
    state = filter.step(filter.initial((40,)), 0.0, y[0])
    assert (filter.forecast(state, 1.0).modes == 0).all()


def test_a_grid_far_from_the_origin_has_the_same_variance():
    def run(shift):
        system = SwitchingSystem(
            (x,), [[shift + (x - shift) / 2 + v]], Noise((v,)), [[1]], [[x - shift + w]],
            Noise((w,), cov=[[0.25]]), [(1, [shift], [[1]])],
        )  # fmt: skip
        return GridBayesFilter(system, (shift - 6, shift + 6, 121)).run([0, 1], [[0.3], [-0.2]])

    near, far = run(0), run(2**27)
    np.testing.assert_allclose(far.cov, near.cov, rtol=1e-6)
    np.testing.assert_allclose(near.cov[0, 0, 0], 0.2, rtol=1e-6)


def test_weights_beside_a_huge_logarithm_still_sum_to_one():
    """Both modes are 1e59 too small, as after an outlier; log 2 is not seen beside that."""
    log_prob, total = normalised(np.array([-2.5e59, -2.5e59]), 0)
    np.testing.assert_allclose(np.exp(log_prob), 0.5)
    assert total == -2.5e59
