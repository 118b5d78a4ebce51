"""Stein-Isserlis recursion and heat operator against generating functions and quadrature."""

from itertools import product

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from seedslib.gaussian import gauss_hermite
from seedslib.gaussian.means.polynomial import (
    derivative,
    heat,
    monomial_means,
    polynomial_mean,
    polynomial_value,
    predecessors,
)


def random_law(rng, n):
    root = rng.normal(size=(n, n))
    return rng.normal(size=n), root @ root.T


def random_polynomial(rng, n, degree, size=1):
    indices = [a for a in product(range(degree + 1), repeat=n) if sum(a) <= degree]
    return {alpha: rng.normal(size=size) for alpha in indices}


@pytest.mark.parametrize(("n", "degree"), [(1, 12), (2, 6), (3, 4), (4, 3)])
def test_monomial_means_match_gauss_hermite(n, degree):
    rng = np.random.default_rng(n)
    indices = [a for a in product(range(degree + 1), repeat=n) if sum(a) <= degree]
    rule = gauss_hermite(n, degree // 2 + 1)
    for _ in range(3):
        mean, cov = random_law(rng, n)
        points = mean[:, None] + np.linalg.cholesky(cov) @ rule.points
        means = monomial_means(indices, mean, cov)
        for alpha in indices:
            values = np.prod(points ** np.array(alpha)[:, None], axis=0)
            bound = 1e-12 * (rule.weights @ np.abs(values))
            assert abs(means[alpha] - rule.weights @ values) <= bound + 1e-13


def test_symbols_and_numbers_go_through_the_same_recursion():
    m, s = sp.symbols("m0:2"), sp.symbols("s0:3")
    cov = [[s[0], s[1]], [s[1], s[2]]]
    indices = [(3, 2), (0, 4), (2, 1)]
    formulas = monomial_means(indices, m, cov, zeroth=sp.S.One, tidy=sp.expand)
    values = dict(zip((*m, *s), (0.3, -1.2, 0.9, 0.4, 1.1), strict=True))
    numbers = monomial_means(indices, np.array([0.3, -1.2]), np.array([[0.9, 0.4], [0.4, 1.1]]))
    for alpha in indices:
        assert_allclose(float(formulas[alpha].subs(values)), numbers[alpha], rtol=1e-13)


def test_singular_and_zero_covariances_are_exact():
    direction = np.array([1.0, -2.0])
    means = monomial_means([(2, 2), (1, 3)], np.array([0.5, 0.25]), np.outer(direction, direction))
    # x = (0.5 + t, 0.25 - 2 t) with a standard normal t
    t = sp.Symbol("t")
    for (i, j), value in means.items():
        moments = sp.Poly((sp.Rational(1, 2) + t) ** i * (sp.Rational(1, 4) - 2 * t) ** j, t)
        exact = sum(c * (sp.factorial2(k - 1) if k % 2 == 0 else 0) for (k,), c in moments.terms())
        assert_allclose(value, float(exact), rtol=1e-14)
    point = monomial_means([(3, 1)], np.array([2.0, 5.0]), np.zeros((2, 2)))
    assert point[3, 1] == 40.0


def test_high_degree_keeps_relative_accuracy():
    with mp.workdps(50):
        mean, var = mp.mpf("0.25"), mp.mpf("3.5")
        exact = mp.fsum(
            mp.binomial(40, 2 * k) * mean ** (40 - 2 * k) * var**k * mp.fac2(2 * k - 1)
            for k in range(21)
        )
        computed = monomial_means([(40,)], np.array([0.25]), np.array([[3.5]]))[40,]
        assert abs(computed / exact - 1) < 1e-14


def test_batches_equal_single_evaluations():
    rng = np.random.default_rng(4)
    polynomial = random_polynomial(rng, 3, 4, size=2)
    means, roots = rng.normal(size=(3, 5)), rng.normal(size=(3, 3, 5))
    covs = np.einsum("ik...,jk...->ij...", roots, roots)
    table = monomial_means(tuple(polynomial), means, covs)
    together = polynomial_mean(polynomial, table, (5,))
    for k in range(5):
        one = monomial_means(tuple(polynomial), means[:, k], covs[..., k])
        assert_allclose(together[:, k], polynomial_mean(polynomial, one, ()), rtol=1e-12)


@pytest.mark.parametrize(("n", "degree"), [(1, 9), (2, 5), (3, 4)])
def test_heat_operator_gives_the_mean(n, degree):
    rng = np.random.default_rng(10 + n)
    polynomial = random_polynomial(rng, n, degree, size=2)
    mean, cov = random_law(rng, n)
    by_recursion = polynomial_mean(polynomial, monomial_means(tuple(polynomial), mean, cov), ())
    assert_allclose(polynomial_value(heat(polynomial, cov), mean, 2), by_recursion, rtol=1e-11)
    # without its first term: the mean minus the value, for a small covariance to full accuracy
    small = 1e-12 * cov
    gap = polynomial_value(heat(polynomial, small, first=1), mean, 2)
    laplacian = sum(
        0.5 * cov[i, j] * polynomial_value(derivative(derivative(polynomial, i), j), mean, 2)
        for i in range(n)
        for j in range(n)
    )
    assert_allclose(gap, 1e-12 * laplacian, rtol=1e-9)


def test_heat_operator_in_symbols():
    m, P = sp.symbols("m P")
    image = heat({(6,): sp.S.One}, [[P]])
    formula = sum(c * m**k for (k,), c in image.items())
    assert sp.expand(formula - (m**6 + 15 * P * m**4 + 45 * P**2 * m**2 + 15 * P**3)) == 0
    # composition: variances add
    twice = heat(heat({(5,): sp.S.One}, [[P]]), [[2 * P]])
    once = heat({(5,): sp.S.One}, [[3 * P]])
    assert all(sp.expand(twice[a] - once[a]) == 0 for a in once)


def test_empty_and_constant_polynomials():
    assert monomial_means([], np.zeros(2), np.eye(2)) == {}
    assert predecessors([]) == ()
    assert heat({}, np.eye(2)) == {}
    assert heat({(0, 0): np.ones(1)}, np.eye(2), first=1) == {}
    assert not polynomial_value({}, np.zeros((2, 7)), 3).any()
    assert polynomial_value({}, np.zeros((2, 7)), 3).shape == (3, 7)
    constant = {(0, 0): np.array([2.0])}
    assert_allclose(polynomial_value(constant, np.zeros((2, 4)), 1), np.full((1, 4), 2.0))


def test_indices_that_a_recursion_visits_are_those_of_its_moments():
    wanted = [(2, 1), (0, 3)]
    found = predecessors(wanted)
    assert len(set(found)) == len(found)
    assert set(found) == set(monomial_means(wanted, [1.0, 2.0], np.eye(2).tolist()))


def test_few_indices_are_visited_beside_the_wanted_ones():
    """The smallest exponent is lowered first, so that the powers of one variable are shared."""
    assert predecessors([(3,)]) == ((0,), (1,), (2,), (3,))
    assert predecessors([(0, 0)]) == ((0, 0),)
    assert set(predecessors([(5, 1)])) == {(5, 1), *((k, 0) for k in range(6))}
    assert set(predecessors([(1, 2, 0)])) == {(1, 2, 0), (0, 2, 0), (0, 1, 0), (0, 0, 0)}
    degrees = [sum(index) for index in predecessors([(2, 3), (4, 0)])]
    assert degrees == sorted(degrees)


def test_moments_of_half_a_normal_law():
    """Mass 1/2 and a boundary at the mean: M_1 = phi(0), M_2 = 1/2, M_3 = 2 phi(0)."""
    bell = 1 / np.sqrt(2 * np.pi)
    edge = ([2.0], {(0,): bell / 2, (1,): 0.0, (2,): 0.0})
    means = monomial_means([(3,)], [0.0], [[4.0]], zeroth=0.5, boundary=edge)
    wanted = {(0,): 0.5, (1,): 2 * bell / 2, (2,): 4 * 0.5, (3,): 8 * bell}
    assert means.keys() == wanted.keys()
    assert [means[k] for k in wanted] == pytest.approx(list(wanted.values()), rel=1e-15)


def test_derivatives_and_values_of_a_polynomial_map():
    """(x² y + 3, 2 y² - x) and its partial derivatives (2 x y, -1) and (x², 4 y)."""
    polynomial = {
        (2, 1): np.array([1.0, 0.0]), (0, 0): np.array([3.0, 0.0]),
        (0, 2): np.array([0.0, 2.0]), (1, 0): np.array([0.0, -1.0]),
    }  # fmt: skip
    x, y = point = np.array([[0.5, -2.0, 3.0], [1.5, 0.0, -1.0]])
    assert_allclose(polynomial_value(polynomial, point, 2), [x**2 * y + 3, 2 * y**2 - x])
    along = [derivative(polynomial, axis) for axis in (0, 1)]
    assert_allclose(polynomial_value(along[0], point, 2), [2 * x * y, -1 + 0 * x])
    assert_allclose(polynomial_value(along[1], point, 2), [x**2, 4 * y])
    assert (0, 0) not in along[1]
    turned = polynomial_value({(1, 0): np.array([1j, 0.0])}, point, 2)
    assert turned.tolist() == [(1j * x).tolist(), [0, 0, 0]]
    complex_means = polynomial_mean({(1,): np.array([2.0])}, {(1,): np.array([1j, 3.0])}, (2,))
    assert complex_means.tolist() == [[2j, 6.0]]


def test_powers_of_the_heat_operator_that_are_left_out():
    """x⁴ under variance P: x⁴, then 6 P x², then 3 P²; 2 x y³ with a covariance c as well."""
    P, c = sp.symbols("P c")
    parts = {0: {(4,): 1, (2,): 6 * P, (0,): 3 * P**2}, 1: {(2,): 6 * P, (0,): 3 * P**2},
             2: {(0,): 3 * P**2}, 3: {}}  # fmt: skip
    for first, wanted in parts.items():
        assert heat({(4,): sp.S.One}, [[P]], first=first) == wanted
    assert heat({(1, 3): sp.S(2)}, [[7, c], [c, P]], first=1) == {
        (1, 1): 6 * P, (0, 2): 6 * c, (0, 0): 6 * P * c,
    }  # fmt: skip
