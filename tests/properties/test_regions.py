"""Regions: parts of a whole sum to it, and affine maps carry them along."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from oracles.drawn import EIGHTHS, covariances, vectors
from seedslib.gaussian import interval, lift, polygon

ENDS = st.lists(EIGHTHS, min_size=1, max_size=5, unique=True).map(sorted)


def mixed(parts, axis):
    """Mass, mean and covariance of a distribution from those of its parts, the last axis along
    them."""
    mass = np.exp(parts.log_mass)
    weight, there = mass / mass.sum(), mass > 0
    mean = np.where(there, parts.mean, 0.0)
    cov = np.where(there, parts.cov, 0.0)
    whole = (weight * mean).sum(axis=-1)
    apart = mean - whole[..., None]
    spread = apart[:, None] * apart[None] if axis else apart**2
    return mass.sum(), whole, (weight * (cov + spread)).sum(axis=-1)


@given(EIGHTHS, st.integers(1, 60).map(lambda k: k / 8), ENDS)
def test_parts_of_the_line_make_the_distribution(mean, var, ends):
    ends = np.array([-np.inf, *ends, np.inf])
    total, whole, spread = mixed(interval(mean, var, ends[:-1], ends[1:]), 0)
    np.testing.assert_allclose([total, whole, spread], [1, mean, var], rtol=1e-12, atol=1e-12)


@given(
    EIGHTHS,
    st.integers(1, 60).map(lambda k: k / 8),
    EIGHTHS,
    EIGHTHS,
    st.sampled_from([-1e90, -2.0, 0.5, 1e-90]),
    EIGHTHS,
)
def test_affine_maps_of_the_line(mean, var, one, other, a, b):
    low, high = sorted((one, other + 0.125 * (one == other)))
    b = b * abs(a)
    ends = sorted((a * low + b, a * high + b))
    here, there = interval(mean, var, low, high), interval(a * mean + b, a * var * a, *ends)
    np.testing.assert_allclose(there.log_mass, here.log_mass, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose((there.mean - b) / a, here.mean, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(there.cov / a / a, here.cov, rtol=1e-10)


SQUARE = np.array([[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0]])


def cut(t, s):
    """The square in two by a line from the lower to the upper side."""
    low, high = np.array([t, -1.0]), np.array([s, 1.0])
    left = np.stack([SQUARE[:, 0], low, high, SQUARE[:, 3]], axis=1)
    right = np.stack([low, SQUARE[:, 1], SQUARE[:, 2], high], axis=1)
    return left, right


INSIDE = st.integers(-7, 7).map(lambda k: k / 8)


@given(vectors(2), covariances(2, floor=0.125), INSIDE, INSIDE)
def test_parts_of_a_polygon_make_it(mean, cov, t, s):
    whole = polygon(mean, cov, SQUARE.T)
    parts = [polygon(mean, cov, part.T) for part in cut(t, s)]
    joined = [
        np.stack([np.asarray(getattr(p, name)) for p in parts], axis=-1)
        for name in ("log_mass", "mean", "cov")
    ]
    largest = joined[0].max()
    stacked = type(whole)(joined[0] - largest, *joined[1:])
    total, middle, spread = mixed(stacked, 1)
    np.testing.assert_allclose(np.log(total) + largest, whole.log_mass, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(middle, whole.mean, atol=1e-10)
    np.testing.assert_allclose(spread, whole.cov, atol=1e-10)


@given(vectors(2), covariances(2, floor=0.125), vectors((2, 2)), vectors(2))
def test_affine_maps_of_the_plane(mean, cov, matrix, shift):
    matrix = matrix + 4 * np.eye(2) if abs(np.linalg.det(matrix)) < 0.25 else matrix
    if abs(np.linalg.det(matrix)) < 0.25:
        return
    here = polygon(mean, cov, SQUARE.T)
    there = polygon(matrix @ mean + shift, matrix @ cov @ matrix.T, (matrix @ SQUARE).T + shift)
    np.testing.assert_allclose(there.log_mass, here.log_mass, rtol=1e-9, atol=1e-10)
    if here.log_mass > -300:
        np.testing.assert_allclose(there.mean, matrix @ here.mean + shift, rtol=1e-8, atol=1e-8)
        wanted = matrix @ here.cov @ matrix.T
        np.testing.assert_allclose(there.cov, wanted, rtol=1e-6, atol=1e-7 * np.trace(wanted))


@given(vectors(3), covariances(3, floor=0.125), ENDS)
def test_parts_of_a_component_make_the_vector(mean, cov, ends):
    """Restricted in one component, lifted, and put together again."""
    ends = np.array([-np.inf, *ends, np.inf])
    parts = lift(interval(mean[0], cov[0, 0], ends[:-1], ends[1:]), mean, cov)
    total, whole, spread = mixed(parts, 1)
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)
    np.testing.assert_allclose(whole, mean, atol=1e-9)
    np.testing.assert_allclose(spread, cov, atol=1e-9 * (1 + np.trace(cov)))
