"""Moments of all components from those of one or two restricted ones."""

import numpy as np
import pytest

from oracles.gaussian import random_dist
from seedslib.gaussian import RegionMoments, interval, lift, polygon


def dist(size, seed):
    mean, cov = random_dist(np.random.default_rng(seed), size)
    return mean, cov + 0.2 * np.eye(size)


def integrals(points, weights, mean, cov, about):
    """P, S, Q of formula (1) by a sum over points (n, N)."""
    white = np.linalg.solve(np.linalg.cholesky(cov), points - mean[:, None])
    norm = np.sqrt((2 * np.pi) ** len(mean) * np.linalg.det(cov))
    mass = weights * np.exp(-0.5 * (white**2).sum(axis=0)) / norm
    away = points - about[:, None]
    return mass.sum(), points @ mass, (away * mass) @ away.T


def rule(count, lower, upper):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    half = 0.5 * (upper - lower)
    return lower + half * (nodes + 1), half * weights


def assert_moments(found, exact, about):
    for part, value in zip((found.mass, found.first, found.second(about)), exact, strict=True):
        np.testing.assert_allclose(part, value, rtol=1e-12, atol=1e-12)


def test_two_restricted_components_of_three_against_quadrature():
    """A triangle: the rest of the prism is one long axis."""
    mean, cov = dist(3, 1)
    about = np.array([0.3, -1.0, 2.0])
    corner, a, b = np.array([-1.0, -0.5]), np.array([2.0, 0.3]), np.array([0.4, 1.8])
    u, wu = rule(26, 0.0, 1.0)
    triangle = (corner + u[:, None, None] * (a + u[:, None] * (b - a))).reshape(-1, 2).T
    area = abs(a[0] * b[1] - a[1] * b[0])
    plane = ((area * wu * u)[:, None] * wu).ravel()
    reach = 9 * np.sqrt(cov[2, 2])
    rest, wr = rule(90, mean[2] - reach, mean[2] + reach)
    points = np.concatenate(
        [np.repeat(triangle, rest.size, axis=1), np.tile(rest, plane.size)[None]]
    )
    found = lift(
        polygon(mean[:2], cov[:2, :2], np.array([corner, corner + a, corner + b])),
        mean,
        cov,
    )
    assert_moments(found, integrals(points, np.outer(plane, wr).ravel(), mean, cov, about), about)


def test_whole_line_gives_the_dist_back():
    mean, cov = dist(4, 6)
    found = lift(interval(mean[0], cov[0, 0], -np.inf, np.inf), mean, cov)
    assert found.log_mass == 0.0
    np.testing.assert_allclose(found.mean, mean, atol=1e-14)
    np.testing.assert_allclose(found.cov, cov, rtol=1e-14, atol=1e-14)


def test_batch_axes_of_moments_mean_and_covariance():
    mean = np.random.default_rng(8).normal(size=(3, 4, 5))
    _, cov = dist(3, 9)
    lower = np.arange(4.0)[:, None] - 2
    part = interval(mean[0], cov[0, 0], lower, lower + 1)
    about = [1.0, 2.0, 3.0]
    many = np.repeat(cov[:, :, None, None], 4, axis=2)
    for covs in (cov, many):
        found = lift(part, mean, covs)
        for j, k in np.ndindex(4, 5):
            one = interval(mean[0, j, k], cov[0, 0], lower[j, 0], lower[j, 0] + 1)
            alone = lift(one, mean[:, j, k], cov)
            np.testing.assert_allclose(found.mean[:, j, k], alone.mean, rtol=1e-13)
            np.testing.assert_allclose(
                found.second(about)[:, :, j, k], alone.second(about), rtol=1e-13
            )


@pytest.mark.parametrize("whose", range(3))
def test_any_argument_may_carry_the_batch_alone(whose):
    mean, cov = dist(3, 11)
    triangle = [[0.4, -0.7], [1.7, 0.3], [-0.6, 0.8]]
    block = polygon(mean[:2], cov[:2, :2], triangle)
    alone = lift(block, mean, cov)
    means, covs = (np.repeat(part[..., None], 4, axis=-1) for part in (mean, cov))
    many = polygon(means[:2], cov[:2, :2], triangle)
    arguments = [block, mean, cov]
    arguments[whose] = (many, means, covs)[whose]
    found = lift(*arguments)
    assert found.log_mass.shape == (4,)
    np.testing.assert_allclose(found.mean, np.repeat(alone.mean[:, None], 4, 1), rtol=1e-13)
    np.testing.assert_allclose(found.cov, np.repeat(alone.cov[..., None], 4, 2), rtol=1e-13)
    exact = lift(block, mean, cov).second([1.0, 2.0, 3.0])
    np.testing.assert_allclose(found.second([1.0, 2.0, 3.0])[..., 2], exact, rtol=1e-13)


def test_singular_block_explains_what_it_can():
    """x1, x2, x3 = g s, and an independent x4."""
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
    block = RegionMoments(np.array(0.0), np.zeros(lead), np.zeros((lead, lead)))
    found = lift(block, [0.0] * lead + [1.0] * (3 - lead), cov)
    assert found.mean[2] == 1.0
    assert found.cov[2, 2] == 2.0


def test_pair_with_one_component_without_spread():
    cov = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 1.0], [0.0, 1.0, 3.0]])
    block = RegionMoments(np.array(-0.2), np.array([0.0, 1.0]), np.diag([0.0, 0.5]))
    found = lift(block, np.zeros(3), cov)
    np.testing.assert_allclose(found.mean[2], 0.5)
    np.testing.assert_allclose(found.cov[2, 2], 3 - 0.5 + 0.25 * 0.5)


def test_region_of_no_mass_has_no_moments():
    found = lift(interval(0.0, 0.0, 1.0, 2.0), [0.0, 1.0], np.diag([0.0, 1.0]))
    assert found.log_mass == -np.inf
    assert np.isnan(found.mean).all()
    np.testing.assert_array_equal(found.second(), np.zeros((2, 2)))
