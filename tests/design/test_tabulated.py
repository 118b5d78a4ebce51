"""Designed filters read off as tables."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import Affine, Continuous, minimax_synthesis, synthesize, tabulated
from seedslib.designed import Memory, finite_memory, large_order, load, save
from seedslib.linearization import ExactGaussian, Taylor
from systems import pendulum

TIMES = 1.0 + 0.5 * np.arange(4)
WITH_NODES = np.array([1.0, 1.1, 1.25, 1.5, 1.6, 2.0, 2.5])
MEASURED = np.isin(WITH_NODES, TIMES)


def design(system, memory, rule=None, **options):
    rule = Taylor() if rule is None else rule
    return synthesize(system, memory, rule, TIMES, paths=1000, seed=4, step=0.05, **options)


@pytest.mark.parametrize(
    ("memory", "predictor"),
    [
        (large_order(2), Affine()),
        (finite_memory(1), Affine()),
        (Memory(1, 1), Affine()),
        (large_order(1), Continuous()),
    ],
)
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_table_of_affine_functions_is_exact(memory, predictor):
    """Everything is linear, so multilinear interpolation loses nothing: at nodes, in gaps."""
    system = zoo.linear_gaussian()
    made = design(system, memory, predictor=predictor, components=1)
    table = tabulated(made, y=(-40, 40, 5), z=(-30, 30, 4))
    data = system.simulate(WITH_NODES, 40, 1, measured=MEASURED)
    y = data.measurements.copy()
    if not memory.measurements:
        y[3, :, ::2] = np.nan
    one, two = (f.run(WITH_NODES, y).mean for f in (made, table))
    assert np.abs(one).max() < 30
    np.testing.assert_allclose(two, one, rtol=0, atol=1e-11)
    assert table.order == made.order
    assert table.held_out is None
    rows = np.searchsorted(made.predicted.times, TIMES - 1e-9)
    np.testing.assert_array_equal(table.covariances[:, 0, 0], made.predicted.rms[rows, 0] ** 2)


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_table_claims_the_error_of_its_filter_unless_a_measurement_is_missing(tmp_path):
    system = zoo.flip_process()
    made = design(system, large_order(1), ExactGaussian())
    table = tabulated(made, y=(-8, 8, 81), z=(-4, 4, 81))
    data = system.simulate(TIMES, 20_000, 9)
    found = table.run(TIMES, data.measurements, covariances=True)
    square = ((found.mean - data.states) ** 2).mean(axis=2)[:, 0]
    error = 2 * made.predicted.rms[::5, 0] * made.predicted.error[::5, 0]
    assert (np.abs(square - found.cov[:, 0, 0]) < 4 * error).all()
    save(table, tmp_path / "table.npz")
    y = data.measurements[..., :3].copy()
    y[1, 0, 1] = np.nan
    again = load(tmp_path / "table.npz").run(TIMES, y, covariances=True)
    np.testing.assert_array_equal(again.mean[..., ::2], found.mean[..., :3:2])
    lost = np.logical_or.accumulate(np.isnan(y[:, 0]), axis=0)
    assert np.isnan(again.cov[:, 0, 0]).tolist() == lost.tolist()


def test_table_of_basic_functions_of_ones_own_runs_without_the_model(tmp_path):
    """Two unlike components; a minimax filter with a correction that is not linear."""
    system, times = pendulum(), range(3)
    made = minimax_synthesis(
        system,
        Memory(1),
        times,
        paths=2000,
        seed=1,
        correction=lambda t, forecast, y: np.concatenate([y - np.sin(forecast[:1]), y**3 / 9]),
    )
    table = tabulated(made, y=(-3, 3, 41), z=[(-3, 3, 41), (-4, 4, 17)])
    y = system.simulate(times, 200, 5).measurements
    apart = table.run(times, y).mean - made.run(times, y).mean
    assert np.abs(apart).max() < 0.02
    np.testing.assert_array_equal(table.covariances, made.covariances)
    save(table, tmp_path / "table.npz")
    again = load(tmp_path / "table.npz").run(times, y).mean
    np.testing.assert_array_equal(again, table.run(times, y).mean)
