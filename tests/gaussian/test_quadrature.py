from itertools import combinations_with_replacement

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import (
    cubature,
    expectation,
    fifth_degree,
    gauss_hermite,
    mean_of,
    quadrature,
    unscented,
)
from seedslib.gaussian.quadrature import Rule, points_of, rule_of_rank


def moment(powers):
    """Product of moments of independent standard normals: (k-1)!! for even k."""
    double = {0: 1, 1: 0, 2: 1, 3: 0, 4: 3, 5: 0, 6: 15, 7: 0, 8: 105, 9: 0}
    return float(np.prod([double[k] for k in powers]))


def powers_up_to(n, degree):
    """All monomials: as many factors as the degree, each of them a variable or one."""
    chosen = combinations_with_replacement(range(n + 1), degree)
    return [tuple(factors.count(k) for k in range(n)) for factors in chosen]


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [(gauss_hermite, (1, 5)), (gauss_hermite, (3, 4)), (cubature, (4,)), (unscented, (3, 0.0)),
     (unscented, (2, 1.0)), (unscented, (3, 0.7)), (unscented, (4, -1.3)), (fifth_degree, (1,)),
     (fifth_degree, (2,)), (fifth_degree, (5,)), (fifth_degree, (8,))],
)  # fmt: skip
def test_rules_are_exact_to_their_degree(kind, arguments):
    rule = kind.__wrapped__(*arguments)
    n = rule.points.shape[0]
    assert n == arguments[0]
    assert rule.weights.sum() == pytest.approx(1.0, abs=1e-14)
    for powers in powers_up_to(n, min(rule.degree, 7 if n < 5 else 5)):
        value = rule.weights @ np.prod(rule.points ** np.array(powers)[:, None], axis=0)
        assert value == pytest.approx(moment(powers), abs=3e-12), powers


@pytest.mark.parametrize(("n", "kappa"), [(3, 0.7), (4, -1.3), (1, 2.0)])
def test_sigma_points(n, kappa):
    """The centre, then both ends of each axis at distance sqrt(n + kappa)."""
    rule = unscented.__wrapped__(n, kappa)
    assert rule.degree == 3
    ends = np.sqrt(n + kappa) * np.eye(n)
    np.testing.assert_allclose(rule.points, np.hstack([np.zeros((n, 1)), ends, -ends]), rtol=1e-15)
    weights = [kappa / (n + kappa), *[0.5 / (n + kappa)] * (2 * n)]
    np.testing.assert_allclose(rule.weights, weights, rtol=1e-15)
    fourth = rule.weights @ rule.points[0] ** 4
    assert fourth == pytest.approx(n + kappa, rel=1e-14)  # 3 where kappa = 3 - n
    for bad in (-n, -n - 0.5):
        with pytest.raises(ValueError, match=f"kappa: wanted a number above -{n}, got "):
            unscented(n, float(bad))
    with pytest.raises(ValueError, match="kappa: wanted finite numbers, got inf"):
        unscented(n, np.inf)


def test_points_of_a_rule_that_is_not_symmetric():
    """A rule of two points of unlike weights: they lie at mean + root times point, not minus."""
    rule = Rule(np.array([[-0.5, 2.0], [0.3, -1.2]]), np.array([0.8, 0.2]), 1)
    mean, root = np.array([0.7, -1.1]), np.array([[2.0, 0.0], [0.6, 1.5]])
    found = points_of(mean, root @ root.T, rule)
    np.testing.assert_allclose(found, mean[:, None] + root @ rule.points, rtol=1e-14)
    cubic = mean_of(lambda p: p[0] ** 3 + p[1], mean, root @ root.T, rule)
    assert cubic == pytest.approx(rule.weights @ (found[0] ** 3 + found[1]), rel=1e-14)
    many = np.stack([root @ root.T, 4.0 * root @ root.T], axis=-1)
    found = points_of(mean, many, rule)
    assert found.shape == (2, 2, 2)
    np.testing.assert_allclose(found[..., 1], mean[:, None] + 2.0 * root @ rule.points, rtol=1e-14)
    with pytest.raises(ValueError, match="rule: wanted a rule for 3 variables, got 2"):
        points_of(np.zeros(3), np.eye(3), rule)


def test_points_of_a_rank():
    points, weights = rule_of_rank(0, 5)
    assert points.shape == (0, 1)
    assert weights.tolist() == [1.0]
    points, weights = rule_of_rank(1, 4)
    assert points.shape == (1, 4)
    assert weights @ points[0] ** 6 == pytest.approx(15.0, rel=1e-13)


def test_rules_are_not_exact_beyond_their_degree():
    quartic = cubature(3)
    assert quartic.weights @ quartic.points[0] ** 4 == pytest.approx(3.0)
    assert quartic.weights @ (quartic.points[0] * quartic.points[1]) ** 2 == 0.0  # truth: 1
    fourth = unscented(3, 0.0).weights @ unscented(3, 0.0).points[0] ** 4
    assert fourth == pytest.approx(3.0)
    assert fifth_degree(2).weights @ fifth_degree(2).points[0] ** 6 == pytest.approx(9.0)  # 15


def test_sizes():
    assert gauss_hermite(3, 20).points.shape == (3, 8000)
    assert fifth_degree(6).points.shape == (6, 73)
    assert cubature(7).points.shape == (7, 14)
    assert fifth_degree(5).weights.min() < 0
    assert gauss_hermite(1, 200).weights.min() >= 0


def test_quartic_of_a_correlated_law_against_the_symbolic_mean():
    x = sp.symbols("x0:3", real=True)
    f = x[0] ** 2 * x[1] * x[2] + 3 * x[2] ** 4 - x[0]
    mean, cov = [0.3, -1.0, 0.5], np.array([[1, 0.2, 0.1], [0.2, 0.5, -0.3], [0.1, -0.3, 0.8]])
    exact = float(expectation(f, x, mean, sp.Matrix(cov)))
    numeric = sp.lambdify(x, f)
    for rule in (gauss_hermite(3, 3), fifth_degree(3)):
        assert mean_of(lambda p: numeric(*p), mean, cov, rule) == pytest.approx(exact, rel=1e-13)


def test_singular_covariance_and_smooth_function():
    direction = np.array([1.0, 2.0])
    cov = np.outer(direction, direction)
    ours = mean_of(lambda p: np.cos(p[0] + p[1]), [0.1, 0.2], cov, gauss_hermite(2, 40))
    assert ours == pytest.approx(np.exp(-4.5) * np.cos(0.3), abs=1e-14)


def test_batches_and_vector_functions():
    rng = np.random.default_rng(0)
    mean = rng.normal(size=(2, 3, 4))
    cov = np.array([[1.0, 0.3], [0.3, 0.5]])
    rule = fifth_degree(2)

    def both(p):
        return np.stack([p[0] * p[1], p[0] ** 2])

    ours = mean_of(both, mean, cov, rule)
    np.testing.assert_allclose(ours[0], mean[0] * mean[1] + 0.3, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(ours[1], mean[0] ** 2 + 1.0, rtol=1e-13)
    scale = np.array([1.0, 0.0, 2.0, 0.5])
    ours = mean_of(lambda p: p[0] * p[1], mean, cov[..., None] * scale, rule)
    np.testing.assert_allclose(ours, mean[0] * mean[1] + 0.3 * scale, rtol=1e-13, atol=1e-13)
    assert mean_of(lambda p: p[0], [1.0, 2.0], cov, rule).shape == ()
    ours = mean_of(lambda p: p[0] * p[1], mean[:, 0, 0], cov[..., None] * scale, rule)
    np.testing.assert_allclose(ours, mean[0, 0, 0] * mean[1, 0, 0] + 0.3 * scale, rtol=1e-13)


def test_values_of_a_wrong_shape():
    rule, mean, cov = cubature(2), [0.3, -0.4], np.eye(2)
    for f in (lambda p: 1.0, lambda p: p[:, :3], lambda p: p[None], lambda p: p.T):
        with pytest.raises(ValueError, match=r"f: wanted values of shape \(N,\) or \(p, N\)"):
            mean_of(f, mean, cov, rule)


def test_rules_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        cubature(3).points[0, 0] = 1.0


def test_rules_are_made_once_and_cannot_be_written():
    for make in (lambda: gauss_hermite(2, 3), lambda: cubature(3), lambda: unscented(2, 0.5),
                 lambda: fifth_degree(2)):  # fmt: skip
        rule = make()
        assert make() is rule
        for array in (rule.points, rule.weights):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0
    assert cubature(n=3).points.shape == (3, 6)
    assert gauss_hermite(1, 3).points.shape == (1, 3)
    for n, order in ((True, 3), (1, 3.0), (1.0, 3)):
        with pytest.raises(TypeError, match=r"(n|order): wanted a whole number"):
            gauss_hermite(n, order)
    rules = [cubature(n) for n in range(1, 150)]
    assert all(cubature(n) is rule for n, rule in enumerate(rules, 1))
    # equal as numbers, but one of them is no count
    for count in (True, 1.0, [1]):
        assert cubature(1).degree == 3
        with pytest.raises(TypeError, match="n: wanted a whole number"):
            cubature(count)


def test_order_of_the_points():
    """Of a product the last axis runs fastest; then the centre, plus and minus, axis by axis."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    grid = [[a, b] for a in nodes for b in nodes]
    rule = gauss_hermite.__wrapped__(2, 3)
    np.testing.assert_allclose(rule.points.T, grid, atol=1e-14)
    mass = weights / weights.sum()
    np.testing.assert_allclose(rule.weights, np.outer(mass, mass).ravel(), rtol=1e-13)
    assert [gauss_hermite.__wrapped__(1, k).degree for k in (1, 2, 5)] == [1, 3, 9]
    root = np.sqrt(2.0)
    rule = cubature.__wrapped__(2)
    np.testing.assert_allclose(rule.points, [[root, 0, -root, 0], [0, root, 0, -root]])
    assert rule.weights.tolist() == [0.25] * 4
    third = np.sqrt(3.0) * np.array([
        [0, 1, -1, 0, 0, 1, 1, -1, -1], [0, 0, 0, 1, -1, 1, -1, 1, -1]
    ])  # fmt: skip
    rule = fifth_degree.__wrapped__(2)
    np.testing.assert_allclose(rule.points, third, rtol=1e-15)
    np.testing.assert_allclose(rule.weights, [4 / 9, *[1 / 9] * 4, *[1 / 36] * 4], rtol=1e-14)
    assert rule.degree == 5


def test_limit_on_the_number_of_points(monkeypatch):
    told = r"order: wanted at most 2000000 points, got 1415\*\*2; use fifth_degree or cubature"
    with pytest.raises(ValueError, match=told):
        gauss_hermite(2, 1415)
    monkeypatch.setattr(quadrature, "MOST_POINTS", 64)
    assert gauss_hermite.__wrapped__(3, 4).points.shape == (3, 64)
    with pytest.raises(ValueError, match=r"order: wanted at most 64 points, got 65\*\*1; "):
        gauss_hermite.__wrapped__(1, 65)


def test_means_of_values_in_the_shapes_of_the_batch():
    """One law of many covariances, and means of more batch axes than the covariances."""
    rule, scale = cubature(2), np.array([1.0, 4.0, 9.0])
    cov = np.array([[1.0, 0.3], [0.3, 0.5]])[..., None] * scale

    def f(p):
        return np.stack([p[0] ** 2, p[0] * p[1], p[1]])

    found = mean_of(f, [0.5, -1.0], cov, rule)
    wanted = [0.25 + scale, -0.5 + 0.3 * scale, -1 + 0 * scale]
    np.testing.assert_allclose(found, wanted, rtol=1e-14)
    means = np.multiply.outer([0.5, -1.0], np.ones((2, 3)))
    np.testing.assert_allclose(mean_of(f, means, cov, rule), np.stack([wanted] * 2, axis=1))
    assert points_of(means, cov, rule).shape == (2, 4, 2, 3)
    assert points_of(means[:, 0, 0], cov[..., None], rule).shape == (2, 4, 3, 1)
    assert isinstance(mean_of(lambda p: p[0], [0.5, -1.0], np.eye(2), rule), float)
    with pytest.raises(ValueError, match=r"f: wanted .* with N = 12, got \(4,\)"):
        mean_of(lambda p: p[0, :4], [0.5, -1.0], cov, rule)


def test_arguments_of_rules_are_named():
    for make in (
        cubature,
        fifth_degree,
        lambda n: unscented(n, 1.0),
        lambda n: gauss_hermite(n, 2),
    ):
        with pytest.raises(ValueError, match="n: wanted at least 1, got 0"):
            make(0)
        with pytest.raises(TypeError, match="n: wanted a whole number"):
            make(2.5)
    with pytest.raises(ValueError, match="order: wanted at least 1, got 0"):
        gauss_hermite(2, 0)
    with pytest.raises(ValueError, match="kappa: wanted 0 axes"):
        unscented(2, (0.5,))
    with pytest.raises(TypeError, match="kappa: wanted real numbers"):
        unscented(2, 1j)
    with pytest.raises(ValueError, match="mean: wanted finite numbers"):
        points_of([np.nan, 0.0], np.eye(2), cubature(2))
    with pytest.raises(ValueError, match="cov: wanted"):
        mean_of(lambda p: p[0], [0.0, 0.0], -np.eye(2), cubature(2))


def test_bad_input():
    with pytest.raises(ValueError, match="order: wanted at most"):
        gauss_hermite(8, 20)
    with pytest.raises(ValueError, match="n: wanted at least 1"):
        cubature(0)
    with pytest.raises(TypeError, match="order: wanted a whole number"):
        gauss_hermite(2, 3.5)
    with pytest.raises(ValueError, match="kappa: wanted a number above -2"):
        unscented(2, -2.0)
    with pytest.raises(ValueError, match="rule: wanted a rule for 1"):
        mean_of(lambda p: p[0], [0.0], [[1.0]], cubature(2))
    with pytest.raises(ValueError, match="f: wanted values of shape"):
        mean_of(lambda p: p[0].sum(), [0.0], [[1.0]], cubature(1))
