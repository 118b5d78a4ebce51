from itertools import pairwise

import numpy as np
import pytest

from oracles import piecewise_routes as routes
from seedslib.filters import ParticleFilter
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem
from seedslib.piecewise.cells import line_cells

INF = np.inf


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
    rows, shares = routes.panels(np.linspace(-3.5, 3.7, 121), 1, 8)
    points = []
    for z, share in zip(rows, shares, strict=True):
        edges = np.concatenate([lozi_kinks(z, len(y), 5.0), np.linspace(-4.6, 4.8, 60)])
        x, weight = routes.panels(np.unique(edges[np.abs(edges - 0.1) <= 4.7]), 1, 10)
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
    system = routes.lozi(third)
    y = system.simulate(3, 2, 3).measurements
    found = PiecewiseLinearFilter(system).run(3, y)
    mean, cov, loglik = lozi_route(y[1:, 0, 0], third)
    size = system.state_size
    assert found.mean[1:, :, 0] == pytest.approx(mean[:, :size], abs=2e-7)
    assert found.cov[1:, :, :, 0] == pytest.approx(cov[:, :size, :size], abs=2e-7)
    assert found.loglik[1:, 0] == pytest.approx(loglik, abs=2e-7)


def test_branches_of_the_lozi_map():
    y = routes.lozi().simulate(6, 2, 3).measurements
    states = list(PiecewiseLinearFilter(routes.lozi()).states(6, y))
    assert [len(s.branches.cell) for s in states[1:]] == [4, 8, 16, 30, 54, 96]
    cut = list(PiecewiseLinearFilter(routes.lozi(), prune=1e-3).states(6, y))[-1]
    assert len(cut.branches.cell) < 60
    assert np.abs(cut.mean - states[-1].mean).max() < 5e-3
    assert (cut.error_bound > 0.0).all()


def test_new_coordinates_of_plane_regions_change_nothing(monkeypatch):
    """Regions that are given the coordinates of their laws at every step, against none of that."""
    y = routes.lozi(third=True).simulate(6, 3, 3).measurements
    y[3, 0, 1] = np.nan
    plain = PiecewiseLinearFilter(routes.lozi(third=True)).run(6, y)
    monkeypatch.setattr("seedslib.piecewise.local._FAR", 5.0)
    local = PiecewiseLinearFilter(routes.lozi(third=True)).run(6, y)
    for one, other in zip(plain, local, strict=True):
        assert one == pytest.approx(other, abs=1e-10)


def test_long_record_of_a_plane_map():
    """Sixty steps stretch by 1e14 and shrink by 1e32; the estimates stay consistent."""
    runs = routes.lozi().simulate(60, 3, 4)
    filter_ = PiecewiseLinearFilter(routes.lozi(), keep=30)
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
    coarse = routes.lozi()
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


@pytest.mark.parametrize("line", [routes.tent(), routes.saturation()])
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
    base = routes.lozi()
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
