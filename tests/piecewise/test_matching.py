"""Transitions that are met by matching the moments of every cell."""

import numpy as np
import pytest

from oracles.piecewise import TIMES, at_time, panels, tent, wave
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem, line_cells

INF = np.inf
A, B = (lambda t: at_time(t, (1, 2), 1)), (lambda t: at_time(t, (1, 1, 2), 2))
NOISE = {"noise": lambda t: [[[0.4, 0.3 + 0.1 * np.sin(t)]]]}
NOISY = PiecewiseLinearSystem(
    [-INF, 0.5, INF], lambda t: (A(t), B(t)), lambda t: (0.3 * A(t + 9), B(t + 9)), [[0.3]], [0.2],
    [[0.8]], **NOISE,
)  # fmt: skip


def test_matching_equals_sums_over_pairs_of_cells():
    """Each truncated law by plain quadrature; everything varies with time."""
    y = NOISY.simulate(TIMES, 2, 3).measurements
    y[0], y[2, 0, 1] = 0.3, np.nan
    found = PiecewiseLinearFilter(NOISY).run(TIMES, y)
    x, weights = panels(np.r_[np.linspace(-14, 0.5, 60), np.linspace(0.5, 14, 60)[1:]], 20)
    cell = (x >= 0.5).astype(int)

    def normal(z, mean, var):
        return np.exp(-0.5 * (z - mean) ** 2 / var) / np.sqrt(2 * np.pi * var)

    for n in range(2):
        law = normal(x, 0.2, 0.8)
        for k, t in enumerate(TIMES):
            if k:
                s, predicted = TIMES[k - 1], 0.0
                for j in (0, 1):
                    part = np.where(cell == j, law, 0.0) * weights
                    mass, mean = part.sum(), (part * x).sum() / part.sum()
                    var = B(s)[0, 0, j] ** 2 * (part * (x - mean) ** 2).sum() / mass
                    var += NOISE["noise"](s)[0][0][j] ** 2
                    predicted = predicted + mass * normal(x, A(s)[0, j] + B(s)[0, 0, j] * mean, var)
                law = predicted
            if not np.isnan(y[k, 0, n]):
                seen = 0.3 * A(t + 9)[0, cell] + B(t + 9)[0, 0, cell] * x
                law = law * normal(y[k, 0, n], seen, 0.09)
            total = (law * weights).sum()
            law = law / total
            mean = (law * weights * x).sum()
            assert found.loglik[k, n] == pytest.approx(np.log(total), abs=1e-11)
            assert found.mean[k, 0, n] == pytest.approx(mean, abs=1e-11)
            var = (law * weights * (x - mean) ** 2).sum()
            assert found.cov[k, 0, 0, n] == pytest.approx(var, abs=1e-11)
            shares = np.bincount(cell, law * weights)
            np.testing.assert_allclose(found.mode_prob[k, :, n], shares, atol=1e-11)


def test_matching_in_a_plane_cut_by_parallel_lines_is_that_of_the_line():
    """Cells that depend on one component alone, given as intervals and as plane cells."""
    edges, rng = [-0.3, 0.6], np.random.default_rng(3)
    dynamics = rng.standard_normal((2, 3)), 0.5 * rng.standard_normal((2, 2, 3))
    sensor = rng.standard_normal((1, 3)), rng.standard_normal((1, 2, 3))
    rest = ([[0.4]], [0.1, -0.2], [[0.5, 0.1], [0.1, 0.3]])
    noise = 0.3 * rng.standard_normal((2, 2, 3))
    line = PiecewiseLinearSystem([-INF, *edges, INF], dynamics, sensor, *rest, noise=noise)
    cells = line_cells([[1.0, 1.0], [0.0, 0.0]], edges)
    where = cells.locate(np.array([[-1.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    order = np.argsort(where)
    plane = PiecewiseLinearSystem(
        cells, tuple(part[..., order] for part in dynamics),
        tuple(part[..., order] for part in sensor), *rest, noise=noise[..., order],
    )  # fmt: skip
    y = line.simulate(3, 4, 2).measurements
    one, other = (PiecewiseLinearFilter(s).run(3, y) for s in (line, plane))
    for field in ("mean", "cov", "loglik"):
        np.testing.assert_allclose(getattr(other, field), getattr(one, field), atol=1e-9)
    np.testing.assert_allclose(other.mode_prob[:, where], one.mode_prob, atol=1e-9)


def test_matching_converges_with_the_square_of_the_number_of_cells():
    """Against a grid of points for the nonlinear model."""
    y = wave(8).simulate(8, 20, 3).measurements
    x = np.linspace(-6, 6, 1201)
    kernel, means = np.exp(-0.5 * ((x[:, None] - 2 * np.sin(x)) / 0.5) ** 2), []
    weight = np.exp(-((x - 1.0) ** 2))[:, None] * np.ones(20)
    for t in range(1, 9):
        weight = kernel @ weight * np.exp(-0.5 * ((y[t] - x[:, None] ** 2 / 5) / 0.3) ** 2)
        weight /= weight.sum(axis=0)
        means.append(x @ weight)
    errors = [
        np.sqrt(np.mean((PiecewiseLinearFilter(wave(n)).run(8, y).mean[1:, 0] - means) ** 2))
        for n in (12, 24)
    ]
    assert errors[0] < 0.03
    assert errors[0] / errors[1] > 3.0


def test_exact_and_matched_steps_may_alternate():
    """Noise at the second step only: there the bound is given up, unless there is one cell."""
    gains, widths = {0: 0.0, 1: 0.4, 2: 0.0}, {1: 0.2, 3: 0.3}
    system = tent(noise=lambda t: [[gains[int(t)]]], sensor_noise=lambda t: [[widths[int(t)]]])
    y = np.array([[np.nan], [0.2], [np.nan], [0.3]])
    states = list(PiecewiseLinearFilter(system).states(3, y))
    assert [len(state.weights) for state in states] == [2, 4, 4, 8]
    assert states[1].lost == 0.0
    assert np.isnan(states[2].lost)
    with pytest.raises(ValueError, match=r"^method: .* t = 2, noise"):
        PiecewiseLinearFilter(system, method="exact").run(3, y)
    linear = {"regions": [-INF, INF], "dynamics": ([1.0], [[0.5]]), "sensor": ([0.0], [[1.0]])}
    one = PiecewiseLinearFilter(tent(**linear, noise=[[0.3]]))
    assert list(one.states(3, y))[-1].lost == 0.0


def test_matching_takes_fewer_records_together_the_more_cells_there_are():
    assert PiecewiseLinearFilter(tent()).block(TIMES, 10**7, 1) == 10**7
    for system in (tent(noise=[[0.1]]), tent(noise=lambda t: {2.0: [[0.1]]}[t])):
        filter_ = PiecewiseLinearFilter(system)
        assert [filter_.block(TIMES, n, 1) for n in (0, 7, 10**7)] == [1, 7, 500_000]
    assert PiecewiseLinearFilter(wave(2000)).block(TIMES, 50, 1) == 1
