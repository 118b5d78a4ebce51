import numpy as np
import pytest

from oracles import piecewise_routes as routes
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem

INF = np.inf


# --- noise in the unrestricted block ------------------------------------------------------------


def test_noise_in_the_unrestricted_block_against_a_grid_of_kalman_filters():
    system = routes.noisy_block()
    y = system.simulate(5, 2, 3).measurements
    y[2, 0, 0] = np.nan
    found = PiecewiseLinearFilter(system, method="exact").run(5, y)
    points, weights = routes.tent_nodes(6)
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
    y = routes.wave(8).simulate(15, 40, 3).measurements
    mean, deviation = grid_filter(y, 15)
    errors = []
    for cells in (12, 24, 48):
        found = PiecewiseLinearFilter(routes.wave(cells)).run(15, y)
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
    found = PiecewiseLinearFilter(system).run(2, routes.measurements([0.9, -0.4]))
    x, weights = routes.panels(np.array([-12.0, 0.5, 12.0]), 40, 20)
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
    gains = {0: 0.0, 1: 0.4, 2: 0.0}
    widths = {1: 0.2, 3: 0.3}  # nothing is measured at t = 2, as there is nothing at t = 0
    system = routes.tent(
        noise=lambda t: [[gains[int(t)]]], sensor_noise=lambda t: [[widths[int(t)]]]
    )
    filter_ = PiecewiseLinearFilter(system)
    states = list(filter_.states(3, routes.measurements([0.2, np.nan, 0.3])))
    assert [len(s.branches.cell) for s in states] == [2, 4, 4, 8]
    assert states[1].lost == 0.0
    assert np.isnan(states[2].lost)
    with pytest.raises(ValueError, match="impossible at t = 2, noise enters the restricted"):
        PiecewiseLinearFilter(system, method="exact").run(3, routes.measurements([0.2, 0.5, 0.3]))
