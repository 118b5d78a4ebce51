import numpy as np
import pytest
import sympy as sp

from oracles import piecewise_routes as routes
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem

INF = np.inf


# --- moving regions -----------------------------------------------------------------------------


def test_tent_map_has_as_many_branches_as_itineraries():
    y = routes.tent().simulate(10, 2, 5).measurements
    states = list(PiecewiseLinearFilter(routes.tent()).states(10, y))
    counts = [len(state.branches.cell) for state in states[1:]]
    assert counts == [4, 8, 16, 30, 56, 104, 190, 346, 628, 1134]


def test_moving_regions_against_quadrature():
    y = routes.tent().simulate(9, 3, 5).measurements
    y[4, 0, 1] = np.nan
    found = PiecewiseLinearFilter(routes.tent()).run(9, y)
    points, weights = routes.tent_nodes(9)
    prior = -0.5 * (points - 0.1) ** 2 / 0.25
    for dataset in range(3):
        route = routes.posterior(
            points, prior, weights, lambda x: 1 - 1.8 * np.abs(x), np.abs, 0.2, y[1:, 0, dataset]
        )
        routes.compare(found, route, dataset, 2e-12)


def branch_density(state, points, dataset):
    """Density of a scalar state from its branches; regions in the present coordinate."""
    b, regions = state.branches, state.branches.regions
    assert (b.slope == 1.0).all()
    assert not b.shift.any()
    here = np.flatnonzero(b.log_unit[:, dataset] > -INF)
    var = np.broadcast_to(b.cov[0, 0], b.mean[0].shape)[here, dataset, None]
    gap = points - b.mean[0, here, dataset, None]
    low, high = regions.lower[here, None], regions.upper[here, None]
    log = b.log_unit[here, dataset, None] - 0.5 * gap**2 / var - 0.5 * np.log(2 * np.pi * var)
    inside = (low <= points) & (points < high)
    return np.where(inside, np.exp(np.where(inside, log, 0.0)), 0.0).sum(axis=0)


def total_variation(one, other, dataset):
    """Distance between two laws, by quadrature between the ends of all regions."""
    ends = [s.branches.regions for s in (one, other)]
    edges = np.concatenate([np.concatenate([e.lower, e.upper]) for e in ends])
    edges = np.unique(np.clip(edges, -8.0, 1.0))
    points, weights = routes.panels(edges[np.append(True, np.diff(edges) > 1e-12)], 2, 12)
    difference = branch_density(one, points, dataset) - branch_density(other, points, dataset)
    return 0.5 * (np.abs(difference) * weights).sum()


@pytest.mark.parametrize(
    "options",
    [
        {"prune": 1e-2},
        {"prune": 1e-3},
        {"prune": 1e-5},
        {"merge": 0.1},
        {"prune": 1e-4, "merge": 0.02},
    ],
)
def test_bound_of_pruning_and_merging_is_never_violated(options):
    y = routes.tent().simulate(8, 12, 11).measurements
    exact = list(PiecewiseLinearFilter(routes.tent()).states(8, y))
    cut = list(PiecewiseLinearFilter(routes.tent(), **options).states(8, y))
    ratios = []
    for full, less in zip(exact[1:], cut[1:], strict=True):
        assert less.weights.sum(axis=0) == pytest.approx(1.0)
        for dataset in range(12):
            variation = total_variation(full, less, dataset)
            assert variation <= less.error_bound[dataset] * (1 + 1e-5) + 1e-11
            if variation > 1e-8:
                ratios.append(less.error_bound[dataset] / variation)
    assert len(ratios) > 20
    if "merge" not in options:
        assert np.median(ratios) < 50.0
    count = cut[-1].noticeable(1e-300)
    assert (count < exact[-1].noticeable(1e-300)).all()


def test_pruning_keeps_the_estimate():
    y = routes.tent().simulate(10, 30, 2).measurements
    exact = PiecewiseLinearFilter(routes.tent()).run(10, y)
    cut = PiecewiseLinearFilter(routes.tent(), prune=1e-5)
    states = list(cut.states(10, y))
    error = np.stack([s.mean for s in states]) - exact.mean
    assert np.abs(error).max() < 1e-3
    assert np.median(states[-1].error_bound) < 0.02
    assert states[-1].noticeable(0.0, relative=False).max() < 1134


def test_largest_branches_are_kept():
    y = routes.tent().simulate(12, 6, 2).measurements
    exact = PiecewiseLinearFilter(routes.tent()).run(10, y[:11])
    states = list(PiecewiseLinearFilter(routes.tent(), keep=40).states(12, y))
    assert max(s.noticeable(0.0, relative=False).max() for s in states) <= 2 * 6 * 40
    assert ((states[12].weights > 0).sum(axis=0) <= 40).all()
    shift = np.abs(states[10].mean - exact.mean[10])[0] / np.sqrt(exact.cov[10, 0, 0])
    assert np.median(shift) < 0.05
    assert (states[10].error_bound > 0.0).all()


def test_merging_removes_branches_that_share_an_interval():
    y = routes.tent().simulate(10, 1, 5).measurements[..., 0]
    exact = list(PiecewiseLinearFilter(routes.tent()).states(10, y))[-1]
    merged = list(PiecewiseLinearFilter(routes.tent(), merge=0.01).states(10, y))[-1]
    assert len(merged.branches.cell) < 300
    assert abs(merged.mean - exact.mean)[0] < 1e-6
    assert 0.0 < merged.error_bound < 0.05


def chords(function, edges):
    """Offsets and slopes of the continuous interpolation between the edges, and beyond them."""
    slope = np.diff(function(edges)) / np.diff(edges)
    return (function(edges[:-1]) - slope * edges[:-1])[None], slope[None, None]


def test_adjoining_pieces_of_a_continuous_map_are_merged():
    """A fine interpolation of a smooth map: neighbours on adjoining intervals become one."""
    edges = np.linspace(-2, 2, 21)
    system = PiecewiseLinearSystem(
        regions=np.concatenate([[-INF], edges[1:-1], [INF]]),
        dynamics=chords(lambda x: 0.9 * x + np.sin(x) / 5, edges),
        sensor=([0.0], [[1.0]]), sensor_noise=[[1.0]], mean0=[0.3], cov0=[[0.16]],
    )  # fmt: skip
    y = system.simulate(4, 6, 3).measurements
    exact = PiecewiseLinearFilter(system).run(4, y)
    plain = list(PiecewiseLinearFilter(system).states(4, y))
    merged = list(PiecewiseLinearFilter(system, merge=0.1).states(4, y))
    assert (2 * merged[-1].noticeable(1e-300) < plain[-1].noticeable(1e-300)).all()
    error = np.abs(merged[-1].mean - exact.mean[-1])[0] / np.sqrt(exact.cov[-1, 0, 0])
    assert error.max() < 0.02
    assert (merged[-1].error_bound < 0.1).all()
    for dataset in range(6):
        variation = total_variation(plain[-1], merged[-1], dataset)
        assert 1e-9 < variation < merged[-1].error_bound[dataset]


def test_too_many_branches_are_an_error():
    filter_ = PiecewiseLinearFilter(routes.tent(), max_branches=100)
    with pytest.raises(ValueError, match="max_branches: got 104 branches at t = 6"):
        filter_.run(10, routes.measurements(np.zeros(10)))


# --- collapsing dynamics ------------------------------------------------------------------------


def test_collapsed_regions_against_quadrature():
    y = routes.saturation().simulate(7, 4, 7).measurements
    states = list(PiecewiseLinearFilter(routes.saturation()).states(7, y))
    assert [len(s.branches.cell) for s in states][-1] == 17
    found = PiecewiseLinearFilter(routes.saturation()).run(7, y)
    kinks, level = {-1.0, 1.0}, [-1.0, 1.0]
    for _ in range(8):
        level = [(z - 0.1) / 1.3 for z in level]
        kinks |= {z for z in level if -1 < z < 1}
    reach = 12 * np.sqrt(0.6)
    points, weights = routes.panels(np.array([0.2 - reach, *sorted(kinks), 0.2 + reach]), 4, 60)
    prior = -0.5 * (points - 0.2) ** 2 / 0.6

    def move(x):
        return np.where(x < -1, -1.2, np.where(x < 1, 0.1 + 1.3 * x, 1.4))

    def sensor(x):
        return np.where(np.abs(x) < 1, x, 0.5 * (x + np.sign(x)))

    for dataset in range(4):
        routes.compare(
            found,
            routes.posterior(points, prior, weights, move, sensor, 0.3, y[1:, 0, dataset]),
            dataset,
            1e-12,
        )


def test_contracting_map_keeps_its_digits_for_hundreds_of_steps():
    """x halves at every step and its sign is kept: the exact answer is known in closed form."""
    system = PiecewiseLinearSystem(
        regions=[-INF, 0.0, INF],
        dynamics=([0.0], [[0.5]]),
        sensor=([[-1.0, 1.0]], [[[0.0, 0.0]]]),
        sensor_noise=[[3.0]],
        mean0=[0.4],
        cov0=[[1.0]],
    )
    y = np.ones(300)
    found = PiecewiseLinearFilter(system).run(300, routes.measurements(y))
    positive = 0.5 * (1 + sp.erf(0.4 / sp.sqrt(2)).evalf())
    odds = float(positive / (1 - positive)) * np.exp(2 * np.arange(301) / 9.0)
    assert found.mode_prob[:, 1] == pytest.approx(odds / (1 + odds), rel=1e-13)
    phi = np.exp(-0.08) / np.sqrt(2 * np.pi)
    right, left = 0.4 + phi / float(positive), 0.4 - phi / float(1 - positive)
    mean = (odds * right + left) / (1 + odds) * 0.5 ** np.arange(301)
    assert found.mean[:, 0] == pytest.approx(mean, rel=1e-12)


def test_contraction_to_a_point_off_the_origin_keeps_the_weights():
    """x halves its distance to 2: images of the cells soon have no width in double precision."""
    system = PiecewiseLinearSystem(
        regions=[-INF, 2.0, INF],
        dynamics=([1.0], [[0.5]]),
        sensor=([[-1.0, 1.0]], [[[0.0, 0.0]]]),
        sensor_noise=[[3.0]],
        mean0=[2.4],
        cov0=[[1.0]],
    )
    found = PiecewiseLinearFilter(system).run(200, routes.measurements(np.ones(200)))
    positive = float(0.5 * (1 + sp.erf(0.4 / sp.sqrt(2)).evalf()))
    odds = positive / (1 - positive) * np.exp(2 * np.arange(201) / 9.0)
    assert found.mode_prob[:, 1] == pytest.approx(odds / (1 + odds), rel=1e-9)
