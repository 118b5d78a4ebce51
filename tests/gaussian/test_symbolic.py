"""Gaussian means of SymPy expressions against quadrature, generating functions and known laws."""

from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy import integrate, stats

from seedslib.gaussian import (
    FunctionClass,
    NoClosedForm,
    classify,
    expectation,
    expectation_function,
)

x, y, z = sp.symbols("x y z", real=True)
m1, m2, P, P11, P12, P22 = sp.symbols("m1 m2 P P11 P12 P22", real=True)
ONE = sp.Matrix([[P]])
TWO = sp.Matrix([[P11, P12], [P12, P22]])

SMOOTH = [
    x**2 * y - 3 * y + 1,
    (x + 2 * y) ** 4,
    x * sp.sin(x + y),
    sp.sin(x) ** 3 * y**2,
    sp.exp(x / 3) * x**2 * sp.cos(2 * x + y),
    sp.cosh(x / 2) * y - sp.sinh(y / 3),
    2 ** (x / 3) * y,
    sp.exp(-(x**2) - x * y - y**2 + x) * y**3,
    sp.cos(x * y),
    x * sp.cos(x**2 + y**2 - x * y) + 1,
    sp.exp(-(x**2) / 3) * sp.sin(x * y / 2) * x,
    sp.exp(x**2 / 20),
    sp.sqrt(x**2 + (y - 1) ** 2 + 1),
]

KINKED = [
    (abs(x - 0.3), (0.3,)),
    (sp.Max(x, 1), (1.0,)),
    (sp.Min(2 * x, 1 - x), (1 / 3,)),
    (sp.Max(x, 0) ** 3, (0.0,)),
    (sp.sign(x) * x**2, (0.0,)),
    (sp.Heaviside(x - 1) * (x**2 - x), (1.0,)),
    (sp.Piecewise((x**2, x > 1), (1 - x, True)), (1.0,)),
    (sp.Piecewise((x, x <= -1), (x**3, x > -1), (0, True)), (-1.0,)),
    (abs(x) + abs(x - 1), (0.0, 1.0)),
    (sp.exp(-abs(x)), (0.0,)),
    (abs(x) * sp.exp(x / 2 - x**2), (0.0,)),
    (abs(x) * sp.sin(2 * x + 1), (0.0,)),
    (sp.sqrt(x**2 - 2 * x + 1), (1.0,)),
]


def random_law(rng, n, scale=0.6):
    root = scale * rng.normal(size=(n, n))
    return rng.normal(size=n), root @ root.T


def gauss_hermite(function, mean, cov, nodes=160):
    points, weights = np.polynomial.hermite_e.hermegauss(nodes)
    grid = np.array(np.meshgrid(*[points] * len(mean), indexing="ij")).reshape(len(mean), -1)
    mass = weights / weights.sum()
    total = mass
    for _ in range(len(mean) - 1):
        total = np.outer(total, mass).ravel()
    return total @ function(*(mean[:, None] + np.linalg.cholesky(cov) @ grid))


@pytest.mark.parametrize(
    ("f", "answer"),
    [
        (x**4, m1**4 + 6 * P * m1**2 + 3 * P**2),
        (x**6, m1**6 + 15 * P * m1**4 + 45 * P**2 * m1**2 + 15 * P**3),
        (sp.sin(x), sp.exp(-P / 2) * sp.sin(m1)),
        (sp.cos(x), sp.exp(-P / 2) * sp.cos(m1)),
        (sp.exp(x), sp.exp(m1 + P / 2)),
        (sp.Integer(7), sp.Integer(7)),
    ],
)
def test_literal_outputs_of_one_variable(f, answer):
    assert expectation(f, [x], [m1], ONE) == answer


def test_literal_output_of_two_variables():
    result = expectation(x**2 * y, [x, y], [m1, m2], TWO)
    assert result == m1**2 * m2 + 2 * P12 * m1 + P11 * m2


def test_polynomials_match_derivatives_of_the_generating_function():
    s, t = sp.symbols("s t")
    law = s * m1 + t * m2 + (P11 * s**2 + 2 * P12 * s * t + P22 * t**2) / 2
    for i, j in [(1, 0), (2, 1), (0, 4), (3, 2), (2, 2), (1, 5)]:
        derivative = sp.diff(sp.exp(law), s, i, t, j).subs({s: 0, t: 0})
        result = expectation(x**i * y**j, [x, y], [m1, m2], TWO)
        assert sp.expand(derivative - result) == 0


@pytest.mark.parametrize("f", SMOOTH, ids=str)
def test_smooth_functions_match_gauss_hermite(f):
    rng = np.random.default_rng(11)
    numeric = sp.lambdify((x, y), f, "numpy")
    function = expectation_function(f, [x, y])
    for _ in range(3):
        mean, cov = random_law(rng, 2)
        reference = gauss_hermite(lambda a, b: numeric(a, b) + 0 * a, mean, cov)
        scale = gauss_hermite(lambda a, b: np.abs(numeric(a, b)) + 0 * a, mean, cov)
        assert_allclose(function(mean, cov), reference, atol=1e-10 * scale, rtol=0)
        if function.kind is not FunctionClass.NORM:
            formula = expectation(f, [x, y], list(mean), sp.Matrix(cov.tolist()))
            assert abs(complex(formula.evalf()) - reference) < 1e-10 * scale


@pytest.mark.parametrize(("f", "breaks"), KINKED, ids=lambda v: str(v))
def test_switched_functions_match_split_quadrature(f, breaks):
    numeric = sp.lambdify(x, f, "numpy")
    function = expectation_function(f, [x])
    for mean, var in [(0.2, 0.7), (-1.5, 0.1), (3.0, 2.0)]:
        law = stats.norm(mean, np.sqrt(var))
        ends = [mean - 12 * np.sqrt(var), *breaks, mean + 12 * np.sqrt(var)]
        ends = sorted(e for e in ends if abs(e - mean) <= 12.01 * np.sqrt(var))
        pieces = [
            integrate.quad(lambda u, law=law: float(numeric(u)) * law.pdf(u), a, b, epsabs=1e-13)[0]
            for a, b in pairwise(ends)
        ]
        assert_allclose(function([mean], [[var]]), sum(pieces), atol=1e-11, rtol=1e-10)
        formula = expectation(f, [x], [sp.Float(mean)], sp.Matrix([[sp.Float(var)]]))
        assert abs(complex(formula.evalf()) - sum(pieces)) < 1e-10 * (1 + abs(sum(pieces)))


def test_half_space_across_three_variables_matches_simulation():
    rng = np.random.default_rng(5)
    mean, cov = random_law(rng, 3)
    f = x * y * sp.Max(x - 2 * z, 1 + y) + sp.Piecewise((z, x + y < 1), (x**2, True))
    draws = mean[:, None] + np.linalg.cholesky(cov) @ rng.normal(size=(3, 400_000))
    values = sp.lambdify((x, y, z), f, "numpy")(*draws)
    error = values.std() / np.sqrt(values.size)
    assert abs(expectation_function(f, [x, y, z])(mean, cov) - values.mean()) < 4 * error


@pytest.mark.parametrize("n", [1, 2, 3, 5, 9])
def test_oscillating_quadratics_stay_on_the_right_branch(n):
    # E exp(i k |x|^2) = (1 - 2 i k)^(-n/2): the argument of the determinant passes pi, and 3 pi
    symbols = sp.symbols(f"x:{n}", real=True)
    for k in (0.4, 3.0, 40.0):
        exact = np.exp(-0.5 * n * np.log(1 - 2j * k))
        square = sum(s**2 for s in symbols)
        both = [sp.cos(sp.Float(k) * square), sp.sin(sp.Float(k) * square)]
        result = expectation_function(both, symbols)(np.zeros(n), np.eye(n))
        assert_allclose(result, [exact.real, exact.imag], rtol=1e-12, atol=1e-14)
        if n <= 3:
            formula = expectation(both[0], symbols, [0] * n, sp.eye(n))
            assert abs(complex(formula.evalf()) - exact.real) < 1e-12


def test_oscillating_products_of_three_pairs():
    # indefinite imaginary quadratics of full rank, against Gauss-Hermite in three variables
    f = sp.cos(x * y + 2 * y * z - x * z)
    rng = np.random.default_rng(2)
    mean, cov = random_law(rng, 3, 0.5)
    reference = gauss_hermite(sp.lambdify((x, y, z), f, "numpy"), mean, cov, 70)
    assert_allclose(expectation_function(f, [x, y, z])(mean, cov), reference, atol=1e-11)
    formula = expectation(f, [x, y, z], list(mean), sp.Matrix(cov.tolist()))
    assert abs(complex(formula.evalf()) - reference) < 1e-11


def test_large_batches_agree_with_single_calls():
    rng = np.random.default_rng(3)
    means = rng.normal(size=(2, 3, 4))
    roots = rng.normal(size=(2, 2, 3, 4))
    covs = np.einsum("ij...,kj...->ik...", roots, roots)
    for f in [*SMOOTH[:4], *SMOOTH[7:9], SMOOTH[12], abs(x - y) * x, [x, sp.sin(y), abs(x)]]:
        function = expectation_function(f, [x, y])
        together = function(means, covs)
        shared = function(means, covs[..., 0, 0])
        one_mean = function(means[:, 0, 0], covs)
        assert together.dtype == float
        for i in np.ndindex(3, 4):
            mean, cov = means[(slice(None), *i)], covs[(slice(None), slice(None), *i)]
            assert_allclose(together[(..., *i)], function(mean, cov), rtol=1e-11, atol=1e-13)
            assert_allclose(
                shared[(..., *i)], function(mean, covs[..., 0, 0]), rtol=1e-11, atol=1e-13
            )
            assert_allclose(
                one_mean[(..., *i)], function(means[:, 0, 0], cov), rtol=1e-11, atol=1e-13
            )


def test_shapes_and_types_of_results():
    scalar, vector = expectation_function(x * y, [x, y]), expectation_function([x, y**2], [x, y])
    assert isinstance(scalar(np.zeros(2), np.eye(2)), float)
    assert scalar(np.zeros((2, 5)), np.eye(2)).shape == (5,)
    assert vector(np.zeros(2), np.eye(2)).shape == (2,)
    assert vector(np.zeros((2, 5, 3)), np.eye(2)).shape == (2, 5, 3)
    assert vector(np.zeros((2, 0)), np.eye(2)).shape == (2, 0)
    column = expectation(sp.Matrix([x, x * y]), [x, y], [m1, m2], TWO)
    assert column == sp.Matrix([m1, m1 * m2 + P12])


def test_zero_covariance_gives_the_function_itself():
    functions = [*SMOOTH, *(f for f, _ in KINKED), sp.sign(x - y), sp.Heaviside(x), abs(x)]
    for f in functions:
        function = expectation_function(f, [x, y])
        numeric = sp.lambdify((x, y), f, "numpy")
        for point in [(0.0, 0.0), (1.0, 1.0), (0.3, -0.7)]:
            expected = float(numeric(*point))
            assert_allclose(function(point, np.zeros((2, 2))), expected, rtol=1e-13, atol=1e-14)


def test_edges_of_indicators_count_where_nothing_varies():
    zero = np.zeros((1, 1))
    assert expectation_function(sp.Piecewise((1, x >= 0), (0, True)), [x])([0.0], zero) == 1.0
    assert expectation_function(sp.Piecewise((1, x > 0), (0, True)), [x])([0.0], zero) == 0.0
    assert expectation_function(sp.Piecewise((1, x < 0), (0, True)), [x])([0.0], zero) == 0.0
    assert expectation_function(sp.sign(-x), [x])([0.0], zero) == 0.0


def test_singular_covariance_with_a_plane_that_does_not_vary():
    cov = np.ones((2, 2))
    function = expectation_function(abs(x - y + 1) * x**2, [x, y])
    assert_allclose(function([0.5, 0.2], cov), 1.3 * (1 + 0.25), rtol=1e-14)
    assert_allclose(expectation_function(sp.Max(x, y), [x, y])([2.0, 2.0], cov), 2.0, rtol=1e-15)


def test_exponentials_of_the_modulus_far_from_the_kink():
    # on one side of the plane only: e^|m| must not enter a difference
    for rate in (1, 3):
        function = expectation_function(sp.exp(-rate * abs(x)), [x])
        for mean in (-800.0, -30.0, 20.0, 300.0):
            expected = np.exp(-rate * abs(mean) + 0.5 * rate**2 * 0.7)
            assert_allclose(function([mean], [[0.7]]), expected, rtol=1e-12)
    product = expectation_function(sp.exp(-abs(x)) * (sp.Max(x, 0) + abs(x)), [x])
    assert_allclose(product([25.0], [[0.5]]), 2 * 24.5 * np.exp(-24.75), rtol=1e-12)
    assert_allclose(product([-25.0], [[0.5]]), 24.5 * np.exp(-24.75), rtol=1e-12)


def test_extreme_arguments_stay_finite():
    function = expectation_function([abs(x), sp.sign(x), sp.exp(-(x**2)), sp.sin(x)], [x])
    for mean in (-1e8, 0.0, 1e8):
        for var in (1e-300, 1e-18, 1.0, 1e18):
            result = function([mean], [[var]])
            assert np.isfinite(result).all()
            assert result[0] >= abs(mean) * (1 - 1e-15)


@pytest.mark.parametrize(
    ("f", "kind"),
    [
        (sp.Integer(2), FunctionClass.POLYNOMIAL),
        (x * y**2, FunctionClass.POLYNOMIAL),
        (sp.exp(x) * sp.cos(y) * x, FunctionClass.EXPONENTIAL),
        (sp.exp(-x * y), FunctionClass.TILT),
        (abs(x - 2) * y, FunctionClass.PIECEWISE),
        (sp.Max(x, y), FunctionClass.PIECEWISE),
        ([abs(x - 1), sp.Max(x, 1), y], FunctionClass.PIECEWISE),
        (2 * sp.sqrt(x**2 + y**2) + 1, FunctionClass.NORM),
        (abs(x) + abs(y), FunctionClass.MIXED),
        (abs(x) + sp.sin(x), FunctionClass.MIXED),
        (sp.atan(x), FunctionClass.NONE),
        (1 / x, FunctionClass.NONE),
    ],
    ids=str,
)
def test_classes(f, kind):
    assert classify(f, [x, y]) is kind
    assert classify(f, [x, y]) == str(kind)


@pytest.mark.parametrize(
    "f",
    [
        sp.atan(x),
        1 / x,
        x**x,
        sp.sqrt(x),
        sp.sqrt(x * y),
        sp.log(x),
        sp.tanh(x),
        sp.exp(x**3),
        sp.sqrt(x**2 + y**2) * sp.cos(y),
        sp.sqrt(x**2 + y**2) * x,
        (x**2 + y**2) ** sp.Rational(3, 2),
        abs(x * y),
        abs(x) * abs(y),
        sp.Max(x, y, 1),
        sp.Piecewise((x, x > 0)),
        sp.Piecewise((x, (x > 0) & (y > 0)), (0, True)),
        sp.exp(sp.sin(x)),
        sp.cos(sp.sqrt(x**2 + y**2)),
        sp.sqrt(x**3 + y**2),
    ],
    ids=str,
)
def test_functions_outside_the_class_are_refused(f):
    for call in (
        lambda: expectation_function(f, [x, y]),
        lambda: expectation(f, [x, y], [m1, m2], TWO),
    ):
        with pytest.raises(NoClosedForm, match="no closed form for"):
            call()


def test_the_message_names_the_term():
    with pytest.raises(NoClosedForm, match=r"tanh\(y\)"):
        expectation_function(x**2 + sp.sin(x) + sp.tanh(y), [x, y])
    with pytest.raises(NoClosedForm, match="norm is an integral"):
        expectation(sp.sqrt(x**2 + y**2), [x, y], [m1, m2], TWO)


def test_bad_symbols_and_values_are_refused():
    a = sp.Symbol("a")
    with pytest.raises(ValueError, match="wanted known symbols, got a"):
        expectation_function(a * x, [x])
    with pytest.raises(ValueError, match="wanted known symbols, got a"):
        classify(a * x, [x])
    with pytest.raises(ValueError, match="distinct"):
        expectation_function(x, [x, x])
    with pytest.raises(ValueError, match="real finite"):
        expectation_function(sp.exp(sp.I * x), [x])
    with pytest.raises(ValueError, match="real finite"):
        expectation_function(x + sp.oo, [x])
    with pytest.raises(ValueError, match="vector"):
        expectation_function(sp.eye(2) * x, [x])
    with pytest.raises(ValueError, match="empty"):
        expectation_function([], [x])
    for variables in (x, "x", ["x"], [2]):
        with pytest.raises(TypeError, match="variables"):
            expectation_function(x, variables)
    with pytest.raises(TypeError, match="expression"):
        expectation_function(x > 0, [x])


def test_bad_laws_are_refused():
    function = expectation_function(x * y, [x, y])
    for mean, cov, error in [
        ([0, 0, 0], np.eye(3), ValueError),
        ([0, 0], np.eye(3), ValueError),
        ([0, np.nan], np.eye(2), ValueError),
        ([0, 0], [[1, 2], [0, 1]], ValueError),
        ([0, 0], -np.eye(2), ValueError),
        ([0, 1j], np.eye(2), TypeError),
        (np.zeros((2, 4)), np.zeros((2, 2, 3)), ValueError),
    ]:
        with pytest.raises(error):
            function(mean, cov)
    with pytest.raises(ValueError, match="mean"):
        expectation(x, [x], [m1, m2], ONE)
    with pytest.raises(ValueError, match="shape"):
        expectation(x * y, [x, y], [m1, m2], ONE)
    with pytest.raises(ValueError, match="symmetric"):
        expectation(x * y, [x, y], [m1, m2], sp.Matrix([[1, P], [0, 1]]))


def test_infinite_means_are_refused():
    function = expectation_function(sp.exp(x**2 / 3), [x])
    assert_allclose(function([0.0], [[1.0]]), 3**0.5, rtol=1e-14)
    for var in (1.5, 4.0):
        with pytest.raises(ValueError, match="infinite"):
            function([0.0], [[var]])
    with pytest.raises(ValueError, match="infinite"):
        function(np.zeros((1, 2)), np.array([[[1.0, 2.0]]]))


def test_symbols_need_no_assumptions():
    u, v = sp.symbols("u v")
    for f in [
        abs(u),
        sp.sqrt(u**2),
        sp.Max(u, v),
        sp.exp(-(u**2)) * sp.sin(v),
        sp.sqrt(u**2 + v**2),
    ]:
        plain = expectation_function(f, [u, v])([0.3, 0.1], np.eye(2))
        real = expectation_function(f.subs({u: x, v: y}), [x, y])([0.3, 0.1], np.eye(2))
        assert plain == real


def test_functions_are_built_once():
    f = x**2 * sp.sin(y)
    assert expectation_function(f, [x, y]) is expectation_function(x**2 * sp.sin(y), (x, y))
    assert expectation_function(f, [y, x]) is not expectation_function(f, [x, y])


def test_parameters_are_constants_given_later():
    a, t = sp.symbols("a t")
    f = [a * x + t, sp.sin(a * x), abs(x - t), sp.exp(-a * x**2), sp.Max(a * x, t)]
    function = expectation_function(f, [x], parameters=(a, t))
    for av, tv in [(1.2, 0.3), (0.4, -1.0)]:
        direct = expectation_function([g.subs({a: av, t: tv}) for g in f], [x])
        assert_allclose(function([0.5], [[0.7]], av, tv), direct([0.5], [[0.7]]), rtol=1e-14)
    formula = expectation(a * x**2, [x], [m1], ONE, parameters=(a,))
    assert sp.expand(formula - a * (m1**2 + P)) == 0
    with pytest.raises(TypeError, match="parameters"):
        function([0.5], [[0.7]], 1.0)


def test_decimal_coefficients_are_accepted():
    assert classify(x**2.0 * y, [x, y]) is FunctionClass.POLYNOMIAL
    function = expectation_function(0.0 * x**3 + 0.5 * x**2 - 1.5 * sp.sin(0.3 * x), [x])
    expected = 0.5 * (0.04 + 0.7) - 1.5 * np.exp(-0.045 * 0.7) * np.sin(0.06)
    assert_allclose(function([0.2], [[0.7]]), expected, rtol=1e-14)
