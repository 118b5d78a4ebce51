"""Piecewise-linear systems: cuts, cells and pruning against points and plain loops."""

import numpy as np
import pytest

from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem
from seedslib.piecewise.cells import Intervals, line_cells
from seedslib.piecewise.geometry import IntervalRegions, PolygonRegions
from seedslib.piecewise.weights import prune

INF = np.inf
TENT = {
    "regions": [-INF, -0.4, 0.7, INF], "dynamics": ([[0.9, 0.3, 1.1]], [[[1.1, -0.6, -1.7]]]),
    "noise": [[0.35]], "sensor": ([[0.2, 0.0, -0.1]], [[[-0.7, 1.2, 0.8]]]),
    "sensor_noise": [[0.45]], "mean0": [0.15], "cov0": [[0.6]],
}  # fmt: skip


@pytest.mark.parametrize("known", [False, True])
def test_pieces_of_regions_hold_the_points_that_lie_in_their_cells(known):
    rng = np.random.default_rng(4)
    lower, slope = rng.uniform(-4.0, 1.0, 40), rng.uniform(-2.0, 2.0, 40)
    upper, shift = lower + rng.uniform(0.1, 5.0, 40), rng.uniform(-3.0, 3.0, 40)
    slope[::5] = 0.0
    lower[7], upper[11] = -INF, INF
    cells = Intervals([-INF, -1.3, 0.2, 1.9, INF])
    target = np.where(np.arange(40) % 3 == 0, np.arange(40) % 4, -1) if known else None
    parent, cell, pieces = IntervalRegions(lower, upper).split(
        cells, slope[None, None], shift[None], target
    )
    for b in range(40):
        s = np.linspace(max(lower[b], -9.0), min(upper[b], 9.0), 400)[1:-1]
        wanted = cells.locate((shift[b] + slope[b] * s)[None])
        if known and target[b] >= 0:
            wanted = np.full(s.size, target[b])
        held = np.full(s.size, -1)
        for k in np.flatnonzero(parent == b):
            held[(pieces.lower[k] <= s) & (s < pieces.upper[k])] = cell[k]
        np.testing.assert_array_equal(held, wanted)


@pytest.mark.parametrize("size", [1, 2])
def test_bounds_of_masses_lie_above_them_and_are_met_by_small_and_large_regions(size):
    """Width or area, the whole, and half of it at the distance of the nearest edge."""
    unit = np.array([[-0.3, 0.9, 0.2], [-0.7, 0.1, 0.8]])[:size]
    mean = np.repeat(np.array([[0.4], [-1.1]])[:size, :, None], 4, axis=1)
    cov = np.array([[1.7, 0.5], [0.5, 0.6]])[:size, :size, None, None] * np.ones((4, 1))
    # about the mean and small; about the mean and large; two at a distance, small and large
    shapes = [(1e-3, 0.0), (60.0, 0.0), (1e-3, 2.6), (40.0, 70.0)]
    parts = [mean[:, 0] + scale * unit + away * np.eye(2)[:size, :1] for scale, away in shapes]
    if size == 1:
        regions = IntervalRegions(*np.array([[p.min(), p.max()] for p in parts]).T)
    else:
        regions = PolygonRegions(tuple(parts))
    bound = regions.log_mass_bound(mean, cov)[:, 0]
    exact = regions.moments(np.arange(4), mean[..., 0], cov[..., 0]).log_mass
    assert (bound >= exact - 1e-12).all()
    np.testing.assert_allclose(bound[:2], exact[:2], atol=3e-3)
    assert bound[2] - exact[2] < (0.02 if size == 1 else 0.5)
    assert bound[3] < -100.0
    assert exact[3] < bound[3] < 0.5 * exact[3]
    # just beside the mean, half of the law
    if size == 1:
        beside = IntervalRegions(np.array([0.401]), np.array([60.0]))
    else:
        sides = np.array([[0.401, 60.0, 60.0, 0.401], [-60.0, -60.0, 60.0, 60.0]])
        beside = PolygonRegions((sides,))
    assert beside.log_mass_bound(mean[:, :1], cov[:, :, :1]).item() == pytest.approx(
        -np.log(2.0), abs=1e-6
    )


@pytest.mark.parametrize("keep", [None, 3])
def test_pruning_against_a_plain_loop(keep):
    weight = np.random.default_rng(2).gamma(0.3, size=(9, 50))
    weight /= weight.sum(axis=0)
    dropped, lost = prune(weight, 0.07, keep)
    assert dropped.dtype == bool
    for n in range(50):
        held, wanted = 0.0, np.zeros(9, bool)
        for place, b in enumerate(np.argsort(weight[:, n])):
            held += weight[b, n]
            wanted[b] = held <= 0.07 or (keep is not None and place < 9 - keep)
        np.testing.assert_array_equal(dropped[:, n], wanted)
        assert lost[n] == pytest.approx(weight[wanted, n].sum(), abs=1e-15)


@pytest.mark.parametrize("length", [1e-3, 1.0, 250.0])
def test_lengths_of_normals_do_not_matter(length):
    parallel = line_cells(length * np.array([[1.0, 1.0], [0.0, 0.0]]), length * np.array([5, -3]))
    assert parallel.count == 3
    assert line_cells(length * np.array([[1.0, 0.4], [0.2, -1.0]]), [0.3, 7.0]).count == 4
    where = parallel.locate(np.array([[-4.0, 0.0, 6.0, 4.9], [1.0, -2.0, 0.5, 30.0]]))
    assert where[1] == where[3]
    assert len({*where.tolist()}) == 3


def test_one_number_is_no_noise_matrix():
    for name in ("noise", "sensor_noise"):
        with pytest.raises(ValueError, match=r"\(noise\): wanted shape"):
            PiecewiseLinearSystem(**{**TENT, name: [0.3]})


def test_a_line_without_noise_against_points_of_the_start():
    system = PiecewiseLinearSystem(**{**TENT, "noise": None})
    y = np.array([[np.nan], [0.9], [-0.3], [np.nan], [0.4]])
    found = PiecewiseLinearFilter(system).run(4, y)
    x = np.linspace(-6.0, 6.0, 40001)
    weight = np.exp(-0.5 * (x - 0.15) ** 2 / 0.6)
    weight /= weight.sum()
    c, d = system.dynamics_at(0.0), system.sensor_at(0.0)
    for k in range(1, 5):
        cell = system.regions.locate(x[None])
        x = c.offset[0, cell, 0] + c.matrix[0, 0, cell, 0] * x
        cell, total = system.regions.locate(x[None]), 1.0
        if np.isfinite(y[k, 0]):
            error = y[k, 0] - d.offset[0, cell, 0] - d.matrix[0, 0, cell, 0] * x
            weight = weight * np.exp(-0.5 * (error / 0.45) ** 2) / (0.45 * np.sqrt(2 * np.pi))
            total = weight.sum()
            weight /= total
        mean = weight @ x
        assert found.mean[k, 0] == pytest.approx(mean, abs=1e-3)
        assert found.cov[k, 0, 0] == pytest.approx(weight @ (x - mean) ** 2, abs=1e-3)
        assert found.loglik[k] == pytest.approx(np.log(total), abs=1e-3)
        np.testing.assert_allclose(
            found.mode_prob[k], np.bincount(cell, weight, minlength=3), atol=1e-3
        )


def test_an_impossible_reading_leaves_the_other_data_sets_alone():
    weak = {"sensor": ([[0.2, 0.0, -0.1]], [[[-0.07, 0.12, 0.08]]]), "sensor_noise": [[0.02]]}
    system = PiecewiseLinearSystem(**{**TENT, **weak})
    y = np.array([[[np.nan] * 3], [[0.1, 1.7e308, -0.2]], [[-0.03, 0.1, 0.04]]])
    found = PiecewiseLinearFilter(system).run(2, y)
    for n in (0, 2):
        alone = PiecewiseLinearFilter(system).run(2, y[..., n])
        np.testing.assert_allclose(found.mean[..., n], alone.mean, rtol=1e-12)
        np.testing.assert_allclose(found.cov[..., n], alone.cov, rtol=1e-12)
        np.testing.assert_allclose(found.loglik[..., n], alone.loglik, rtol=1e-12)


def test_the_paths_of_a_seed():
    found = PiecewiseLinearSystem(**TENT).simulate(2, 2, 11)
    states = [[0.184905140452, -0.323095557437], [-0.467352918421, 0.611616763805],
              [0.463884994301, -0.196648799249]]  # fmt: skip
    seen = [[0.027419660185, 1.530201537373], [-0.008207709007, 0.136582975971]]
    np.testing.assert_allclose(found.states[:, 0], states, atol=1e-11)
    np.testing.assert_allclose(found.measurements[1:, 0], seen, atol=1e-11)
