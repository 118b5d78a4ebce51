"""Filters of tables: what is looked up, remembered, claimed, forecast and left out."""

import warnings
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import RegularGridInterpolator

from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import (
    grid_synthesis,
    simulated_synthesis,
)
from seedslib.designed import Memory, TableFilter, finite_memory, large_order

TIMES = 0.25 * np.arange(5)
FLIP = {"x": (-3.5, 3.5, 71), "z": (-2.5, 2.5, 51), "y": (-8.0, 8.0, 49)}
MODES = {"x": (-8, 8, 41), "z": (-6, 6, 31), "y": (-16, 18, 35)}
HINTED = {"x": (-6, 6, 31), "z": (-4, 4, 21), "y": (-7, 11, 31)}


def looked_up(table, points):
    """Multilinear between the nodes and constant beyond them, by SciPy; (., N) of each part."""
    if not table.axes:
        return table.estimate[:, None], table.mode
    axes = [
        np.arange(a.count) if not isinstance(a, Axis) else np.linspace(a.low, a.high, a.count)
        for a in table.axes
    ]
    points = np.broadcast_arrays(*points)
    inside = [np.clip(p, axis[0], axis[-1]) for p, axis in zip(points, axes, strict=True)]
    inside = np.stack(inside, axis=-1)

    def value(part, method="linear"):
        return RegularGridInterpolator(axes, part, method)(inside)

    mean = np.stack([value(part) for part in table.estimate])
    mode = None if table.mode is None else value(table.mode.astype(float), "nearest")
    return mean, mode


CASES = {
    "large order": (lambda: zoo.flip_process(), large_order(2), FLIP),
    "finite memory": (lambda: zoo.flip_process(), finite_memory(1), FLIP),
    "modes": (lambda: zoo.scalar_switching("A1H"), Memory(2), MODES | {"z": (-6, 6, 9)}),
    "indicator": (lambda: zoo.dependent_switching(), Memory(1, 0, 1), HINTED),
    "indicator that is forgotten": (lambda: zoo.dependent_switching(), Memory(1), HINTED),
    "measurements with an indicator": (lambda: zoo.dependent_switching(), Memory(0, 1, 1), HINTED),
}


@pytest.fixture(scope="module", params=CASES)
def table(request):
    make, memory, options = CASES[request.param]
    system = make()
    times = TIMES if hasattr(system, "drift") else 2.0 + np.arange(4)
    return grid_synthesis(system, memory, times, **options)


def recorded(filter, paths=12):
    data = filter.system.simulate(filter.times, paths, 3)
    y, shown = np.array(data.measurements), data.indicators
    return y, None if shown is None else np.array(shown)


def by_hand(filter, y, shown):
    """Estimates and modes of a batch (K + 1, 1, N), NaN and -1 where missing."""
    memory, blocks, found = filter.memory, [], []
    values = filter.system.indicators
    for k, step in enumerate(filter.steps):
        told = [] if shown is None else [np.where(shown[k] < 0, values, shown[k])]
        past = []
        for z, mode, seen, measured in blocks[: max(memory.estimates, memory.measurements)]:
            past += [mode] if mode is not None and memory.estimates else []
            past += [seen] if memory.indicators else []
            past += [z] if memory.estimates else [measured]
        there, blind = ~np.isnan(y[k, 0]), looked_up(step.forecast, [*told, *past])
        seen = looked_up(step.update, [*told, np.nan_to_num(y[k, 0]), *past])
        row = [
            None if a is None else np.where(there, a, b) for a, b in zip(seen, blind, strict=True)
        ]
        found.append(row)
        blocks.insert(0, (row[0][0], row[1], None if shown is None else shown[k], y[k, 0]))
    return found


def test_run_is_the_tables_looked_up(table):
    """And the steps are the run; alone, in a batch, in a grid, in threads."""
    y, shown = recorded(table)
    if not table.memory.measurements:
        y[2, :, 4] = y[0, :, 5] = np.nan
    if shown is not None and not table.memory.indicators:
        shown[1, 6] = shown[2, 4] = -1
    gaps = (~np.isfinite(y[:, 0])) | (False if shown is None else shown < 0)
    given = {} if shown is None else {"indicators": shown}
    if gaps.any():
        with pytest.warns(UserWarning, match=f"{gaps.any(axis=0).sum()} of 12 records have gaps"):
            found = table.run(table.times, y, covariances=True, **given)
    else:
        found = table.run(table.times, y, covariances=True, **given)
    state, one = table.initial((12,)), table.initial()
    lost = np.logical_or.accumulate(gaps)
    for k, (mean, mode) in enumerate(by_hand(table, y, shown)):
        assert_allclose(found.mean[k], mean, atol=1e-9)
        if mode is not None:
            assert_array_equal(found.modes[k], mode)
        ahead = table.predict(state, table.times[k])
        told = None if shown is None else shown[k]
        state = table.correct(ahead, y[k], told)
        one = table.step(one, table.times[k], y[k, :, 4], None if shown is None else shown[k, 4])
        assert_array_equal(state.mean, found.mean[k])
        assert_allclose(one.mean, found.mean[k, :, 4], rtol=1e-12)
        wanted = np.where(lost[k], np.nan, table.covariances[k, 0, 0])
        assert_array_equal(np.broadcast_to(state.cov, (1, 1, 12))[0, 0], wanted)
        assert_array_equal(
            np.broadcast_to(found.cov[k].reshape(1, 1, -1), (1, 1, 12))[0, 0], wanted
        )
        if k and mode is not None:
            assert ahead.mode.shape == (12,)
            assert_array_equal(state.mode, found.modes[k])
    assert found.loglik is None
    assert not found.diverged.any()
    plane = {name: part.reshape(-1, 3, 4) for name, part in given.items()}
    alone = {name: part[:, 2] for name, part in given.items()}
    shaped = y.reshape(len(y), 1, 3, 4)
    with pytest.warns(UserWarning, match="gaps") if gaps.any() else nullcontext():
        whole = table.run(table.times, shaped, workers=2, covariances=True, **plane)
    assert_array_equal(whole.mean.reshape(found.mean.shape), found.mean)
    single = table.run(table.times, y[..., 2], covariances=True, **alone)
    assert_allclose(single.mean, found.mean[..., 2], rtol=1e-12)
    assert single.cov.shape == (len(y), 1, 1)


def test_tables_are_constant_beyond_their_axes(table):
    y, shown = np.full((len(table.times), 1, 4), 0.5), None
    y[-1, 0] = [-50.0, -1e9, 50.0, 1e9]
    if table.system.indicators:
        shown = np.zeros((len(y), 4), dtype=int)
    given = {} if shown is None else {"indicators": shown}
    with pytest.warns(UserWarning, match=r"^y: wanted measurements from .*, where the tables are"):
        last = table.run(table.times, y, **given).mean[-1, 0]
    assert last[0] == last[1]
    assert last[2] == last[3]


def test_measurements_inside_of_the_tables_are_not_warned_of(table):
    y = np.full((len(table.times), 1, 2), 0.5)
    y[1:, 0, 0] = np.nan
    given = {}
    if table.system.indicators:
        given["indicators"] = np.zeros((len(y), 2), dtype=int)
    y = y[..., 1:] if table.memory.measurements else y
    given = {name: part[:, : y.shape[2]] for name, part in given.items()}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        table.run(table.times, y, **given)
    assert not [one for one in caught if str(one.message).startswith("y:")]


def test_order_change_and_size_of_tables(table):
    memory = table.memory
    numbers = memory.estimates + memory.measurements
    modes = memory.estimates * (getattr(table.system, "modes", 0) > 0)
    assert table.order == numbers + modes + memory.indicators
    moved, wrong = table.change
    error = np.sqrt(table.covariances[-1, 0, 0])
    assert_allclose([moved, wrong], [table.changes[0, -1] / error, table.changes[1, -1]])
    tables = [each for row in table.steps for each in row]
    parts = [part for each in tables for part in each[1:] if part is not None]
    assert table.bytes == sum(part.nbytes for part in parts)
    assert isinstance(table, TableFilter)
    said = [
        f"{a.count} nodes from {a.low:g} to {a.high:g}"
        for a in table.steps[1].update.axes
        if isinstance(a, Axis)
    ]
    assert all(each in str(table) for each in said)
    some = table.taking([0, 1])
    assert some.predicted is None
    assert_array_equal(some.changes, table.changes[:, :2])
    assert np.isnan(replace(table, changes=None).change).all()


def test_missing_measurement_leaves_the_conditional_mean():
    """Against the mean over simulated paths whose first measurement was nearly the same."""
    system = zoo.scalar_switching("A1H")
    axes = {"x": (-8, 8, 81), "z": (-6, 6, 61), "y": (-16, 18, 69)}
    filter = grid_synthesis(system, large_order(1), [0, 1], **axes)
    data = system.simulate([0, 1], 100_000, 3)
    first = data.measurements[0, 0]
    for low, high in ((-2.2, -1.8), (3.8, 4.2)):
        same = (first > low) & (first < high)
        shown = data.measurements[..., same].copy()
        shown[1] = np.nan
        found = filter.run([0, 1], shown)
        states, forecast = data.states[1, 0, same], found.mean[1, 0]
        assert abs(states.mean() - forecast.mean()) < 4 * states.std() / same.sum() ** 0.5
        assert (found.modes[1] == ((data.modes[1, same] == 1).mean() > 0.5)).all()


def test_tables_of_several_components_see_a_measurement_as_a_whole():
    """Functions of two measurements and two estimates; by regression on paths."""
    filter = simulated_synthesis(
        zoo.van_der_pol(),
        large_order(1),
        [0.0, 0.5],
        paths=500,
        seed=1,
        z=[(-4, 4, 9), (-5, 5, 7)],
        y=[(-3, 14, 9), (-8, 8, 6)],
    )
    y = np.random.default_rng(1).normal(size=(2, 2, 5))
    found = filter.run([0.0, 0.5], y).mean
    assert found.shape == (2, 2, 5)
    assert_allclose(found[1], looked_up(filter.steps[1].update, [*y[1], *found[0]])[0], atol=1e-10)
    assert_array_equal(filter.output(1, y[1], found[0]).mean, found[1])
    assert_allclose(filter.run([0.0], np.full((1, 2), np.nan)).mean[0], [2.0, 0.0], atol=1e-12)
