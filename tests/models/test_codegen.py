import inspect

import numpy as np
import pytest
import sympy

from seedslib.base.symbols import real_part
from seedslib.models.codegen import (
    as_expressions,
    compile_array,
    compile_components,
    stack,
)

x, y, t = sympy.symbols("x y t")


def test_agrees_with_sympy_on_numbers():
    expressions = [
        x**2 * y + x**4 + 1 / (x**2 + 1) ** 3,
        sympy.sqrt(x) * sympy.exp(-(x**2) / 2) / sympy.sqrt(y),
        sympy.erf(x) + x**-2 + x ** sympy.Rational(3, 2),
        sympy.pi**2 / 100 * x + t,
        sympy.Rational(1, 3),
    ]
    function = compile_components([t, (x, y)], expressions)
    values = {t: 0.3, x: 1.7, y: 0.4}
    got = function(0.3, [np.array([1.7]), np.array([0.4])])
    for a, b in zip(got, expressions, strict=True):
        np.testing.assert_allclose(a, float(b.subs(values)), rtol=1e-14)


def test_powers_are_products_and_constants_are_folded():
    source = inspect.getsource(
        compile_components([(x,)], [sympy.pi**2 * x**5 / 100, 1 / x**2, 1 / sympy.sqrt(x)])
    )
    assert "**" not in source
    assert "pi" not in source


@pytest.mark.parametrize("kind", [sympy.Symbol, sympy.Dummy])
def test_powers_give_the_same_bits_as_products(kind):
    values = np.random.default_rng(0).standard_normal(1000)
    s = kind("s", real=True)
    (cube,) = compile_components([(s,)], [s**3])([values])
    np.testing.assert_array_equal(cube, values * values * values)


def test_array_has_components_first_and_batch_last():
    function = compile_array([t, (x, y)], [[x, 1], [0, x * y]])
    assert function(0.0, np.ones(2)).shape == (2, 2)
    assert function(0.0, np.ones((2, 3, 4))).shape == (2, 2, 3, 4)
    # one component may be common to the batch of the other
    assert function(0.0, [np.ones(3), 2.0])[1, 1].tolist() == [2.0] * 3


def test_constants_are_spread_only_where_an_array_is_asked_for():
    assert compile_components([(x,)], [sympy.Integer(2)])([np.ones(4)]) == [2]
    assert compile_array([(x,)], [2])(np.ones((1, 4))).shape == (1, 4)
    assert stack([1.0, 2.0], (2,)).shape == (2,)
    assert compile_array([(x,)], x)(np.ones((1, 4))).shape == (4,)


def test_unknown_symbols_are_named():
    with pytest.raises(ValueError, match="got y"):
        compile_components([t, (x,)], [x + y])


@pytest.mark.parametrize("bad", [["x +"], [[x], [x, y]], [object()], [None]])
def test_what_is_no_expression_is_refused(bad):
    with pytest.raises(TypeError, match="sensor: wanted SymPy expressions"):
        as_expressions("sensor", bad)


def test_real_part_of_conjugate_sums():
    m, p = sympy.symbols("m p", real=True)
    wave = sympy.exp(-p + sympy.I * m / (p + 4))
    expression = (1 + sympy.I * m) * wave + (1 - sympy.I * m) * wave.subs(sympy.I, -sympy.I)
    expression = expression + (m + sympy.I * p) ** 3 + 1 / (1 + sympy.I * p)
    got = real_part(expression)
    assert not got.has(sympy.I)
    values = {m: 0.7, p: 1.3}
    want = complex(expression.subs(values).evalf()).real
    np.testing.assert_allclose(float(got.subs(values)), want, rtol=1e-14)
