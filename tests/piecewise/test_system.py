"""Piecewise-linear systems: cells, coefficients, tangents of functions, maps and simulation."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import sympy as sp
from scipy.stats import multivariate_normal

from oracles.piecewise import TIMES, line_parts, plane_system, tent, wave
from seedslib.models import Noise
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem, examples, line_cells

INF = np.inf
X, Z, V, W, T, U = sp.symbols("x z v w t u")


def plain(regions, count, size=2):
    """A system of these cells, of which only the cells matter."""
    return PiecewiseLinearSystem(
        regions, (np.zeros(size), np.eye(size)), ([0.0], np.ones((1, size))), [[1.0]],
        0.1 * np.ones(size), np.eye(size),
    )  # fmt: skip


# ---------------------------------------------------------------- cells


def test_intervals_are_half_open_and_may_be_given_as_pairs():
    pairs = plain([(-INF, -1.0), (-1.0, 2.0), (2.0, INF)], 3, 1).regions
    edges = plain([-INF, -1.0, 2.0, INF], 3, 1).regions
    points = np.array([[[-5.0, -1.0], [1.999, 2.0], [9.0, 0.0]]])
    for cells in (pairs, edges):
        assert cells.locate(points).tolist() == [[0, 1], [1, 2], [2, 1]]
        assert (cells.count, cells.edges.tolist()) == (3, [-INF, -1.0, 2.0, INF])
        assert plain(cells, 3, 1).regions is cells


@pytest.mark.parametrize("length", [1e-3, 1.0, 250.0])
def test_lines_cut_the_plane_into_the_cells_of_their_sides(length):
    """In the order of the sides, the first line first; three lines leave out one pattern."""
    normals, offsets = np.array([[1.0, 0.4, 1.0], [0.2, -1.0, 1.0]]), np.array([0.3, 0.7, 1.0])
    cells = line_cells(length * normals, length * offsets)
    assert (cells.count, line_cells(normals[:, :2], offsets[:2]).count) == (7, 4)
    assert line_cells([[1.0, 1.0], [0.0, 0.0]], [5.0, -3.0]).count == 3
    points = 2.0 * np.random.default_rng(0).standard_normal((2, 40, 50))
    beyond = np.tensordot(normals.T, points, 1) - offsets[:, None, None]
    binary = np.tensordot([4, 2, 1], beyond > 0.0, 1)
    present = np.unique(binary)
    assert present.size == 7
    np.testing.assert_array_equal(cells.locate(points), np.searchsorted(present, binary))
    assert line_cells(np.empty((2, 0)), []).locate(np.zeros((2, 3))).tolist() == [0, 0, 0]
    # the square of the partition reaches four times as far as its crossings and lines, and one
    crossings = [
        np.linalg.solve(normals[:, list(pair)].T, offsets[list(pair)])
        for pair in combinations(range(3), 2)
    ]
    reach = max(np.abs(crossings).max(), (np.abs(offsets) / np.hypot(*normals)).max())
    assert cells.radius == pytest.approx(4.0 * reach + 1.0, rel=1e-9)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e4])
def test_plane_cells_from_vertices_and_half_planes(size):
    """A turned square, in either orientation, in a frame; an edge is that of the first cell."""
    turn = size * np.array([[0.8, -0.6], [0.6, 0.8]])
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) @ turn.T
    half = type(line_cells([[1.0], [0.0]], [0.0]).cells[0])
    outer = [
        half(turn @ np.array(normals, float).T, size**2 * np.array(offsets, float))
        for normals, offsets in (
            ([[3, 0]], [0]), ([[-1, 0]], [-1]), ([[-1, 0], [1, 0], [0, 1]], [0, 1, 0]),
            ([[-1, 0], [1, 0], [0, -1]], [0, 1, -1]),
        )
    ]  # fmt: skip
    x, y = points = np.random.default_rng(0).uniform(-2.0, 3.0, (2, 7, 11))
    wanted = np.select([x < 0, x > 1, y < 0, y > 1], [1, 2, 3, 4], default=0)
    for first in (square, square[::-1].tolist()):
        cells = plain([first, *outer], 5).regions
        np.testing.assert_array_equal(cells.locate(np.tensordot(turn, points, 1)), wanted)
    middles = np.array([[0.5, -1.0, 2.0, 0.5, 0.5], [0.5, 0.0, 0.0, -1.0, 2.0]])
    system = PiecewiseLinearSystem.from_functions(
        state=(X, Z), dynamics=[X * Z, Z], sensor=[Z], breakpoints=[square, *outer],
        initial=([0.2, 0.7], np.eye(2)), support=turn @ middles,
    )  # fmt: skip
    slopes = system.dynamics_at(0.0).matrix[0, :, :, 0]
    np.testing.assert_allclose(slopes, (turn @ middles)[::-1], atol=1e-15)
    edge = line_cells([[1.0], [0.0]], [0.5]).locate(np.array([[0.4, 0.5, 0.6], [1.0, 1.0, 1.0]]))
    assert edge.tolist() == [0, 0, 1]


def test_prior_probabilities_of_plane_cells_are_those_of_draws():
    system = plane_system()
    state = PiecewiseLinearFilter(system).initial()
    draws = np.random.default_rng(1).multivariate_normal(system.mean0, system.cov0, 200_000).T
    shares = np.bincount(system.regions.locate(draws[:2]), minlength=4) / 200_000
    np.testing.assert_allclose(state.mode_prob, shares, atol=4 * 0.5 / np.sqrt(200_000))


# ---------------------------------------------------------------- coefficients and maps


def test_maps_of_the_system_for_other_filters():
    """Value, mean, covariance and density, against the coefficients of the time and the cell."""
    parts = line_parts()
    system = PiecewiseLinearSystem(**parts)
    pair, t = system.discrete(times=(2.0, 3.0)), 2.5
    x = np.array([[-0.5, -0.4, 0.1, 0.7], [3.0, -2.0, 1.0, 0.5], [0.2, 0.1, -0.4, 1.0]])
    rng = np.random.default_rng(1)
    for map_, offset, noise in (
        (pair.dynamics, parts["dynamics"](t), parts["noise"](t)),
        (pair.sensor, parts["sensor"](t), parts["sensor_noise"](t)),
    ):
        v, y = rng.standard_normal((2, 4)), rng.standard_normal((len(noise), 4))
        y[0, 1] = np.nan
        mean, cov = map_.conditional_moments(t, x)
        for n, i in enumerate([0, 1, 1, 2]):
            center, gain = offset[0][:, i] + offset[1][:, :, i] @ x[:, n], noise[:, :, i]
            np.testing.assert_allclose(mean[:, n], center, rtol=1e-13)
            np.testing.assert_allclose(cov[:, :, n], gain @ gain.T, rtol=1e-12)
            value = map_.value(t, x, v)[:, n]
            np.testing.assert_allclose(value, center + gain @ v[:, n], rtol=1e-12)
            if len(noise) == 2:
                seen = np.isfinite(y[:, n])
                law = multivariate_normal(center[seen], (gain @ gain.T)[np.ix_(seen, seen)])
                found = map_.log_density(t, y, x)[n]
                np.testing.assert_allclose(found, law.logpdf(y[seen, n]), rtol=1e-11)


def test_coefficients_with_and_without_an_axis_of_cells():
    system = tent(dynamics=lambda t: ([t], [[1.0]]), sensor_noise=lambda t: [[0.1 * t, 0.2]],
                  noise=[[[0.5, 0.7]]])  # fmt: skip
    c, d = system.dynamics_at(3.0), system.sensor_at(2.0)
    assert c.offset.tolist() == [[[3.0], [3.0]]]
    assert c.noise.tolist() == [[[[0.5], [0.7]]]]
    np.testing.assert_allclose(d.noise[0, :, 1, 0], [0.2, 0.2])
    assert (system.state_size, system.measurement_size) == (1, 1)


def test_simulated_paths_have_the_moments_of_their_maps():
    """Each step from the state before; nothing is measured at the first time."""
    parts, paths = line_parts(), 20_000
    system = PiecewiseLinearSystem(**parts)
    runs = system.simulate(TIMES, paths, 5)
    assert np.isnan(runs.measurements[0]).all()
    start = runs.states[0]
    np.testing.assert_allclose(start.mean(axis=1), parts["mean0"], atol=0.03)
    np.testing.assert_allclose(np.cov(start), parts["cov0"], atol=0.03)
    for k, t in enumerate(TIMES[:4]):
        cell = system.regions.locate(runs.states[k][:1])
        a, A = parts["dynamics"](t)
        b, B = parts["sensor"](TIMES[k + 1])
        left = runs.states[k + 1] - a[:, cell]
        left -= np.einsum("ijn,jn->in", A[..., cell], runs.states[k])
        assert np.abs(left[0]).max() < 1e-12
        after = system.regions.locate(runs.states[k + 1][:1])
        error = runs.measurements[k + 1] - b[:, after]
        error -= np.einsum("ijn,jn->in", B[..., after], runs.states[k + 1])
        for i in range(3):
            for noise, sample, where in (
                (parts["noise"](t)[1:, :, i], left[1:], cell),
                (parts["sensor_noise"](TIMES[k + 1])[:, :, i], error, after),
            ):
                sample, cov = sample[:, where == i], noise @ noise.T
                if sample.shape[1] < 100:
                    continue
                size = np.sqrt(np.outer(np.diag(cov), np.diag(cov)) + cov**2)
                limit = 5 / np.sqrt(sample.shape[1])
                assert (np.abs(sample @ sample.T / sample.shape[1] - cov) < limit * size).all()
                assert (np.abs(sample.mean(axis=1)) < limit * np.sqrt(np.diag(cov))).all()


def test_simulation_takes_a_start_masks_workers_and_the_linear_model():
    system = wave(8, dynamics=[2 * sp.sin(X)], noise=V)
    runs = system.simulate([0.0, 1.0, 2.0], 4, 1, start=[0.7])
    np.testing.assert_allclose(
        runs.states[:, 0, 0], [0.7, 2 * np.sin(0.7), 2 * np.sin(2 * np.sin(0.7))]
    )
    linear = system.simulate(2, 4, 1, start=[0.7], linear=True)
    tangent = 2 * np.sin(0.5) + 2 * np.cos(0.5) * 0.2
    assert linear.states[1, 0, 0] == pytest.approx(tangent)
    one, two = (system.simulate(2, 9000, 1, start=[0.7], workers=w) for w in (1, 2))
    np.testing.assert_array_equal(one.measurements, two.measurements)
    np.testing.assert_array_equal(one.measurements[1:, :, :4], runs.measurements[1:])
    shown = np.isfinite(tent().simulate(3, 5, 1, measured=[0, 2]).measurements)
    assert shown.all(axis=(1, 2)).tolist() == [False, False, True, False]
    some = tent().simulate(200, 5, 1, availability=0.25).measurements
    assert np.isfinite(some[1:]).mean() == pytest.approx(0.25, abs=0.06)


# ---------------------------------------------------------------- tangents


SUPPORT = np.array([[-1.0, -2.0, 3.0, 4.0], [-5.0, 6.0, -7.0, 8.0]])


def bent(**changes):
    parts = {
        "state": (X, Z), "dynamics": [X * Z + T * V, X - U * Z**2],
        "sensor": [sp.cos(X) * Z + 3 * W], "noise": (V, W), "time": T, "parameters": {U: 1.5},
        "breakpoints": line_cells([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0]), "support": SUPPORT,
        "initial": ([0.5, 0.25], np.eye(2)),
    }  # fmt: skip
    return PiecewiseLinearSystem.from_functions(**(parts | changes))


@pytest.mark.parametrize("estimate", [None, [[1.5, -2.5, np.nan], [0.5, 0.25, 1.0]]])
def test_tangents_of_a_plane_agree_with_those_of_sympy(estimate):
    """At support points, or at estimates in the cells that hold them, one for each record."""
    system = bent()
    where = np.repeat(SUPPORT[:, :, None], 1 if estimate is None else 3, axis=2)
    if estimate is not None:
        estimate = np.array(estimate)
        system = replace(system, functions=replace(system.functions, adaptive=True))
        where[:, 3, 0], where[:, 1, 1] = estimate[:, 0], estimate[:, 1]
    maps = sp.Matrix([X * Z, X - 1.5 * Z**2]), sp.Matrix([sp.cos(X) * Z])
    found = system.dynamics_at(2.5, estimate), system.sensor_at(1.0, estimate)
    for map_, c in zip(maps, found, strict=True):
        for i, n in np.ndindex(4, where.shape[2]):
            at = dict(zip((X, Z), where[:, i, n].tolist(), strict=True))
            slope = np.array(map_.jacobian([X, Z]).subs(at).tolist(), float)
            value = np.array(map_.subs(at).tolist(), float)[:, 0] - slope @ where[:, i, n]
            np.testing.assert_allclose(c.matrix[:, :, i, n], slope, rtol=1e-13, atol=1e-14)
            np.testing.assert_allclose(c.offset[:, i, n], value, rtol=1e-13, atol=1e-13)
    assert found[0].noise[:, 0, 0, 0].tolist() == [2.5, 0.0]
    assert (found[1].noise == 3.0).all()


def test_support_is_the_middle_of_a_cell_and_the_prior_mean_or_the_estimate():
    parts = {
        "dynamics": [X, X * Z + X**2], "sensor": [Z + V], "noise": V,
        "breakpoints": [0.0, 1.0, 4.0], "initial": ([1.0, 7.0], np.eye(2)), "support": "centroid",
    }  # fmt: skip
    system, follow = bent(**parts), bent(**(parts | {"support": "estimate"}))
    for found, z, points in (
        (system.dynamics_at(1.0), 7.0, [0.5, 2.5]),
        (system.dynamics_at(1.0, np.array([[1.2], [3.0]])), 7.0, [0.5, 2.5]),
        (follow.dynamics_at(1.0), 7.0, [0.5, 2.5]),
        (follow.dynamics_at(1.0, np.array([[1.2], [3.0]])), 3.0, [0.5, 1.2]),
        (bent(**(parts | {"support": [0.3, 2.0]})).dynamics_at(1.0), 7.0, [0.3, 2.0]),
    ):
        points = np.array(points)
        np.testing.assert_allclose(found.matrix[1, 0, :, 0], z + 2 * points)
        np.testing.assert_allclose(found.matrix[1, 1, :, 0], points)
        np.testing.assert_allclose(found.offset[1, :, 0], -z * points - points**2)


def test_correlated_noises_with_means_enter_by_mean_and_covariance():
    cov = np.array([[0.5, 0.2, 0.0], [0.2, 0.4, 0.0], [0.0, 0.0, 0.09]])
    system = wave(
        4, dynamics=[X + W + 2 * X * U], sensor=[X + 3 * V],
        noise=Noise((W, U, V), mean=[0.1, 0.2, 0.3], cov=cov),
    )  # fmt: skip
    c, d = system.dynamics_at(0.0), system.sensor_at(0.0)
    np.testing.assert_allclose(c.matrix[0, 0, :, 0], 1.4, rtol=1e-14)
    np.testing.assert_allclose(c.offset[0, :, 0], 0.1, rtol=1e-13)
    for i, p in enumerate([-3.0, -1.0, 1.0, 3.0]):
        turn = np.array([1.0, 2 * p])
        root = c.noise[0, :, i, 0]
        assert root @ root == pytest.approx(turn @ cov[:2, :2] @ turn, rel=1e-12)
    np.testing.assert_allclose(d.offset[0, :, 0], 0.9, rtol=1e-13)
    np.testing.assert_allclose(np.abs(d.noise[0, 0, :, 0]), 0.9, rtol=1e-13)
    for noise in (V, [V], Noise((V,))):  # and maps without noise
        silent = wave(4, dynamics=[X], sensor=[X + V], noise=noise)
        assert silent.dynamics_at(0.0).noise.shape == (1, 0, 4, 1)
        assert (silent.sensor_at(0.0).noise == 1.0).all()


# ---------------------------------------------------------------- the falling body


@pytest.mark.parametrize(("partition", "power"), [("gradient", -2.0), ("curvature", -0.5)])
def test_the_falling_body_is_that_of_the_paper(partition, power):
    system = examples.falling_body(
        4, partition=partition, span=(10.0, 40.0), sensor_noise=0.5, deviation=3.0, speed=1.5
    )
    first, last = 10.0**power, 40.0**power
    edges = [(first + k / 4 * (last - first)) ** (1 / power) for k in range(5)]
    np.testing.assert_allclose(system.regions.edges[1:-1], edges[1:-1], rtol=1e-13)
    np.testing.assert_allclose(system.cov0, np.diag([9.0, 1e-12]), rtol=1e-15)
    t, x = 3.0, np.array([[20.0, 30.0], [0.2, 0.3]])
    moved = system.functions.transition.value(t, x, np.zeros((0, 2)))
    np.testing.assert_allclose(moved, [x[0], x[1] - 0.01 * 5.0 / x[0]], rtol=1e-14)
    seen = system.functions.sensor_map.value(t, x, np.array([[1.0, -2.0]]))
    np.testing.assert_allclose(seen, [[0.7, -0.7]], rtol=1e-14)
    middles, c = 0.5 * (np.array(edges[:-1]) + edges[1:]), system.dynamics_at(t)
    np.testing.assert_allclose(c.matrix[1, 0, :, 0], 0.05 / middles**2, rtol=1e-12)
    np.testing.assert_allclose(c.offset[1, :, 0], -0.1 / middles, rtol=1e-12)
    usual = examples.falling_body()
    assert (usual.regions.count, usual.mean0.tolist()) == (100, [27.5, 0.1])
    assert usual.regions.edges[50] == pytest.approx(7.035975447, abs=5e-9)
    assert usual.cov0[0, 0] == 11.25**2
    assert (usual.sensor_at(1.0).noise == 1e-3).all()
