import numpy as np
import pytest

from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import Polynomial, grid_risk, simulated_synthesis, synthesize
from seedslib.design.tables.regression import histogram_table, likelihood_table
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.evaluation import compare
from seedslib.linearization import ExactGaussian
from seedslib.models import JumpDiffusion, Noise, StochasticMap

TIMES = 0.25 * np.arange(13)
GRID = {"x": (-3.5, 3.5, 281), "z": (-3.0, 3.0, 601), "y": (-8.0, 8.0, 241)}
EXACT = [0.13492, 0.13355, 0.13374, 0.13411, 0.13440, 0.13463, 0.13477, 0.13487]
"""Risk of the exact filter of order one at the measurements 1 to 8, from the grid."""

TABLES = {"z": (-2.0, 2.0, 81), "y": (-8.0, 8.0, 97), "nodes": 0}


@pytest.fixture(scope="module")
def flip():
    return zoo.flip_process()


@pytest.mark.parametrize(
    ("method", "paths", "most"),
    [("likelihood", 5000, 1.01), ("likelihood", 20_000, 1.004), ("histogram", 20_000, 1.02)],
)
def test_exact_synthesis_on_paths_comes_close_to_the_grid(flip, method, paths, most):
    """Its true risk, which is known without random numbers: at most 1 % (2 %) above."""
    found = simulated_synthesis(
        flip, large_order(1), TIMES[:9], paths=paths, seed=1, method=method, **TABLES
    )
    risk = grid_risk(found, **GRID).mse[1:]
    assert 1.0 <= risk.mean() / np.mean(EXACT) < most
    # what the design says about itself, on paths it has not seen, is true within its error
    says, error = found.predicted.rms[1:, 0], found.predicted.error[1:, 0]
    assert (np.abs(says - np.sqrt(risk)) < 4 * error).all()


def test_known_likelihood_is_worth_many_paths(flip):
    """A fourth of the paths with the likelihood does better than the histogram."""
    risks = [
        grid_risk(
            simulated_synthesis(
                flip, large_order(1), TIMES[:5], paths=paths, seed=2, method=method, **TABLES
            ),
            **GRID,
        ).mse[1:].mean()
        for method, paths in (("likelihood", 4000), ("histogram", 16_000))
    ]  # fmt: skip
    assert risks[0] < risks[1]


def test_likelihood_weights_by_hand():
    """Paths at two nodes of the memory, no smoothing: ratios of likelihood-weighted sums."""
    rng = np.random.default_rng(3)
    x, u = rng.standard_normal((1, 60)), np.where(np.arange(60) < 30, 1.0, 2.0)[None]
    axes = (Axis(-4.0, 4.0, 9),), (Axis(0.0, 3.0, 4),)
    sensor, grid = zoo.flip_process().sensor, axes[0][0].nodes

    def log_density(part):
        return sensor.log_density(0.0, grid[None, None], x[:, part, None])

    table = likelihood_table(log_density, x, u, *axes, 1e-9)
    assert table.shape == (1, 9, 4)
    for cell in (1, 2):
        here = x[0, u[0] == cell]
        for y in (-1.0, 0.0, 3.0):
            spread = 0.25 + 0.09 * here**2
            likely = np.exp(-0.5 * (y - here) ** 2 / spread) / np.sqrt(spread)
            wanted = (likely @ here) / likely.sum()
            assert table[0, int(y) + 4, cell] == pytest.approx(wanted, rel=1e-12)


def test_histogram_by_hand():
    """Measurements on the nodes, no smoothing: means of the paths there."""
    rng = np.random.default_rng(4)
    x, y = rng.standard_normal((1, 90)), rng.integers(-1, 2, (1, 90)).astype(float)
    table = histogram_table(x, y, (Axis(-1.0, 1.0, 3),), 1e-9)
    assert table[0] == pytest.approx([x[y == v].mean() for v in (-1.0, 0.0, 1.0)], rel=1e-12)


def test_forecast_where_no_path_was_is_that_of_the_nearest_crowd():
    x = np.concatenate([np.full(50, 2.0), np.full(50, 5.0)])[None]
    u = np.concatenate([np.zeros(50), np.full(50, 3.0)])[None]
    axis = Axis(-10.0, 13.0, 93)
    table = histogram_table(x, u, (axis,), 0.1)
    for node, wanted in ((0.0, 2.0), (3.0, 5.0), (4.0, 5.0), (-10.0, 3.5)):
        # at the end, beyond every kernel, the mean of all
        assert table[0, np.argmin(np.abs(axis.nodes - node))] == pytest.approx(wanted)


def test_two_components_and_two_measurements():
    """Van der Pol: tables over four arguments beat the filter of theorem 2 by far."""
    system, times = zoo.van_der_pol(), 0.5 * np.arange(5)
    found = simulated_synthesis(
        system, large_order(1), times, paths=6000, seed=1, nodes=0,
        z=[(-4, 4, 21), (-6, 6, 21)], y=[(-3, 14, 15), (-8, 8, 13)],
    )  # fmt: skip
    assert found.order == 2
    data = system.simulate(times, 8000, 55)
    error = found.run(times, data.measurements).mean - data.states
    rms = np.sqrt((error[:, 0] ** 2).mean(axis=1))
    assert rms[0] == pytest.approx(0.2133, abs=4e-3)
    # affine forecasts: 0.368 at t = 2 from 1e5 paths; the exact filter of order one: 0.271
    assert 0.25 < rms[4] < 0.30


def test_tables_of_the_kicked_oscillator_beat_polynomial_forecasts():
    system, times = zoo.kicked_duffing(), 0.5 * np.arange(7)
    table = simulated_synthesis(
        system, large_order(1), times, paths=5000, seed=1, nodes=0,
        z=[(-3, 3, 31), (-5, 5, 31)], y=(-8, 8, 49),
    )  # fmt: skip
    cubic = synthesize(
        system, large_order(1), ExactGaussian(), times, predictor=Polynomial(3, 2), nodes=0,
        paths=8000, seed=1,
    )  # fmt: skip
    found = compare({"table": table, "cubic": cubic}, system, times, 8192, 2, components=1)
    apart = found.difference("table", "cubic")
    assert apart.average[0] < -4 * apart.average_error[0]


def test_one_component_of_two_and_mixed_memory():
    system, times = zoo.van_der_pol(), 0.5 * np.arange(3)
    found = simulated_synthesis(
        system, Memory(1, 1), times, paths=2000, seed=1, nodes=1, components=1,
        z=(-4, 4, 11), y=[(-3, 14, 9), (-8, 8, 9)],
    )  # fmt: skip
    assert found.order == 3
    data = system.simulate(times, 500, 55)
    estimates = found.run(times, data.measurements)
    assert estimates.mean.shape == (3, 1, 500)
    assert found.steps[1].shown.estimate.shape == (1, 9, 9, 11, 9, 9)
    assert np.sqrt(((estimates.mean - data.states[:, :1]) ** 2).mean(axis=2)).max() < 0.35


def test_default_axes_and_equal_seeds(flip):
    one, two = (
        simulated_synthesis(flip, finite_memory(1), TIMES[:3], paths=500, seed=7, nodes=1)
        for _ in range(2)
    )
    assert np.array_equal(one.steps[2].shown.estimate, two.steps[2].shown.estimate)
    assert one.design.entropy == 7
    assert not one.design.exact
    assert not one.predicted.in_sample
    assert one.predicted.times == pytest.approx([0.0, 0.125, 0.25, 0.375, 0.5])


@pytest.mark.filterwarnings("ignore:held out:UserWarning")
def test_diverged_paths_are_left_out():
    system = JumpDiffusion.from_functions(
        lambda t, x: np.where(np.abs(x) > 1.5, x**9, -x),
        lambda t, x: np.ones((1, 1, *x.shape[1:])),
        StochasticMap.from_functions(
            1, 1, lambda t, x, v: x + v, Noise(1),
            log_density=lambda t, y, x: (-0.5 * (y - x) ** 2)[0],
        ),
        [0.0],
        [[0.3]],
        step=0.05,
    )  # fmt: skip
    with pytest.warns(UserWarning, match="design paths diverged and were left out"):
        found = simulated_synthesis(system, large_order(1), [0.0, 0.5], paths=2000, seed=1, nodes=0)
    assert 0 < found.design.diverged < 2000
    assert found.design.paths == 4000
    assert np.isfinite(found.steps[1].shown.estimate).all()


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"method": "neural"}, ValueError, "method: wanted one of likelihood, histogram"),
        ({"sets": 1}, ValueError, "sets: wanted at least 2, got 1"),
        ({"kernel": 0.0}, ValueError, "kernel: wanted a positive number"),
        ({"components": 2}, ValueError, "components: wanted 1 to 1, got 2"),
        ({"paths": 0}, ValueError, "paths: wanted at least 1"),
        ({"paths": 10.5}, TypeError, "paths: wanted a whole number"),
        ({"seed": None}, TypeError, "seed: wanted"),
        ({"nodes": -1}, ValueError, "nodes: wanted at least 1"),
        ({"memory": Memory(1, log_odds=True)}, ValueError, "memory: wanted estimates"),
        ({"memory": 1}, TypeError, "memory: wanted a Memory"),
        ({"memory": large_order(4), "z": (-2, 2, 99)}, ValueError, "would have .* entries"),
        ({"y": (-8, 8)}, TypeError, "y: wanted an Axis"),
    ],
)
def test_bad_input(flip, options, kind, message):
    given = {"memory": large_order(1), "times": TIMES[:2], "paths": 100, "seed": 1, **options}
    with pytest.raises(kind, match=message):
        simulated_synthesis(flip, **given)


def test_a_likelihood_is_wanted_by_name():
    system = JumpDiffusion.from_functions(
        lambda t, x: -x,
        lambda t, x: np.ones((1, 1, *x.shape[1:])),
        StochasticMap.from_functions(1, 1, lambda t, x, v: x * v, Noise(1)),
        [1.0],
        [[0.3]],
    )
    with pytest.raises(ValueError, match="likelihood wants a sensor with a log-density"):
        simulated_synthesis(system, large_order(1), [0.0, 0.5], paths=100, seed=1)
    found = simulated_synthesis(
        system, large_order(1), [0.0, 0.5], paths=2000, seed=1, method="histogram"
    )
    assert np.isfinite(found.predicted.rms).all()
