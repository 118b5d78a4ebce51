"""From expressions to terms: symbols, components, what is refused by which name, classes."""

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import (
    FunctionClass,
    NoClosedForm,
    classify,
    expectation,
    expectation_function,
)
from seedslib.gaussian.means.classes import Plane, opposite
from seedslib.gaussian.means.parse import components_of, parse
from seedslib.gaussian.means.quadratics import is_semidefinite, quadratic_gram
from seedslib.gaussian.means.symbolic import class_of

x, y = VARIABLES = sp.symbols("x y", real=True)
MEAN, COV = [0.4, -0.7], np.array([[1.3, -0.45], [-0.45, 0.6]])

# Symbols


def test_symbols_that_are_refused_are_named():
    a = sp.Symbol("a")
    for call in (
        lambda f, v, p: parse(f, v, p),
        lambda f, v, p: expectation(f, v, [0] * len(v), sp.eye(len(v)), parameters=p),
        lambda f, v, p: expectation_function(f, v, parameters=p),
    ):
        with pytest.raises(ValueError, match=r"f: .* got a; the variables are \(x, y\)$"):
            call(a * x, [x, y], [])
        with pytest.raises(ValueError, match=r"f: .* got b; the variables are \(x, a\)$"):
            call(a * x + sp.Symbol("b"), [x], [a])
        with pytest.raises(ValueError, match=r"variables: wanted distinct .* got \(x, x\)"):
            call(x, [x, x], [])
        with pytest.raises(ValueError, match=r"variables: wanted distinct .* got \(x, y, x\)"):
            call(x, [x, y], [x])
        with pytest.raises(ValueError, match=r"variables: wanted distinct .* got \(\)"):
            call(sp.S.One, [], [])
        with pytest.raises(TypeError, match="variables: wanted SymPy symbols, got 2"):
            call(x, [x, 2], [])
        with pytest.raises(TypeError, match="parameters: wanted SymPy symbols, got 3"):
            call(x, [x], [3])
        for f, told in [(sp.I * x, r"I\*x"), ([x, sp.oo], "oo"), (sp.nan, "nan")]:
            with pytest.raises(ValueError, match=f"f: wanted real finite values, got {told}"):
                call(f, [x], [])


def test_components_of_scalars_lists_and_matrices():
    assert components_of(3) == ((sp.S(3),), True)
    assert components_of(x) == ((x,), True)
    assert components_of([x]) == components_of((x,)) == ((x,), False)
    assert components_of(sp.Matrix([[x, y]])) == components_of(sp.Matrix([x, y])) == ((x, y), False)
    assert components_of(sp.Matrix([[x]])) == ((x,), False)
    with pytest.raises(ValueError, match=r"f: wanted a scalar or a vector, .* of shape \(2, 2\)"):
        components_of(sp.eye(2))
    with pytest.raises(ValueError, match="f: wanted at least one component, got an empty list"):
        components_of([])
    for text in ("x", ["x"], ("x",)):
        with pytest.raises(TypeError, match="f: wanted SymPy expressions, got the string 'x'"):
            components_of(text)


def test_what_was_read_keeps_the_order_of_its_symbols():
    a, b = sp.symbols("a b")
    parsed = parse([a * x, b * y], [y, x], [b, a])
    assert [s.name for s in parsed.symbols] == ["y", "x"]
    assert [s.name for s in parsed.parameters] == ["b", "a"]
    assert all(s.is_real for s in (*parsed.symbols, *parsed.parameters))
    assert not parsed.scalar
    assert parse(x, [x]).scalar


def test_plain_symbols_are_taken_as_real():
    """Of a parameter and a variable without assumptions: no real or imaginary part is left."""
    u, a, m, P = sp.symbols("u a m P")
    found = expectation(sp.cos(a * u), [u], [m], sp.Matrix([[P]]), parameters=[a])
    assert sp.expand(found - sp.exp(-(a**2) * P / 2) * sp.cos(a * m)) == 0
    n, Q, R = sp.symbols("n Q R")
    found = expectation(sp.sin(u + a), [u, a], [m, n], [[P, Q], [Q, R]])
    assert sp.expand(found - sp.exp(-P / 2 - Q - R / 2) * sp.sin(m + n)) == 0
    found = expectation(abs(a) ** 2 * u * abs(u) ** 3, [u], [0], sp.eye(1), parameters=[a])
    assert found.subs(a, 2) == 0
    assert classify(abs(u) ** 4, [u]) is FunctionClass.POLYNOMIAL


# What is read, and what is refused


def mean(f):
    return expectation_function(f, VARIABLES)(MEAN, COV)


def test_decimal_powers_are_roots_and_squares():
    square = x**2 + 3 * y**2 + 1
    assert mean(square**0.5) == mean(sp.sqrt(square))
    assert mean(square**1.0 + x) == pytest.approx(mean(square + x), rel=1e-15)
    line = (x + 2 * y - 0.3) ** 2
    assert mean(line**1.5) == pytest.approx(mean(abs(x + 2 * y - 0.3) ** 3), rel=1e-14)
    assert mean(sp.sqrt(sp.expand(line))) == pytest.approx(mean(abs(x + 2 * y - 0.3)), rel=1e-14)
    for power in (0.25, 1 / 3, -1.0, -0.5, sp.Rational(1, 3)):
        with pytest.raises(NoClosedForm, match=r"wanted a positive integer power, or a number"):
            mean(square**power)


def test_powers_of_numbers_are_numbers():
    wave = mean(sp.sin(x))
    assert mean(sp.sqrt(2) + sp.sin(x)) == pytest.approx(np.sqrt(2) + wave, rel=1e-15)
    assert mean(sp.cbrt(5) * sp.sin(x)) == pytest.approx(5 ** (1 / 3) * wave, rel=1e-14)
    growth = mean(sp.exp(x * sp.log(3) / 2))
    assert mean(sp.sqrt(3) ** x) == mean(3 ** (x / 2)) == pytest.approx(growth, rel=1e-14)


def test_edges_and_signs_of_switching_functions():
    """On the boundary each keeps its own value; a step down is one less a step up."""
    at = np.zeros(2), np.zeros((2, 2))
    for f, there in [
        (sp.Heaviside(2 * x - y, sp.Rational(1, 4)), 0.25),
        (sp.Heaviside(-x, sp.Rational(1, 4)), 0.25),
        (sp.Heaviside(-x, sp.Rational(1, 4)) * sp.Heaviside(-x, sp.Rational(1, 4)), 0.0625),
        (sp.Piecewise((3, y >= x), (5, True)), 3.0),
        (sp.Piecewise((3, y > x), (5, True)), 5.0),
        (sp.Piecewise((3, x <= y), (5, True)), 3.0),
        (sp.Piecewise((3, x < y), (5, True)), 5.0),
        (sp.Piecewise((3, x >= 0), (5, True)), 3.0),
        (sp.Piecewise((3, x > 0), (5, True)), 5.0),
    ]:
        assert expectation_function(f, VARIABLES)(*at) == there, f
    steps = [sp.Heaviside(s * (x - 2 * y + 0.3), 0) for s in (1, -3)]
    assert mean(steps[0] + steps[1]) == pytest.approx(1.0, rel=1e-15)
    pieces = sp.Piecewise((x, x < 1), (y, x >= 1))
    whole = x * sp.Heaviside(1 - x) + y * sp.Heaviside(x - 1)
    assert mean(pieces) == pytest.approx(mean(whole), rel=1e-14)


u, v = sp.symbols("u v")


@pytest.mark.parametrize(
    ("f", "told"),
    [
        (u + sp.tanh(v), r"tanh\(v\): tanh is outside the closed class"),
        (sp.Max(u, v, 1), r"Max\(1, u, v\): Max is outside the closed class"),
        (u / v, r"1/v: wanted a positive integer power, or a number to a quadratic power"),
        (sp.sqrt(u**2 - v**2), r"sqrt\(u\*\*2 - v\*\*2\): wanted the root of a sum of squares"),
        (sp.sqrt(u**4 + 1), r"sqrt\(u\*\*4 \+ 1\): wanted the root of a sum of squares"),
        (sp.sqrt(u**3 + v**2), r"sqrt\(u\*\*3 \+ v\*\*2\): wanted the root of a sum of squares"),
        (sp.exp(u**3), r"exp\(u\*\*3\): wanted an exponent that is a polynomial"),
        (sp.sin(u * v**2), r"sin\(u\*v\*\*2\): wanted an exponent that is a polynomial"),
        (3 ** (u**3), r"3\*\*\(u\*\*3\): wanted an exponent that is a polynomial"),
        (sp.exp(abs(u) - abs(v)), r"exp\(.*\): wanted an exponent that is a polynomial"),
        (sp.exp(sp.Heaviside(u) * v**3), r"exp\(.*\): wanted an exponent that is a polynomial"),
        (sp.cos(sp.erf(u)), r"cos\(erf\(u\)\): wanted an exponent that is a polynomial"),
        (sp.exp(sp.sqrt(u**2 + v**2)), r"exp\(.*\): wanted an exponent that is a polynomial"),
        (abs(u * v), r"Abs\(u\*v\): wanted an affine switching function, got u\*v"),
        (sp.Heaviside(sp.sin(u)), r"Heaviside.*: wanted an affine switching .*, got sin\(u\)"),
        (sp.Max(u**2, v), r"Max\(.*\): wanted an affine switching function, got (u\*\*2 - v|-u)"),
        (sp.erf(u**2), r"erf\(u\*\*2\): wanted an affine switching function, got .*u\*\*2"),
        (abs(u) * sp.sign(v), r".*: wanted one affine switching function to a term, got two"),
        (sp.erf(u) * abs(v), r".*: wanted one error function and no other switching function"),
        (sp.sqrt(u**2 + 1) * sp.sqrt(v**2 + 1), r".*: wanted at most one norm to a term"),
        (u * sp.sqrt(u**2 + 1), r".*: wanted a constant multiple of a norm"),
        (sp.sqrt(u**2 + 1) * sp.exp(v), r".*: wanted a constant multiple of a norm"),
        (sp.sqrt(u**2 + 1) * abs(v), r".*: wanted a constant multiple of a norm"),
        (sp.Piecewise((u, v > 0)), r"Piecewise.*: wanted a value for every x, the last"),
        (
            sp.Piecewise((u, (u > 0) & (v > 0)), (0, True)),
            r"Piecewise.*: wanted one inequality to a piece, got \(u > 0\) & \(v > 0\)",
        ),
        (sp.Piecewise((u, u * v > 1), (0, True)), r"Piece.*: wanted an affine .* u\*v - 1"),
        (sp.Piecewise((u, sp.Eq(v, 0)), (0, True)), r".*: wanted one inequality to a piece, got"),
    ],
    ids=str,
)  # fmt: skip
def test_a_refusal_names_the_term_in_the_symbols_of_the_caller(f, told):
    """Also where the symbols have no assumptions: they are replaced by real ones and back."""
    with pytest.raises(NoClosedForm, match=rf"^no closed form for {told}"):
        expectation_function(f, [u, v])


# Formulas


def test_arguments_of_a_formula():
    m, P = sp.symbols("m P")
    assert expectation(x * y, [x, y], (m, 2), [[P, 3], [3, 1]]) == 2 * m + 3
    assert expectation(x**2, [x], sp.Matrix([m]), [P]) == m**2 + P
    split = sp.Matrix([[1, (m + 1) ** 2], [m**2 + 2 * m + 1, 1]])
    assert sp.expand(expectation(x * y, [x, y], [0, 0], split) - (m + 1) ** 2) == 0
    assert expectation([x, y], [x, y], [m, 1], sp.eye(2)) == sp.Matrix([m, 1])
    for centre, cov, told in [
        ([m, 1], [[P]], r"mean: wanted 1 components, got shape \(2, 1\)"),
        ([m], sp.eye(2), r"cov: wanted shape \(1, 1\), got \(2, 2\)"),
        ([m], [[P, P]], r"cov: wanted shape \(1, 1\), got \(1, 2\)"),
    ]:
        with pytest.raises(ValueError, match=f"^{told}$"):
            expectation(x, [x], centre, cov)
    with pytest.raises(ValueError, match=r"^cov: wanted a symmetric matrix$"):
        expectation(x, [x, y], [0, 0], [[1, m], [P, 1]])
    with pytest.raises(TypeError, match=r"^mean: wanted SymPy expressions, got the string 'm'"):
        expectation(x, [x], ["m"], [[P]])
    with pytest.raises(TypeError, match=r"^cov: wanted SymPy expressions, got the string 'P'"):
        expectation(x, [x], [m], [["P"]])
    told = r"^no closed form in symbols for sqrt\(.*\): the mean of a norm is an integral; expect"
    with pytest.raises(NoClosedForm, match=told):
        expectation([x, sp.sqrt(x**2 + y**2)], [x, y], [0, 0], sp.eye(2))


@pytest.mark.parametrize(
    "f",
    [
        x**2 * y - 3 * y + 1,
        x * sp.sin(x - 2 * y + 1) * sp.exp(y / 3),
        (x + y) * sp.exp(-(x**2) / 2 - x * y / 3 + y),
        x * sp.cos(x * y / 2 + y),
        sp.sin(x**2 / 3 - y**2 / 2 + x * y) * y,
        sp.exp(-(x**2) / 3) * sp.cos(x * y / 2),
        x**2 * y * sp.Heaviside(x - 2 * y + 1, 0),
        abs(x + y) * sp.exp(y / 2 - x**2 / 4),
        sp.Heaviside(y, 0) * sp.cos(x - y),
        x * y * sp.erf(x - y / 2 + 1),
        sp.erfc(x) * sp.exp(x / 2 - y**2 / 3),
    ],
    ids=str,
)
def test_a_formula_and_the_numbers_of_the_function_agree(f):
    """Two routes: a recursion of symbols, and NumPy's linear algebra."""
    exact = [sp.Rational(2, 5), -sp.Rational(7, 10)], sp.Matrix(COV).applyfunc(sp.nsimplify)
    formula = expectation(f, VARIABLES, *exact)
    assert complex(formula.evalf(17)).imag == pytest.approx(0.0, abs=1e-14)
    assert complex(formula.evalf(17)).real == pytest.approx(mean(f), rel=1e-12)


def test_the_probabilities_of_a_formula_are_error_functions():
    """`expectation` writes SymPy's own erf, in every component of a vector."""
    m, P = sp.symbols("m P", real=True)
    one = expectation(sp.Heaviside(x), [x], [m], [[P]])
    assert one == (1 + sp.erf(m / sp.sqrt(P) / sp.sqrt(2))) / 2
    assert expectation([sp.Heaviside(x), x], [x], [m], [[P]]) == sp.Matrix([one, m])


# Classes


ROUND = sp.sqrt(x**2 + y**2 + 1)
BELL = sp.exp(-(x**2))


@pytest.mark.parametrize(
    ("f", "kind"),
    [
        ([sp.S.Zero, x**3], "polynomial"),
        ([x, sp.sin(y)], "exponential-polynomial"),
        ([sp.cos(x), BELL], "tilt"),
        (abs(x), "piecewise"),
        ([sp.Heaviside(x, 0), sp.Heaviside(x, 1), abs(x)], "piecewise"),
        ([abs(x), abs(y)], "mixed"),
        ([abs(x), sp.sin(x)], "mixed"),
        (abs(x) * BELL, "mixed"),
        (sp.erf(x), "mixed"),
        (ROUND, "norm"),
        (3 - 2 * ROUND, "norm"),
        (ROUND + x, "mixed"),
        (ROUND + BELL, "mixed"),
        (ROUND + abs(x), "mixed"),
        (ROUND + sp.sqrt(x**2 + y**2 + 2), "mixed"),
        ([ROUND, ROUND], "mixed"),
        ([ROUND, sp.S.One], "mixed"),
        (ROUND * x, "none"),
        ([x, sp.tan(y)], "none"),
    ],
    ids=str,
)
def test_classes_of_sums_and_lists(f, kind):
    assert classify(f, VARIABLES) == kind
    if kind != "none":
        assert class_of(parse(f, VARIABLES)) == kind
        assert expectation_function(f, VARIABLES).kind == kind


def test_half_spaces_and_their_opposites():
    plane = Plane((sp.S(1), sp.S(-2)), sp.S(3), sp.Rational(1, 4))
    assert opposite(plane) == Plane((-1, 2), -3, sp.Rational(3, 4), False)
    assert opposite(opposite(plane)) == plane
    assert opposite(plane._replace(blurred=True)).blurred
    assert plane.place == plane._replace(edge=sp.S.One).place
    assert plane.place != plane._replace(blurred=True).place


def test_quadratic_polynomials_as_gram_matrices():
    poly = sp.Poly(3 * x**2 - 4 * x * y + 5 * y**2 + 6 * x - 8 * y + 7, x, y)
    assert quadratic_gram(poly) == sp.Matrix([[7, 3, -4], [3, 3, -2], [-4, -2, 5]])
    assert is_semidefinite(sp.diag(0, 2))
    assert is_semidefinite(sp.zeros(2, 2))
    assert is_semidefinite(sp.diag(1, -sp.Rational(1, 10**13)))
    assert not is_semidefinite(sp.diag(1, -sp.Rational(1, 10**11)))
    assert not is_semidefinite(sp.diag(-1, -2))
    assert not is_semidefinite(sp.diag(1, sp.Symbol("a", positive=True)))
