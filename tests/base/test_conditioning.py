"""The correction of a mean and a covariance: every part against the formulas of the textbook."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
import sympy

from seedslib.base import update
from seedslib.linearization import Moments

TINY = np.finfo(float).tiny


def drawn(rng, shapes, kind, n, m):
    """Mean, covariance, y, E y, cov(x, y), cov y with batches of these shapes."""
    mean, cov, y, predicted, cross, spread = shapes

    def square(size, batch, floor):
        root = rng.standard_normal((*batch, size, size))
        product = root @ np.swapaxes(root, -1, -2) + floor * np.eye(size)
        return np.moveaxis(product, (-2, -1), (0, 1))

    parts = [
        rng.standard_normal((n, *mean)),
        square(n, cov, 0.0),
        rng.standard_normal((m, *y)),
        rng.standard_normal((m, *predicted)),
        rng.standard_normal((n, m, *cross)),
        square(m, spread, 0.3),
    ]
    if "singular" in kind:
        # y and cov(x, y) in the range of cov y, which has rank one in all items or in the first
        line = np.array([2.0, -1.0, 3.0, 0.5, -2.0])[:m]
        for k, batch in ((2, y), (3, predicted)):
            parts[k] = line.reshape(m, *(1,) * len(batch)) * rng.standard_normal(batch)
        parts[4] = rng.standard_normal((n, 1, *cross)) * line.reshape(1, m, *(1,) * len(cross))
        flat = parts[5].reshape(m, m, -1)
        flat[..., 0] = 1.7 * np.outer(line, line)
        parts[5] = flat.reshape(parts[5].shape)
    if "missing" in kind:
        flat = parts[2].reshape(m, -1)
        flat[m // 2, 0] = np.nan
        flat[:, 1:2] = np.nan
        parts[2] = flat.reshape(parts[2].shape)
    return parts


def formulas(mean, cov, y, predicted, cross, spread):
    """Of the components that those before them do not determine."""
    kept: list[int] = []
    for j in np.flatnonzero(np.isfinite(y)):
        if np.linalg.matrix_rank(spread[np.ix_([*kept, j], [*kept, j])], 1e-9) > len(kept):
            kept.append(j)
    e, C, S = (y - predicted)[kept], cross[:, kept], spread[np.ix_(kept, kept)]
    gain = np.linalg.solve(S, C.T).T
    loglik = -0.5 * (e @ np.linalg.solve(S, e) + np.linalg.slogdet(2 * np.pi * S)[1])
    return mean + gain @ e, cov - gain @ C.T, loglik


def aligned(part, core, depth):
    short = depth - (part.ndim - core)
    return part.reshape(*part.shape[:core], *(1,) * short, *part.shape[core:])


@pytest.mark.parametrize(("n", "m"), [(3, 3), (2, 5), (4, 1)])
@pytest.mark.parametrize("kind", ["regular", "missing", "singular", "singular missing"])
def test_any_part_may_carry_a_batch_and_each_item_has_its_own_correction(kind, n, m):
    rng = np.random.default_rng(11)
    every = list(itertools.product(((), (3,), (2, 1)), repeat=6))
    for i in np.random.default_rng(7).choice(len(every), 20, False):
        shapes = every[i]
        given = drawn(rng, shapes, kind, n, m)
        copies = [part.copy() for part in given]
        mean, cov, y, *moments = given
        found = update(mean, cov, y, Moments(*moments))
        for before, after in zip(copies, given, strict=True):
            np.testing.assert_array_equal(before, after)
        gains = np.broadcast_shapes(*shapes[4:])
        batch = np.broadcast_shapes(shapes[0], *shapes[2:4], gains)
        of_cov = np.broadcast_shapes(shapes[1], gains)
        present = np.isfinite(y).reshape(m, -1)
        if not (present.all(axis=1) | ~present.any(axis=1)).all():
            depth = max(len(batch), len(of_cov))  # axes of y stand where those of the mean do
            of_cov = np.broadcast_shapes(of_cov, (1,) * (depth - len(shapes[2])) + shapes[2])
        assert [part.shape for part in found] == [(n, *batch), (n, n, *of_cov), batch]
        whole = np.broadcast_shapes(batch, of_cov)
        cores = (1, 2, 1, 1, 2, 2, 1, 2, 0)
        every_part = [
            np.broadcast_to(aligned(part, core, len(whole)), part.shape[:core] + whole)
            for part, core in zip((*given, *found), cores, strict=True)
        ]
        for i in np.ndindex(whole):
            one = [part[(..., *i)] for part in every_part]
            for got, want in zip(one[6:], formulas(*one[:6]), strict=True):
                np.testing.assert_allclose(got, want, rtol=1e-8, atol=1e-9)
        again = update(mean, None, y, Moments(*moments))
        np.testing.assert_array_equal(again[0], found[0])
        assert again[1] is None
        np.testing.assert_array_equal(again[2], found[2])


def case(n=2, m=2, count=None, seed=0):
    shapes = [() if count is None else (count,)] * 6
    mean, cov, y, *moments = drawn(np.random.default_rng(seed), shapes, "regular", n, m)
    return mean, cov, y, Moments(*moments)


def test_a_common_covariance_stays_common_where_a_component_is_missing_everywhere():
    mean, _, y, moments = case(3, 2, 6)
    cov = np.eye(3)
    common = Moments(moments.mean, moments.cross[..., 0], moments.cov[..., 0])
    y[1] = np.nan
    assert update(mean, cov, y, common)[1].shape == (3, 3)
    y[0, 2] = np.nan
    found = update(mean, cov, y, common)
    assert found[1].shape == (3, 3, 6)
    np.testing.assert_array_equal(found[1][..., 2], cov)


def test_singular_items_do_not_disturb_regular_ones_nor_undefined_ones_others():
    mean, cov, y, moments = case(2, 2, 5)
    wanted = update(mean, cov, y, moments)
    moments.cov[..., 1] = [[1.0, 2.0], [2.0, 1.0]]  # indefinite
    moments.mean[:, 2] = np.nan
    moments.cov[..., 3] = [[1.0, 1.0], [1.0, 1.0]]
    moments.cov[0, 0, 4] = np.nan
    found = update(mean, cov, y, moments)
    for part, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(part[..., 0], other[..., 0])
        assert np.isnan(part[..., [1, 4]]).all()
    assert np.isnan(found[2][2])
    assert np.isfinite(found[1][..., 3]).all()


def test_units_of_sensors_do_not_make_them_singular():
    scale, (mean, cov, y, moments) = np.array([1.0, 1e-12]), case()
    scaled = Moments(
        moments.mean * scale, moments.cross * scale, moments.cov * np.outer(scale, scale)
    )
    plain, tiny = update(mean, cov, y, moments), update(mean, cov, y * scale, scaled)
    np.testing.assert_allclose(plain[0], tiny[0], rtol=1e-9)
    np.testing.assert_allclose(plain[1], tiny[1], rtol=1e-9, atol=1e-12)
    # with a copy of the tiny one beside it the rank is found in spite of the scale
    pick = [0, 1, 1]
    twice = Moments(scaled.mean[pick], scaled.cross[:, pick], scaled.cov[np.ix_(pick, pick)])
    again = update(mean, cov, (y * scale)[pick], twice)
    np.testing.assert_allclose(again[0], tiny[0], rtol=1e-8)
    np.testing.assert_allclose(again[1], tiny[1], rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("copies", [1, 2])
def test_a_variance_below_the_normal_numbers_is_none(copies):
    ones = np.ones((copies, copies))
    for variance, told in ((TINY, False), (4 * TINY, True)):
        cross = np.full((1, copies), 0.5 * variance)
        y = np.full(copies, np.sqrt(variance)) * told
        mean, _, loglik = update([3.0], [[1.0]], y, Moments(0 * y, cross, variance * ones))
        assert mean[0] == pytest.approx(3.0 + 0.5 * np.sqrt(variance) * told)
        wanted = -0.5 * (1.0 + np.log(2 * np.pi * variance)) if told else 0.0
        assert loglik == pytest.approx(wanted)


def test_a_component_on_a_circle_takes_the_shortest_way():
    y, moments = np.array([1.0, 3.9]), Moments(np.zeros(2), np.eye(2), 2 * np.eye(2))
    for periods, wanted in (((), [0.5, 1.95]), (((1, 4.0),), [0.5, -0.05])):
        mean = update(np.zeros(2), np.eye(2), y, moments, periods=periods)[0]
        np.testing.assert_allclose(mean, wanted)


# Priors so wide that cov y has lost the noise: against the formulas in rational numbers

SMALL = np.array([[5.0, 2.0, -3.0], [2.0, 7.0, 1.0], [-3.0, 1.0, 11.0]])
SLOPE = np.array([[2.0, -1.0, 3.0], [1.0, 4.0, -2.0], [3.0, 1.0, 5.0]])
NOISE = np.array([[3.0, 1.0, -2.0], [1.0, 5.0, 2.0], [-2.0, 2.0, 7.0]])


def without(k):
    """The noise, none of it in component k."""
    kept = np.arange(3) != k
    return NOISE * np.outer(kept, kept)


def rational(matrix):
    rows = np.asarray(matrix, dtype=float)
    return sympy.Matrix(
        [[sympy.Rational(*Fraction(v).as_integer_ratio()) for v in row] for row in rows]
    )


def posterior(cov, slope, noise):
    """P - P H' (H P H' + R)^-1 H P without any rounding before the last one."""
    P, H, R = map(rational, (cov, slope, noise))
    return np.array(P - P * H.T * (H * P * H.T + R).inv() * H * P, dtype=float)


def measured(cov, slope, noise):
    return Moments(np.zeros(len(slope)), cov @ slope.T, slope @ cov @ slope.T + noise)


def corrected(cov, slope, noise):
    zeros = np.zeros(len(cov)), np.zeros(len(slope))
    moments = measured(cov, slope, noise)
    return update(zeros[0], cov, zeros[1], moments, noise=lambda: noise)[1]


def assert_near(found, wanted):
    """In units of the deviations."""
    unit = np.sqrt(np.diag(wanted))
    unit = np.where(unit > 0, unit, unit.max())
    assert np.abs((found - wanted) / np.outer(unit, unit)).max() < 1e-7
    assert np.array_equal(found, found.T)


ONE = np.array([[0.0, 0, 3], [2, -1, 3], [3, 1, 5]])
ALL = [0, 1, 2]
CASES = {  # and the components that are not known exactly afterwards
    "all noisy": (SMALL, SLOPE, NOISE, ALL),
    "noise in whole numbers": (SMALL, SLOPE, NOISE.astype(int), ALL),
    "two sensors": (SMALL, SLOPE[:2], NOISE[:2, :2], ALL),
    "one sensor of one component": (SMALL, SLOPE[:1] * [0, 1, 0], NOISE[:1, :1], ALL),
    "an exact sensor": (SMALL, np.array([[2.0, -1, 3], [0, 1, 0], [3, 1, 5]]), without(1), [0, 2]),
    "an exact sensor first": (SMALL, ONE, without(0), [0, 1]),
    "unrelated components": (np.diag([5.0, 7.0, 11.0]), ONE, without(0), [0, 1]),
    "four sensors of two": (
        SMALL[:2, :2],
        np.array([[2.0, -1], [1, 4], [3, 1], [1, -2]]),
        np.diag([3.0, 5.0, 7.0, 2.0]) + 1.0,
        [0, 1],
    ),
    "a known component": (SMALL * np.outer([1, 0, 1], [1, 0, 1]), SLOPE, NOISE, ALL),
}


@pytest.mark.parametrize("wide", [2.0**34, 2.0**44])
@pytest.mark.parametrize("name", CASES)
def test_wide_priors_keep_their_digits(name, wide):
    """Where P is 1e10 and 1e13 times the noise, cov y alone would keep six digits and three."""
    cov, slope, noise, kept = CASES[name]
    found = corrected(wide * cov, slope, noise)
    wanted = posterior(wide * cov, slope, noise)
    exact = np.setdiff1d(range(len(cov)), kept)
    assert (np.abs(found[exact]) <= 1e-14 * wide).all()
    assert_near(found[np.ix_(kept, kept)], wanted[np.ix_(kept, kept)])


def test_a_sensor_that_always_shows_zero_changes_nothing():
    wide, pick = 2.0**40 * SMALL[:2, :2], np.array([[2.0, -1.0], [0.0, 0.0], [3.0, 1.0]])
    wanted = posterior(wide, pick[[0, 2]], NOISE[np.ix_([0, 2], [0, 2])])
    for order in ([0, 1, 2], [1, 0, 2], [0, 2, 1]):
        assert_near(corrected(wide, pick[order], without(1)[np.ix_(order, order)]), wanted)


def test_each_path_of_wide_and_narrow_priors_is_corrected_as_it_is_alone():
    """One misses a component; a path without noise is left to the usual lines."""
    covs = [2.0**40 * SMALL, SMALL, 2.0**36 * SMALL, 2.0**38 * SMALL]
    y = np.arange(12.0).reshape(3, 4)
    y[1, 2] = np.nan
    parts = [measured(cov, SLOPE, NOISE) for cov in covs]
    moments = Moments(*(np.stack(part, axis=-1) for part in zip(*parts, strict=True)))
    mean, cov = np.zeros((3, 4)), np.stack(covs, axis=-1)
    found = update(mean, cov, y, moments, noise=lambda: NOISE)[1]
    for k, part in enumerate(parts):
        kept = np.isfinite(y[:, k])
        alone = update(mean[:, k], covs[k], y[:, k], part, noise=lambda: NOISE)[1]
        np.testing.assert_allclose(found[..., k], alone, rtol=1e-13)
        assert_near(found[..., k], posterior(covs[k], SLOPE[kept], NOISE[np.ix_(kept, kept)]))
    # the noise is not asked where nothing narrows
    narrow = update(mean[:, 1], covs[1], y[:, 1], parts[1], noise=lambda: 1 / 0)[1]
    np.testing.assert_array_equal(narrow, found[..., 1])
    cov, slope, noise = 1.1e12 * SMALL, np.array([[0.0, 3.3, 0.0]]), np.array([[[0.0, 3.0]]])
    moments = Moments(np.zeros(1), cov @ slope.T, (slope @ cov @ slope.T)[..., None] + noise)
    told = update(np.zeros(3), cov, np.zeros(1), moments, noise=lambda: noise)[1]
    plain = update(np.zeros(3), cov, np.zeros(1), moments)[1]
    np.testing.assert_array_equal(told[..., 0], plain[..., 0])
    assert_near(told[..., 1], posterior(cov, slope, [[3.0]]))
    assert np.abs(plain[1, 1, 1] / told[1, 1, 1] - 1) > 1e-7
