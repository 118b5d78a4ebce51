"""Means of SymPy functions: formulas and numbers against quadrature and known distributions."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.special import ndtr

from oracles.gaussian import hermite_mean, panel_mean, random_dist
from seedslib.gaussian import (
    NoClosedForm,
    expectation,
    expectation_function,
    posterior_variance_function,
)

x, y, z = sp.symbols("x y z", real=True)
m, n, P, Q, R = sp.symbols("m n P Q R", real=True)
ONE, TWO = sp.Matrix([[P]]), sp.Matrix([[P, Q], [Q, R]])
MEAN, COV = np.array([0.4, -0.7]), np.array([[1.3, -0.45], [-0.45, 0.6]])
HALF = sp.S.Half


def normal_cdf(u):
    return (1 + sp.erf(u / sp.sqrt(2))) / 2


KINDS = {  # function, normal of its switching plane, places of the kinks along the normal
    "powers": ((x - 2 * y + 0.3) ** 4 * (x + 0.2), (1, 0), ()),
    "decimal power": (sp.Pow(2 * x + y + 0.5, 2.0, evaluate=False) * x, (1, 0), ()),
    "number to a power": (sp.Float(1.3) ** (x - 0.5 * y) * y, (1, 0), ()),
    "irrational factor": (sp.sqrt(2) * y * sp.exp(x / 3) + sp.sqrt(3), (1, 0), ()),
    "hyperbolic": (sp.sinh(0.4 * x + 0.1) + sp.cosh(0.3 * y - 0.2) * x, (1, 0), ()),
    "power of a sine": (sp.sin(0.8 * x - 0.5 * y + 0.4) ** 2 * x, (1, 0), ()),
    "exponential, sine and power": (sp.exp(x / 3) * x**2 * sp.cos(2 * x + y), (1, 0), ()),
    "sine of a product": (sp.cos(0.3 * x * y + 0.2 * y) * sp.exp(0.2 * x), (1, 0), ()),
    "sine of squares": (x * sp.cos(x**2 / 2 + y**2 - x * y) + 1, (1, 0), ()),
    "bell": ((x + 2 * y) * sp.exp(-0.4 * x**2 - 0.3 * x * y - 0.2 * y**2 + 0.3 * x), (1, 0), ()),
    "swinging bell": (sp.exp(-(x**2) / 3) * sp.sin(x * y / 2) * x, (1, 0), ()),
    "growing square": (sp.exp(x**2 / 20) * y, (1, 0), ()),
    "modulus": (abs(x - 2 * y + 0.3) * y**2, (1, -2), (-0.3,)),
    "third power of a modulus": (abs(x - 2 * y + 0.3) ** 3, (1, -2), (-0.3,)),
    "two moduli": (abs(x) - abs(x - 1) * y, (1, 0), (0.0, 1.0)),
    "sign": (sp.exp(0.3 * x - 0.2 * y) * sp.sign(x + 2 * y - 0.4), (1, 2), (0.4,)),
    "falling sign": (x * sp.sign(0.4 - x - 2 * y), (1, 2), (0.4,)),
    "falling step": (sp.Heaviside(0.2 - 3 * y) * x * y, (0, 1), (0.2 / 3,)),
    "larger": (sp.Max(x - 0.4 * y + 0.1, 0.3 * x + y - 0.7), (0.7, -1.4), (-0.8,)),
    "smaller": (sp.Min(x - 0.4 * y + 0.1, 0.3 * x + y - 0.7) * x, (0.7, -1.4), (-0.8,)),
    "pieces": (sp.Piecewise((x + 2 * y, x < 0.3), (x * y + 1, True)), (1, 0), (0.3,)),
    "two pieces of three": (sp.Piecewise((x, x <= -1), (x**3, x > -1), (0, True)), (1, 0), (-1.0,)),
    "bell and modulus": (abs(x) * sp.exp(y / 2 - x**2), (1, 0), (0.0,)),
    "sine and step": (sp.cos(x - y) * sp.Heaviside(y + 0.3, 0.5), (0, 1), (-0.3,)),
    "error function": (sp.erf(0.7 * x - 0.4 * y + 0.2) * x, (0.7, -0.4), ()),
    "falling error function": (sp.erf(0.2 - 0.7 * x - 0.4 * y) * y**2, (0.7, 0.4), ()),
    "erfc": (sp.erfc(0.5 * y - 0.3 * x) * (y + 2), (-0.3, 0.5), ()),
    "erfc and bell": (x * sp.exp(-(y**2) / 4 + x) * sp.erfc(x / 2 + y / 3), (1, 0), ()),
    "distribution function": (normal_cdf(0.9 * x + 0.3 * y - 0.5) * y, (0.9, 0.3), ()),
    "its complement": (x - x * normal_cdf(0.4 - 1.1 * x), (1, 0), ()),
    "norm": (2 * sp.sqrt(x**2 + 2 * (y - 1) ** 2 + 1) + 3 * y, (1, 0), ()),
    "two norms": (
        (sp.sqrt(x**2 + 2 * y**2 + 1) + 2) * (3 * sp.sqrt(x**2 + 2 * y**2 + 1) - 1),
        (1, 0),
        (),
    ),
    "root of a square": (sp.sqrt((x + 2 * y - 0.3) ** 2) * x, (1, 2), (0.3,)),
}


NUMBERS_ONLY = "sign", "bell and modulus", "sine and step", "erfc and bell"
"""Exponentials on one side of a plane."""


@pytest.mark.parametrize("kind", KINDS)
def test_mean_of_every_kind_of_function_against_quadrature(kind):
    """Of numbers, in a batch with a known state, and of the formula."""
    f, normal, kinks = KINDS[kind]
    value = sp.lambdify((x, y), f, ["scipy", "numpy"])
    exact = panel_mean(value, MEAN, COV, normal, kinks)
    function = expectation_function(f, [x, y])
    assert function(MEAN, COV) == pytest.approx(exact, rel=1e-12, abs=1e-13)
    other = -0.6 * MEAN
    batch = function(
        np.stack([MEAN, MEAN, other], axis=1), np.stack([COV, 0 * COV, 0 * COV], axis=-1)
    )
    known = float(value(*MEAN)), float(value(*other))
    assert batch.tolist() == pytest.approx([exact, *known], rel=1e-12, abs=1e-13)
    values = function.compiled.value(np.stack([MEAN, other], axis=1))
    assert values[0].tolist() == pytest.approx(known, rel=1e-12, abs=1e-13)
    if "norm" in kind or kind in NUMBERS_ONLY:
        with pytest.raises(NoClosedForm, match="numbers only"):
            expectation(f, [x, y], list(MEAN), sp.Matrix(COV))
    else:
        formula = complex(expectation(f, [x, y], list(MEAN), sp.Matrix(COV)).evalf())
        assert formula == pytest.approx(exact, rel=1e-10, abs=1e-11)


@pytest.mark.parametrize(
    ("f", "answer"),
    [
        (x**6, m**6 + 15 * P * m**4 + 45 * P**2 * m**2 + 15 * P**3),
        (sp.sin(x), sp.exp(-P / 2) * sp.sin(m)),
        (sp.cos(x), sp.exp(-P / 2) * sp.cos(m)),
        (sp.exp(x), sp.exp(m + P / 2)),
        (sp.Heaviside(x), (1 + sp.erf(m / sp.sqrt(2 * P))) / 2),
        (sp.Integer(7), sp.Integer(7)),
    ],
)
def test_formula_of_one_variable(f, answer):
    assert sp.expand(expectation(f, [x], [m], ONE) - answer) == 0


def test_polynomials_match_derivatives_of_the_generating_function():
    s, t = sp.symbols("s t")
    dist = sp.exp(s * m + t * n + (P * s**2 + 2 * Q * s * t + R * t**2) / 2)
    for i, j in [(1, 0), (2, 1), (0, 4), (3, 2), (1, 5)]:
        derivative = sp.diff(dist, s, i, t, j).subs({s: 0, t: 0})
        assert sp.expand(derivative - expectation(x**i * y**j, [x, y], [m, n], TWO)) == 0
    column = expectation([x, x * y], [x, y], [m, n], TWO)
    assert column == sp.Matrix([m, m * n + Q])
    assert expectation(x * y, [x, y], sp.Matrix([m, 2]), [[P, 3], [3, 1]]) == 2 * m + 3


def test_power_of_degree_forty_keeps_its_digits():
    with mp.workdps(50):
        mean, var = mp.mpf("0.25"), mp.mpf("3.5")
        exact = mp.fsum(
            mp.binomial(40, 2 * k) * mean ** (40 - 2 * k) * var**k * mp.fac2(2 * k - 1)
            for k in range(21)
        )
        assert abs(expectation_function(x**40, [x])([0.25], [[3.5]]) / exact - 1) < 1e-14


@pytest.mark.parametrize("size", [1, 2, 3, 5, 9])
def test_sines_of_squares_stay_on_the_continuous_branch(size):
    """E exp(ik|x|²) = (1 - 2ik)^(-n/2): the argument of the determinant passes pi, and 3 pi."""
    state = sp.symbols(f"x:{size}", real=True)
    for k in (0.4, 3.0, 40.0):
        exact = np.exp(-0.5 * size * np.log(1 - 2j * k))
        square = sum(s**2 for s in state)
        both = [sp.cos(sp.Float(k) * square), sp.sin(sp.Float(k) * square)]
        found = expectation_function(both, state)(np.zeros(size), np.eye(size))
        assert_allclose(found, [exact.real, exact.imag], rtol=1e-12, atol=1e-14)
        if size <= 3:
            formula = expectation(both[0], state, [0] * size, sp.eye(size))
            assert complex(formula.evalf()) == pytest.approx(exact.real, abs=1e-12)


def test_sine_of_products_of_three_variables():
    f = sp.cos(x * y + 2 * y * z - x * z)
    mean, cov = random_dist(np.random.default_rng(2), 3, 0.5)
    exact = hermite_mean(sp.lambdify((x, y, z), f), mean, cov, 70)
    assert expectation_function(f, [x, y, z])(mean, cov) == pytest.approx(exact, abs=1e-11)
    formula = expectation(f, [x, y, z], list(mean), sp.Matrix(cov.tolist()))
    assert complex(formula.evalf()) == pytest.approx(exact, abs=1e-11)


def test_planes_across_three_variables_match_simulation():
    rng = np.random.default_rng(5)
    mean, cov = random_dist(rng, 3, 0.6)
    f = x * y * sp.Max(x - 2 * z, 1 + y) + sp.Piecewise((z, x + y < 1), (x**2, True))
    draws = mean[:, None] + np.linalg.cholesky(cov) @ rng.normal(size=(3, 400_000))
    values = sp.lambdify((x, y, z), f, "numpy")(*draws)
    doubt = values.std() / np.sqrt(values.size)
    assert abs(expectation_function(f, [x, y, z])(mean, cov) - values.mean()) < 4 * doubt


ALIKE = {
    "root of an expanded square": (sp.sqrt(sp.expand((2 * y - x) ** 2)), abs(2 * y - x)),
    "power 3/2 of a square": (
        sp.expand((x - y / 2 + 1) ** 2) ** sp.Rational(3, 2),
        abs(x - y / 2 + 1) ** 3,
    ),
    "decimal root": ((x**2 + 3 * y**2 + 1) ** 0.5, sp.sqrt(x**2 + 3 * y**2 + 1)),
    "numbers to powers": (
        sp.cbrt(5) * sp.sin(x) + sp.sqrt(3) ** x,
        5 ** (1 / 3) * sp.sin(x) + sp.exp(x * sp.log(3) / 2),
    ),
    "an affine difference": (
        sp.Max(sp.sqrt(2) * (x + sp.sin(y)), sp.sqrt(2) * sp.sin(y)),
        sp.sqrt(2) * (sp.Max(x, 0) + sp.sin(y)),
    ),
    "a constant difference": (sp.Max(x * (x + 1), x**2 + x - 2, evaluate=False), x**2 + x),
    "equal half-spaces": (
        sp.Heaviside(3 * x - y, 0) * sp.Heaviside(x - y / 3, 0),
        sp.Heaviside(3 * x - y),
    ),
    "both sides": (
        sp.Heaviside(x - 2 * y + 0.3, 0) + sp.Heaviside(-3 * (x - 2 * y + 0.3), 0),
        sp.S.One,
    ),
    "opposite sides": (sp.Heaviside(x - y, 0) * sp.Heaviside(y - x, 0), sp.S.Zero),
    "pieces": (
        sp.Piecewise((x, x < 1), (y, x >= 1)),
        x * sp.Heaviside(1 - x) + y * sp.Heaviside(x - 1),
    ),
    "error function of a constant": (
        sp.erf(x * (x + 1) - x**2 - x + 1, evaluate=False) * x,
        sp.erf(1) * x,
    ),
}


@pytest.mark.parametrize("name", ALIKE)
def test_two_ways_to_write_a_function_have_one_mean(name):
    one, other = (expectation_function(f, [x, y])(MEAN, COV) for f in ALIKE[name])
    assert one == pytest.approx(other, rel=1e-14, abs=1e-16)


def test_parameters_are_real_constants():
    a = sp.Symbol("a")
    formula = expectation(a * x**2, [x], [m], ONE, parameters=(a,))
    assert sp.expand(formula - a * (m**2 + P)) == 0


def test_plain_symbols_are_taken_as_real():
    u, v, a = sp.symbols("u v a")
    for f in (abs(u) * v, sp.Max(u, v), sp.exp(-(u**2)) * sp.sin(v), sp.sqrt(u**2 + v**2)):
        plain = expectation_function(f, [u, v])(MEAN, COV)
        assert plain == expectation_function(f.subs({u: x, v: y}), [x, y])(MEAN, COV)
    p, q = sp.symbols("p q")
    formula = expectation(sp.cos(a * u), [u], [p], sp.Matrix([[q]]), parameters=[a])
    assert sp.expand(formula - sp.exp(-(a**2) * q / 2) * sp.cos(a * p)) == 0


EDGES = [
    (sp.Heaviside(2 * x - y, sp.Rational(1, 4)), 0.25),
    (sp.Heaviside(-x, sp.Rational(1, 4)) ** 2, 0.0625),
    (sp.Piecewise((3, y >= x), (5, True)), 3.0),
    (sp.Piecewise((3, y > x), (5, True)), 5.0),
    (sp.Piecewise((3, x <= y), (5, True)), 3.0),
    (sp.Piecewise((3, x < y), (5, True)), 5.0),
    (sp.sign(-x) + 2, 2.0),
    (sp.Heaviside(x * (x + 1) - x**2 - x, sp.Rational(1, 4)), 0.25),
]


@pytest.mark.parametrize(("f", "value"), EDGES, ids=str)
def test_known_state_on_an_edge_has_the_value_of_the_edge(f, value):
    function = expectation_function(f, [x, y])
    assert function(np.zeros(2), np.zeros((2, 2))) == pytest.approx(value, rel=1e-15)
    assert function.compiled.value(np.zeros((2, 1)))[0, 0] == pytest.approx(value, rel=1e-15)


def test_state_without_spread_across_the_plane():
    """Moving along the plane only: the one side counts."""
    cov = np.ones((2, 2))
    function = expectation_function(abs(x - y + 1) * x**2, [x, y])
    assert function([0.5, 0.2], cov) == pytest.approx(1.3 * 1.25, rel=1e-14)
    assert expectation_function(sp.Max(x, y), [x, y])([2.0, 2.0], cov) == pytest.approx(2.0)


def test_error_functions_have_the_classical_means():
    """E Phi(2x - 1) = Phi((2m - 1) / sqrt(1 + 4P)), in a batch and far in the tail."""
    mean, var = np.linspace(-2, 2, 7), np.linspace(0, 3, 7)
    found = expectation_function(normal_cdf(2 * x - 1), [x])(mean[None], var[None, None])
    assert_allclose(found, ndtr((2 * mean - 1) / np.sqrt(1 + 4 * var)), rtol=1e-13)
    for sign in (1, -1):
        tail = expectation_function(sp.erfc(sign * x) / 2, [x])([16.0 * sign], [[0.5]])
        assert tail == pytest.approx(ndtr(-16.0), rel=1e-12, abs=0)


ONE_SIDED = (
    sp.Min(x, 0),
    sp.Min(x, 0) ** 2,
    sp.Heaviside(-x, 1),
    x**3 * sp.Heaviside(-x) ** 2,
    sp.Piecewise((x**2, x < 0), (0, True)),
    sp.Piecewise((sp.exp(x), x <= 0), (0, True)),
    sp.Piecewise((x * sp.cos(x), x < 0), (0, True)),
)


@pytest.mark.parametrize("f", ONE_SIDED, ids=str)
@pytest.mark.parametrize("mean", [1.0, 9.0])
def test_mean_of_a_tail_keeps_its_digits(f, mean):
    with mp.workdps(50):
        value = sp.lambdify(x, f, "mpmath")
        stops = [-mp.mpf(k) / mean for k in (150, 80, 40, 20, 10, 5, 2, 1, 0.5, 0)]
        inside = mp.quad(lambda u: value(u) * mp.exp(u * (mean - u / 2)), stops)
        exact = float(inside * mp.npdf(mean, 0, 1))
    # the recursion over powers subtracts what agrees in mean² for each power
    rounding = max(1e-15 * (3 * mean**2) ** 3, 1e-12)
    found = expectation_function(f, [x])([mean], [[1.0]])
    assert found == pytest.approx(exact, rel=rounding, abs=0)
    if not f.has(sp.exp, sp.cos):
        formula = expectation(f, [x], [m], ONE).subs({m: int(mean), P: 1})
        assert complex(formula.evalf(30, maxn=600)) == pytest.approx(exact, rel=1e-12, abs=0)


def test_extreme_arguments_stay_finite():
    function = expectation_function([abs(x), sp.sign(x), sp.exp(-(x**2)), sp.sin(x)], [x])
    for mean in (-1e8, 0.0, 1e8):
        for var in (1e-300, 1e-18, 1.0, 1e18):
            found = function([mean], [[var]])
            assert np.isfinite(found).all()
            assert found[0] >= abs(mean) * (1 - 1e-15)


def test_infinite_means_are_refused():
    function = expectation_function(sp.exp(x**2 / 3), [x])
    assert function([0.0], [[1.0]]) == pytest.approx(3**0.5, rel=1e-14)
    for mean, cov in (([0.0], [[1.5]]), (np.zeros((1, 2)), np.array([[[1.0, 2.0]]]))):
        with pytest.raises(ValueError, match="infinite"):
            function(mean, cov)
    swinging = expectation_function(sp.exp(0.75 * x**2 - 1.5 * y**2) * sp.cos(10 * x * y), [x, y])
    with pytest.raises(ValueError, match="infinite"):
        swinging([0.0, 0.0], np.eye(2))


BATCHED = {
    "polynomial": [x**2 * y, x],
    "exponential": sp.exp(x / 3) * sp.sin(y),
    "bell": sp.exp(-(x**2) / 3),
    "swinging": sp.cos(x * y),
    "piecewise": [abs(x - y), x * y],
    "one coordinate": sp.Max(y, 0),
    "norm": sp.sqrt(x**2 + y**2),
    "distant norm": sp.sqrt((x - 20) ** 2 + y**2),
    "mixed": [x * y, sp.sin(x), abs(x - y), sp.sqrt(x**2 + y**2 + 1)],
}
SHAPES = [((3, 3), (3,)), ((2, 4, 3), (4, 3)), ((2, 0), (0,)), ((5, 3), ()), ((3,), (5, 3))]


@pytest.mark.parametrize("make", [expectation_function, posterior_variance_function])
@pytest.mark.parametrize("name", BATCHED)
@pytest.mark.parametrize("rank", [0, 1, 2])
def test_batch_axes_are_aligned_at_the_end(make, name, rank):
    if make is posterior_variance_function and name == "mixed":
        return
    rng = np.random.default_rng(4)
    function = make(BATCHED[name], [x, y])
    for of_mean, of_cov in SHAPES:
        mean, factor = rng.normal(size=(2, *of_mean)), rng.normal(size=(2, rank, *of_cov))
        cov = np.einsum("ik...,jk...->ij...", factor, factor)
        batch = np.broadcast_shapes(of_mean, of_cov)
        found = function(mean, cov)
        assert found.shape[found.ndim - len(batch) :] == batch
        means = np.broadcast_to(
            mean.reshape(2, *(1,) * (len(batch) - len(of_mean)), *of_mean), (2, *batch)
        )
        covs = np.broadcast_to(
            cov.reshape(2, 2, *(1,) * (len(batch) - len(of_cov)), *of_cov), (2, 2, *batch)
        )
        for index in np.ndindex(*batch):
            one = function(means[:, *index], covs[:, :, *index])
            assert found[..., *index] == pytest.approx(one, rel=1e-11, abs=1e-12)
