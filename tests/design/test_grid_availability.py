"""Exact designs that condition on what has arrived: claims after gaps, likely or not, are right."""

import csv
import warnings
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import (
    grid_risk,
    grid_synthesis,
    optimal_risk,
    stationary,
    tabulated,
)
from seedslib.designed import Memory, finite_memory, load, save
from seedslib.evaluation import diff
from seedslib.extra import to_c
from seedslib.filters import extended_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap

p, q, v, w = sympy.symbols("p q v w", real=True)
TIMES = np.arange(20.0)
GRIDS = {"x": (-12, 12, 65), "z": (-12, 12, 73), "y": (-15, 15, 57)}
SMALL = {"x": (-9, 9, 35), "z": (-9, 9, 41), "y": (-11, 11, 33)}


@pytest.fixture(scope="module")
def system():
    """Errors after a silence are up to three times those without."""
    return DiscreteSystem(
        StochasticMap([p], [0.95 * p + q], Noise([q], cov=[[0.7]])),
        StochasticMap([p], [p + v], Noise([v])), [0.5], [[1.0]],
    )  # fmt: skip


@pytest.fixture(scope="module")
def filter(system):
    return grid_synthesis(system, Memory(1), TIMES, availability=0.9, **GRIDS)


@pytest.fixture(scope="module")
def pair():
    """One state, two sensors."""
    return DiscreteSystem(
        StochasticMap([p], [0.8 * p + q], Noise([q])),
        StochasticMap([p], [p + v, p - w], Noise([v, w], cov=np.diag([1.0, 3.0]))), [0.0], [[2.0]],
    )  # fmt: skip


def kalman(system, times, y):
    """Variances of the Kalman filter, (K+1, records)."""
    found = extended_kalman(system).run(times, y).cov
    return np.broadcast_to(found.reshape(len(times), -1), (len(times), y.shape[2]))


def variances(found):
    return found.cov.reshape(len(found.cov), -1)


def test_claims_after_a_silence_are_those_of_the_kalman_filter_and_the_errors_too(system, filter):
    """After 1 to 15 missing rows, which by chance would hardly ever be met, and after their end."""
    data = system.simulate(TIMES, 3000, 3)
    for count in (1, 4, 15):
        y = data.measurements.copy()
        y[3 : 3 + count] = np.nan
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = filter.run(TIMES, y, covariances=True)
        best = extended_kalman(system).run(TIMES, y)
        claims = np.sqrt(variances(found).mean(axis=1))
        right = np.sqrt(best.cov.reshape(len(TIMES), -1)[:, 0])
        assert np.abs(claims / right - 1).max() < 0.02
        # on the same paths: the difference of the squares has far smaller standard errors
        square = (found.mean - data.states)[:, 0] ** 2
        more = square - (best.mean - data.states)[:, 0] ** 2
        has = right**2 + more.mean(axis=1)
        doubt = 4 * more.std(axis=1) / np.sqrt(3000) / has
        assert (np.abs(has / claims**2 - 1) < 2 * 0.02 + doubt).all()
        assert doubt.max() < 0.02


def test_the_mean_covariance_is_that_of_all_histories(system, monkeypatch):
    """Each history a class of its own: what is predicted is the mean over all, exactly."""
    monkeypatch.setattr("seedslib.design.histories.ALIKE", 1e-12)
    times, rate, wanted = np.arange(4.0), 0.7, np.zeros(4)
    for history in product((False, True), repeat=4):
        cov = np.float64(1.0)
        for k, there in enumerate(history):
            if k:
                cov = 0.95**2 * cov + 0.7
            cov = cov / (1 + cov) if there else cov
            chance = np.prod([rate if seen else 1 - rate for seen in history])
            wanted[k] += chance * cov
    apart = []
    for nodes in (81, 161):
        axes = {
            "x": (-10, 10, 61),
            "z": (-8, 8, nodes),
            "y": (-11, 11, 239),
        }  # no multiples of each other
        made = grid_synthesis(system, Memory(1), times, availability=rate, **axes)
        assert [len(part.table) for part in made.arrivals] == [1, 2, 4, 8]
        apart.append(made.predicted.rms[:, 0] ** 2 - wanted)
    # the rounding of the memory is all that is left, and falls with the square of its step
    np.testing.assert_allclose(apart[0][1:] / apart[1][1:], 4.0, rtol=0.05)
    assert np.abs(4.0 * apart[1] - apart[0]).max() / 3.0 < 1e-4


def test_the_risk_without_tables_is_that_of_the_tables(system):
    told = {"availability": 0.6, "measured": [0, 2, 3], **SMALL}
    made = grid_synthesis(system, Memory(1), TIMES[:4], **told)
    risk = optimal_risk(system, Memory(1), TIMES[:4], **told)
    np.testing.assert_allclose(risk.mse, made.predicted.rms[:, 0] ** 2, rtol=1e-12)
    np.testing.assert_allclose(made.covariances[:, 0, 0], risk.mse, rtol=1e-12)
    for part in made.arrivals:
        assert part.prob.sum() == pytest.approx(1.0)


def test_what_is_sure_is_the_old_design_and_nothing_the_forecast(system, tmp_path):
    times = TIMES[:5]
    old = grid_synthesis(system, Memory(2), times, **SMALL)
    for told in ({"availability": 1.0}, {"measured": np.ones(5, dtype=bool)}):
        sure = grid_synthesis(system, Memory(2), times, **told, **SMALL)
        for name, made in (("a", old), ("b", sure)):
            save(made, tmp_path / f"{name}.npz")
        assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    blind = grid_synthesis(system, Memory(1), times, availability=0.0, **GRIDS)
    mean, var = 0.5, 1.0
    found = blind.run(times, np.full((5, 1, 2), np.nan), covariances=True)
    for k in range(5):
        assert found.mean[k, 0, 1] == pytest.approx(mean, abs=1e-9)
        assert found.cov[k, 0, 0] == pytest.approx(var, rel=1e-6)
        mean, var = 0.95 * mean, 0.95**2 * var + 0.7
    with pytest.raises(ValueError, match="got component 0 of a measurement without it"):
        blind.run(times, np.zeros((5, 1, 1)))


def test_two_sensors_by_schedule_and_by_chance(pair):
    """Against the Kalman filter, of every pattern and of one that the design does not expect."""
    times, axes = TIMES[:9], {"x": (-9, 9, 41), "z": (-9, 9, 51)}
    axes["y"] = [(-12, 12, 25), (-15, 15, 21)]
    mask = np.ones((9, 2), dtype=bool)
    mask[1::3, 1] = mask[4] = False
    made = grid_synthesis(pair, Memory(1), times, measured=mask, **axes)
    y = pair.simulate(times, 60, 4, measured=mask).measurements
    found = made.run(times, y, covariances=True)
    right = kalman(pair, times, y)[:, 0]
    np.testing.assert_allclose(found.cov[:, 0, 0], right, rtol=0.02)
    best = extended_kalman(pair).run(times, y)
    assert np.sqrt(((found.mean - best.mean) ** 2).mean()) < 0.04
    made = grid_synthesis(pair, Memory(1), times, measured=mask, availability=[0.6, 0.8], **axes)
    y = pair.simulate(times, 200, 4, measured=mask, availability=[0.6, 0.8]).measurements
    found = made.run(times, y, covariances=True)
    error = np.log(variances(found) / kalman(pair, times, y)) / 2
    assert np.abs(error).max() < 0.06
    assert np.sqrt((error**2).mean()) < 0.012
    assert np.isfinite(found.mean).all()
    # a component that is sure has a table for when it is not, and no claims
    made = grid_synthesis(pair, Memory(1), times[:3], availability=[0.6, 1.0], **axes)
    y = pair.simulate(times[:3], 3, 4, availability=[0.5, 1.0]).measurements.copy()
    y[1, 1, 1] = np.nan
    with pytest.warns(UserWarning, match="1 of 3 records have gaps, from 1 on"):
        found = made.run(times[:3], y, covariances=True)
    assert np.isnan(found.cov[:, 0, 0]).sum(axis=0).tolist() == [0, 2, 0]
    assert np.isfinite(found.mean).all()


def test_a_jumping_signal_with_forecasts_between():
    """A bistable process: what is predicted, on average and after gaps, is what is found."""
    flip, times = zoo.flip_process(), 0.25 * np.arange(7)
    axes = {"x": (-3.5, 3.5, 57), "z": (-2.4, 2.4, 49), "y": (-8, 8, 65)}
    made = grid_synthesis(flip, Memory(1), times, nodes=1, availability=0.7, **axes)
    grid = made.predicted.times
    data = flip.simulate(grid, 6000, 3, measured=np.arange(13) % 2 == 0, availability=0.7,
                         step=0.0125)  # fmt: skip
    square = (made.run(grid, data.measurements).mean - data.states)[:, 0] ** 2
    doubt = 4 * square.std(axis=1) / np.sqrt(6000)
    assert (np.abs(square.mean(axis=1) - made.predicted.rms[:, 0] ** 2) < doubt + 0.004).all()
    y = data.measurements[::2].copy()
    y[2:6] = np.nan
    found = made.run(times, y, covariances=True)
    square = (found.mean - data.states[::2])[:, 0] ** 2
    doubt = 4 * square.std(axis=1) / np.sqrt(6000)
    assert (np.abs((square - variances(found)).mean(axis=1)) < doubt + 0.004).all()


@pytest.mark.parametrize("kept", [False, True])
def test_modes_and_an_indicator_that_may_be_missing(kept):
    """Predicted errors and wrong modes are those found; remembered indicators are all there."""
    system, times = zoo.dependent_switching(), np.arange(5.0)
    rates = [0.6, 1.0 if kept else 0.7]
    made = grid_synthesis(system, Memory(1, 0, int(kept)), times, x=(-7, 11, 46), z=(-4, 8, 37),
                          y=(-9, 22, 55), availability=rates, probabilities=not kept)  # fmt: skip
    data = system.simulate(times, 6000, 3, availability=rates)
    told = {"indicators": data.indicators}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = made.run(times, data.measurements, covariances=True, **told)
    square = (found.mean - data.states)[:, 0] ** 2
    doubt = 4 * square.std(axis=1) / np.sqrt(6000)
    assert (np.abs(square.mean(axis=1) - made.predicted.rms[:, 0] ** 2) < doubt + 0.01).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    assert (np.abs(wrong - made.predicted.mode_rate) < 4 * np.sqrt(0.25 / 6000)).all()
    # given what arrived at the last two times
    apart = square - variances(found)
    for here in np.isnan(data.measurements[-1, 0]), ~np.isnan(data.measurements[-1, 0]):
        part = apart[-1, here]
        assert abs(part.mean()) < 4 * part.std() / np.sqrt(len(part)) + 0.01
    if not kept:
        assert (np.abs(found.mode_prob.sum(axis=1) - 1) < 1e-12).all()


def test_steps_are_the_run_and_files_keep_it(system, filter, tmp_path):
    y = system.simulate(TIMES, 4, 4, availability=0.6).measurements
    save(filter, tmp_path / "f.npz")
    alone, again = load(tmp_path / "f.npz"), load(tmp_path / "f.npz", system)
    assert "availability 0.9; up to" in str(alone)
    assert diff(again, filter).equal
    other = diff(filter, replace(filter, availability=np.array([0.8])))
    assert [tuple(change) for change in other.changes] == [("availability", "0.9", "0.8")]
    found = alone.run(TIMES, y, covariances=True)
    state, single = filter.initial((4,)), filter.initial()
    for k, t in enumerate(TIMES):
        state, single = filter.step(state, t, y[k]), filter.step(single, t, y[k, :, 0])
        np.testing.assert_array_equal(state.mean, found.mean[k])
        np.testing.assert_array_equal(single.mean, found.mean[k, :, 0])
        np.testing.assert_array_equal(state.cov, found.cov[k])
        np.testing.assert_array_equal(single.cov, found.cov[k, ..., 0])
    with pytest.raises(TypeError, match="wanted tables over evenly spaced axes"):
        to_c(filter, name="f")


def test_it_goes_on_for_ever(system, filter):
    lasting = stationary(filter, tolerance=0.05, paths=300)
    long = np.arange(100.0)
    y = system.simulate(long, 50, 9, availability=0.9).measurements
    y[60:70] = np.nan
    found = lasting.run(long, y, covariances=True)
    apart = np.log(variances(found) / kalman(system, long, y)) / 2
    assert np.abs(apart).max() < 0.05
    short = stationary(filter, tolerance=0.05, transient=2, paths=300)
    other = np.log(variances(short.run(long, y, covariances=True)) / variances(found)) / 2
    assert np.abs(other)[20:].max() < 0.05


def test_the_committed_table_of_deviations():
    """Jumps, modes and a target: claimed and actual within 3 per cent but for their doubt."""
    with (Path(__file__).parents[2] / "benchmarks" / "dropouts.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {int(row["missing"]) for row in rows} == {1, 2, 4, 8, 15}
    for row in rows:
        claimed, actual, doubt = (float(row[name]) for name in ("claimed", "actual", "doubt"))
        assert abs(actual / claimed - 1) < 0.03, row
        assert doubt < 0.01 * claimed


def test_what_does_not_fit_is_refused(system, pair, filter):
    def made(memory=None, model=system, **told):
        axes = SMALL if model is system else {**SMALL, "y": [(-9, 9, 9)] * 2}
        return grid_synthesis(model, memory or Memory(1), TIMES[:3], **told, **axes)

    with pytest.raises(ValueError, match="availability: wanted a probability"):
        made(availability=1.5)
    with pytest.raises(ValueError, match="availability: wanted a probability, or 2 of them"):
        made(model=pair, availability=[0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match=r"measured: wanted a mask of shape \(3,\)"):
        made(measured=[True])
    with pytest.raises(ValueError, match="memory: wanted estimates for a sensor with a schedule"):
        made(finite_memory(1), availability=0.5)
    with pytest.raises(ValueError, match="wanted every indicator that the memory keeps"):
        grid_synthesis(zoo.dependent_switching(), Memory(1, 0, 1), [0.0, 1.0], x=(-5, 10, 31),
                       availability=0.5)  # fmt: skip
    with pytest.raises(ValueError, match="arrivals: wanted those of 20 steps"):
        replace(filter, arrivals=())
    first, *rest = filter.arrivals
    with pytest.raises(ValueError, match=r"arrivals\[0\].table: wanted classes below 2"):
        replace(filter, arrivals=(first._replace(table=first.table + 9), *rest))
    with pytest.raises(ValueError, match=r"arrivals\[0\]: wanted positive semidefinite"):
        replace(filter, arrivals=(first._replace(after=-first.after), *rest))
    steps = filter.steps[:1] * 2 + filter.steps[2:]
    with pytest.raises(ValueError, match=r"steps\[1\].shown.tables\[0\] has other axes"):
        replace(filter, steps=steps)
    with pytest.raises(ValueError, match="filter: wanted one whose sensor is always there"):
        grid_risk(filter, x=(-10, 10, 61))
    with pytest.raises(ValueError, match="filter: wanted one whose sensor is always there"):
        tabulated(filter, y=(-9, 9, 9), z=(-9, 9, 9))
