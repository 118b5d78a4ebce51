import numpy as np
import pytest
import sympy

from oracles import literal_lemmas as literal
from seedslib.gaussian import RegionMoments, interval, lift, polygon


def law(size, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size))
    return rng.normal(size=size), root @ root.T + 0.2 * np.eye(size)


def density(points, mean, cov):
    """Normal density at points of shape (n, ...)."""
    away = points - mean.reshape(-1, *(1,) * (points.ndim - 1))
    root = np.linalg.cholesky(cov)
    white = np.linalg.solve(root, away.reshape(len(mean), -1))
    norm = (2 * np.pi) ** (len(mean) / 2) * np.prod(np.diag(root))
    return (np.exp(-0.5 * (white**2).sum(axis=0)) / norm).reshape(points.shape[1:])


def integrals(points, weights, mean, cov, about):
    """P, S, Q of formula (1) by a sum over points (n, N)."""
    mass = weights * density(points, mean, cov)
    away = points - about[:, None]
    return mass.sum(), points @ mass, (away * mass) @ away.T


def rule(count, lower, upper):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    half = 0.5 * (upper - lower)
    return lower + half * (nodes + 1), half * weights


def assert_moments(found, mass, first, second, tolerance):
    np.testing.assert_allclose(found.mass, mass, rtol=tolerance)
    np.testing.assert_allclose(found.first, first, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(found.second, second, rtol=tolerance, atol=tolerance)


def test_one_restricted_component_of_three_against_quadrature():
    mean, cov = law(3, 0)
    about = np.array([0.3, -1.0, 2.0])
    sigma = np.sqrt(np.diag(cov))
    axes = [rule(40, -0.5, 1.5)] + [
        rule(90, mean[i] - 9 * sigma[i], mean[i] + 9 * sigma[i]) for i in (1, 2)
    ]
    points = np.stack(np.meshgrid(*(a[0] for a in axes), indexing="ij")).reshape(3, -1)
    weights = np.einsum("i,j,k->ijk", *(a[1] for a in axes)).ravel()
    found = lift(interval(mean[0], cov[0, 0], -0.5, 1.5), mean, cov, about)
    assert_moments(found, *integrals(points, weights, mean, cov, about), 1e-12)


def test_two_restricted_components_of_four_against_quadrature():
    mean, cov = law(4, 1)
    about = np.array([0.3, -1.0, 2.0, 0.0])
    corner, a, b = np.array([-1.0, -0.5]), np.array([2.0, 0.3]), np.array([0.4, 1.8])
    u, wu = rule(26, 0.0, 1.0)
    triangle = corner[:, None, None] + a[:, None, None] * u[:, None]
    triangle = triangle + (b - a)[:, None, None] * (u[:, None] * u[None, :])
    area = abs(a[0] * b[1] - a[1] * b[0])
    plane_weights = (area * wu * u)[:, None] * wu[None, :]
    sigma = np.sqrt(np.diag(cov))
    rest = [rule(60, mean[i] - 9 * sigma[i], mean[i] + 9 * sigma[i]) for i in (2, 3)]
    grid = np.stack(np.meshgrid(*(r[0] for r in rest), indexing="ij")).reshape(2, -1)
    grid_weights = np.outer(rest[0][1], rest[1][1]).ravel()
    total = [0.0, 0.0, 0.0]
    for x, w in zip(triangle.reshape(2, -1).T, plane_weights.ravel(), strict=True):
        points = np.concatenate([np.repeat(x[:, None], grid.shape[1], axis=1), grid])
        for k, part in enumerate(integrals(points, w * grid_weights, mean, cov, about)):
            total[k] = total[k] + part
    vertices = np.array([corner, corner + a, corner + b])
    found = lift(polygon(mean[:2], cov[:2, :2], vertices), mean, cov, about)
    assert_moments(found, *total, 1e-12)


@pytest.mark.parametrize(("lead", "size", "seed"), [(1, 2, 2), (1, 4, 3), (2, 3, 4), (2, 5, 5)])
def test_literal_lemma_1(lead, size, seed):
    mean, cov = law(size, seed)
    about = np.arange(size) - 1.0
    if lead == 1:
        part = interval(mean[0], cov[0, 0], -0.3, 2.0, about=mean[0])
        triple = part.mass, part.first[None], part.second[None, None]
    else:
        vertices = [[-1, -1], [2, -0.5], [0.3, 1.7]]
        part = polygon(mean[:2], cov[:2, :2], vertices, about=mean[:2])
        triple = part.mass, part.first, part.second
    assert_moments(lift(part, mean, cov, about), *literal.lemma_1(triple, mean, cov, about), 1e-12)


def symbolic(name, rows, columns):
    return sympy.Matrix(rows, columns, lambda i, j: sympy.Symbol(f"{name}{i}{j}"))


@pytest.mark.parametrize(("k1", "k2"), [(1, 1), (1, 2), (2, 1), (2, 2)])
def test_conditional_form_is_lemma_1(k1, k2):
    """(4), (6) to (8) follow from the conditional form for any block moments and any gain."""
    p = sympy.Symbol("P", positive=True)
    m1, d1, mu1 = (symbolic(n, k1, 1) for n in ("m", "d", "u"))
    m2, d2 = symbolic("w", k2, 1), symbolic("e", k2, 1)
    spread = sympy.Matrix(k1, k1, lambda i, j: sympy.Symbol(f"c{min(i, j)}{max(i, j)}"))
    gain = symbolic("k", k1, k2)
    residual = sympy.Matrix(k2, k2, lambda i, j: sympy.Symbol(f"r{min(i, j)}{max(i, j)}"))
    # conditional form
    mu = mu1.col_join(m2 + gain.T * (mu1 - m1))
    upper = spread.row_join(spread * gain)
    c = upper.col_join((gain.T * spread).row_join(residual + gain.T * spread * gain))
    delta = d1.col_join(d2)
    second = p * (c + (mu - delta) * (mu - delta).T)
    # the paper's form
    s_bar = p * (mu1 - m1)
    q_bar = p * (spread + (mu1 - m1) * (mu1 - m1).T)
    e1, e2 = m1 - d1, m2 - d2
    q11 = q_bar + e1 * s_bar.T + s_bar * e1.T + p * e1 * e1.T
    q12 = (q_bar + e1 * s_bar.T) * gain + (p * mu1 - p * d1) * e2.T
    q22 = p * (residual + e2 * e2.T) + gain.T * q_bar * gain
    q22 = q22 + e2 * s_bar.T * gain + gain.T * s_bar * e2.T
    printed = q11.row_join(q12).col_join(q12.T.row_join(q22))
    assert (second - printed).expand() == sympy.zeros(k1 + k2, k1 + k2)
    first = p * mu
    printed_first = (p * mu1).col_join(p * m2 + gain.T * s_bar)
    assert (first - printed_first).expand() == sympy.zeros(k1 + k2, 1)


def test_whole_line_gives_the_law_back():
    mean, cov = law(4, 6)
    found = lift(interval(mean[0], cov[0, 0], -np.inf, np.inf), mean, cov)
    assert found.log_mass == 0.0
    np.testing.assert_allclose(found.mean, mean, atol=1e-14)
    np.testing.assert_allclose(found.cov, cov, rtol=1e-14, atol=1e-14)


def test_nothing_to_lift():
    mean, cov = law(2, 7)
    part = polygon(mean, cov, [[0, 0], [1, 0], [0, 1]])
    whole = lift(part, mean, cov)
    np.testing.assert_array_equal(whole.mean, part.mean)
    np.testing.assert_array_equal(whole.cov, part.cov)


def test_batch_axes_broadcast():
    rng = np.random.default_rng(8)
    mean = rng.normal(size=(3, 4, 5))
    _, cov = law(3, 9)
    lower, upper = np.arange(4.0)[:, None] - 2, np.arange(4.0)[:, None] - 1
    part = interval(mean[0], cov[0, 0], lower, upper)
    found = lift(part, mean, cov, about=[1.0, 2.0, 3.0])
    assert found.mean.shape == (3, 4, 5)
    assert found.cov.shape == found.second.shape == (3, 3, 4, 5)
    many = np.repeat(cov[:, :, None, None], 4, axis=2)
    np.testing.assert_array_equal(lift(part, mean, many).cov, found.cov)
    one = lift(interval(mean[0, 2, 3], cov[0, 0], 0.0, 1.0), mean[:, 2, 3], cov, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(found.second[:, :, 2, 3], one.second, rtol=1e-13)
    # the moments may have fewer batch axes than the law
    few = polygon(np.zeros((2, 5)), np.eye(2), [[0, 0], [1, 0], [0, 1]])
    wide = lift(few, np.zeros((3, 7, 5)), np.eye(3))
    assert wide.mean.shape == (3, 7, 5)
    assert wide.log_mass.shape == (7, 5)
    moved = wide.referred_to([1.0, 2.0, 3.0])
    np.testing.assert_allclose(moved.second[2, 2], few.mass * 10.0 * np.ones((7, 5)))


def test_singular_block_explains_what_it_can():
    # x1, x2, x3 = g s, and an independent x4
    g = np.array([1.3, -0.7, 2.0])
    cov = np.zeros((4, 4))
    cov[:3, :3] = np.outer(g, g)
    cov[3, 3] = 0.5
    block = RegionMoments(np.array(-1.0), 0.4 * g[:2], 0.3 * np.outer(g[:2], g[:2]))
    found = lift(block, np.zeros(4), cov)
    np.testing.assert_allclose(found.mean, [*(0.4 * g), 0.0], atol=1e-15)
    np.testing.assert_allclose(found.cov[:3, :3], 0.3 * np.outer(g, g), atol=2e-15)
    np.testing.assert_allclose(found.cov[3], [0, 0, 0, 0.5], atol=1e-15)


@pytest.mark.parametrize("lead", [1, 2])
def test_block_without_spread_explains_nothing(lead):
    cov = np.zeros((3, 3))
    cov[2, 2] = 2.0
    zero = np.zeros(lead)
    block = RegionMoments(np.array(0.0), zero, np.zeros((lead, lead)))
    found = lift(block, [0.0] * lead + [1.0] * (3 - lead), cov)
    assert found.mean[2] == 1.0
    assert found.cov[2, 2] == 2.0


def test_one_component_of_the_pair_without_spread():
    cov = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 1.0], [0.0, 1.0, 3.0]])
    block = RegionMoments(np.array(-0.2), np.array([0.0, 1.0]), np.diag([0.0, 0.5]))
    found = lift(block, np.zeros(3), cov)
    np.testing.assert_allclose(found.mean[2], 0.5)
    np.testing.assert_allclose(found.cov[2, 2], 3 - 0.5 + 0.25 * 0.5)


def test_nearly_singular_block_is_not_regularised():
    # x3 = x1 - x2 exactly: the gain (1, -1) must come out of a block with 1 - rho = 1e-14
    rho = 1 - 1e-14
    left = 1 - rho
    cov = np.array([[1, rho, left], [rho, 1, -left], [left, -left, 2 * left]])
    block = RegionMoments(
        np.array(0.0), np.array([0.25, 0.125]), np.array([[0.5, 0.1], [0.1, 0.3]])
    )
    found = lift(block, np.zeros(3), cov)
    np.testing.assert_allclose(found.mean[2], 0.125, rtol=1e-14)
    np.testing.assert_allclose(found.cov[2, :2], [0.4, -0.2], rtol=1e-14)


def test_scales_do_not_matter():
    mean, cov = law(3, 10)
    units = np.array([1e-150, 1e140, 1.0])
    part = polygon(mean[:2], cov[:2, :2], [[0, 0], [1, 0], [0, 1]])
    scaled = RegionMoments(
        part.log_mass, part.mean * units[:2], part.cov * np.outer(units[:2], units[:2])
    )
    found = lift(scaled, mean * units, cov * np.outer(units, units))
    np.testing.assert_allclose(found.mean[2], lift(part, mean, cov).mean[2], rtol=1e-14)


def test_region_of_no_mass():
    found = lift(interval(0.0, 0.0, 1.0, 2.0), [0.0, 1.0], np.diag([0.0, 1.0]))
    assert found.log_mass == -np.inf
    assert np.isnan(found.mean).all()
    np.testing.assert_array_equal(found.second, np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, np.nan], np.eye(2)), "mean"),
        ((0.0, np.eye(2)), "mean"),
        (([0.0, 0.0], np.eye(3)), "cov: wanted shape"),
        (([0.0, 0.0], [[1.0, 0.5], [0.1, 1.0]]), "symmetric"),
        (([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]]), "semidefinite"),
        (([0.0, 0.0], [[1.0, 0.0], [0.0, -1.0]]), "nonnegative variances"),
        (([0.0, 0.0], np.eye(2), [1.0, 2.0, 3.0]), "about"),
        ((np.zeros((2, 3)), np.zeros((2, 2, 4))), "broadcast"),
    ],
)
def test_bad_values(arguments, message):
    with pytest.raises(ValueError, match=message):
        lift(interval(0.0, 1.0, 0.0, 1.0), *arguments)


def test_bad_moments():
    block = RegionMoments(np.array(0.0), np.zeros(3), np.eye(3))
    with pytest.raises(ValueError, match="moments: wanted one or two"):
        lift(block, np.zeros(4), np.eye(4))
