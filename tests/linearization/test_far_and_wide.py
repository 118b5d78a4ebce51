"""Exact Gaussian means of one-sided exponentials where the factors of a mean are out of range."""

import mpmath as mp
import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose

from seedslib.filters import assumed_density
from seedslib.gaussian import expectation_function
from seedslib.gaussian.means.formulas import mean_expression
from seedslib.linearization import ExactGaussian
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from seedslib.models.codegen import compile_components

x, y, v, w = sympy.symbols("x y v w", real=True)
ELU = sympy.Piecewise((sympy.exp(x) - 1, x < 0), (x, True))
DECAYING = sympy.exp(-sympy.Abs(x))
ONE_SIDED = (
    ELU,
    DECAYING,
    sympy.Piecewise((x * sympy.exp(2 * x + 1), x < 1), (0, True)),
    sympy.Piecewise((sympy.exp(-3 * x), x > -2), (x**2, True)),
    sympy.Piecewise((sympy.exp(x - x**2 / 200), x < 0), (1, True)),
)
LAWS = ((0.0, 1.0), (0.0, 1e4), (0.3, 1e8), (800.0, 1.0), (-800.0, 1.0), (30.0, 1e3), (-40.0, 9.0))


def moved(value, mean, cov):
    state = (x, y)[: len(mean)]
    found = ExactGaussian().moments(StochasticMap(state, [value + v], Noise((v,), cov=[[0.25]])))
    return found(0.0, np.array(mean), np.array(cov))


def integrals(value, mean, variance):
    """Mean, covariance with x and variance in thirty digits, piece by piece."""
    with mp.workdps(30):
        f, s = sympy.lambdify(x, value, "mpmath"), mp.sqrt(variance)
        near = [
            c + side * width for c in (-2, 0, 1) for width in (0, 0.3, 3, 30) for side in (1, -1)
        ]
        places = {mean + s * k for k in (-38, -20, -8, -4, -2, -1, 0, 1, 2, 4, 8, 20, 38)}
        places |= {mp.mpf(p) for p in near if abs(p - mean) < 38 * s}
        stops = sorted(places)

        def of(g):
            density = mp.mpf(1) / (s * mp.sqrt(2 * mp.pi))
            return mp.quad(lambda u: g(u) * density * mp.exp(-(((u - mean) / s) ** 2) / 2), stops)

        first = of(f)
        cross = of(lambda u: (u - mean) * f(u))
        return [float(p) for p in (first, cross, of(lambda u: (f(u) - first) ** 2))]


@pytest.mark.parametrize("value", ONE_SIDED, ids=str)
@pytest.mark.parametrize(("mean", "variance"), LAWS)
def test_moments_are_those_of_the_integrals(value, mean, variance):
    first, cross, second = integrals(value, mean, variance)
    found = moved(value, [mean], [[variance]])
    scale = np.sqrt(variance * (second + 0.25))
    assert_allclose(found.mean, [first], rtol=1e-11, atol=1e-13 * np.sqrt(second))
    assert_allclose(found.cross, [[cross]], rtol=1e-11, atol=1e-11 * scale)
    # what the boundary leaves of the variance is rounded as the variance is
    assert_allclose(found.cov, [[second + 0.25]], rtol=1e-10, atol=1e-18 * variance)


def test_two_states_whose_sum_is_one_sided():
    """The exponent leans on the plane at an angle; the numeric mean goes another way."""
    value = sympy.Piecewise((sympy.exp(x + y / 2), x + y < 0), (0, True))
    numeric = expectation_function(value, [x, y])
    for mean, cov in (
        ([0.0, 0.0], [[900.0, -500.0], [-500.0, 1600.0]]),
        ([700.0, 300.0], [[4.0, 1.0], [1.0, 3.0]]),
        ([0.4, -0.1], [[1.0, 0.2], [0.2, 2.0]]),
    ):
        found = moved(value, mean, cov)
        assert np.isfinite(found.cov).all()
        assert_allclose(found.mean, [numeric(mean, cov)], rtol=1e-10, atol=1e-280)


def test_a_plane_that_a_parameter_takes_away():
    """Where its coefficient is zero the other side is nowhere."""
    slope, pull = sympy.symbols("a b", real=True)
    value = sympy.Piecewise((sympy.exp(pull * x), slope * x + 1 > 0), (0, True))
    law = [y], sympy.Matrix([[v]])
    formula = mean_expression(value, [x], *law, parameters=(slope, pull))
    code = compile_components([y, v, slope, pull], [formula])
    for steep in (1.0, 0.2, 1e-3, 0.0):
        with mp.workdps(30):
            inside = (
                mp.ncdf((1 + steep * (0.3 + mp.mpf(2) / 2)) / (steep * mp.sqrt(2))) if steep else 1
            )
            want = float(mp.exp(mp.mpf("0.15") + 0.25) * inside)
        assert_allclose(code(0.3, 2.0, steep, 0.5), [want], rtol=1e-14)


@pytest.mark.parametrize("variance", [1.0, 400.0, 1e6])
def test_an_error_function_instead_of_a_plane(variance):
    """``exp(x) Phi(-2 x)`` under N(m, P), a half-space that is blurred."""
    value = sympy.exp(x) * sympy.erfc(sympy.sqrt(2) * x) / 2
    code = compile_components([y, v], [mean_expression(value, [x], [y], sympy.Matrix([[v]]))])
    for mean in (0.0, 5.0, 30.0):
        with mp.workdps(40):
            P, m = mp.mpf(variance), mp.mpf(mean)
            z = -2 * (m + P) / mp.sqrt(1 + 4 * P)
            want = float(mp.exp(m + P / 2) * mp.ncdf(z))
        assert_allclose(code(mean, variance), [want], rtol=1e-11, atol=1e-300)


@pytest.mark.parametrize("value", [ELU, DECAYING], ids=["elu", "decaying"])
def test_a_filter_starts_from_next_to_nothing_known(value):
    """Its first variance is too large for an exponential of it; nothing becomes NaN."""
    system = DiscreteSystem(
        StochasticMap([x], [0.9 * x + v], Noise((v,), cov=[[0.25]])),
        StochasticMap([x], [value + w], Noise((w,), cov=[[0.04]])),
        mean0=300.0, cov0=1e4,
    )  # fmt: skip
    times = np.arange(30.0)
    y = system.simulate(times, 50, seed=1).measurements
    found = assumed_density(system).run(times, y)
    for part in (found.mean, found.cov, found.loglik):
        assert np.isfinite(part).all()
    alone = [assumed_density(system).run(times, y[..., k : k + 1]).mean[..., 0] for k in range(3)]
    assert_allclose(found.mean[..., :3], np.stack(alone, axis=-1), rtol=1e-12, atol=1e-12)
