"""Functions that vanish on one side of a plane: their tails, their kinks, their errors."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from seedslib.gaussian import (
    FunctionClass,
    classify,
    expectation,
    expectation_function,
    mean_square_errors,
)
from seedslib.gaussian.means.classes import PLAIN, Key, Plane, folded
from seedslib.gaussian.means.covariance import covariance_expression

x, y, m, P = sp.symbols("x y m P", real=True)
ONE_SIDED = (
    sp.Min(x, 0),
    sp.Min(x, 0) ** 2,
    sp.Heaviside(-x, 1),
    x**3 * sp.Heaviside(-x) ** 2,
    sp.Piecewise((x**2, x < 0), (0, True)),
    sp.Piecewise((sp.exp(x), x <= 0), (0, True)),
    sp.Piecewise((x * sp.cos(x), x < 0), (0, True)),
)
SIDES = np.array([[0.5, -0.5], [0.5, 0.5]])  # the smaller and the larger of x, 0 from x and |x|


def tail(f, mean):
    """Mean of f under N(mean, 1) over x < 0 in fifty digits, the panels as the tail falls."""
    with mp.workdps(50):
        value = sp.lambdify(x, f, "mpmath")
        stops = [-mp.mpf(k) / mean for k in (150, 80, 40, 20, 10, 5, 2, 1, 0.5, 0)]
        inside = mp.quad(lambda u: value(u) * mp.exp(u * (mean - u / 2)), stops)
        return float(inside * mp.npdf(mean, 0, 1))


@pytest.mark.parametrize("f", ONE_SIDED, ids=str)
@pytest.mark.parametrize("mean", [1.0, 9.0, 25.0])
def test_the_mean_of_a_tail_keeps_its_digits(f, mean):
    found = expectation_function(f, [x])([mean], [[1.0]])
    # the recursion over powers subtracts what agrees in mean^2 for each power
    power = 1e-15 * (3 * mean**2) ** 3
    assert found == pytest.approx(tail(f, mean), rel=max(power, 1e-12), abs=0)
    formula = expectation(f, [x], [m], sp.Matrix([[P]])).subs({m: int(mean), P: 1})
    digits = complex(formula.evalf(30, maxn=600))
    assert digits == pytest.approx(tail(f, mean), rel=1e-12, abs=0)


@pytest.mark.parametrize("mean", [0.5, 9.0])
def test_the_covariance_of_tails_keeps_its_digits(mean):
    low, high = sp.Min(x, 0), sp.Max(x, 0)
    found = {
        other: float(
            covariance_expression(low, other, [x], [m], sp.Matrix([[P]]))
            .subs({m: sp.nsimplify(mean), P: 1})
            .evalf(30)
        )
        for other in (low, high)
    }
    small = tail(low, mean)
    assert found[low] == pytest.approx(tail(low**2, mean) - small**2, rel=1e-12, abs=0)
    # one of the two is always zero
    large = mean - small
    assert found[high] == pytest.approx(-small * large, rel=1e-12, abs=0)


@pytest.mark.parametrize(
    "f",
    [
        sp.exp(sp.Abs(x)) * sp.cosh(sp.Abs(x)),
        sp.exp(-sp.Abs(x)) * sp.cos(sp.Abs(x)),
        sp.exp(-sp.Abs(x - 2)) * sp.exp(-3 * sp.Abs(x - 2) + x),
        sp.exp(3 * sp.Abs(x)) + sp.exp(-sp.Abs(x)) * sp.sign(x),
        sp.Min(x, 0) * sp.exp(sp.Abs(x)) + sp.Heaviside(-x, sp.Rational(1, 3)),
    ],
    ids=str,
)
@pytest.mark.parametrize("place", [0, 2, -1])
def test_a_known_state_at_the_kink_has_the_value_there(f, place):
    want = float(f.subs(x, place))
    found = expectation_function(f, [x])([float(place)], [[0.0]])
    assert found == pytest.approx(want, rel=1e-14)


def test_a_kink_of_two_variables_where_the_state_is_known():
    gap = sp.Abs(x - 2 * y + 1)
    found = expectation_function(sp.exp(gap) * sp.cos(gap), [x, y])([1.0, 1.0], np.zeros((2, 2)))
    assert found == pytest.approx(1.0, rel=1e-15)


def test_errors_of_both_sides_of_a_plane_at_once():
    """The smaller and the larger of x and 0 are sums of x and |x|, which have one side only."""
    law = [0.3], [[1.2]], [[0.4]]
    both = mean_square_errors([sp.Min(x, 0), sp.Max(x, 0)], [x])
    assert both.kind is FunctionClass.PIECEWISE
    apart = mean_square_errors([x, sp.Abs(x)], [x])(*law)
    for found, given in zip(both(*law), apart, strict=True):
        assert_allclose(found, SIDES @ given @ SIDES.T, rtol=1e-9)
    assert mean_square_errors(sp.Min(x, 0), [x])(*law).optimal == pytest.approx(
        both(*law).optimal[0, 0], rel=1e-9
    )
    # a jump: the value on the plane is that of neither side
    jump = sp.Heaviside(-x, sp.Rational(1, 4))
    two = mean_square_errors([jump, sp.Heaviside(x, sp.Rational(3, 4))], [x])([0.0], *law[1:])
    assert_allclose(two.optimal, two.optimal[0, 0] * np.array([[1, -1], [-1, 1]]), rtol=1e-9)


def test_both_sides_of_a_plane_are_one_plane():
    assert classify([sp.Min(x, y), sp.Max(x, y)], [x, y]) is FunctionClass.PIECEWISE
    assert classify([sp.Min(x, y), sp.Max(x, 0)], [x, y]) is FunctionClass.MIXED


def test_sides_whose_boundaries_differ_are_turned_together():
    plane = Plane((sp.S(1),), sp.S(3), sp.S.Half)
    once, twice = plane, plane._replace(edge=sp.Rational(1, 4))
    poly = sp.Poly(x**2, x)
    given = {PLAIN: poly, Key(plane=once): -2 * poly, Key(plane=twice): poly}
    turned = Plane((sp.S(-1),), sp.S(-3), sp.S.Half)
    assert folded(given) == {
        Key(plane=turned): 2 * poly,
        Key(plane=turned._replace(edge=sp.Rational(3, 4))): -poly,
    }
