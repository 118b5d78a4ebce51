"""Designed filters read off as tables."""

import numpy as np

from seedslib.design import minimax_synthesis, tabulated
from seedslib.designed import Memory, load, save
from systems import pendulum


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
