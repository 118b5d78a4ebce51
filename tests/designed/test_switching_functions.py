"""Filters of switching systems given as array functions, or without closed forms."""

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.linearization import GaussHermite, Taylor
from seedslib.models import Noise, StochasticMap, SwitchingSystem

X, V, W = sympy.symbols("x v w", real=True)


def twins(dependent):
    """The same system as array functions and as formulas; time moves everything."""

    def bend(z):
        return 1 / (1 + (np if isinstance(z, np.ndarray) else sympy).exp(-z))

    def leaves(t, x, v):
        return 0.2 + 0.6 * bend(x + 0.2 * t + (v if dependent else 0))

    def tells(i):
        return lambda t, x, w: 0.1 + 0.5 * i + 0.3 * bend(x)

    def moves(a, b):
        return lambda t, x, v: a * x + 0.1 * t + b * v

    def shows(i):
        return lambda t, x, w: 0.2 * x**2 + i + w

    def pair(value, share):
        return [
            StochasticMap.from_functions(
                1, 1, value, Noise(1), weight=lambda t, x, v, s=s: s(t, x[0], v[0])
            )
            for s in (lambda *a: 1 - share(*a), share)
        ]

    slopes, initial = [(0.9, 0.5), (0.5, 1.0)], [(0.5, [0], [[1]]), (0.5, [1], [[1]])]
    plain = SwitchingSystem.from_maps(
        [pair(moves(a, b), leaves) for a, b in slopes],
        [pair(shows(i), tells(i)) for i in (0, 1)],
        initial,
        indicator=True,
    )
    t = sympy.Symbol("t")
    leave, told = leaves(t, X, V), [tells(i)(t, X, W) for i in (0, 1)]
    written = SwitchingSystem(
        (X,), [[moves(a, b)(t, X, V)] for a, b in slopes], Noise((V,)), [[1 - leave, leave]] * 2,
        [[shows(i)(t, X, W)] for i in (0, 1)], Noise((W,)), initial,
        indicator=[[1 - p, p] for p in told],
    )  # fmt: skip
    return plain, written


@pytest.mark.parametrize("dependent", [False, True])
def test_array_functions_with_an_indicator_of_the_state_are_the_formulas(dependent):
    """At times that do not start at zero; the forecast is split by the indicator."""
    times, rule = 2.0 + 0.7 * np.arange(5), GaussHermite(5)
    plain, written = twins(dependent)
    data = written.simulate(times, 200, 4)
    np.testing.assert_allclose(plain.simulate(times, 200, 4).states, data.states, atol=1e-12)
    found, wanted = (
        SwitchingFilter(s, rule).run(times, data.measurements, indicators=data.indicators)
        for s in (plain, written)
    )
    np.testing.assert_allclose(found.mean, wanted.mean, atol=1e-12)
    np.testing.assert_allclose(found.loglik, wanted.loglik, atol=1e-11)
    designed = synthesize(plain, large_order(1), rule, times, paths=1500, seed=2)
    other = synthesize(written, large_order(1), rule, times, paths=1500, seed=2)
    np.testing.assert_allclose(designed.fits[-1].gain, other.fits[-1].gain, atol=1e-9)


def test_linearizations_that_cannot_split_the_forecast_say_so():
    """A forecast split by the indicator has a weight with the noise of the move in it."""
    with pytest.raises(ValueError, match="split=False, which asks for less"):
        SwitchingFilter(told(0), Taylor())
    filter = SwitchingFilter(told(0), Taylor(), split=False)
    assert filter.run([0.0, 1.0], np.zeros((2, 1)), indicators=np.array([0, 1])).mean.shape == (
        2,
        1,
    )


def told(dependent):
    """One mode, and an indicator of the state whose mean over the noise has no closed form."""
    share = 1 / (1 + sympy.exp(-X - dependent * W))
    return SwitchingSystem(
        (X,), [[0.9 * X + V]], Noise((V,)), [[1]], [[X + W]], Noise((W,)), [(1, [0], [[1]])],
        indicator=[[share, 1 - share]],
    )  # fmt: skip


def test_probability_without_a_closed_form_is_a_quadrature():
    system, x = told(1), np.array([[0.3, -1.0]])
    w = np.linspace(-9, 9, 4001)
    density = np.exp(-(w**2) / 2) / np.sqrt(2 * np.pi) * (w[1] - w[0])
    wanted = [(density / (1 + np.exp(-at - w))).sum() for at in x[0]]
    np.testing.assert_allclose(system.readings[0][0].probability(0.0, x), wanted, rtol=1e-5)
    data = system.simulate(np.arange(4.0), 20, 1)
    found = SwitchingFilter(system, GaussHermite(5)).run(
        data.times, data.measurements, indicators=data.indicators
    )
    assert np.isfinite(found.loglik).all()


def test_maps_of_a_row_have_one_value_and_one_noise():
    def moves(value, noise, share=0.5):
        return StochasticMap((X,), [value], noise, share)

    shown = [[StochasticMap((X,), [X + W], Noise((W,)))]] * 2
    initial = [(0.5, [0], [[1]])] * 2
    even = Noise((V,))
    good = [moves(X + V, even)] * 2
    with pytest.raises(ValueError, match="switching: wanted maps of one value in mode 1"):
        SwitchingSystem.from_maps(
            [good, [moves(X + V, even), moves(X / 2 + V, even)]], shown, initial
        )
    with pytest.raises(ValueError, match="switching: wanted maps with one noise"):
        SwitchingSystem.from_maps(
            [good, [moves(X + V, Noise((V,), cov=[[4.0]]))] * 2], shown, initial
        )
    # the same moments, drawn otherwise
    coin = Noise((V,), sample=lambda rng, count: 2.0 * rng.integers(0, 2, (1, count)) - 1.0)
    with pytest.raises(ValueError, match="switching: wanted maps with one noise"):
        SwitchingSystem.from_maps([good, [moves(X + V, coin)] * 2], shown, initial)
