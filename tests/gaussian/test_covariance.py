"""Covariances of two expressions against the difference of their means, taken with sixty digits."""

import numpy as np
import pytest
import sympy as sp
from scipy.special import ndtr

from seedslib.gaussian import NoClosedForm, expectation
from seedslib.gaussian.means.covariance import covariance_expression
from seedslib.models.codegen import compile_components

x, y, m = sp.symbols("x y m", real=True)
P = sp.Symbol("P", nonnegative=True)
MEAN = sp.Rational(2, 5), -sp.Rational(7, 10)
COV = sp.Matrix([[sp.Rational(3, 5), -sp.Rational(1, 4)], [-sp.Rational(1, 4), sp.Rational(1, 10)]])
COV += sp.diag(0, sp.Rational(4, 5))
HALF = sp.S.Half

SMOOTH = {
    "polynomials": (x**2 * y - x, x * y - y**3),
    "sines that swing together": (sp.cos(x + sp.Rational(1, 3)), sp.cos(2 * x + y)),
    "sines that swing against each other": (sp.sin(x + 2 * y), sp.cos(x - 3 * y)),
    "sines beside powers": (x * sp.sin(y), y * sp.cos(x) + sp.sin(x)),
    "sums": (sp.sin(x) + sp.cos(2 * y) * x + sp.exp(x / 3), sp.cos(x - y) - sp.sin(x)),
    "a sine and a power": (sp.cos(y + 1) * x, x**2 - y),
    "exponentials": (sp.exp(x / 3), x * sp.exp(-y / 2)),
    "exponentials of one sign": (sp.exp(x / 3), sp.exp(x / 2 - y)),
    "an exponential and a power": (x**2, sp.exp(y - x)),
    "an exponential and a sine": (sp.exp(x / 3) * y, sp.sin(2 * y - x)),
    "two growing sines": (sp.exp(x / 3) * sp.cos(2 * y), y * sp.exp(y / 4) * sp.sin(x)),
    "hyperbolic": (sp.sinh(x / 2), sp.cosh(y / 3) * x),
    "a bell and a power": (sp.exp(-(x**2)) * y, x - y**2),
    "two bells": (x * sp.exp(-(x**2) / 2), sp.exp(-x * y / 4)),
    "a bell and an exponential": (sp.exp(-(x**2) / 2 + x), y * sp.exp(y / 3)),
    "a swinging bell and a sine": (sp.exp(-(x**2)) * sp.cos(x - y), sp.sin(y) * x),
    "two swinging bells": (sp.exp(-(x**2) / 2) * sp.sin(y), sp.exp(-x * y / 3) * sp.cos(2 * x)),
    "two swinging bells with powers": (
        x * sp.exp(-(x**2) / 2) * sp.sin(x), sp.exp(-(x**2) / 3 + x / 2) * (sp.cos(2 * x) + x)
    ),
    "an error function and a power": (sp.erf(x - y / 3), x * y),
    "an error function and a sine": (sp.erf(x) * y, sp.sin(x + 1)),
}  # fmt: skip
OTHERS = {
    "a step and a power": (sp.Heaviside(x - HALF, HALF), x * y),
    "a larger one and itself": (sp.Max(x, y), sp.Max(x, y)),
    "a modulus and a step": (abs(x) * y, sp.Heaviside(-x, HALF)),
    "a modulus and a sine": (abs(x), sp.cos(x)),
    "a wave of squares": (sp.cos(x**2), x + y),
    "two sums": (sp.sin(x) + sp.Heaviside(x, HALF), x + abs(x)),
}


def by_sixty_digits(f, g, mean, cov):
    """E f g - E f E g."""
    product = expectation(sp.expand(f * g), [x, y], mean, cov)
    apart = expectation(f, [x, y], mean, cov) * expectation(g, [x, y], mean, cov)
    return float(sp.re((product - apart).evalf(60)))


def value(f, g, mean, cov):
    return float(sp.re(covariance_expression(f, g, [x, y], mean, cov).evalf(17)))


@pytest.mark.parametrize("pair", SMOOTH)
@pytest.mark.parametrize("size", [sp.S.One, sp.Rational(1, 10**17)], ids=["wide", "narrow"])
def test_smooth_functions(pair, size):
    """Every digit is right, also where the variances are below the rounding of the functions."""
    f, g = SMOOTH[pair]
    wanted = by_sixty_digits(f, g, MEAN, size * COV)
    assert value(f, g, MEAN, size * COV) == pytest.approx(wanted, rel=1e-14, abs=0)


@pytest.mark.parametrize("pair", OTHERS)
def test_functions_with_a_kink_and_waves_of_squares(pair):
    f, g = OTHERS[pair]
    wanted = by_sixty_digits(f, g, MEAN, COV)
    assert value(f, g, MEAN, COV) == pytest.approx(wanted, rel=1e-14, abs=0)


def test_the_order_of_the_two_does_not_matter():
    for pair in ("an exponential and a sine", "a bell and a power", "a step and a power"):
        f, g = (SMOOTH | OTHERS)[pair]
        assert value(g, f, MEAN, COV) == pytest.approx(value(f, g, MEAN, COV), rel=1e-14, abs=0)


def test_exponents_are_summed_before_they_are_raised():
    """cov(x, e^x) = P e^(m + P / 2), where e^m and e^(P / 2) are out of range."""
    formula = covariance_expression(x, sp.exp(x), [x], [m], sp.Matrix([[P]]))
    assert compile_components([m, P], [formula])(-800.0, 1600.0) == pytest.approx([1600.0])


@pytest.mark.parametrize("mean", [-9.0, -1.0, 0.3, 9.0])
def test_a_step_has_the_variance_of_a_coin(mean):
    """q (1 - q), also where one of them is 1e-19."""
    step = sp.Heaviside(x, HALF)
    wanted = ndtr(mean) * ndtr(-mean)
    for f, g, sign in [(step, step, 1), (step, 1 - step, -1), (step, sp.Heaviside(-x, HALF), -1)]:
        found = covariance_expression(f, g, [x], [sp.Float(mean)], sp.eye(1))
        assert float(found) == pytest.approx(sign * wanted, rel=1e-14, abs=0)


def test_formulas_in_symbols():
    """cov(e^ax, e^bx) = e^((a + b) m + (a² + b²) P / 2) (e^abP - 1); sines and powers likewise."""
    a, b = sp.symbols("a b")
    found = covariance_expression(
        sp.exp(a * x), sp.exp(b * x), [x], [m], sp.Matrix([[P]]), parameters=[a, b]
    )
    told = {a: 0.7, b: -1.3, m: 0.4, P: 0.9}
    exact = np.exp(-0.6 * 0.4 + (0.49 + 1.69) * 0.45) * np.expm1(-0.91 * 0.9)
    assert float(found.subs(told)) == pytest.approx(exact, rel=1e-14)
    rate, rate_0 = a * (b + 1), 0.7 * (1 - 1.3)
    wave = covariance_expression(sp.cos(rate * x), x, [x], [m], sp.Matrix([[P]]), parameters=[a, b])
    exact = -0.9 * rate_0 * np.exp(-(rate_0**2) * 0.45) * np.sin(rate_0 * 0.4)
    assert float(wave.subs(told)) == pytest.approx(exact, rel=1e-14)
    sine = covariance_expression(sp.sin(x), x, [x], [m], sp.Matrix([[P]]))
    assert sp.expand(sine - P * sp.exp(-P / 2) * sp.cos(m)) == 0
    square = covariance_expression(x**2, x**2, [x], [m], sp.Matrix([[P]]))
    assert sp.expand(square - 4 * m**2 * P - 2 * P**2) == 0
    assert covariance_expression(sp.S(3), sp.exp(x), [x], [m], sp.Matrix([[P]])) == 0


def test_means_and_covariances_of_waves_are_written_in_real_numbers():
    law = [x, y], sp.symbols("m n", real=True), sp.Matrix(2, 2, sp.symbols("P Q Q R", real=True))
    for f in (sp.exp(y) * sp.cos(x) * x, sp.sin(x - y)):
        assert not expectation(f, *law).has(sp.I)
        assert not covariance_expression(f, x * y, *law).has(sp.I)


def test_the_variance_of_a_sine_of_any_size():
    """(1 - e^-9P) (1 + e^-9P cos 6m) / 2 for variances of 1e-300 to 1e300, by the code of it."""
    formula = covariance_expression(sp.sin(3 * x), sp.sin(3 * x), [x], [m], sp.Matrix([[P]]))
    code = compile_components([m, P], [formula])
    for var in (1e-300, 1e-20, 1e-3, 2.0, 1e300):
        less = -np.expm1(-9 * var)
        exact = less * (1 + (1 - less) * np.cos(2.4)) / 2
        assert code(0.4, var)[0] == pytest.approx(exact, rel=1e-14, abs=0)


def test_pairs_outside_the_class_are_refused_by_name():
    one, other = sp.Heaviside(x, HALF), sp.Heaviside(y, HALF)
    law = [x, y], MEAN, COV
    with pytest.raises(NoClosedForm, match=r"no closed form for .*: wanted one affine switching"):
        covariance_expression(one, other, *law)
    for f, g in ((sp.sqrt(x**2 + y**2), x), (x, sp.sqrt(x**2 + y**2))):
        with pytest.raises(NoClosedForm, match="the mean of a norm is an integral"):
            covariance_expression(f, g, *law)
    with pytest.raises(TypeError, match="variables: wanted SymPy symbols, got 1"):
        covariance_expression(x, x, [1], [m], sp.eye(1))
    with pytest.raises(TypeError, match="parameters: wanted SymPy symbols, got 2"):
        covariance_expression(x, x, [x], [m], sp.eye(1), parameters=[2])
