"""Quadrature rules for Gaussian means: exactness, their points, means in batches."""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import cubature, expectation, fifth_degree, gauss_hermite, mean_of, unscented


def moment(powers):
    """Product of moments of independent standard normals: (k-1)!! for even k."""
    double = {0: 1, 1: 0, 2: 1, 3: 0, 4: 3, 5: 0, 6: 15, 7: 0, 8: 105, 9: 0}
    return float(np.prod([double[k] for k in powers]))


def powers_up_to(n, degree):
    """All monomials: as many factors as the degree, each of them a variable or one."""
    chosen = combinations_with_replacement(range(n + 1), degree)
    return [tuple(factors.count(k) for k in range(n)) for factors in chosen]


@pytest.mark.parametrize(
    ("kind", "arguments", "degree"),
    [
        (gauss_hermite, (1, 5), 9),
        (gauss_hermite, (3, 4), 7),
        (cubature, (4,), 3),
        (unscented, (3, 0.0), 3),
        (unscented, (3, 0.7), 3),
        (unscented, (4, -1.3), 3),
        (fifth_degree, (1,), 5),
        (fifth_degree, (2,), 5),
        (fifth_degree, (5,), 5),
        (fifth_degree, (8,), 5),
    ],
)
def test_rule_is_exact_to_its_degree_and_not_beyond(kind, arguments, degree):
    rule = kind(*arguments)
    n = arguments[0]
    assert rule.points.shape[0] == n

    def mean(powers):
        return rule.weights @ np.prod(rule.points ** np.array(powers)[:, None], axis=0)

    for powers in powers_up_to(n, degree if n < 5 else 5):
        assert mean(powers) == pytest.approx(moment(powers), abs=3e-12), powers
    if kind is not gauss_hermite and n > 1:
        beyond = (2, 2) if degree == 3 else (6, 0)
        assert mean(beyond + (0,) * (n - 2)) != pytest.approx(moment(beyond), rel=1e-3)


def test_points_of_the_rules():
    """Of a product the last axis runs fastest; then the centre, plus and minus, axis by axis."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    rule = gauss_hermite(2, 3)
    np.testing.assert_allclose(rule.points.T, [[a, b] for a in nodes for b in nodes], atol=1e-14)
    mass = weights / weights.sum()
    np.testing.assert_allclose(rule.weights, np.outer(mass, mass).ravel(), rtol=1e-13)
    root = np.sqrt(2.0)
    np.testing.assert_allclose(cubature(2).points, [[root, 0, -root, 0], [0, root, 0, -root]])
    for n, kappa in [(3, 0.7), (4, -1.3), (1, 2.0)]:
        rule = unscented(n, kappa)
        ends = np.sqrt(n + kappa) * np.eye(n)
        points = np.hstack([np.zeros((n, 1)), ends, -ends])
        np.testing.assert_allclose(rule.points, points, rtol=1e-15)
        weights = [kappa / (n + kappa), *[0.5 / (n + kappa)] * (2 * n)]
        np.testing.assert_allclose(rule.weights, weights, rtol=1e-15)
    rule = fifth_degree(2)
    third = np.sqrt(3.0) * np.array(
        [[0, 1, -1, 0, 0, 1, 1, -1, -1], [0, 0, 0, 1, -1, 1, -1, 1, -1]]
    )
    np.testing.assert_allclose(rule.points, third, rtol=1e-15)
    np.testing.assert_allclose(rule.weights, [4 / 9, *[1 / 9] * 4, *[1 / 36] * 4], rtol=1e-14)


@pytest.mark.parametrize("make", [lambda: gauss_hermite(2, 3), lambda: cubature(n=3)])
def test_rules_cannot_be_changed(make):
    for array in (make().points, make().weights):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


def test_mean_by_a_rule_without_symmetry():
    """Two points of unlike weights: they lie at mean + root times point, not minus."""
    points, weights = np.array([[-0.5, 2.0], [0.3, -1.2]]), np.array([0.8, 0.2])
    rule = replace(cubature(2), points=points, weights=weights)
    mean, root = np.array([0.7, -1.1]), np.array([[2.0, 0.0], [0.6, 1.5]])
    at = mean[:, None] + root @ points
    found = mean_of(lambda p: p[0] ** 3 + p[1], mean, root @ root.T, rule)
    assert found == pytest.approx(weights @ (at[0] ** 3 + at[1]), rel=1e-14)


def test_mean_of_a_quartic_of_a_correlated_dist_is_the_symbolic_one():
    x = sp.symbols("x0:3", real=True)
    f = x[0] ** 2 * x[1] * x[2] + 3 * x[2] ** 4 - x[0]
    mean, cov = [0.3, -1.0, 0.5], np.array([[1, 0.2, 0.1], [0.2, 0.5, -0.3], [0.1, -0.3, 0.8]])
    exact = float(expectation(f, x, mean, sp.Matrix(cov)))
    numeric = sp.lambdify(x, f)
    for rule in (gauss_hermite(3, 3), fifth_degree(3)):
        assert mean_of(lambda p: numeric(*p), mean, cov, rule) == pytest.approx(exact, rel=1e-13)
    flat = np.outer([1.0, 2.0], [1.0, 2.0])
    wave = mean_of(lambda p: np.cos(p[0] + p[1]), [0.1, 0.2], flat, gauss_hermite(2, 40))
    assert wave == pytest.approx(np.exp(-4.5) * np.cos(0.3), abs=1e-14)


def test_mean_of_a_vector_in_batches():
    """Batches of means, of covariances, and of both; fewer axes on either side."""
    rng = np.random.default_rng(0)
    mean = rng.normal(size=(2, 3, 4))
    scale = np.array([1.0, 0.0, 2.0, 0.5])
    cov = np.array([[1.0, 0.3], [0.3, 0.5]])
    rule = fifth_degree(2)

    def both(p):
        return np.stack([p[0] * p[1], p[0] ** 2])

    for means, covs, size in [
        (mean, cov, 1.0),
        (mean, cov[..., None] * scale, scale),
        (mean[:, 0, 0], cov[..., None] * scale, scale),
        (mean[:, 0], cov, 1.0),
    ]:
        found = mean_of(both, means, covs, rule)
        exact = np.stack([means[0] * means[1] + 0.3 * size, means[0] ** 2 + size + 0 * means[0]])
        np.testing.assert_allclose(found, exact, rtol=1e-13, atol=1e-13)
    assert isinstance(mean_of(lambda p: p[0], [0.5, -1.0], cov, rule), float)
