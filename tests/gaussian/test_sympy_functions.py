"""Functions added to SymPy: differences of exponentials, and the normal distribution."""

from math import factorial

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.special import ndtr
from sympy.codegen.cfunctions import expm1

from seedslib.gaussian.means.exp_difference import ExpDifference, exp_difference
from seedslib.gaussian.means.normal_cdf import NormalCDF, Spread, TiltedTail, tilted_tail
from seedslib.models.codegen import compile_components

u, v, t = sp.symbols("u v t", real=True)
plus, minus = sp.Symbol("p", nonnegative=True), sp.Symbol("n", nonpositive=True)


def test_a_difference_of_exponentials_has_the_digits_of_its_gap():
    first = np.array([1.0, 0.5, 2.0, -3.0, 700.0, -800.0, 0.3])
    gap = np.array([1e-20, -1e-9, 1.5, -40.0, 1400.0, -1e-300, 0.0])
    found = exp_difference(first, first - gap, gap)
    with mp.workdps(400):
        exact = [mp.exp(a) * -mp.expm1(-mp.mpf(g)) for a, g in zip(first, gap, strict=True)]
    assert_allclose(found, np.array(exact, dtype=float), rtol=1e-15)
    # the larger of the two alone is computed: nothing overflows on the way
    assert exp_difference(-5000.0, 700.0, -5700.0) == -np.exp(700.0)
    assert exp_difference(-5000.0, -4000.0, -1000.0) == 0.0


def test_a_difference_of_exponentials_of_numbers_is_a_number():
    assert ExpDifference(u, v, 0) == 0
    assert ExpDifference(2, 1, 1) == sp.Float(np.exp(2.0) * -np.expm1(-1.0))
    assert float(ExpDifference(1, 2, -1)) == pytest.approx(np.e - np.e**2, rel=1e-15)
    # the gap is the one that is not found by subtraction
    assert float(ExpDifference(1, 1, sp.Float(1e-20))) == pytest.approx(
        np.e * 1e-20, rel=1e-15, abs=0
    )


def test_a_difference_of_exponentials_of_a_known_sign_is_written_with_expm1():
    assert ExpDifference(u, v, plus) == -sp.exp(u) * expm1(-plus)
    assert ExpDifference(u, v, minus) == sp.exp(v) * expm1(minus)
    assert ExpDifference(u, 2, sp.S(3)) == -sp.exp(u) * expm1(-3)
    assert ExpDifference(2, v, sp.S(-3)) == sp.exp(v) * expm1(-3)
    for unknown in (ExpDifference(u, v, u - v), ExpDifference(1, 2, t), ExpDifference(u, 1, t)):
        assert unknown.func is ExpDifference
        assert unknown.is_real
    with pytest.raises(TypeError, match="3 arguments"):
        ExpDifference(u, v)


def test_derivatives_of_a_difference_of_exponentials():
    whole = ExpDifference(t**2, 3 * t, t**2 - 3 * t)
    assert sp.expand(sp.diff(whole, t) - 2 * t * sp.exp(t**2) + 3 * sp.exp(3 * t)) == 0
    parts = [ExpDifference(u, v, t).fdiff(k) for k in (1, 2, 3)]
    assert parts == [sp.exp(u), -sp.exp(v), 0]


def test_code_of_a_difference_of_exponentials():
    code = compile_components([u, v], [ExpDifference(u, v, u - v)])
    at, beside = np.array([0.3, -2.0, 700.0]), np.array([0.3 + 2.0**-40, 1.0, 0.0])
    (found,) = code(at, beside)
    exact = np.exp(np.maximum(at, beside)) * -np.expm1(-abs(at - beside)) * np.sign(at - beside)
    assert_allclose(found, exact, rtol=1e-15)


def test_the_normal_distribution_function_stays_as_it_is():
    assert NormalCDF(0) == sp.S.Half
    assert NormalCDF(1).func is NormalCDF
    assert NormalCDF(u).args == (u,)
    assert NormalCDF(-u) + NormalCDF(u) != 1
    assert NormalCDF(u).is_real
    with pytest.raises(TypeError, match="1 argument"):
        NormalCDF(u, v)


def test_digits_and_derivative_of_the_normal_distribution_function():
    for z in (sp.Rational(-61, 2), sp.Rational(-1, 3), sp.S(2)):
        with mp.workdps(40):
            exact = mp.ncdf(mp.mpf(z.p) / z.q)
            assert abs(mp.mpf(NormalCDF(z).evalf(35)) / exact - 1) < mp.mpf(10) ** -33
    assert sp.diff(NormalCDF(3 * t), t) == 3 * sp.exp(-9 * t**2 / 2) / sp.sqrt(2 * sp.pi)
    assert NormalCDF(u).fdiff() == sp.diff(NormalCDF(u).rewrite(sp.erf), u)
    assert NormalCDF(u).rewrite(sp.erf) == (1 + sp.erf(u / sp.sqrt(2))) / 2


def test_code_of_the_normal_distribution_function_keeps_the_tail():
    z = np.array([-37.0, -8.0, -0.2, 0.0, 0.7, 9.0])
    (found,) = compile_components([u], [NormalCDF(u)])(z)
    assert_allclose(found, ndtr(z), rtol=1e-13)


def test_the_variance_of_a_switching_function_is_itself_where_it_is_positive():
    assert Spread(plus + 1, t, u) == plus + 1
    unknown = Spread(v, t, u)
    assert (unknown.func, unknown.is_positive) == (Spread, True)
    assert [unknown.fdiff(k) for k in (1, 2, 3)] == [1, 0, 0]
    assert sp.diff(Spread(v**2, t, u), v) == 2 * v
    assert Spread(v, t, u).subs({v: sp.Rational(1, 3)}).evalf(30) == sp.Rational(1, 3).evalf(30)
    assert unknown.rewrite("erf") == v


def test_a_known_side_has_a_variance_that_leaves_it_certain():
    """Where the variance counts as zero, the mean is a hundred deviations away or on the plane."""
    code = compile_components([v, t, u], [Spread(v, t, u)])
    variance = np.array([2.0, 1e-20, 1e-20, 0.0, 1e-9, 1e-9, -1e-25])
    least = np.array([1e-9] * 7)
    square = np.array([9.0, 9.0, 0.0, 1e308, 4.0, 1e-9, 25.0])
    (found,) = code(variance, least, square)
    assert_allclose(found, [2.0, 9e-4, 1.0, 1e300, 4e-4, 1.0 + 1e-13, 25e-4], rtol=1e-14)
    assert_allclose(np.sqrt(square / found)[[1, 4, 6]], 100.0, rtol=1e-14)


def one_sided(u, z, power):
    """``e^u E max(z + e, 0)^power`` by a parabolic cylinder function."""
    with mp.workdps(60):
        u, z = mp.mpf(u), mp.mpf(z)
        whole = mp.factorial(power) * mp.exp(u - z**2 / 4) * mp.pcfd(-power - 1, -z)
        return whole / mp.sqrt(2 * mp.pi)


@pytest.mark.parametrize("power", range(5))
def test_tilted_tails_are_those_of_the_integrals(power):
    z = np.array([-3000.0, -60.0, -16.0 - 2**-20, -16.0, -9.0, -1.0, 0.0, 2.5, 20.0])
    boundary = np.array([0.5, -300.0, 2.0, 2.0, 40.0, -3.0, 0.0, 1.0, -500.0])
    exponent = boundary + z**2 / 2
    found = tilted_tail(exponent, z, boundary, power)
    with mp.workdps(60):
        laws = [(b + mp.mpf(s) ** 2 / 2, s) for b, s in zip(boundary, z, strict=True)]
        exact = np.array([one_sided(*law, power) for law in laws], dtype=float)
    # before the series begins each power subtracts what agrees to one part in z^2
    square = np.where((z < 0) & (z >= -16), z**2, 1.0)
    loss = 2.5e-16 * square ** (power + 1) / factorial(power)
    assert (abs(found / exact - 1) < np.maximum(loss, 2e-15)).all()
    for k, law in enumerate(zip(exponent, z, boundary, strict=True)):
        assert tilted_tail(*map(float, law), power) == found[k]
        assert tilted_tail(*(np.array([part]) for part in law), power)[0] == found[k]
    code = compile_components([u, v, t], [TiltedTail(u, v, t, power)])
    assert_allclose(code(exponent, z, boundary)[0], found, rtol=1e-15)


def test_derivatives_and_digits_of_tilted_tails():
    for power in range(4):
        atom = TiltedTail(u, v, t, power)
        assert atom.is_real
        plain = TiltedTail(u, v, u - v**2 / 2, power).rewrite(sp.erf)
        own = {t: u - v**2 / 2}
        for symbol, number in ((u, 1), (v, 2)):
            slope = atom.fdiff(number).rewrite(sp.erf).subs(own)
            at = {u: sp.Rational(1, 3), v: sp.Rational(-7, 5)}
            gap = (slope - sp.diff(plain, symbol)).subs(at)
            assert abs(gap.evalf(30)) < 1e-28
        assert atom.fdiff(3) == 0
        at = {u: sp.S(800), v: sp.S(-40), t: sp.S(0)}
        with mp.workdps(40):
            digits = mp.mpf(atom.subs(at).evalf(35, maxn=400))
            lost = 40**2  # for each power
            gap = abs(digits / one_sided(800, -40, power) - 1)
            assert gap < mp.mpf(10) ** -33 * lost**power
    with pytest.raises(TypeError, match="4 arguments"):
        TiltedTail(u, v, t)
