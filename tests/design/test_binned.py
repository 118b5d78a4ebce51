"""Plain histograms: cells of equal probability, means and majorities, the same paths again."""

from pathlib import Path

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import binned_synthesis, grid_risk
from seedslib.designed import Memory, finite_memory, large_order

TABLE = Path(__file__).parents[2] / "benchmarks" / "switching_histogram.csv"
PRINTED = {"A1H": (0.3075, 1.1918), "A1L": (0.1242, 0.6576), "A2": (0.3668, 1.3132)}
"""Another program's part of wrong modes and RMSE, of 40 x 40 cells on 300 000 paths."""

DOUBTS = {"A1H": (0.002, 0.0052), "A1L": (0.0018, 0.0036), "A2": (0.002, 0.0076)}
"""Their standard errors, on 4000 test paths."""


def test_first_steps_by_hand():
    """Quantiles, means and majorities of two steps written out, on the paths of the design."""
    system, bins, least = zoo.scalar_switching(), 6, 21
    filter = binned_synthesis(
        system, large_order(1), [0, 1], paths=800, seed=5, bins=bins, least=least
    )
    data = system.simulate([0, 1], 800, 5)
    found = filter.run([0, 1], data.measurements)
    x, y, mode = data.states[:, 0], data.measurements[:, 0], data.modes
    level = np.arange(1, bins) / bins
    cell = np.searchsorted(np.quantile(y[0], level), y[0])
    z = np.array([x[0][cell == c].mean() for c in range(bins)])[cell]
    d = np.array([mode[0][cell == c].mean() > 0.5 for c in range(bins)])[cell]
    np.testing.assert_allclose(found.mean[0, 0], z, rtol=1e-12)
    assert (found.modes[0] == d).all()
    thin = 0
    for i in (0, 1):
        here = np.flatnonzero(d == i)
        a = np.searchsorted(np.quantile(y[1][here], level), y[1][here])
        b = np.searchsorted(np.quantile(z[here], level), z[here])
        for p in range(bins):
            column = here[a == p]
            for q in range(bins):
                inside = here[(a == p) & (b == q)]
                if inside.size:
                    crowd = inside if inside.size >= least else column
                    np.testing.assert_allclose(found.mean[1, 0, inside], x[1][crowd].mean())
                    assert (found.modes[1][inside] == (mode[1][crowd].mean() > 0.5)).all()
                    thin += inside.size < least
    assert thin > 3
    own = filter.predicted
    assert own.in_sample
    assert own.rms[1, 0] == pytest.approx(np.sqrt(((found.mean[1] - data.states[1]) ** 2).mean()))


def test_errors_come_to_the_optimum_as_cells_and_paths_grow():
    """True risks, from the grid: above the optimum, falling, and flattered by the own paths."""
    flip, times = zoo.flip_process(), 0.25 * np.arange(4)
    axes = {"x": (-3.5, 3.5, 141), "z": (-3, 3, 241), "y": (-8, 8, 161)}
    exact, risks = 0.13374, []
    for bins, paths in ((6, 4000), (20, 60_000)):
        filter = binned_synthesis(flip, large_order(1), times, paths=paths, seed=2, bins=bins)
        risks.append(grid_risk(filter, **axes).mse[-1])
        assert filter.predicted.rms[-1, 0] ** 2 < risks[-1]
    assert exact < risks[1] < risks[0]
    assert risks[1] < 1.04 * exact


def test_numbers_of_another_program():
    """40 x 40 cells on 300 000 paths, committed, within the standard errors of both."""
    import csv

    with TABLE.open() as file:
        rows = {(r["sensor"], int(r["bins"]), int(r["paths"])): r for r in csv.DictReader(file)}
    for sensor, wanted in PRINTED.items():
        row = rows[sensor, 40, 300_000]
        for name, value, doubt in zip(("mode_error", "rmse"), wanted, DOUBTS[sensor], strict=True):
            error = np.hypot(doubt, float(row[f"{name}_error"]))
            assert abs(float(row[name]) - value) < 3 * error, (sensor, name)
    # with few paths many cells are worse than few cells
    few, many = (float(rows["A1H", bins, 30_000]["rmse"]) for bins in (20, 40))
    assert many > few > float(rows["A1H", 20, 300_000]["rmse"])


def test_too_many_cells_for_the_paths_are_noticed():
    """The errors held out are those of a run on other paths, and above those predicted."""
    system, times = zoo.scalar_switching(), np.arange(12.0)
    with pytest.warns(UserWarning, match="not the predicted one") as said:
        filter = binned_synthesis(system, large_order(1), times, paths=20_000, seed=2, bins=40)
    assert len(said) == 2  # of the errors, of the modes
    data = system.simulate(times, 20_000, 9)
    found = filter.run(times, data.measurements)
    rms = np.sqrt(((found.mean - data.states) ** 2).mean(axis=2))
    held = filter.held_out
    assert (np.abs(held.rms - rms) < 4.5 * np.hypot(held.error, rms / 200))[2:].all()
    assert (filter.predicted.rms[4:] < 0.95 * held.rms[4:]).all()
    assert (np.abs(held.mode_rate - (found.modes != data.modes).mean(axis=1)) < 0.07).all()


def test_every_memory_and_missing_data():
    system, times = zoo.dependent_switching(), np.arange(3.0)
    data = system.simulate(times, 50, 1)
    for memory in (large_order(1), Memory(1, 0, 1), finite_memory(1), large_order(2)):
        filter = binned_synthesis(system, memory, times, paths=3000, seed=1, bins=5)
        y = data.measurements.copy()
        if memory.estimates:
            y[1, :, :10] = np.nan
        found = filter.run(times, y, indicators=data.indicators)
        assert np.isfinite(found.mean).all()
        assert set(np.unique(found.modes)) <= {0, 1}


def test_bad_input():
    with pytest.raises(ValueError, match="one measured component"):
        binned_synthesis(zoo.van_der_pol(), large_order(1), [0, 1], paths=10, seed=1)
    with pytest.raises(ValueError, match="bins"):
        binned_synthesis(zoo.flip_process(), large_order(1), [0, 1], paths=10, seed=1, bins=1)
