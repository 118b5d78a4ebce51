"""Plain histograms: cells of equal probability, means and majorities, the same paths again."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import binned_synthesis
from seedslib.designed import Memory, finite_memory, large_order


def test_first_two_steps_are_quantiles_means_and_majorities():
    """On the paths of the design; thin cells take the mean over all memories."""
    system, bins, least = zoo.scalar_switching(), 12, 5
    filter = binned_synthesis(system, large_order(1), [0, 1], paths=800, seed=5, bins=bins)
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
    own, square = filter.predicted, (found.mean - data.states)[:, 0] ** 2
    assert own.in_sample
    np.testing.assert_allclose(own.rms[:, 0], np.sqrt(square.mean(axis=1)))
    np.testing.assert_allclose(filter.covariances[:, 0, 0], square.mean(axis=1))
    np.testing.assert_allclose(own.mode_rate, (found.modes != mode).mean(axis=1))


def test_too_many_cells_for_the_paths_are_warned_of():
    """The errors held out are those of a run on other paths, and above those predicted."""
    system, times = zoo.scalar_switching(), np.arange(12.0)
    with pytest.warns(UserWarning, match="held out") as said:
        filter = binned_synthesis(system, large_order(1), times, paths=20_000, seed=2, bins=40)
    assert len(said) == 1
    data = system.simulate(times, 20_000, 9)
    found = filter.run(times, data.measurements)
    rms = np.sqrt(((found.mean - data.states) ** 2).mean(axis=2))
    held = filter.held_out
    assert (np.abs(held.rms - rms) < 4.5 * np.hypot(held.error, rms / 200))[2:].all()
    assert (filter.predicted.rms[4:] < 0.95 * held.rms[4:]).all()
    assert (np.abs(held.mode_rate - (found.modes != data.modes).mean(axis=1)) < 0.07).all()


@pytest.mark.parametrize(
    "memory", [large_order(1), Memory(1, 0, 1), finite_memory(1), large_order(2)]
)
def test_every_memory_is_better_than_the_mean_also_with_gaps(memory):
    system, times = zoo.dependent_switching(), np.arange(3.0)
    data = system.simulate(times, 2000, 1)
    filter = binned_synthesis(system, memory, times, paths=4000, seed=1, bins=5)
    y = data.measurements.copy()
    if memory.estimates:
        y[1, :, :400] = np.nan
    found = filter.run(times, y, indicators=data.indicators)
    error = np.sqrt(((found.mean - data.states) ** 2).mean(axis=(1, 2)))
    assert (error < 0.9 * data.states.std(axis=(1, 2))).all()
    assert (found.modes != data.modes).mean() < 0.3
