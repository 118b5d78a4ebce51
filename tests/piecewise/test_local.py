"""New coordinates of plane regions that are too large for their laws."""

import numpy as np
import pytest

from oracles.piecewise_branches import branches
from seedslib.piecewise.branches import Branches
from seedslib.piecewise.clipping import area, box
from seedslib.piecewise.geometry import PolygonRegions
from seedslib.piecewise.local import localise


def plane(regions, mean, cov, alive=True):
    """Branches of k components in one cell; mean (k, N), cov (k, k) or (k, k, N)."""
    count, (size, datasets) = len(regions), np.shape(mean)
    cov = np.reshape(cov, (size, size, 1, -1)) * np.ones((count, 1))
    rng = np.random.default_rng(0)
    return Branches(
        np.zeros(count, int), PolygonRegions(tuple(regions)), rng.standard_normal((2, 2, count)),
        rng.standard_normal((2, count)), np.repeat(np.array(mean, float)[:, None], count, axis=1),
        cov, np.where(alive, 0.0, -np.inf) * np.ones((count, datasets)),
    )  # fmt: skip


def square(half, center=(0.0, 0.0)):
    return box(np.array(center), np.full(2, half))


def in_state(found, b, points):
    """Points s of a branch as x1."""
    return found.shift[:, b, None] + found.slope[:, :, b] @ points


def reach(found, b=0):
    """Least and largest distances of the new region from the law, in its deviations."""
    return found.regions.vertices[b].min(axis=1), found.regions.vertices[b].max(axis=1)


def test_intervals_and_regions_of_moderate_size_keep_their_coordinates():
    line = branches([(-1e9, 1e9)], [0.0], 1.0, [1.0])[0]
    assert localise(line) is line
    small = plane([square(9999.0), square(1.0)], [[0.0], [0.0]], np.eye(2))
    assert localise(small) is small
    assert localise(plane([square(10001.0)], [[0.0], [0.0]], np.eye(2))) is not small


def test_coordinates_are_changed_from_ten_thousand_deviations_on():
    """The extent of the region or the distance of its centre from the origin."""
    for regions, changed in (
        ([square(9999.0)], False), ([square(10001.0)], True),
        ([square(1.0, (9999.0, 0.0))], False), ([square(1.0, (0.0, -10001.0))], True),
    ):  # fmt: skip
        old = plane(regions, [[0.0], [0.0]], np.eye(2))
        assert (localise(old) is not old) == changed
    wide = plane([square(10001.0)], [[0.0], [0.0]], 4.0 * np.eye(2))
    assert localise(wide) is wide
    mean_of_both = np.stack([0.5 * np.eye(2), 1.5 * np.eye(2)], axis=2)
    several = plane([square(9999.0)], np.zeros((2, 2)), mean_of_both)
    assert localise(several) is several


@pytest.mark.parametrize("depth", [1, 3])
def test_new_coordinates_describe_the_same_law_of_the_state(depth):
    """Mean, covariance with the third component, and every corner, as states."""
    rng = np.random.default_rng(1)
    root = rng.standard_normal((3, 3, depth)) * np.array([1e-4, 1e-5, 1.0])[:, None, None]
    cov = np.einsum("ij...,kj...->ik...", root, root)
    mean = rng.standard_normal((3, 3)) * [[1e-3], [1e-3], [1.0]]
    old = plane([square(1e-6), square(2.0)], mean, cov)
    new = localise(old)
    assert new.regions.vertices[0] is old.regions.vertices[0]
    assert (new.slope[..., 0] == old.slope[..., 0]).all()
    assert (new.mean[:, 0] == old.mean[:, 0]).all()
    assert (new.cov[:, :, 0] == old.cov[:, :, 0]).all()
    np.testing.assert_allclose(
        in_state(new, 1, new.mean[:2, 1]), in_state(old, 1, old.mean[:2, 1]), rtol=1e-12
    )
    assert (new.mean[2] == old.mean[2]).all()
    for n in range(depth):
        both = [np.eye(3), np.eye(3)]
        for turn, each in zip(both, (new, old), strict=True):
            turn[:2, :2] = each.slope[:, :, 1]
        one, other = (t @ e.cov[:, :, 1, n] @ t.T for t, e in zip(both, (new, old), strict=True))
        scale = np.sqrt(np.outer(np.diag(other), np.diag(other)))
        np.testing.assert_allclose(one / scale, other / scale, rtol=1e-9, atol=1e-12)
    assert (new.cov == np.swapaxes(new.cov, 0, 1)).all()
    average = new.cov[:2, :2, 1].mean(axis=-1)
    np.testing.assert_allclose(average, np.eye(2), atol=1e-10)
    corners = np.linalg.solve(old.slope[:, :, 1], in_state(new, 1, new.regions.vertices[1])
                              - old.shift[:, 1, None])  # fmt: skip
    assert np.abs(corners).max() < 2.0 * (1 + 1e-12)


def test_the_region_is_cut_forty_deviations_from_a_law_within():
    old = plane([square(1e5, (3.0, -4.0))], [[13.0, 18.0], [6.0, -9.0]], 4.0 * np.eye(2))
    low, high = reach(localise(old))
    # origin at (3, -4), unit two
    np.testing.assert_allclose(low, [5.0 - 40.0, -2.5 - 40.0], rtol=1e-12)
    np.testing.assert_allclose(high, [7.5 + 40.0, 5.0 + 40.0], rtol=1e-12)


@pytest.mark.parametrize(
    ("mean", "distance"),
    [
        ((1e5 + 3.0, 1e5 + 4.0), 5.0), ((1e5 + 7.0, 0.0), 7.0), ((-1e5 - 8.0, 50.0), 8.0),
        ((50.0, -1e5 - 2.0), 2.0), ((-1e5 - 5.0, -1e5 - 12.0), 13.0), ((1e5, 5.0), 0.0),
        ((1e5 - 1.0, 1e5 - 1.0), 0.0),
    ],
)  # fmt: skip
def test_a_law_beside_its_region_is_given_its_distance_more(mean, distance):
    """To the nearest corner or side."""
    found = localise(plane([square(1e5)], np.array(mean)[:, None], np.eye(2)))
    low, high = reach(found)
    center = np.array(mean)
    np.testing.assert_allclose(low, np.maximum(center - 40.0 - distance, -1e5), rtol=1e-12)
    np.testing.assert_allclose(high, np.minimum(center + 40.0 + distance, 1e5), rtol=1e-12)


def test_every_data_set_is_given_its_own_reach():
    """One law in the middle, one beside the region; what the branch was stays as it was."""
    old = plane([square(1e5)], [[0.0, 1e5 + 30.0], [0.0, 0.0]], np.eye(2))
    before = [part.copy() for part in (old.mean, old.cov, old.slope, old.shift)]
    low, high = reach(localise(old))
    np.testing.assert_allclose(low, [-40.0, -70.0], rtol=1e-12)
    np.testing.assert_allclose(high, [1e5, 70.0], rtol=1e-12)
    for part, copy in zip((old.mean, old.cov, old.slope, old.shift), before, strict=True):
        assert (part == copy).all()


def test_data_sets_without_the_branch_do_not_count():
    mean = np.array([[0.0, 300.0], [0.0, 500.0]])
    old = plane([square(1e5)], mean, np.eye(2), alive=[[True, False]])
    low, high = reach(localise(old))
    np.testing.assert_allclose([low, high], [[-40.0, -40.0], [40.0, 40.0]], rtol=1e-12)
    gone = plane([square(1e5)], mean, np.eye(2), alive=False)
    assert localise(gone) is gone


def test_a_law_without_spread_keeps_its_coordinates():
    for cov in (np.zeros((2, 2)), np.ones((2, 2)), np.diag([1.0, 0.0])):
        old = plane([square(1e9)], [[0.0], [0.0]], cov)
        assert localise(old) is old


def test_other_branches_keep_theirs():
    old = plane([square(1.0), square(1e5), square(2.0)], [[0.5], [0.25]], np.eye(2))
    new = localise(old)
    for b in (0, 2):
        assert new.regions.vertices[b] is old.regions.vertices[b]
        assert (new.slope[:, :, b] == old.slope[:, :, b]).all()
        assert (new.shift[:, b] == old.shift[:, b]).all()
    assert area(new.regions.vertices[1]) == pytest.approx(80.0**2, rel=1e-12)
    assert area(old.regions.vertices[1]) == pytest.approx(4e10, rel=1e-12)
