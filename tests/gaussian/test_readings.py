"""Every kind of term the reader knows, under a law without symmetry, against panels of nodes."""

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import NoClosedForm, classify, expectation_function
from seedslib.gaussian.means.classes import PLAIN, Key, Plane, add_terms, clean, folded, multiply
from seedslib.gaussian.means.normal_cdf import NormalCDF

x, y = VARIABLES = sp.symbols("x y", real=True)
MEAN = np.array([0.4, -0.7])
COV = np.array([[1.3, -0.45], [-0.45, 0.6]])
NODES = np.polynomial.legendre.leggauss(40)


def panels(stops):
    """Gauss-Legendre nodes and weights of several intervals."""
    half = 0.5 * np.diff(stops)[:, None]
    middle = 0.5 * (stops[1:] + stops[:-1])[:, None]
    return (middle + half * NODES[0]).ravel(), (half * NODES[1]).ravel()


def by_panels(f, normal=(1.0, 0.0), kinks=()):
    """E f with the first of two independent deviations along the normal, cut at the kinks.

    With u = n x the law of x is b u + r, where b = cov(x, u) / var u.
    """
    normal = np.array(normal)
    var, centre = normal @ COV @ normal, normal @ MEAN
    slope = COV @ normal / var
    rest = COV - var * np.outer(slope, slope)
    values, vectors = np.linalg.eigh(rest)
    ends = centre + 9.0 * np.sqrt(var) * np.array([-1.0, -0.3, 0.0, 0.3, 1.0])
    u, weights = panels(np.sort(np.append(ends, [k for k in kinks if abs(k - centre) < 9])))
    weights = weights * np.exp(-0.5 * (u - centre) ** 2 / var) / np.sqrt(2 * np.pi * var)
    z, masses = panels(np.linspace(-9.0, 9.0, 4))
    masses = masses * np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    away = vectors[:, 1] * np.sqrt(values[1])
    points = (MEAN[:, None] + np.outer(slope, u - centre))[:, :, None] + away[:, None, None] * z
    return weights @ f(*points) @ masses


def numeric(f):
    return sp.lambdify(VARIABLES, f, ["scipy", "numpy"])


KINDS = {
    "powers": ((x - 2 * y + 0.3) ** 2 * (x + 0.2), (1, 0), ()),
    "decimal power": (sp.Pow(2 * x + y + 0.5, 2.0, evaluate=False) * x, (1, 0), ()),
    "number to a power": (sp.Float(1.3) ** (x - 0.5 * y) * y, (1, 0), ()),
    "hyperbolic": (sp.sinh(0.4 * x + 0.1) + sp.cosh(0.3 * y - 0.2) * x, (1, 0), ()),
    "power of a sine": (sp.sin(0.8 * x - 0.5 * y + 0.4) ** 2 * x, (1, 0), ()),
    "waves": (sp.cos(0.3 * x * y + 0.2 * y) * sp.exp(0.2 * x), (1, 0), ()),
    "bell": ((x + 2 * y) * sp.exp(-0.4 * x**2 - 0.3 * x * y - 0.2 * y**2 + 0.3 * x), (1, 0), ()),
    "modulus": (abs(x - 2 * y + 0.3) * y**2, (1, -2), (-0.3,)),
    "third power of a modulus": (abs(x - 2 * y + 0.3) ** 3, (1, -2), (-0.3,)),
    "sign": (sp.exp(0.3 * x - 0.2 * y) * sp.sign(x + 2 * y - 0.4), (1, 2), (0.4,)),
    "sign, falling": (x * sp.sign(0.4 - x - 2 * y), (1, 2), (0.4,)),
    "step": (sp.Heaviside(0.2 - 3 * y) * x * y, (0, 1), (0.2 / 3,)),
    "larger": (sp.Max(x - 0.4 * y + 0.1, 0.3 * x + y - 0.7), (0.7, -1.4), (-0.8,)),
    "smaller": (sp.Min(x - 0.4 * y + 0.1, 0.3 * x + y - 0.7) * x, (0.7, -1.4), (-0.8,)),
    "pieces": (
        sp.Piecewise((x + 2 * y, x < 0.3), (x * y + 1, True)), (1, 0), (0.3,)
    ),
    "exponential of a modulus": (sp.exp(-0.7 * abs(x + y - 0.2) + 0.1 * x), (1, 1), (0.2,)),
    "sine of a modulus": (sp.sin(abs(x + y - 0.2) + 0.3), (1, 1), (0.2,)),
    "erf": (sp.erf(0.7 * x - 0.4 * y + 0.2) * x, (0.7, -0.4), ()),
    "erf, falling": (sp.erf(0.2 - 0.7 * x - 0.4 * y) * y**2, (0.7, 0.4), ()),
    "erfc": (sp.erfc(0.5 * y - 0.3 * x) * (y + 2), (-0.3, 0.5), ()),
    "distribution function": (NormalCDF(0.9 * x + 0.3 * y - 0.5) * y, (0.9, 0.3), ()),
    "its complement": (x - x * NormalCDF(0.4 - 1.1 * x), (1, 0), ()),
    "wave beside a step": (sp.cos(x - y) * sp.Heaviside(y + 0.3, 0.5), (0, 1), (-0.3,)),
    "norms": ((sp.sqrt(x**2 + 2 * y**2 + 1) + 2) * (3 * sp.sqrt(x**2 + 2 * y**2 + 1) - 1),
              (1, 0), ()),
    "root of a square": (sp.sqrt((x + 2 * y - 0.3) ** 2) * x, (1, 2), (0.3,)),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_means(kind):
    f, normal, kinks = KINDS[kind]
    function = expectation_function(f, VARIABLES)
    value = numeric(f)
    wanted = by_panels(value, normal, kinks)
    assert function(MEAN, COV) == pytest.approx(wanted, rel=1e-12, abs=1e-13)
    # the same at two places of a batch, each with a covariance of its own
    covs = np.stack([COV, 0.0 * COV], axis=-1)
    found = function(np.stack([MEAN, MEAN], axis=1), covs)
    assert found[0] == pytest.approx(wanted, rel=1e-12, abs=1e-13)
    there = float(value(*MEAN))
    assert found[1] == pytest.approx(there, rel=1e-12, abs=1e-13)
    other = float(value(*(-0.6 * MEAN)))
    found = function.compiled().value(MEAN[:, None] * [1.0, -0.6])
    assert found[0].tolist() == pytest.approx([there, other], rel=1e-12, abs=1e-13)


def test_parameters_are_numbers_of_a_call():
    a, b = sp.symbols("a b")
    f = sp.exp(-a * x**2) * sp.Heaviside(x + b * y, 0.5) + b * sp.sin(a * y)
    function = expectation_function(f, VARIABLES, parameters=[a, b])
    told = {a: 0.3, b: 1.7}
    wanted = by_panels(numeric(f.subs(told)), (1.0, 1.7), (0.0,))
    assert function(MEAN, COV, 0.3, 1.7) == pytest.approx(wanted, rel=1e-12)
    for bad in ([0.3], [[0.3]], np.nan, "a"):
        with pytest.raises((TypeError, ValueError), match="a: wanted"):
            function(MEAN, COV, bad, 1.7)
    with pytest.raises(TypeError, match="wanted values of the parameters"):
        function(MEAN, COV, 0.3)
    # the root of a square that is semidefinite for some parameters only
    with pytest.raises(NoClosedForm, match="sum of squares"):
        expectation_function(sp.sqrt(a * x**2 + y**2), VARIABLES, parameters=[a])


def test_switching_functions_that_are_constants():
    """Their variables cancel, where SymPy does not see it."""
    larger = sp.Max(x * (x + 1), x**2 + x - 2, evaluate=False)
    assert expectation_function(larger, [x])([0.4], [[1.3]]) == pytest.approx(0.4 + 0.16 + 1.3)
    gone = sp.erf(x * (x + 1) - x**2 - x + sp.Rational(1, 3), evaluate=False)
    found = expectation_function(gone * x, [x])([0.4], [[1.3]])
    assert found == pytest.approx(0.4 * float(sp.erf(sp.Rational(1, 3))), rel=1e-14)


def test_numbers_out_of_range():
    for f in (10**400 * x, sp.exp(10**400 * x), sp.Heaviside(x - 10**400)):
        with pytest.raises(ValueError, match="in the range of float64"):
            expectation_function(f, [x])
    assert classify(sp.sqrt(x**2 - y**2), VARIABLES) == "none"


def terms(**parts):
    """A sum of terms in two variables, from (key, polynomial)."""
    return {key: sp.Poly(poly, x, y) for key, poly in parts.values()}


def test_products_of_terms():
    """Exponents add up, a half-space never meets its opposite, a norm squared is a polynomial."""
    up = Plane((sp.S(1), sp.S(2)), sp.S(3), sp.S(0))
    down = Plane((sp.S(-1), sp.S(-2)), sp.S(-3), sp.S(1))
    square = sp.Poly(x**2 + y**2 + 1, x, y)
    waves = Key((((1, 0), sp.I), ((0, 2), sp.S(-2))))
    back = Key((((1, 0), -sp.I), ((0, 1), sp.S(5))))
    found = multiply(terms(a=(waves, x)), terms(a=(back, y)))
    assert found == terms(a=(Key((((0, 1), sp.S(5)), ((0, 2), sp.S(-2)))), x * y))
    assert multiply(terms(a=(Key(plane=up), x)), terms(a=(Key(plane=down), y))) == {}
    # half the mass on the boundary, twice
    half = up._replace(edge=sp.S.Half)
    found = multiply(terms(a=(Key(plane=half), x)), terms(a=(Key(plane=half), y)))
    assert found == terms(a=(Key(plane=up._replace(edge=sp.S(1) / 4)), x * y))
    found = multiply(terms(a=(Key(norm=square), 3)), terms(a=(Key(norm=square), x)))
    assert found == {PLAIN: 3 * sp.Poly(x, x, y) * square}
    found = multiply(terms(a=(Key(norm=square), 3)), terms(a=(PLAIN, x)))
    assert found == terms(a=(Key(norm=square), 3 * x))
    assert multiply(terms(a=(PLAIN, x)), terms(a=(Key(norm=square), 3))) == found
    assert add_terms(terms(a=(PLAIN, x)), terms(a=(PLAIN, -x))) == {}
    assert clean(terms(a=(PLAIN, x), b=(waves, 0))) == terms(a=(PLAIN, x))


def test_tails_are_written_from_their_own_side():
    """p - p 1{u > U} is p 1{-u > -U}, and likewise without a blur."""
    soft = Plane((sp.S(1), sp.S(2)), sp.S(3), sp.S.Half, blurred=True)
    other = Plane((sp.S(-1), sp.S(-2)), sp.S(-3), sp.S.Half, blurred=True)
    given = terms(a=(PLAIN, x), b=(Key(plane=soft), -x))
    assert folded(given) == terms(a=(Key(plane=other), x))
    hard = terms(a=(PLAIN, x), b=(Key(plane=soft._replace(blurred=False)), -x))
    assert folded(hard) == terms(a=(Key(plane=other._replace(blurred=False)), x))
    unlike = terms(a=(PLAIN, x), b=(Key(plane=soft), -2 * x))
    assert folded(unlike) == unlike
    tail = expectation_function(1 - NormalCDF(x), [x])([30.0], [[1.0]])
    assert tail == pytest.approx(float((sp.erfc(sp.S(30) / 2) / 2).evalf()), rel=1e-13, abs=0)


def test_half_spaces_are_refused_together():
    for f in (
        sp.Heaviside(x, 0.5) * sp.Heaviside(y, 0.5),
        sp.erf(x) ** 2,
        sp.erf(x) * sp.sign(x),
        sp.sqrt(x**2 + y**2 + 1) * sp.sqrt(x**2 + y**2 + 2),
        sp.sqrt(x**2 + y**2 + 1) * x,
    ):
        with pytest.raises(NoClosedForm):
            expectation_function(f, VARIABLES)
