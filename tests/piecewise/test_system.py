"""Piecewise-linear systems: cells, coefficients, tangents of functions, maps and simulation."""

import numpy as np
import pytest
import sympy as sp
from scipy.stats import multivariate_normal

from oracles.piecewise import TIMES, line_parts, plane_system, tent, wave
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem, line_cells
from seedslib.zoo import falling_body

INF = np.inf
X, Z, V, W, T, U = sp.symbols("x z v w t u")


# ---------------------------------------------------------------- cells


def test_intervals_are_half_open():
    cells = tent(regions=[-INF, -1.0, 2.0, INF]).regions
    points = np.array([[[-5.0, -1.0], [1.999, 2.0], [9.0, 0.0]]])
    assert cells.locate(points).tolist() == [[0, 1], [1, 2], [2, 1]]
    assert (len(cells), cells.edges.tolist()) == (3, [-INF, -1.0, 2.0, INF])
    assert tent(regions=cells).regions is cells


@pytest.mark.parametrize("length", [1e-3, 1.0, 250.0])
def test_lines_cut_the_plane_into_the_cells_of_their_sides(length):
    """Numbered by the sides, the first line first; three lines leave out one pattern."""
    normals, offsets = np.array([[1.0, 0.4, 1.0], [0.2, -1.0, 1.0]]), np.array([0.3, 0.7, 1.0])
    cells = line_cells(length * normals, length * offsets)
    points = 2.0 * np.random.default_rng(0).standard_normal((2, 40, 50))
    beyond = np.tensordot(normals.T, points, 1) - offsets[:, None, None]
    binary = np.tensordot([4, 2, 1], beyond > 0.0, 1)
    np.testing.assert_array_equal(cells.locate(points), binary)
    assert (len(cells), np.unique(binary).size) == (8, 7)
    assert line_cells(np.empty((2, 0)), []).locate(np.zeros((2, 3))).tolist() == [0, 0, 0]
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
    """Value and density, against the coefficients of the time and the cell."""
    parts = line_parts()
    system = PiecewiseLinearSystem(**parts)
    pair, t = system.discrete(), 2.5
    x = np.array([[-0.5, -0.4, 0.1, 0.7], [3.0, -2.0, 1.0, 0.5], [0.2, 0.1, -0.4, 1.0]])
    rng = np.random.default_rng(1)
    for map_, offset, noise in (
        (pair.dynamics, parts["dynamics"](t), parts["noise"](t)),
        (pair.sensor, parts["sensor"](t), parts["sensor_noise"](t)),
    ):
        v, y = rng.standard_normal((2, 4)), rng.standard_normal((len(noise), 4))
        y[0, 1] = np.nan
        for n, i in enumerate([0, 1, 1, 2]):
            center, gain = offset[0][:, i] + offset[1][:, :, i] @ x[:, n], noise[:, :, i]
            value = map_.value(t, x, v)[:, n]
            np.testing.assert_allclose(value, center + gain @ v[:, n], rtol=1e-12)
            if len(noise) == 2:
                seen = np.isfinite(y[:, n])
                dist = multivariate_normal(center[seen], (gain @ gain.T)[np.ix_(seen, seen)])
                found = map_.log_density(t, y, x)[n]
                np.testing.assert_allclose(found, dist.logpdf(y[seen, n]), rtol=1e-11)


def test_coefficients_with_and_without_an_axis_of_cells():
    system = tent(
        dynamics=lambda t: ([t], [[1.0]]),
        sensor_noise=lambda t: [[0.1 * t, 0.2]],
        noise=[[[0.5, 0.7]]],
    )
    c, d = system.dynamics_at(3.0), system.sensor_at(2.0)
    assert c.offset.tolist() == [[[3.0], [3.0]]]
    assert c.noise.tolist() == [[[[0.5], [0.7]]]]
    np.testing.assert_allclose(d.noise[0, :, 1, 0], [0.2, 0.2])
    assert system.state_size == 1


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


def test_simulation_is_that_of_the_functions_and_of_any_number_of_threads():
    system = wave(8, dynamics=[2 * sp.sin(X)], noise=[V])
    one, two = (system.simulate(2, 9000, 1, workers=w) for w in (1, 2))
    np.testing.assert_allclose(one.states[1], 2 * np.sin(one.states[0]))
    np.testing.assert_array_equal(one.measurements, two.measurements)


# ---------------------------------------------------------------- tangents


def bent(**changes):
    parts = {
        "state": (X, Z),
        "dynamics": [X + T * V, X * Z + X**2],
        "sensor": [sp.cos(X) * Z + 3 * W],
        "noise": (V, W),
        "time": T,
        "breakpoints": [0.0, 1.0, 4.0],
        "initial": ([1.0, 7.0], np.eye(2)),
    }
    return PiecewiseLinearSystem.from_functions(**(parts | changes))


@pytest.mark.parametrize("estimate", [None, [[1.5, -2.5, np.nan], [0.5, 0.25, 1.0]]])
def test_tangents_agree_with_those_of_sympy(estimate):
    """At support points, or at estimates in the cells that hold them, one for each record."""
    system = bent(support="centroid" if estimate is None else "estimate")
    where = np.array([[0.5, 2.5], [7.0, 7.0]])[:, :, None]
    if estimate is not None:
        estimate = np.array(estimate)
        where = np.repeat(where, 3, axis=2)
        where[1, :, :2] = estimate[1, :2]
        where[0, 1, 0], where[0, 0, 1] = estimate[0, :2]
    maps = sp.Matrix([X, X * Z + X**2]), sp.Matrix([sp.cos(X) * Z])
    found = system.dynamics_at(2.5, estimate), system.sensor_at(1.0, estimate)
    for map_, c in zip(maps, found, strict=True):
        for i, n in np.ndindex(2, where.shape[2]):
            at = dict(zip((X, Z), where[:, i, n].tolist(), strict=True))
            slope = np.array(map_.jacobian([X, Z]).subs(at).tolist(), float)
            value = np.array(map_.subs(at).tolist(), float)[:, 0] - slope @ where[:, i, n]
            np.testing.assert_allclose(c.matrix[:, :, i, n], slope, rtol=1e-13, atol=1e-14)
            np.testing.assert_allclose(c.offset[:, i, n], value, rtol=1e-13, atol=1e-13)
    assert found[0].noise[:, 0, 0, 0].tolist() == [2.5, 0.0]
    assert (found[1].noise == 3.0).all()


def test_support_is_the_middle_of_a_cell_and_the_prior_mean_or_the_estimate():
    parts = {
        "dynamics": [X, X * Z + X**2],
        "sensor": [Z + V],
        "noise": [V],
        "support": "centroid",
    }
    system, follow = bent(**parts), bent(**(parts | {"support": "estimate"}))
    for found, z, points in (
        (system.dynamics_at(1.0), 7.0, [0.5, 2.5]),
        (follow.dynamics_at(1.0), 7.0, [0.5, 2.5]),
        (follow.dynamics_at(1.0, np.array([[1.2], [3.0]])), 3.0, [0.5, 1.2]),
        (bent(**(parts | {"support": [0.3, 2.0]})).dynamics_at(1.0), 7.0, [0.3, 2.0]),
    ):
        points = np.array(points)
        np.testing.assert_allclose(found.matrix[1, 0, :, 0], z + 2 * points)
        np.testing.assert_allclose(found.matrix[1, 1, :, 0], points)
        np.testing.assert_allclose(found.offset[1, :, 0], -z * points - points**2)


# ---------------------------------------------------------------- the falling body


@pytest.mark.parametrize(("partition", "power"), [("gradient", -2.0), ("curvature", -0.5)])
def test_the_falling_body_is_that_of_the_paper(partition, power):
    system = falling_body(
        4, partition=partition, span=(10.0, 40.0), sensor_noise=0.5, deviation=3.0, speed=1.5
    )
    first, last = 10.0**power, 40.0**power
    edges = [(first + k / 4 * (last - first)) ** (1 / power) for k in range(5)]
    np.testing.assert_allclose(system.regions.edges[1:-1], edges[1:-1], rtol=1e-13)
    np.testing.assert_allclose(system.cov0, np.diag([9.0, 1e-12]), rtol=1e-15)
    t, x = 3.0, np.array([[20.0, 30.0], [0.2, 0.3]])
    maps = system.discrete()
    moved = maps.dynamics.value(t, x, np.zeros((0, 2)))
    np.testing.assert_allclose(moved, [x[0], x[1] - 0.01 * 5.0 / x[0]], rtol=1e-14)
    seen = maps.sensor.value(t, x, np.array([[1.0, -2.0]]))
    np.testing.assert_allclose(seen, [[0.7, -0.7]], rtol=1e-14)
    middles, c = 0.5 * (np.array(edges[:-1]) + edges[1:]), system.dynamics_at(t)
    np.testing.assert_allclose(c.matrix[1, 0, :, 0], 0.05 / middles**2, rtol=1e-12)
    np.testing.assert_allclose(c.offset[1, :, 0], -0.1 / middles, rtol=1e-12)
    usual = falling_body()
    assert (len(usual.regions), usual.mean0.tolist()) == (100, [27.5, 0.1])
    assert usual.regions.edges[50] == pytest.approx(7.035975447, abs=5e-9)
    assert usual.cov0[0, 0] == 11.25**2
    assert (usual.sensor_at(1.0).noise == 1e-3).all()
