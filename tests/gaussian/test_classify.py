"""Which functions have closed means, and how: classes of sums and lists, and what has none."""

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import (
    FunctionClass,
    NoClosedForm,
    classify,
    expectation,
    expectation_function,
    mean_square_errors,
)

x, y = sp.symbols("x y", real=True)
u, v = sp.symbols("u v")
BELL, ROUND = sp.exp(-(x**2)), sp.sqrt(x**2 + y**2 + 1)


@pytest.mark.parametrize(
    ("f", "kind"),
    [
        (sp.Integer(2), "polynomial"),
        ([sp.S.Zero, x**3], "polynomial"),
        (x**2.0 * y, "polynomial"),
        (abs(x) ** 4, "polynomial"),
        ([x, sp.sin(y)], "exponential-polynomial"),
        (sp.exp(x) * sp.cos(y) * x, "exponential-polynomial"),
        (sp.exp(-x * y), "tilt"),
        ([sp.cos(x), BELL], "tilt"),
        (abs(x - 2) * y, "piecewise"),
        (sp.Max(x, y), "piecewise"),
        ([abs(x - 1), sp.Max(x, 1), y], "piecewise"),
        ([sp.Min(x, y), sp.Max(x, y)], "piecewise"),
        ([sp.Heaviside(x, 0), sp.Heaviside(x, 1), abs(x)], "piecewise"),
        (3 - 2 * ROUND, "norm"),
        ([abs(x), abs(y)], "mixed"),
        ([sp.Min(x, y), sp.Max(x, 0)], "mixed"),
        ([abs(x), sp.sin(x)], "mixed"),
        (abs(x) * BELL, "mixed"),
        (sp.erf(x), "mixed"),
        (ROUND + x, "mixed"),
        (ROUND + BELL, "mixed"),
        (ROUND + abs(x), "mixed"),
        (ROUND + sp.sqrt(x**2 + y**2 + 2), "mixed"),
        ([ROUND, ROUND], "mixed"),
        ([ROUND, sp.S.One], "mixed"),
        ([x, sp.tan(y)], "none"),
    ],
    ids=str,
)
def test_class_of_a_function(f, kind):
    assert classify(f, [x, y]) == kind
    if kind != "none":
        assert expectation_function(f, [x, y]).kind is FunctionClass(kind)
    if kind == "mixed":
        with pytest.raises(NoClosedForm):
            mean_square_errors(f, [x, y])


@pytest.mark.parametrize(
    "f",
    [
        u + sp.tanh(v),
        sp.atan(u),
        sp.log(u),
        1 / u,
        u**u,
        sp.sqrt(u * v),
        sp.Max(u, v, 1),
        sp.sqrt(u**2 - v**2),
        sp.sqrt(u**4 + 1),
        sp.sqrt(u**3 + v**2),
        (u**2 + v**2) ** sp.Rational(3, 2),
        (u**2 + v**2) ** 0.25,
        sp.exp(u**3),
        3 ** (u**3),
        sp.sin(u * v**2),
        sp.exp(sp.sin(u)),
        sp.exp(abs(u) - abs(v)),
        sp.exp(sp.Heaviside(u) * v**3),
        sp.cos(sp.erf(u)),
        sp.cos(sp.sqrt(u**2 + v**2)),
        abs(u * v),
        sp.Heaviside(sp.sin(u)),
        sp.Max(u**2, v),
        sp.erf(u**2),
        abs(u) * sp.sign(v),
        sp.Heaviside(u, 0.5) * sp.Heaviside(v, 0.5),
        sp.erf(u) * abs(v),
        sp.erf(u) * sp.sign(u),
        sp.erf(u) ** 2,
        sp.sqrt(u**2 + 1) * sp.sqrt(v**2 + 1),
        sp.sqrt(u**2 + v**2) * u,
        sp.sqrt(u**2 + 1) * sp.exp(v),
        sp.sqrt(u**2 + 1) * abs(v),
        sp.Piecewise((u, v > 0)),
        sp.Piecewise((u, (u > 0) & (v > 0)), (0, True)),
        sp.Piecewise((u, u * v > 1), (0, True)),
        sp.Piecewise((u, sp.Eq(v, 0)), (0, True)),
    ],
    ids=str,
)
def test_function_without_a_closed_form(f):
    assert classify(f, [u, v]) is FunctionClass.NONE
    for call in (
        lambda: expectation_function(f, [u, v]),
        lambda: expectation(f, [u, v], [0, 0], sp.eye(2)),
        lambda: mean_square_errors(f, [u, v]),
    ):
        with pytest.raises(NoClosedForm, match="no closed form"):
            call()


def test_refusal_names_the_term_in_the_symbols_of_the_caller():
    with pytest.raises(NoClosedForm, match=r"tanh\(v\)"):
        expectation_function(u**2 + sp.sin(u) + sp.tanh(v), [u, v])


def test_norm_has_numbers_and_no_formula():
    assert expectation_function(ROUND, [x, y])([0.0, 0.0], np.zeros((2, 2))) == 1.0
    with pytest.raises(NoClosedForm, match="norm"):
        expectation([x, ROUND], [x, y], [0, 0], sp.eye(2))


def test_square_that_is_semidefinite_for_some_parameters_only():
    a, b = sp.Symbol("a"), sp.Symbol("b", positive=True)
    for square, parameter in ((a * x**2 + y**2, a), (x**2 - b * y**2, b)):
        with pytest.raises(NoClosedForm):
            expectation(sp.sqrt(square), [x, y], [0, 0], sp.eye(2), parameters=[parameter])
