"""Error functions of affine arguments: closed means against quadrature, and what is refused."""

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy import integrate, special, stats

from seedslib.gaussian import (
    FunctionClass,
    NoClosedForm,
    classify,
    expectation,
    expectation_function,
    mean_square_errors,
)
from seedslib.gaussian.means.formulas import mean_expression
from seedslib.models.codegen import compile_components

x, y, m, P = sp.symbols("x y m P", real=True)
HALF = sp.Rational(1, 2)

IN_ONE = [
    sp.erf(x),
    sp.erfc(3 * x + 1),
    (1 - sp.erf((sp.Rational(6, 5) - sp.Rational(4, 5) * x) / sp.sqrt(2))) / 2,
    x**3 * sp.erf(-2 * x + sp.Rational(1, 3)),
    x * sp.exp(-(x**2) + x) * sp.erfc(x / 2),
    sp.exp(x / 3) * sp.erf(x) + x**2,
    sp.erf(x) + sp.erf(2 * x) + x * sp.Heaviside(x - 1),
]


def mean_by_quadrature(f, mean, variance):
    """Adaptive quadrature over 12 deviations, split at the kink of the test functions."""
    g = sp.lambdify(x, f, "scipy")
    deviation = np.sqrt(variance)
    ends = (mean - 12 * deviation, mean + 12 * deviation)
    return integrate.quad(
        lambda u: g(u) * stats.norm.pdf(u, mean, deviation),
        *ends,
        points=[1.0],
        epsabs=1e-14,
        epsrel=1e-13,
        limit=400,
    )[0]


@pytest.mark.parametrize("f", IN_ONE, ids=str)
@pytest.mark.parametrize(("mean", "variance"), [(0.7, 1.3), (-1.5, 0.2)])
def test_mean_in_one_dimension(f, mean, variance):
    want = mean_by_quadrature(f, mean, variance)
    got = expectation_function(f, [x])([mean], [[variance]])
    assert got == pytest.approx(want, rel=1e-12, abs=1e-12)
    formula = expectation(f, [x], [m], sp.Matrix([[P]]))
    assert not formula.atoms(sp.Integral)
    assert float(formula.subs({m: mean, P: variance})) == pytest.approx(want, rel=1e-12, abs=1e-12)


def test_mean_in_the_plane():
    """Product rule of 90 nodes in each direction; the functions are entire."""
    f = [y**2 * sp.erf(x - y / 2 + HALF), x * sp.exp(-(y**2) / 4) * sp.erfc(x / 2 + y / 3)]
    nodes, weights = np.polynomial.hermite_e.hermegauss(90)
    weights = np.outer(weights, weights).ravel() / (2 * np.pi)
    cov = np.array([[0.8, -0.3], [-0.3, 0.5]])
    grid = np.array(np.meshgrid(nodes, nodes, indexing="ij")).reshape(2, -1)
    points = np.array([[0.4], [-0.7]]) + np.linalg.cholesky(cov) @ grid
    want = [weights @ sp.lambdify((x, y), part, "scipy")(*points) for part in f]
    got = expectation_function(f, [x, y])([0.4, -0.7], cov)
    assert_allclose(got, want, rtol=1e-12)
    formula = expectation(f, [x, y], [0.4, -0.7], sp.Matrix(cov))
    assert_allclose([float(part) for part in formula], want, rtol=1e-12)


def test_mean_of_the_normal_distribution_function():
    """E Phi(a x + b) = Phi((a m + b) / sqrt(1 + a² P)), a classical identity."""
    f = (1 + sp.erf((2 * x - 1) / sp.sqrt(2))) / 2
    mean, variance = np.linspace(-2, 2, 7), np.linspace(0, 3, 7)
    got = expectation_function(f, [x])(mean[None], variance[None, None])
    assert_allclose(got, special.ndtr((2 * mean - 1) / np.sqrt(1 + 4 * variance)), rtol=1e-13)


def test_no_spread_leaves_the_function():
    f = [x * sp.erf(x / 2), sp.erfc(-x) * sp.exp(-(x**2))]
    points = np.linspace(-2, 2, 5)
    got = expectation_function(f, [x])(points[None], np.zeros((1, 1)))
    want = [points * special.erf(points / 2), special.erfc(-points) * np.exp(-(points**2))]
    assert_allclose(got, want, rtol=1e-13)


@pytest.mark.parametrize("sign", [1, -1])
def test_tails_keep_their_digits(sign):
    """A probability of 1e-57 from 1 - Phi(16): the numbers and the code of the formula."""
    f = (1 - sp.erf(sign * x)) / 2
    mean, variance = 16.0 * sign, 0.5
    want = special.ndtr(-16.0 / np.sqrt(0.5 + variance))
    assert want < 1e-50
    got = expectation_function(f, [x])([mean], [[variance]])
    assert got == pytest.approx(want, rel=1e-12, abs=0)
    formula = mean_expression(f, [x], [m], sp.Matrix([[P]]))
    (code,) = compile_components([m, P], [formula])(mean, variance)
    assert code == pytest.approx(want, rel=1e-12, abs=0)
    slope = compile_components([m, P], [sp.diff(formula, m)])(mean, variance)[0]
    assert slope == pytest.approx(-sign * stats.norm.pdf(16.0), rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("f", "why"),
    [
        (sp.erf(x) * sp.erf(y), r"erf\(x\)\*erf\(y\): wanted one error function"),
        (x + sp.erf(x) ** 2, r"erf\(x\)\*\*2: wanted one error function"),
        (sp.erf(x) * sp.Heaviside(x), "wanted one error function and no other switching"),
        (sp.erf(x) * abs(y), "wanted one error function and no other switching"),
        (sp.exp(sp.erf(x)), "wanted an exponent that is a polynomial"),
        (sp.erf(x**2), "wanted an affine switching function"),
    ],
    ids=str,
)
def test_refused_by_name(f, why):
    assert classify(f, [x, y]) is FunctionClass.NONE
    with pytest.raises(NoClosedForm, match=why):
        expectation(f, [x, y], [0, 0], sp.eye(2))
    with pytest.raises(NoClosedForm, match=why):
        expectation_function(f, [x, y])


def test_class_value_and_errors():
    """Exact errors, which assume a sharp half-space, are refused with advice."""
    f = x * (1 + sp.erf(x / sp.sqrt(2))) / 2
    assert classify(f, [x]) is FunctionClass.MIXED
    points = np.linspace(-3, 3, 7)
    value = expectation_function(f, [x]).compiled().value(points[None])
    assert_allclose(value[0], points * special.ndtr(points), rtol=1e-14, atol=1e-300)
    with pytest.raises(NoClosedForm, match="approximate_errors"):
        mean_square_errors(f, [x])
