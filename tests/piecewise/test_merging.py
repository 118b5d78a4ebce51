"""Merging of branches, against the densities that it replaces."""

import numpy as np
import pytest
from scipy.stats import norm

from oracles.piecewise_branches import branches, density
from seedslib.piecewise.merging import merge

INF = np.inf


def variation(log_ratio):
    return log_ratio.max() - log_ratio.min()


def ends_of(found):
    return list(zip(found.regions.lower.tolist(), found.regions.upper.tolist(), strict=True))


GRID = np.linspace(0.0, 3.0, 30_001)[:-1]
ROW = {"ends": [(0.0, 1.0), (1.0, 3.0)], "mean": [0.4, 0.7], "var": [0.5, 0.7]}


def test_two_adjoining_pieces_become_one():
    """The mean precision and the weighted mean by shares, all of the weight, both intervals."""
    old, log_weight = branches(**ROW, weight=[0.3, 0.7], cell=2, slope=0.5, shift=-0.3)
    new, weight, distance = merge(old, log_weight, 9.0)
    assert ends_of(new) == [(0.0, 3.0)]
    precision = 0.3 / 0.5 + 0.7 / 0.7
    np.testing.assert_allclose(new.cov, [[[[1 / precision]]]], rtol=1e-14)
    mean = (0.3 * 0.4 / 0.5 + 0.7 * 0.7 / 0.7) / precision
    np.testing.assert_allclose(new.mean, [[[mean]]], rtol=1e-14)
    np.testing.assert_allclose(weight, [[0.0]], atol=1e-15)
    mass = np.diff(norm.cdf([0.0, 3.0], mean, precision**-0.5))
    np.testing.assert_allclose(new.log_unit, -np.log([mass]), rtol=1e-13)
    assert (new.cell, new.slope, new.shift) == (2, 0.5, -0.3)
    wanted = variation(np.log(density(old, GRID) / density(new, GRID)))
    np.testing.assert_allclose(distance, wanted, rtol=1e-4)


@pytest.mark.parametrize("row", [True, False])
def test_the_tolerance_is_the_largest_distance_that_is_allowed(row):
    ends = ROW["ends"] if row else [(0.0, 3.0)] * 2
    old, log_weight = branches(ends, [0.4, 0.7], [0.5, 0.7], [0.3, 0.7])
    distance = merge(old, log_weight, 9.0)[2].item()
    assert distance > 0.01
    assert merge(old, log_weight, distance)[2] == distance
    kept, weight, none = merge(old, log_weight, np.nextafter(distance, 0.0))
    assert kept is old
    assert weight is log_weight
    assert none.tolist() == [0.0]


def test_two_laws_on_one_interval_become_one():
    """Each is compared with its share of the new law, so that the sum deviates by less."""
    old, log_weight = branches([(0.0, 3.0)] * 2, [0.9, 0.4], [0.5, 0.7], [0.3, 0.7])
    new, weight, distance = merge(old, log_weight, 9.0)
    assert ends_of(new) == [(0.0, 3.0)]
    precision = 0.3 / 0.5 + 0.7 / 0.7
    np.testing.assert_allclose(new.cov, [[[[1 / precision]]]], rtol=1e-14)
    np.testing.assert_allclose(new.mean[0], (0.3 * 0.9 / 0.5 + 0.4) / precision, rtol=1e-14)
    np.testing.assert_allclose(weight, [[0.0]], atol=1e-15)
    ratios = [
        np.log(density(branches([(0.0, 3.0)], m, v, 1.0)[0], GRID) / density(new, GRID))
        for m, v in ((0.9, 0.5), (0.4, 0.7))
    ]
    np.testing.assert_allclose(distance, variation(np.stack(ratios)), rtol=1e-4)
    assert variation(np.log(density(old, GRID) / density(new, GRID))) < distance


@pytest.mark.parametrize(
    "apart",
    [{"cell": [0, 1]}, {"slope": [1.0, -1.0]}, {"shift": [0.5, -0.5]}, {"shift": [0, 1e-9]}],
)
@pytest.mark.parametrize("row", [True, False])
def test_pieces_of_other_cells_or_coordinates_stay_apart(row, apart):
    ends = ROW["ends"] if row else [(0.0, 3.0)] * 2
    old, log_weight = branches(ends, ROW["mean"], ROW["var"], [0.3, 0.7], **apart)
    assert merge(old, log_weight, 9.0)[0] is old


@pytest.mark.parametrize("tiny", [0.0, 1e-13, -1e-13])
def test_ends_that_differ_by_rounding_are_the_same(tiny):
    row = [(-2.0 + tiny, 1.0), (1.0 + tiny, 3.0)]
    stack = [(-2.0 + tiny, 3.0), (-2.0, 3.0 - tiny)]
    for ends in (row, stack):
        old, log_weight = branches(ends, [0.4, 0.7], 0.6, 0.5, slope=[1.0, 1.0 + tiny])
        assert merge(old, log_weight, 9.0)[1].shape == (1, 1)


@pytest.mark.parametrize(
    "ends",
    [
        [(-1.0, 1.0), (1.0 + 1e-9, 3.0)],  # a gap
        [(-1.0, 2.0), (1.0, 3.0)],  # an overlap
        [(-1.0, 3.0), (1.0, 3.0)],
        [(-3.0, 2.0), (-3.0, 1.0)],
        [(-2.0, 1.0), (-1.0, 2.0)],
        [(-1.0, 1.0), (-1.0, 1.0 + 1e-9)],
    ],
)
def test_intervals_that_are_neither_the_same_nor_adjoining_stay_apart(ends):
    old, log_weight = branches(ends, [0.4, 0.7], 0.6, 0.5)
    assert merge(old, log_weight, 9.0)[0] is old


def test_half_lines_with_one_variance_are_merged_and_with_others_are_not():
    """Only where the variances are the same does the ratio stay bounded on an infinite interval."""
    ends = [(-INF, 0.0), (0.0, INF)]
    old, log_weight = branches(ends, 0.2, 0.6, [0.4, 0.6])
    new, weight, distance = merge(old, log_weight, 9.0)
    assert ends_of(new) == [(-INF, INF)]
    np.testing.assert_allclose(np.exp(weight), 1.0)
    at = np.array([-1.0, 1.0])
    wanted = variation(np.log(density(old, at) / density(new, at)))
    np.testing.assert_allclose(distance, wanted, rtol=1e-13)
    for mean, var in ((0.2, [0.6, 0.7]), ([0.2, 0.3], 0.6)):
        old, log_weight = branches(ends, mean, var, [0.4, 0.6])
        assert merge(old, log_weight, 1e9)[0] is old


def test_a_dropped_piece_does_not_keep_its_neighbours_apart():
    """The first of three adjoining pieces holds no weight in any data set."""
    ends = [(-1.0, 0.0), *ROW["ends"]]
    old, log_weight = branches(ends, [-0.4, 0.4, 0.7], 0.6, [0.0, 0.3, 0.7])
    new, weight, _ = merge(old, log_weight, 9.0)
    assert ends_of(new) == [(0.0, 3.0)]
    np.testing.assert_allclose(weight, [[0.0]], atol=1e-15)
    old, log_weight = branches([(0.0, 3.0)] * 3, [-0.4, 0.4, 0.7], 0.6, [0.3, 0.0, 0.7])
    new, weight, _ = merge(old, log_weight, 9.0)
    np.testing.assert_allclose(weight, [[0.0]], atol=1e-15)


def test_a_dropped_piece_between_two_keeps_them_apart():
    ends = [(0.0, 1.0), (1.0, 2.0), (2.0, 3.0)]
    old, log_weight = branches(ends, 0.6, 0.6, [0.3, 0.0, 0.7])
    assert merge(old, log_weight, 9.0)[0] is old


def test_a_piece_beside_two_others_goes_with_one_of_them():
    """Two laws on (0, 1), and two pieces that continue one of them."""
    ends = [(0.0, 1.0), (1.0, 3.0), (0.0, 1.0), (3.0, 4.0)]
    old, log_weight = branches(ends, [0.4, 0.4, 9.0, 0.4], 0.6, [0.25, 0.125, 0.5, 0.125])
    new, weight, _ = merge(old, log_weight, 9.0)
    assert sorted(ends_of(new)) == [(0.0, 1.0), (0.0, 4.0)]
    np.testing.assert_allclose(np.exp(weight).sum(), 1.0, rtol=1e-14)
    np.testing.assert_allclose(new.mean[0, :, 0], [9.0, 0.4], rtol=1e-14)


def test_chains_end_where_the_law_changes():
    """Six adjoining pieces, given out of order: two, three and one."""
    ends = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6)])
    mean, var = np.array([1.0, 1.1, 4.0, 4.1, 4.2, 9.0]), np.array([1, 1, 0.8, 0.8, 0.8, 2.0])
    weight, turn = np.array([0.1, 0.11, 0.16, 0.35, 0.23, 0.05]), np.array([4, 1, 5, 0, 3, 2])
    old, log_weight = branches(ends[turn], mean[turn], var[turn], weight[turn])
    new, found, distance = merge(old, log_weight, 1.5)
    order = np.argsort(new.regions.lower)
    assert [ends_of(new)[k] for k in order] == [(0.0, 2.0), (2.0, 5.0), (5.0, 6.0)]
    np.testing.assert_allclose(np.exp(found[order, 0]), [0.21, 0.74, 0.05])
    np.testing.assert_allclose(new.cov[0, 0, order, 0], [1.0, 0.8, 2.0], rtol=1e-13)
    means = [1 + 0.011 / 0.21, 4 + (0.035 + 0.046) / 0.74, 9.0]
    np.testing.assert_allclose(new.mean[0, order, 0], means, rtol=1e-13)
    # of the three: the bounds of both merges one after the other
    points = np.linspace(0.0, 5.0, 50_001)[:-1]
    ratio = np.log(density(old, points) / density(new, points))
    assert variation(ratio) <= distance * (1 + 1e-12)
    middle = branches([(2.0, 4.0)], 4.0 + 0.035 / 0.51, 0.8, 0.51)[0]
    here = points[(points >= 2) & (points < 4)]
    one, two = density(old, here), density(middle, here)
    steps = np.log(one / two), np.log(two / density(new, here))
    rest = ratio[points < 2], ratio[points >= 4]
    high = max(sum(step.max() for step in steps), *(part.max() for part in rest))
    low = min(sum(step.min() for step in steps), *(part.min() for part in rest))
    np.testing.assert_allclose(distance, high - low, rtol=1e-4)


def several(seed, stacks=1, touching=True, datasets=1):
    """Branches on four intervals with a number of laws on each, some of them dropped."""
    rng = np.random.default_rng(seed)
    ends = np.array([(-1.0, -0.2), (-0.2, 0.5), (0.5, 1.3), (1.3, 2.0)])
    ends = np.repeat(ends - (0.0 if touching else [0.0, 0.1]), stacks, axis=0)
    count = len(ends)
    mean = rng.choice([0.0, 0.9], (count, datasets)) + 0.3 * rng.standard_normal((count, datasets))
    var = rng.choice([0.5, 0.8], (count, datasets))
    mass = np.diff(norm.cdf(ends[..., None], mean[:, None], var[:, None] ** 0.5), axis=1)[:, 0]
    weight = mass * rng.uniform(1.0, 1.3, (count, datasets))
    weight *= rng.random((count, datasets)) < 0.8
    turn = rng.permutation(count)
    weight /= weight.sum(axis=0)
    return branches(ends[turn], mean[turn], var[turn], weight[turn])


def part(found, dataset):
    each = slice(dataset, dataset + 1)
    return found._replace(
        mean=found.mean[..., each], cov=found.cov[..., each], log_unit=found.log_unit[:, each]
    )


POINTS = np.linspace(-1.0, 2.0, 3001)[:-1]


@pytest.mark.parametrize(("stacks", "touching"), [(1, True), (5, False)])
def test_every_data_set_is_merged_by_itself(stacks, touching):
    old, log_weight = several(3, stacks, touching, 8)
    new, weight, distance = merge(old, log_weight, 0.4)
    count = (weight > -INF).sum(axis=0)
    assert np.ptp(count) > 0
    assert (count <= (log_weight > -INF).sum(axis=0)).all()
    assert (distance == 0.0).any() or stacks > 1
    for n in range(8):
        alone, its, far = merge(part(old, n), log_weight[:, n : n + 1], 0.4)
        np.testing.assert_allclose(far, distance[n], rtol=1e-12)
        np.testing.assert_allclose(density(alone, POINTS), density(new, POINTS, n), rtol=1e-11)
        found = np.sort(weight[weight[:, n] > -INF, n])
        np.testing.assert_allclose(np.sort(its[its > -INF]), found, rtol=1e-11, atol=1e-13)
        assert (new.log_unit[weight[:, n] == -INF, n] == -INF).all()


def test_merging_leaves_what_it_was_given_as_it_was():
    old, log_weight = several(5, 3, datasets=2)
    parts = old.mean, old.cov, old.log_unit, old.regions.lower, old.regions.upper, log_weight
    before = [part.copy() for part in parts]
    assert (merge(old, log_weight, 0.6)[2] > 0.0).all()
    for part, copy in zip(parts, before, strict=True):
        np.testing.assert_array_equal(part, copy)


def test_the_distance_bounds_what_merging_has_changed():
    """The variation of the log-ratio of the two laws, and the total variation between them."""
    shares = []
    for seed in range(12):
        old, log_weight = several(seed, 3)
        new, weight, distance = merge(old, log_weight, 0.6)
        assert len(weight) < (log_weight > -INF).sum()
        np.testing.assert_allclose(np.exp(weight).sum(), 1.0, rtol=1e-13)
        one, other = density(old, POINTS), density(new, POINTS)
        shares.append(variation(np.log(one / other)) / distance.item())
        assert 0.5 * np.abs(one - other).mean() * 3.0 <= np.tanh(distance / 4)
    assert max(shares) <= 1.0
    assert max(shares) > 0.5
