from itertools import pairwise

import numpy as np
import pytest
import sympy as sp

from seedslib.filters.particle import ParticleFilter
from seedslib.filters.piecewise import PiecewiseLinearFilter
from seedslib.systems import zoo
from seedslib.systems.piecewise import PiecewiseLinearSystem
from seedslib.systems.piecewise_cells import line_cells

INF = np.inf


# --- independent routes: no Kalman recursion on restricted laws anywhere below -----------------


def panels(edges, per_panel=1, order=60):
    """Gauss-Legendre nodes and weights between consecutive edges."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    edges = np.concatenate(
        [np.linspace(a, b, per_panel, endpoint=False) for a, b in pairwise(edges)] + [edges[-1:]]
    )
    half, middle = 0.5 * np.diff(edges), 0.5 * (edges[:-1] + edges[1:])
    return (middle[:, None] + half[:, None] * nodes).ravel(), (half[:, None] * weights).ravel()


def posterior(points, log_prior, weights, move, sensor, noise, y):
    """Mean, variance and log-likelihood at every time, by summing over deterministic paths."""
    weight = weights * np.exp(log_prior)
    weight = weight / weight.sum()
    x, out = points.copy(), []
    for value in y:
        x = move(x)
        if np.isfinite(value):
            density = np.exp(-0.5 * ((value - sensor(x)) / noise) ** 2) / noise / np.sqrt(2 * np.pi)
        else:
            density = np.ones_like(x)
        total = (weight * density).sum()
        weight = weight * density / total
        mean = (weight * x).sum()
        out.append((mean, (weight * (x - mean) ** 2).sum(), np.log(total)))
    return np.array(out).T


def kalman(system, y):
    """Plain Kalman filter with the coefficients of the first cell."""
    mean, cov, out = system.mean0, system.cov0, []
    for t, value in enumerate(y, start=1):
        a, A, G = (part[..., 0, 0] for part in system.dynamics_at(t))
        b, B, H = (part[..., 0, 0] for part in system.sensor_at(t))
        mean, cov = a + A @ mean, A @ cov @ A.T + G @ G.T
        spread = B @ cov @ B.T + H @ H.T
        gain, error = np.linalg.solve(spread, B @ cov).T, value - b - B @ mean
        density = error @ np.linalg.solve(spread, error) + np.linalg.slogdet(2 * np.pi * spread)[1]
        mean, cov = mean + gain @ error, cov - gain @ spread @ gain.T
        out.append((mean, cov, -0.5 * density))
    return [np.stack(part) for part in zip(*out, strict=True)]


def compare(estimates, route, dataset, tolerance):
    """Mean in posterior deviations and ulps, variance relative, log-likelihood absolute."""
    mean, var, loglik = route
    error = np.abs(estimates.mean[1:, 0, dataset] - mean)
    assert (error <= tolerance * np.sqrt(var) + 1e-15 * np.abs(mean)).all()
    assert estimates.cov[1:, 0, 0, dataset] == pytest.approx(var, rel=tolerance, abs=1e-15)
    assert estimates.loglik[1:, dataset] == pytest.approx(loglik, abs=tolerance)


def tent(**changes):
    parts = {
        "regions": [-INF, 0.0, INF],
        "dynamics": ([[1.0, 1.0]], [[[1.8, -1.8]]]),
        "sensor": ([[0.0, 0.0]], [[[-1.0, 1.0]]]),
        "sensor_noise": [[0.2]],
        "mean0": [0.1],
        "cov0": [[0.25]],
    }
    return PiecewiseLinearSystem(**(parts | changes))


def tent_nodes(steps):
    """Nodes between all points that some iterate of the tent map sends to its kink."""
    kinks = level = np.zeros(1)
    for _ in range(steps):
        level = np.concatenate([(1 - level) / 1.8, (level - 1) / 1.8])
        kinks = np.concatenate([kinks, level])
    kinks = np.unique(kinks[np.abs(kinks - 0.1) < 6.0])
    return panels(np.concatenate([[-5.9], kinks[np.abs(kinks - 0.1) < 5.9], [6.1]]), 6, 24)


def measurements(values):
    """Records with nothing measured at the first time; values (K, N) or (K,)."""
    values = np.asarray(values, dtype=float)
    return np.concatenate([np.full((1, 1, *values.shape[1:]), np.nan), values[:, None]])


def falling(start, noise):
    """Angles of a body that starts at range `start` and angle 0.1; noise (runs, 10)."""
    t = np.arange(1, noise.shape[1] + 1)[:, None]
    return measurements(0.1 - 0.005 * t**2 / start + 1e-3 * noise.T)


# --- fixed regions ------------------------------------------------------------------------------


def test_fixed_regions_against_quadrature_in_every_cell():
    system = zoo.falling_body(12)
    runs = np.random.default_rng(4).standard_normal((3, 10))
    y = np.concatenate([falling(5.0, runs[:2]), falling(50.0, runs[2:])], axis=2)
    found = PiecewiseLinearFilter(system).run(10, y)

    inner = system.regions.edges[1:-1]
    edges = np.concatenate([np.arange(-74.0, 5.0, 0.3), inner, np.arange(50.0, 129.0, 0.3)])
    x, weight = panels(np.unique(edges), 6, 20)
    angle, share = np.polynomial.hermite_e.hermegauss(12)
    cell = system.regions.locate(x[None])
    log_prior = -0.5 * ((x - 27.5) / 11.25) ** 2
    for dataset in range(3):
        state = np.repeat(0.1 + 1e-6 * angle[:, None], x.size, axis=1)
        log_density = log_prior + np.log(share / share.sum())[:, None]
        before = np.log((np.exp(log_density) * weight).sum())
        for t in range(1, 11):
            c = system.dynamics_at(t)
            state = state + c.offset[1, cell, 0] + c.matrix[1, 0, cell, 0] * x
            error = (y[t, 0, dataset] - state) / 1e-3
            log_density = log_density - 0.5 * error**2 - np.log(1e-3 * np.sqrt(2 * np.pi))
            top = log_density.max()
            joint = np.exp(log_density - top) * weight
            total = joint.sum()
            mean = np.array([(joint * x).sum(), (joint * state).sum()]) / total
            offset = x - mean[0], state - mean[1]
            cov = np.array([[(joint * a * b).sum() for a in offset] for b in offset]) / total
            deviation = np.sqrt(np.diag(cov))
            error = (found.mean[t, :, dataset] - mean) / deviation
            assert np.abs(error).max() <= 5e-13
            gap = (found.cov[t, :, :, dataset] - cov) / np.outer(deviation, deviation)
            assert np.abs(gap).max() <= 5e-13
            after = top + np.log(total)
            assert found.loglik[t, dataset] == pytest.approx(after - before, abs=5e-13)
            per_cell = np.bincount(cell, joint.sum(axis=0), minlength=12) / total
            assert found.mode_prob[t, :, dataset] == pytest.approx(per_cell, abs=5e-13)
            before = after


def figure(start, seed, runs, **options):
    noise = np.random.default_rng(seed).standard_normal((runs, 10))
    system = zoo.falling_body(**options)
    found = PiecewiseLinearFilter(system).run(10, falling(start, noise))
    error = found.mean[:, 0] - start
    return np.sqrt((error**2).mean(axis=1)) / start, error**2 / found.cov[:, 0, 0]


R5 = [4.22, 1.65, 0.141, 0.0604, 0.0334, 0.0212, 0.0149, 0.0108, 0.0081, 0.0062]
TAU5 = [3.52, 0.92, 0.90, 0.97, 0.95, 0.94, 0.98, 0.98, 0.96, 0.94]
R50 = [0.446, 0.409, 0.348, 0.276, 0.209, 0.160, 0.123, 0.096, 0.073, 0.057]
TAU50 = [4.18, 4.41, 4.28, 3.71, 2.99, 2.51, 2.17, 1.91, 1.67, 1.63]


@pytest.mark.parametrize(("start", "r", "tau"), [(5.0, R5, TAU5), (50.0, R50, TAU50)])
def test_falling_body_in_4000_runs(start, r, tau):
    """Relative errors and consistency of the figure, seed 1."""
    relative, ratio = figure(start, 1, 4000)
    assert relative[0] == pytest.approx(22.5 / start)
    assert ratio[0] == pytest.approx(4.0)
    digits = [0.005, 0.005, 0.0005] + [5e-5] * 7 if start == 5.0 else [5e-4] * 10
    assert (np.abs(relative[1:] - r) <= np.array(digits) * 1.01).all()
    assert ratio[1:].mean(axis=1) == pytest.approx(tau, abs=0.0051)


def test_falling_body_in_the_paper_s_20_runs():
    ratio = figure(50.0, 0, 20)[1].mean(axis=1)[1:]
    expected = [4.20, 4.31, 3.89, 3.33, 2.57, 2.07, 2.12, 1.52, 2.10, 2.27]
    assert ratio == pytest.approx(expected, abs=0.0051)
    ratio = figure(5.0, 0, 20)[1].mean(axis=1)[1:]
    expected = [3.41, 0.81, 0.74, 0.59, 0.84, 0.64, 0.96, 1.20, 1.34, 1.71]
    assert ratio == pytest.approx(expected, abs=0.0051)


def extended_kalman(y):
    """EKF of the falling body: mean and variance of the range, (K+1, N)."""
    x, z = np.full(y.shape[2], 27.5), np.full(y.shape[2], 0.1)
    p, q, s = np.full_like(x, 11.25**2), np.zeros_like(x), np.full_like(x, 1e-12)
    kept = [(x, p)]
    for t in range(1, len(y)):
        k = 0.01 * (t - 0.5)
        slope = k / x**2
        z, s, q = z - k / x, s + 2 * slope * q + slope**2 * p, q + slope * p
        w, error = s + 1e-6, y[t, 0] - z
        x, z = x + q / w * error, z + s / w * error
        p, q, s = p - q * q / w, q * 1e-6 / w, s * 1e-6 / w
        kept.append((x, p))
    return np.array(kept).swapaxes(0, 1)


def test_extended_kalman_filter_diverges_on_the_falling_body():
    noise = np.random.default_rng(1).standard_normal((4000, 10))
    mean, var = extended_kalman(falling(50.0, noise))
    ratio = ((mean - 50.0) ** 2 / var).mean(axis=1)
    expected = [4.0, 4.1, 4.4, 5.4, 7.0, 9.2, 11.7, 14.4, 17.1, 20.1]
    assert ratio[1:] == pytest.approx(expected, abs=0.06)
    mean, var = extended_kalman(falling(5.0, noise))
    median = np.median((mean - 5.0) ** 2 / var, axis=1)[1:]
    expected = [3.8, 1.2, 10, 280, 996, 2.4e3, 5.0e3, 9.2e3, 1.6e4, 2.5e4]
    assert median == pytest.approx(expected, rel=0.05)
    relative = np.sqrt(((mean - 5.0) ** 2).mean(axis=1)) / 5.0
    assert relative[1] == pytest.approx(4.4, abs=0.06)
    assert 30.0 < relative[10] < 50.0


def test_number_of_noticeable_branches():
    noise = np.random.default_rng(1).standard_normal((1000, 10))
    filter_ = PiecewiseLinearFilter(zoo.falling_body())
    states = list(filter_.states(10, falling(50.0, noise)))[1:]
    relative = [state.noticeable(0.01).mean() for state in states]
    expected = [23.6, 18.5, 9.5, 5.1, 3.0, 2.1, 1.5, 1.1, 1.0, 1.0]
    assert relative == pytest.approx(expected, abs=0.15)
    absolute = [state.noticeable(0.005, relative=False).mean() for state in states]
    expected = [16.7, 14.1, 8.7, 5.0, 3.1, 2.2, 1.6, 1.2, 1.0, 1.0]
    assert absolute == pytest.approx(expected, abs=0.15)


def exact_body(y, points):
    """Posterior mean and deviation of the range for the nonlinear model, (K, N)."""
    x = np.geomspace(1.0, 27.5 + 9 * 11.25, points)[:, None]
    log_weight = np.log(x) - 0.5 * ((x - 27.5) / 11.25) ** 2 + np.zeros((1, y.shape[2]))
    angle, var, out = np.full(log_weight.shape, 0.1), 1e-12, []
    for t in range(1, len(y)):
        angle = angle - 0.01 * (t - 0.5) / x
        error, spread = y[t] - angle, var + 1e-6
        log_weight = log_weight - 0.5 * error**2 / spread
        angle, var = angle + var / spread * error, var - var**2 / spread
        weight = np.exp(log_weight - log_weight.max(axis=0))
        weight /= weight.sum(axis=0)
        mean = (weight * x).sum(axis=0)
        out.append((mean, np.sqrt((weight * (x - mean) ** 2).sum(axis=0))))
    return np.array(out).swapaxes(0, 1)


def test_the_paper_s_partition_does_not_converge_and_an_even_one_does():
    noise = np.random.default_rng(0).standard_normal((20, 10))
    y = falling(50.0, noise)
    mean, deviation = exact_body(y, 6001)

    def error(system):
        found = PiecewiseLinearFilter(system).run(10, y).mean[1:, 0]
        return np.sqrt((((found - mean) / deviation) ** 2).mean(axis=1))[-1]

    assert error(zoo.falling_body(100)) == pytest.approx(0.40, abs=0.006)
    assert error(zoo.falling_body(800)) == pytest.approx(0.11, abs=0.006)
    wide = {"partition": "curvature", "span": (2.5, 100.0)}
    errors = [error(zoo.falling_body(n, **wide)) for n in (50, 100, 200)]
    assert errors == pytest.approx([0.0298, 0.0071, 0.0018], abs=2e-4)


def test_bodies_drawn_from_the_prior_are_judged_consistently():
    """At 50 km the exact posterior has a ratio above 3 as well; over the prior it is 1."""
    noise = np.random.default_rng(1).standard_normal((200, 10))
    mean, deviation = exact_body(falling(50.0, noise), 5001)
    assert (((mean - 50.0) / deviation)[:4] ** 2).mean(axis=1).min() > 3.0
    ours = PiecewiseLinearFilter(zoo.falling_body(100)).run(10, falling(50.0, noise))
    ratio = ((ours.mean[:, 0] - 50.0) ** 2 / ours.cov[:, 0, 0]).mean(axis=1)
    assert ratio[10] > 1.5

    rng = np.random.default_rng(2)
    start = 27.5 + 11.25 * rng.standard_normal(1500)
    start = start[start > 2.5]
    y = falling(start, rng.standard_normal((start.size, 10)))
    even = zoo.falling_body(100, partition="curvature", span=(2.5, 100.0))
    found = PiecewiseLinearFilter(even).run(10, y)
    square = (found.mean[1:, 0] - start) ** 2 / found.cov[1:, 0, 0]
    error = square.std(axis=1) / np.sqrt(start.size)
    assert (np.abs(square.mean(axis=1) - 1) < 4 * error).all()


def test_cutting_branches_of_the_falling_body_does_no_harm():
    y = falling(50.0, np.random.default_rng(1).standard_normal((300, 10)))
    system = zoo.falling_body(100)
    full = PiecewiseLinearFilter(system).run(10, y)
    states = list(PiecewiseLinearFilter(system, prune=1e-4).states(10, y))
    shift = np.stack([s.mean[0] for s in states]) - full.mean[:, 0]
    assert np.abs(shift / np.sqrt(full.cov[:, 0, 0])).max() < 0.02
    assert (states[-1].weights > 0).sum(axis=0).mean() < 4
    assert 0.0 < np.median(states[-1].error_bound) < 0.2


def test_support_points_that_follow_the_estimate_are_slightly_worse():
    still, follow = (figure(5.0, 0, 20, support=s)[1] for s in ("centroid", "estimate"))
    assert not np.array_equal(still, follow)
    assert follow[10].mean() == pytest.approx(1.80, abs=0.01)  # against 1.71


# --- moving regions -----------------------------------------------------------------------------


def test_tent_map_has_as_many_branches_as_itineraries():
    y = tent().simulate(10, 2, 5).measurements
    states = list(PiecewiseLinearFilter(tent()).states(10, y))
    counts = [len(state.branches.cell) for state in states[1:]]
    assert counts == [4, 8, 16, 30, 56, 104, 190, 346, 628, 1134]


def test_moving_regions_against_quadrature():
    y = tent().simulate(9, 3, 5).measurements
    y[4, 0, 1] = np.nan
    found = PiecewiseLinearFilter(tent()).run(9, y)
    points, weights = tent_nodes(9)
    prior = -0.5 * (points - 0.1) ** 2 / 0.25
    for dataset in range(3):
        route = posterior(
            points, prior, weights, lambda x: 1 - 1.8 * np.abs(x), np.abs, 0.2, y[1:, 0, dataset]
        )
        compare(found, route, dataset, 2e-12)


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
    points, weights = panels(edges[np.append(True, np.diff(edges) > 1e-12)], 2, 12)
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
    y = tent().simulate(8, 12, 11).measurements
    exact = list(PiecewiseLinearFilter(tent()).states(8, y))
    cut = list(PiecewiseLinearFilter(tent(), **options).states(8, y))
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
    y = tent().simulate(10, 30, 2).measurements
    exact = PiecewiseLinearFilter(tent()).run(10, y)
    cut = PiecewiseLinearFilter(tent(), prune=1e-5)
    states = list(cut.states(10, y))
    error = np.stack([s.mean for s in states]) - exact.mean
    assert np.abs(error).max() < 1e-3
    assert np.median(states[-1].error_bound) < 0.02
    assert states[-1].noticeable(0.0, relative=False).max() < 1134


def test_largest_branches_are_kept():
    y = tent().simulate(12, 6, 2).measurements
    exact = PiecewiseLinearFilter(tent()).run(10, y[:11])
    states = list(PiecewiseLinearFilter(tent(), keep=40).states(12, y))
    assert max(s.noticeable(0.0, relative=False).max() for s in states) <= 2 * 6 * 40
    assert ((states[12].weights > 0).sum(axis=0) <= 40).all()
    shift = np.abs(states[10].mean - exact.mean[10])[0] / np.sqrt(exact.cov[10, 0, 0])
    assert np.median(shift) < 0.05
    assert (states[10].error_bound > 0.0).all()


def test_merging_removes_branches_that_share_an_interval():
    y = tent().simulate(10, 1, 5).measurements[..., 0]
    exact = list(PiecewiseLinearFilter(tent()).states(10, y))[-1]
    merged = list(PiecewiseLinearFilter(tent(), merge=0.01).states(10, y))[-1]
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
    filter_ = PiecewiseLinearFilter(tent(), max_branches=100)
    with pytest.raises(ValueError, match="max_branches: got 104 branches at t = 6"):
        filter_.run(10, measurements(np.zeros(10)))


# --- collapsing dynamics ------------------------------------------------------------------------


def saturation():
    return PiecewiseLinearSystem(
        regions=[-INF, -1.0, 1.0, INF],
        dynamics=([[-1.2, 0.1, 1.4]], [[[0.0, 1.3, 0.0]]]),
        sensor=([[-0.5, 0.0, 0.5]], [[[0.5, 1.0, 0.5]]]),
        sensor_noise=[[0.3]],
        mean0=[0.2],
        cov0=[[0.6]],
    )


def test_collapsed_regions_against_quadrature():
    y = saturation().simulate(7, 4, 7).measurements
    states = list(PiecewiseLinearFilter(saturation()).states(7, y))
    assert [len(s.branches.cell) for s in states][-1] == 17
    found = PiecewiseLinearFilter(saturation()).run(7, y)
    kinks, level = {-1.0, 1.0}, [-1.0, 1.0]
    for _ in range(8):
        level = [(z - 0.1) / 1.3 for z in level]
        kinks |= {z for z in level if -1 < z < 1}
    reach = 12 * np.sqrt(0.6)
    points, weights = panels(np.array([0.2 - reach, *sorted(kinks), 0.2 + reach]), 4, 60)
    prior = -0.5 * (points - 0.2) ** 2 / 0.6

    def move(x):
        return np.where(x < -1, -1.2, np.where(x < 1, 0.1 + 1.3 * x, 1.4))

    def sensor(x):
        return np.where(np.abs(x) < 1, x, 0.5 * (x + np.sign(x)))

    for dataset in range(4):
        compare(
            found,
            posterior(points, prior, weights, move, sensor, 0.3, y[1:, 0, dataset]),
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
    found = PiecewiseLinearFilter(system).run(300, measurements(y))
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
    found = PiecewiseLinearFilter(system).run(200, measurements(np.ones(200)))
    positive = float(0.5 * (1 + sp.erf(0.4 / sp.sqrt(2)).evalf()))
    odds = positive / (1 - positive) * np.exp(2 * np.arange(201) / 9.0)
    assert found.mode_prob[:, 1] == pytest.approx(odds / (1 + odds), rel=1e-9)


# --- noise in the unrestricted block ------------------------------------------------------------


def noisy_block(gain=0.4):
    """Tent map in x1; x2 is driven by x1 and by noise, and differently in the two cells."""
    return PiecewiseLinearSystem(
        regions=[-INF, 0.0, INF],
        dynamics=(
            [[1.0, 1.0], [0.2, -0.1]],
            [[[1.8, -1.8], [0.0, 0.0]], [[0.5, 0.3], [0.8, 0.6]]],
        ),
        noise=[[0.0], [gain]],
        sensor=([[0.0, 0.1]], [[[0.3, 0.3], [1.0, 0.5]]]),
        sensor_noise=[[0.5]],
        mean0=[0.1, -0.3],
        cov0=[[0.25, 0.1], [0.1, 0.5]],
    )


def test_noise_in_the_unrestricted_block_against_a_grid_of_kalman_filters():
    system = noisy_block()
    y = system.simulate(5, 2, 3).measurements
    y[2, 0, 0] = np.nan
    found = PiecewiseLinearFilter(system, method="exact").run(5, y)
    points, weights = tent_nodes(6)
    for dataset in range(2):
        # given x1 at the start everything else is linear and Gaussian
        x1, log_weight = points.copy(), np.log(weights) - 0.5 * (points - 0.1) ** 2 / 0.25
        log_weight -= np.log(np.exp(log_weight).sum())
        x2, var = -0.3 + 0.4 * (points - 0.1), np.full(points.shape, 0.5 - 0.04)
        for t in range(1, 6):
            low = x1 < 0
            x2 = np.where(low, 0.2 + 0.5 * x1 + 0.8 * x2, -0.1 + 0.3 * x1 + 0.6 * x2)
            var = np.where(low, 0.64, 0.36) * var + 0.16
            x1 = 1 - 1.8 * np.abs(x1)
            value, before = y[t, 0, dataset], 0.0
            if np.isfinite(value):
                b = np.where(x1 < 0, 1.0, 0.5)
                spread = b * b * var + 0.25
                error = value - np.where(x1 < 0, 0.0, 0.1) - 0.3 * x1 - b * x2
                log_weight = log_weight - 0.5 * error**2 / spread - 0.5 * np.log(2 * np.pi * spread)
                x2, var = x2 + b * var / spread * error, var * 0.25 / spread
            before = np.log(np.exp(log_weight).sum())
            log_weight -= before
            weight = np.exp(log_weight)
            mean = np.array([(weight * x1).sum(), (weight * x2).sum()])
            c11, c12, c22 = (
                (weight * (x1 - mean[0]) ** 2).sum(),
                (weight * (x1 - mean[0]) * (x2 - mean[1])).sum(),
                (weight * (var + (x2 - mean[1]) ** 2)).sum(),
            )
            assert found.mean[t, :, dataset] == pytest.approx(mean, abs=1e-11)
            assert found.cov[t, :, :, dataset] == pytest.approx(
                np.array([[c11, c12], [c12, c22]]), abs=1e-11
            )
            assert found.loglik[t, dataset] == pytest.approx(before, abs=1e-11)


# --- region-wise moment matching ----------------------------------------------------------------


def wave(cells, **changes):
    x, v, w = sp.symbols("x v w")
    parts = {
        "state": (x,),
        "dynamics": [2 * sp.sin(x) + w / 2],
        "sensor": [x**2 / 5 + 3 * v / 10],
        "noise": (v, w),
        "breakpoints": np.linspace(-4, 4, cells + 1),
        "initial": ([1.0], [[0.5]]),
    }
    return PiecewiseLinearSystem.from_functions(**(parts | changes))


def grid_filter(y, steps):
    """Means and deviations (K, N) of the model `wave` on a grid of 1201 points."""
    x = np.linspace(-6, 6, 1201)
    kernel = np.exp(-0.5 * ((x[:, None] - 2 * np.sin(x)) / 0.5) ** 2)
    weight = np.exp(-((x - 1.0) ** 2))[:, None] * np.ones(y.shape[2])
    out = []
    for t in range(1, steps + 1):
        weight = kernel @ weight * np.exp(-0.5 * ((y[t] - x[:, None] ** 2 / 5) / 0.3) ** 2)
        weight /= weight.sum(axis=0)
        mean = x @ weight
        out.append((mean, np.sqrt((weight * (x[:, None] - mean) ** 2).sum(axis=0))))
    return np.array(out).swapaxes(0, 1)


def test_moment_matching_converges_with_the_square_of_the_number_of_cells():
    y = wave(8).simulate(15, 40, 3).measurements
    mean, deviation = grid_filter(y, 15)
    errors = []
    for cells in (12, 24, 48):
        found = PiecewiseLinearFilter(wave(cells)).run(15, y)
        errors.append(np.sqrt(np.mean(((found.mean[1:, 0] - mean) / deviation) ** 2)))
    assert errors[0] < 0.03
    assert errors[0] / errors[1] > 3.0
    assert errors[1] / errors[2] > 3.0


def test_one_step_of_moment_matching_against_sums_over_pairs():
    """Two cells, two steps, each truncated law by plain quadrature."""
    a, slope, b, sensor = [0.3, -0.2], [0.7, 1.2], [0.1, 0.0], [1.0, 0.6]
    system = PiecewiseLinearSystem(
        regions=[-INF, 0.5, INF], dynamics=([a], [[slope]]), noise=[[0.4]],
        sensor=([b], [[sensor]]), sensor_noise=[[0.3]], mean0=[0.2], cov0=[[0.8]],
    )  # fmt: skip
    found = PiecewiseLinearFilter(system).run(2, measurements([0.9, -0.4]))
    x, weights = panels(np.array([-12.0, 0.5, 12.0]), 40, 20)
    cell = (x >= 0.5).astype(int)

    def normal(z, mean, var):
        return np.exp(-0.5 * (z - mean) ** 2 / var) / np.sqrt(2 * np.pi * var)

    density = normal(x, 0.2, 0.8)
    for t, value in ((1, 0.9), (2, -0.4)):
        predicted = np.zeros_like(x)
        for j in (0, 1):
            inside = np.where(cell == j, density, 0.0) * weights
            mass = inside.sum()
            mean = (inside * x).sum() / mass
            var = (inside * (x - mean) ** 2).sum() / mass
            predicted += mass * normal(x, a[j] + slope[j] * mean, slope[j] ** 2 * var + 0.16)
        likelihood = normal(value, np.take(b, cell) + np.take(sensor, cell) * x, 0.09)
        density = predicted * likelihood
        total = (density * weights).sum()
        density /= total
        mean = (density * weights * x).sum()
        assert found.loglik[t] == pytest.approx(np.log(total), abs=1e-12)
        assert found.mean[t, 0] == pytest.approx(mean, abs=1e-12)
        assert found.cov[t, 0, 0] == pytest.approx(
            (density * weights * (x - mean) ** 2).sum(), abs=1e-12
        )


def test_exact_and_matched_steps_may_alternate():
    """Noise at every second step only; with a single matched step everything else is exact."""
    gains = {1: 0.0, 2: 0.4, 3: 0.0}
    widths = {1: 0.2, 3: 0.3}  # nothing is measured at t = 2, as there is nothing at t = 0
    system = tent(noise=lambda t: [[gains[int(t)]]], sensor_noise=lambda t: [[widths[int(t)]]])
    filter_ = PiecewiseLinearFilter(system)
    states = list(filter_.states(3, measurements([0.2, np.nan, 0.3])))
    assert [len(s.branches.cell) for s in states] == [2, 4, 4, 8]
    assert states[1].lost == 0.0
    assert np.isnan(states[2].lost)
    with pytest.raises(ValueError, match="impossible at t = 2, noise enters the restricted"):
        PiecewiseLinearFilter(system, method="exact").run(3, measurements([0.2, 0.5, 0.3]))


# --- regions of a plane -------------------------------------------------------------------------


def lozi(third=False, regions=None):
    """Lozi map; optionally with a third state, driven by noise and seen by the sensor."""
    matrix = np.array([[[1.7, -1.7], [1.0, 1.0]], [[0.5, 0.5], [0.0, 0.0]]])
    mean0, cov0 = np.array([0.1, 0.1]), np.array([[0.3, 0.05], [0.05, 0.2]])
    offset, sensor, noise = np.array([1.0, 0.0]), np.array([[1.0, 0.0]]), None
    if third:
        full = np.zeros((3, 3, 2))
        full[:2, :2], full[2, 0], full[2, 2] = matrix, 0.3, [0.6, -0.4]
        matrix, offset, sensor = full, np.array([1.0, 0.0, 0.1]), np.array([[1.0, 0.0, 0.5]])
        noise = np.array([[0.0], [0.0], [0.4]])
        mean0, cov0 = np.append(mean0, -0.2), np.diag([0.3, 0.2, 0.5])
        cov0[0, 1] = cov0[1, 0] = 0.05
    return PiecewiseLinearSystem(
        regions=line_cells([[1.0], [0.0]], [0.0]) if regions is None else regions,
        dynamics=(offset, matrix),
        noise=noise,
        sensor=([0.0], sensor),
        sensor_noise=[[0.3]],
        mean0=mean0,
        cov0=cov0,
    )


def lozi_kinks(z, steps, reach):
    """All starting points (x, z) of one row at which an iterate meets the kink."""
    pieces, kinks = [(-reach, reach, 0.0, 1.0, z, 0.0)], []
    for _ in range(steps):
        pieces, old = [], pieces
        for low, high, a, b, c, d in old:
            root = -a / b if b else INF
            cuts = [low, high]
            if low < root < high:
                kinks.append(root)
                cuts = [low, root, high]
            for p, q in pairwise(cuts):
                slope = 1.7 if a + b * 0.5 * (p + q) < 0 else -1.7
                pieces.append((p, q, 1 + slope * a + c, slope * b + d, 0.5 * a, 0.5 * b))
    return np.array(kinks)


def lozi_route(y, third):
    """Posterior by quadrature over the start, row by row between the kinks.

    Accurate to 8e-8 with 120 panels of rows; the error falls with the square of their number.
    Given the start, the first two states are known and the third one is linear and Gaussian.
    """
    rows, shares = panels(np.linspace(-3.5, 3.7, 121), 1, 8)
    points = []
    for z, share in zip(rows, shares, strict=True):
        edges = np.concatenate([lozi_kinks(z, len(y), 5.0), np.linspace(-4.6, 4.8, 60)])
        x, weight = panels(np.unique(edges[np.abs(edges - 0.1) <= 4.7]), 1, 10)
        points.append(np.stack([x, np.full(x.size, z), weight * share]))
    x, z, weight = np.concatenate(points, axis=1)
    start = np.stack([x, z]) - 0.1
    weight *= np.exp(-0.5 * np.sum(start * np.linalg.solve([[0.3, 0.05], [0.05, 0.2]], start), 0))
    weight /= weight.sum()
    seen, drive = (0.5, 0.16) if third else (0.0, 0.0)
    w, var, out = np.full(x.size, -0.2), np.full(x.size, 0.5), []
    for value in y:
        left = x < 0
        w, var = 0.1 + 0.3 * x + np.where(left, 0.6, -0.4) * w, np.where(left, 0.36, 0.16) * var
        var = var + drive
        x, z = 1 - 1.7 * np.abs(x) + z, 0.5 * x
        spread, error = seen**2 * var + 0.09, value - x - seen * w
        density = np.exp(-0.5 * error**2 / spread) / np.sqrt(2 * np.pi * spread)
        w, var = w + seen * var / spread * error, var * 0.09 / spread
        total = (weight * density).sum()
        weight = weight * density / total
        states = np.stack([x, z, w])
        mean = states @ weight
        cov = (weight * (states - mean[:, None])) @ (states - mean[:, None]).T
        cov[2, 2] += (weight * var).sum()
        out.append((mean, cov, np.log(total)))
    return [np.stack(part) for part in zip(*out, strict=True)]


@pytest.mark.parametrize("third", [False, True])
def test_plane_regions_against_quadrature(third):
    system = lozi(third)
    y = system.simulate(3, 2, 3).measurements
    found = PiecewiseLinearFilter(system).run(3, y)
    mean, cov, loglik = lozi_route(y[1:, 0, 0], third)
    size = system.n
    assert found.mean[1:, :, 0] == pytest.approx(mean[:, :size], abs=2e-7)
    assert found.cov[1:, :, :, 0] == pytest.approx(cov[:, :size, :size], abs=2e-7)
    assert found.loglik[1:, 0] == pytest.approx(loglik, abs=2e-7)


def test_branches_of_the_lozi_map():
    y = lozi().simulate(6, 2, 3).measurements
    states = list(PiecewiseLinearFilter(lozi()).states(6, y))
    assert [len(s.branches.cell) for s in states[1:]] == [4, 8, 16, 30, 54, 96]
    cut = list(PiecewiseLinearFilter(lozi(), prune=1e-3).states(6, y))[-1]
    assert len(cut.branches.cell) < 60
    assert np.abs(cut.mean - states[-1].mean).max() < 5e-3
    assert (cut.error_bound > 0.0).all()


def test_new_coordinates_of_plane_regions_change_nothing(monkeypatch):
    """Regions that are given the coordinates of their laws at every step, against none of that."""
    y = lozi(third=True).simulate(6, 3, 3).measurements
    y[3, 0, 1] = np.nan
    plain = PiecewiseLinearFilter(lozi(third=True)).run(6, y)
    monkeypatch.setattr("seedslib.filters.piecewise_local._FAR", 5.0)
    local = PiecewiseLinearFilter(lozi(third=True)).run(6, y)
    for one, other in zip(plain, local, strict=True):
        assert one == pytest.approx(other, abs=1e-10)


def test_long_record_of_a_plane_map():
    """Sixty steps stretch by 1e14 and shrink by 1e32; the estimates stay consistent."""
    runs = lozi().simulate(60, 6, 4)
    filter_ = PiecewiseLinearFilter(lozi(), keep=30)
    found = filter_.run(60, runs.measurements)
    error = (runs.states - found.mean)[1:, 0] ** 2 / found.cov[1:, 0, 0]
    assert 0.6 < error.mean() < 1.6
    assert np.isfinite(found.loglik).all()
    assert np.abs(found.cov[1:]).max() < 5.0


def test_more_cells_with_the_same_coefficients_change_nothing():
    """Cutting cells of equal dynamics into polygons leaves the posterior as it was."""
    fine = line_cells([[1.0, 0.3, 0.0], [0.0, 1.0, 1.0]], [0.0, 0.2, -0.3])
    left = np.array([cell.normals[0, 0] > 0 for cell in fine.cells])
    assert left.size == 7
    coarse = lozi()
    a, A = coarse.dynamics
    split = PiecewiseLinearSystem(
        regions=fine, dynamics=(a, A[:, :, np.where(left, 0, 1)]), sensor=coarse.sensor,
        sensor_noise=coarse.sensor_noise, mean0=coarse.mean0, cov0=coarse.cov0,
    )  # fmt: skip
    y = coarse.simulate(3, 3, 8).measurements
    one, other = (PiecewiseLinearFilter(s).run(3, y) for s in (coarse, split))
    assert one.mean == pytest.approx(other.mean, abs=1e-11)
    assert one.cov == pytest.approx(other.cov, abs=1e-11)
    assert one.loglik == pytest.approx(other.loglik, abs=1e-11)
    halves = [other.mode_prob[:, left == kept].sum(axis=1) for kept in (True, False)]
    assert one.mode_prob == pytest.approx(np.stack(halves, axis=1), abs=1e-11)


@pytest.mark.parametrize("line", [tent(), saturation()])
def test_collapsing_plane_map_agrees_with_the_line(line):
    """x moves alone and z = x / 2 follows it: a map of rank one, or zero, in the plane."""
    edges, (a, slope) = line.regions.edges[1:-1], map(np.asarray, line.dynamics)
    b, sensor = map(np.asarray, line.sensor)
    rows = np.concatenate([slope[0], 0.5 * (slope[0] != 0.0)])
    plane = PiecewiseLinearSystem(
        regions=line_cells(np.stack([np.ones(edges.size), np.zeros(edges.size)]), edges),
        dynamics=(np.stack([a[0], 0 * a[0]]), np.stack([rows, 0 * rows], axis=1)),
        sensor=(b, np.stack([sensor[:, 0], 0 * sensor[:, 0]], axis=1)),
        sensor_noise=line.sensor_noise,
        mean0=[line.mean0[0], 0.3],
        cov0=[[line.cov0[0, 0], 0.1], [0.1, 0.5]],
    )
    y = line.simulate(5, 3, 2).measurements
    one, other = (PiecewiseLinearFilter(s).run(5, y) for s in (line, plane))
    assert other.mean[:, :1] == pytest.approx(one.mean, abs=1e-10)
    assert other.cov[:, :1, :1] == pytest.approx(one.cov, abs=1e-10)
    assert other.loglik == pytest.approx(one.loglik, abs=1e-10)
    assert other.mode_prob == pytest.approx(one.mode_prob, abs=1e-10)


def test_moment_matching_on_a_plane_against_particles():
    """Eight cells; single data sets far in the tails are off by more."""
    normals, offsets = [[1, 1, 1, 0], [0, 0, 0, 1]], [-0.6, 0.0, 0.6, 0.0]
    cells = line_cells(normals, offsets)
    right = np.array([cell.normals[0, 1] < 0 for cell in cells.cells])  # of the line x = 0
    base = lozi()
    system = PiecewiseLinearSystem(
        regions=cells,
        dynamics=(base.dynamics[0], base.dynamics[1][:, :, right.astype(int)]),
        noise=0.15 * np.eye(2),
        sensor=base.sensor,
        sensor_noise=base.sensor_noise,
        mean0=base.mean0,
        cov0=base.cov0,
    )
    y = system.simulate(4, 12, 5).measurements
    found = PiecewiseLinearFilter(system).run(4, y)
    cloud = ParticleFilter(system.discrete(), 40_000).run(np.arange(5.0), y, seed=1)
    error = (found.mean - cloud.mean)[1:] / np.sqrt(np.einsum("tiin->tin", cloud.cov))[1:]
    assert np.median(np.abs(error)) < 0.04
    assert np.median(np.abs(found.loglik - cloud.loglik)[1:]) < 0.04


# --- what every filter must do ------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_one_region_is_the_kalman_filter(noise):
    rng = np.random.default_rng(8)
    system = PiecewiseLinearSystem(
        regions=[-INF, INF],
        dynamics=(rng.standard_normal(3), 0.5 * rng.standard_normal((3, 3))),
        noise=noise * rng.standard_normal((3, 2)),
        sensor=(rng.standard_normal(2), rng.standard_normal((2, 3))),
        sensor_noise=0.4 * np.eye(2),
        mean0=rng.standard_normal(3),
        cov0=np.eye(3) + 0.3,
    )
    y = system.simulate(12, 1, 4).measurements[..., 0]
    found = PiecewiseLinearFilter(system).run(12, y)
    mean, cov, loglik = kalman(system, y[1:])
    assert found.mean[1:] == pytest.approx(mean, abs=1e-13)
    assert found.cov[1:] == pytest.approx(cov, abs=1e-13)
    assert found.loglik[1:] == pytest.approx(loglik, abs=1e-12)
    assert found.mode_prob == pytest.approx(np.ones((13, 1)), abs=1e-14)


@pytest.mark.parametrize(
    "system", [zoo.falling_body(30), tent(), saturation(), noisy_block(), wave(9)]
)
def test_one_data_set_is_the_same_in_a_batch(system):
    y = system.simulate(6, 12, 1).measurements
    y[3, 0, ::4] = np.nan
    filter_ = PiecewiseLinearFilter(system)
    batch = filter_.run(6, y)
    grid = filter_.run(np.arange(7.0), y.reshape(7, 1, 3, 4))
    assert grid.mean.shape == (7, system.n, 3, 4)
    assert grid.diverged.shape == (3, 4)
    assert np.array_equal(grid.cov.reshape(batch.cov.shape), batch.cov)
    for dataset in (0, 5, 11):
        alone = filter_.run(6, y[:, :, dataset])
        for part, whole in zip(alone, batch, strict=True):
            assert part == pytest.approx(whole[..., dataset], rel=1e-11, abs=1e-13)


def test_pruned_data_set_is_the_same_in_a_batch():
    y = tent().simulate(8, 12, 1).measurements
    filter_ = PiecewiseLinearFilter(tent(), prune=1e-3)
    batch = filter_.run(8, y)
    for dataset in (0, 7):
        alone = filter_.run(8, y[:, :, dataset])
        assert alone.mean == pytest.approx(batch.mean[..., dataset], abs=1e-13)


def test_missing_measurement_is_no_measurement():
    """A step without data forecasts; a missing component is as if the sensor lacked it."""
    both = noisy_block()
    double = PiecewiseLinearSystem(
        regions=both.regions, dynamics=both.dynamics, noise=both.noise,
        sensor=([[0.0, 0.1], [0.3, 0.2]], [[[0.3, 0.3], [1.0, 0.5]], [[1.0, 2.0], [0.0, 0.0]]]),
        sensor_noise=[[0.5, 0.0], [0.0, 0.7]], mean0=both.mean0, cov0=both.cov0,
    )  # fmt: skip
    y = double.simulate(4, 5, 2).measurements
    y[:, 1] = np.nan
    y[2] = np.nan
    pair, single = (PiecewiseLinearFilter(s).run(4, z) for s, z in ((double, y), (both, y[:, :1])))
    for one, other in zip(pair, single, strict=True):
        assert one == pytest.approx(other, abs=1e-13)
    assert pair.loglik[2] == pytest.approx(np.zeros(5), abs=1e-13)
    filter_ = PiecewiseLinearFilter(both)
    states = list(filter_.states(4, y[:, :1]))
    forecast = filter_.forecast(states[1], 2.0)
    assert forecast.mode_prob == pytest.approx(states[2].mode_prob, abs=1e-13)
    assert forecast.mean == pytest.approx(states[2].mean, abs=1e-13)
    again = filter_.correct(filter_.predict(states[2], 3.0), y[3, :1])
    assert again.cov == pytest.approx(states[3].cov, abs=1e-13)


def test_measurement_at_the_first_time_is_used():
    y = measurements(np.array([0.3, 0.4]))
    y[0] = 0.7
    found = PiecewiseLinearFilter(tent()).run(2, y)
    points, weights = tent_nodes(3)
    prior = -0.5 * (points - 0.1) ** 2 / 0.25 - 0.5 * ((0.7 - np.abs(points)) / 0.2) ** 2
    mean, _, loglik = posterior(
        points, prior, weights, lambda x: 1 - 1.8 * np.abs(x), np.abs, 0.2, [0.3, 0.4]
    )
    assert found.mean[1:, 0] == pytest.approx(mean, abs=1e-12)
    assert found.loglik[1:] == pytest.approx(loglik, abs=1e-12)


def test_impossible_measurement_spoils_its_own_data_set_only():
    y = tent().simulate(5, 4, 3).measurements
    spoiled = y.copy()
    spoiled[2, 0, 1] = 1e200
    filter_ = PiecewiseLinearFilter(tent())
    clean, found = filter_.run(5, y), filter_.run(5, spoiled)
    assert found.diverged.tolist() == [False, True, False, False]
    others = [0, 2, 3]
    assert np.array_equal(found.mean[..., others], clean.mean[..., others])
    assert np.isnan(found.mean[2:, 0, 1]).all()
    assert np.isfinite(found.mean[:2, 0, 1]).all()
    assert found.loglik[2, 1] == -INF
    for options in ({"prune": 1e-4}, {"merge": 0.1, "prune": 1e-3}, {"method": "matched"}):
        cut = PiecewiseLinearFilter(tent(), **options)
        assert cut.run(5, spoiled).diverged.tolist() == [False, True, False, False]
        assert cut.run(5, spoiled[..., 1:2]).diverged.tolist() == [True]
    assert filter_.run(5, spoiled[..., 1:2]).diverged.tolist() == [True]
    with pytest.raises(ValueError, match="incompatible with every branch at t = 2"):
        filter_.run(5, spoiled[..., 1])


def test_far_measurement_is_no_failure():
    """Seventy standard deviations off: the weights live on the logarithmic scale."""
    found = PiecewiseLinearFilter(tent()).run(2, measurements([-14.0, 0.2]))
    assert np.isfinite(found.mean).all()
    assert found.loglik[1] < -1000


def test_neglected_integrals_do_not_show():
    noise = np.random.default_rng(3).standard_normal((30, 10))
    y = falling(5.0, noise)
    system = zoo.falling_body(200)
    full = PiecewiseLinearFilter(system, neglect=0.0).run(10, y)
    default = PiecewiseLinearFilter(system).run(10, y)
    assert default.mean == pytest.approx(full.mean, rel=1e-14)
    assert default.cov == pytest.approx(full.cov, rel=1e-12)
    coarse = PiecewiseLinearFilter(system, neglect=1e-3).run(10, y)
    deviation = np.sqrt(full.cov[:, 0, 0])
    assert 0.0 < np.abs((coarse.mean - full.mean)[:, 0] / deviation).max() < 5e-3


def test_precise_sensor_keeps_a_semidefinite_covariance():
    noise = np.random.default_rng(3).standard_normal((5, 10))
    system = zoo.falling_body(100, sensor_noise=1e-7)
    t = np.arange(1, 11)[:, None]
    y = measurements(0.1 - 0.005 * t**2 / 20.0 + 1e-7 * noise.T)
    found = PiecewiseLinearFilter(system).run(10, y)
    values = np.linalg.eigvalsh(np.moveaxis(found.cov, 3, 1))
    assert (values[..., 0] >= -1e-12 * values[..., 1]).all()


def test_sharp_sensor_keeps_the_digits_of_what_is_left():
    """One component is seen with an error of 1e-9; the other with NaN in half of the records."""
    system = PiecewiseLinearSystem(
        regions=[-INF, INF],
        dynamics=([0.0, 0.0], np.eye(2)),
        sensor=([0.0, 0.0], np.eye(2)),
        sensor_noise=np.diag([1e-9, 0.5]),
        mean0=[0.0, 0.0],
        cov0=[[1.0, 0.3], [0.3, 2.0]],
    )
    y = np.full((2, 2, 4), np.nan)
    y[1, 0], y[1, 1, :2] = 0.7, 0.2
    for batch in (y, y[..., 2:]):
        cov = PiecewiseLinearFilter(system).run(1, batch).cov[1]
        rest = 2 - sp.Rational(9, 100) / (1 + sp.Rational(1, 10**18))
        first = sp.Rational(1, 10**18) / (1 + sp.Rational(1, 10**18))
        assert cov[0, 0] == pytest.approx(float(first), rel=1e-12)
        assert cov[1, 1, -1] == pytest.approx(float(rest), rel=1e-14)
        assert cov[0, 1, -1] == pytest.approx(float(sp.Rational(3, 10) * first), rel=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_random_systems_with_sharp_sensors_do_not_break(seed):
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((3, 3, 2))
    matrix[0, 1:], matrix[0, 0] = 0.0, rng.choice([-1, 1], 2) * rng.uniform(0.5, 1.5, 2)
    system = PiecewiseLinearSystem(
        regions=[-INF, 0.3, INF],
        dynamics=(rng.standard_normal((3, 2)), matrix),
        noise=np.array([[0.0], [1.0], [0.3]]) * 10.0 ** rng.uniform(-6, 0),
        sensor=(rng.standard_normal((2, 2)), rng.standard_normal((2, 3, 2))),
        sensor_noise=10.0 ** rng.uniform(-9, -6) * np.eye(2),
        mean0=np.zeros(3),
        cov0=np.eye(3),
    )
    runs = system.simulate(5, 3, seed)
    found = PiecewiseLinearFilter(system).run(5, runs.measurements)
    assert not found.diverged.any()
    variance = np.einsum("tiin->tin", found.cov)
    assert (variance >= 0.0).all()
    assert np.isfinite(found.mean).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "fast"}, "method: wanted"),
        ({"prune": 1.0}, "prune: wanted a share"),
        ({"prune": -0.1}, "prune: wanted a share"),
        ({"neglect": 2.0}, "neglect: wanted a share"),
        ({"merge": -1.0}, "merge: wanted a nonnegative"),
        ({"keep": 0}, "keep: wanted at least 1"),
        ({"max_branches": 1}, "max_branches: wanted"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        PiecewiseLinearFilter(tent(), **options)


def test_bad_arguments_are_refused():
    filter_ = PiecewiseLinearFilter(tent())
    with pytest.raises(TypeError, match="system: wanted"):
        PiecewiseLinearFilter("tent")
    with pytest.raises(ValueError, match="merge: wanted 0"):
        PiecewiseLinearFilter(noisy_block(), merge=0.1)
    with pytest.raises(ValueError, match=r"measurements: wanted shape \(4, 1, \*batch\)"):
        filter_.run(3, np.zeros((3, 1)))
    with pytest.raises(ValueError, match="y: wanted shape"):
        filter_.step(filter_.initial(), 0.0, [1.0, 2.0])
    with pytest.raises(ValueError, match="state: wanted a state with a time"):
        filter_.correct(filter_.initial(), [1.0])
    started = filter_.step(filter_.initial(), 0.0, [np.nan])
    with pytest.raises(ValueError, match="t: wanted a time from 2 on, got 1"):
        filter_.predict(filter_.predict(started, 2.0), 1.0)
    with pytest.raises(ValueError, match="finite"):
        filter_.run(1, measurements([INF]))
    with pytest.raises(ValueError, match="times"):
        filter_.run([0.0, 2.0, 1.0], np.zeros((3, 1)))


def test_two_measurements_at_one_time_are_one_of_both():
    """Correcting twice at one time is the same as a sensor with two independent rows."""
    double = tent(
        sensor=([[0.0, 0.0], [0.1, 0.2]], [[[-1.0, 1.0]], [[0.5, 1.0]]]),
        sensor_noise=[[0.2, 0.0], [0.0, 0.3]],
    )
    together = PiecewiseLinearFilter(double)
    y = double.simulate(3, 4, 6).measurements
    whole = together.run(3, y)
    state = together.initial((4,))
    for t in range(4):
        state = together.predict(state, float(t))
        total = np.zeros(4)
        for part in ([0], [1]):
            alone = np.full((2, 4), np.nan)
            alone[part] = y[t, part]
            state = together.correct(state, alone)
            total += state.loglik
        assert state.mean == pytest.approx(whole.mean[t], abs=1e-13)
        assert total == pytest.approx(whole.loglik[t], abs=1e-12)


def test_known_starting_point():
    """Prior without spread: the posterior is one deterministic path."""
    found = PiecewiseLinearFilter(tent(cov0=[[0.0]])).run(3, measurements([0.7, 0.1, 0.3]))
    x, path = 0.1, [0.1]
    for _ in range(3):
        x = 1 - 1.8 * abs(x)
        path.append(x)
    assert found.mean[:, 0] == pytest.approx(path, abs=1e-15)
    assert np.abs(found.cov).max() == 0.0
    expected = -0.5 * ((np.array([0.7, 0.1, 0.3]) - np.abs(path[1:])) / 0.2) ** 2
    expected -= np.log(0.2 * np.sqrt(2 * np.pi))
    assert found.loglik[1:] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("spread", [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])
def test_plane_prior_without_spread_in_some_direction(spread):
    """A start known in one component or both, against a sum over the other one."""
    base = lozi()
    system = PiecewiseLinearSystem(
        regions=base.regions,
        dynamics=base.dynamics,
        sensor=base.sensor,
        sensor_noise=base.sensor_noise,
        mean0=base.mean0,
        cov0=np.diag(spread),
    )
    y = [0.6, -0.2, 0.4]
    found = PiecewiseLinearFilter(system).run(3, measurements(y))
    step = np.linspace(-8.0, 8.0, 400_001) if any(spread) else np.zeros(1)
    x, z = (0.1 + np.sqrt(part) * step for part in spread)
    weight = np.exp(-0.5 * step**2)
    weight /= weight.sum()
    for t, value in enumerate(y, start=1):
        x, z = 1 - 1.7 * np.abs(x) + z, 0.5 * x
        density = np.exp(-0.5 * ((value - x) / 0.3) ** 2) / 0.3 / np.sqrt(2 * np.pi)
        total = (weight * density).sum()
        weight = weight * density / total
        assert found.mean[t] == pytest.approx([(weight * x).sum(), (weight * z).sum()], abs=1e-8)
        assert found.loglik[t] == pytest.approx(np.log(total), abs=1e-8)


def test_noise_free_sensor_of_a_known_state_is_refused():
    blind = tent(sensor_noise=[[0.0]], cov0=[[0.0]])
    with pytest.raises(ValueError, match="sensor_noise: a predicted measurement has no spread"):
        PiecewiseLinearFilter(blind).run(1, measurements([0.2]))
    sharp = tent(sensor_noise=[[0.0]])
    with pytest.raises(ValueError, match="prune: the bound needs sensor noise"):
        PiecewiseLinearFilter(sharp, prune=1e-3).run(1, measurements([0.2]))
    found = PiecewiseLinearFilter(sharp).run(1, measurements([0.2]))
    # x0 = +-(1 -+ 0.2) / 1.8 explain the measurement: two points left of the kink, two right of it
    assert found.mode_prob[1].sum() == pytest.approx(1.0)
    roots = np.array([0.8, -0.8, 1.2, -1.2]) / 1.8
    weight = np.exp(-0.5 * (roots - 0.1) ** 2 / 0.25)
    assert found.mean[1, 0] == pytest.approx(
        0.2 * (weight[:2].sum() - weight[2:].sum()) / weight.sum()
    )
