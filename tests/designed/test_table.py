import json

import numpy as np
import pytest

from seedslib import zoo
from seedslib.base import interpolate
from seedslib.design import grid_synthesis, simulated_synthesis, synthesize
from seedslib.designed import TableFilter, finite_memory, large_order, load, save
from seedslib.evaluation import compare
from seedslib.linearization import ExactGaussian

TIMES = 0.25 * np.arange(5)
GRID = {"x": (-3.5, 3.5, 141), "z": (-2.5, 2.5, 101), "y": (-8.0, 8.0, 97)}


@pytest.fixture(scope="module")
def flip():
    return zoo.flip_process()


@pytest.fixture(scope="module", params=[large_order(1), large_order(2), finite_memory(1)])
def table(request, flip):
    return grid_synthesis(flip, request.param, TIMES, **GRID, nodes=2)


@pytest.fixture(scope="module")
def first(flip):
    return grid_synthesis(flip, large_order(1), TIMES, **GRID, nodes=2)


def test_step_by_step_is_the_run(flip, table):
    data = flip.simulate(TIMES, 50, 3)
    whole = table.run(TIMES, data.measurements, covariances=True)
    state = table.initial((50,))
    for k, t in enumerate(TIMES):
        state = table.predict(state, t)
        assert state.mean.shape == (1, 50)
        state = table.correct(state, data.measurements[k])
        assert np.array_equal(state.mean, whole.mean[k])
    assert whole.loglik is None
    assert whole.cov.shape == (5, 1, 1)
    assert np.allclose(np.sqrt(whole.cov[:, 0, 0]), table.predicted.rms[::3, 0], rtol=1e-12)
    assert not whole.diverged.any()


def test_batch_axes_are_optional_and_last(flip, table):
    data = flip.simulate(TIMES, 6, 3)
    whole = table.run(TIMES, data.measurements).mean
    one = table.run(TIMES, data.measurements[..., 0]).mean
    grid = table.run(TIMES, data.measurements.reshape(5, 1, 2, 3)).mean
    assert np.array_equal(one, whole[..., 0])
    assert np.array_equal(grid.reshape(whole.shape), whole)


def test_estimate_is_the_table_at_measurement_and_memory(flip, first):
    data = flip.simulate(TIMES[:2], 9, 3)
    mean = first.run(TIMES[:2], data.measurements).mean
    output = first.steps[1].shown
    wanted = interpolate(output.estimate, output.axes, [data.measurements[1, 0], mean[0, 0]])
    assert np.array_equal(mean[1], wanted)
    assert np.array_equal(first.output(1, data.measurements[1], mean[0]).mean, wanted)


def test_missing_measurement_leaves_the_conditional_mean(flip, first):
    data = flip.simulate(TIMES, 20_000, 5)
    y = data.measurements.copy()
    y[2, :, ::2] = np.nan
    mean = first.run(TIMES, y).mean
    kept = first.run(TIMES, data.measurements).mean
    assert np.array_equal(mean[:, :, 1::2], kept[:, :, 1::2])
    state = first.initial((10_000,))
    for k in range(2):
        state = first.step(state, TIMES[k], y[k, :, ::2])
    assert np.array_equal(first.predict(state, TIMES[2]).mean, mean[2, :, ::2])
    # unbiased, and better than nothing
    error = mean[2, 0, ::2] - data.states[2, 0, ::2]
    assert abs(error.mean()) < 4 * error.std() / 100
    assert error.var() < data.states[2, 0].var()


def test_everything_missing_is_the_unconditional_mean(first):
    mean = first.run(TIMES, np.full((5, 1), np.nan)).mean[:, 0]
    assert mean[0] == 1.0
    assert np.isfinite(mean).all()


def test_missing_measurement_that_would_be_remembered_is_refused(flip):
    table = grid_synthesis(flip, finite_memory(1), TIMES[:2], **GRID, nodes=0)
    with pytest.raises(ValueError, match="it is to be remembered"):
        table.run(TIMES[:2], np.array([[np.nan], [1.0]]))


def test_partly_missing_measurements_are_refused():
    system = zoo.van_der_pol()
    table = simulated_synthesis(
        system, large_order(1), [0.0, 0.5], paths=500, seed=1, nodes=0,
        z=[(-4, 4, 9)] * 2, y=[(-3, 14, 9), (-8, 8, 9)],
    )  # fmt: skip
    with pytest.raises(ValueError, match="all components of a measurement or none"):
        table.run([0.0], np.array([[1.0, np.nan]]))
    assert table.run([0.0], np.full((1, 2), np.nan)).mean[0] == pytest.approx([2.0, 0.0])


def test_forecasts_meet_the_nodes_and_the_next_measurement(flip, first):
    data = flip.simulate(TIMES, 7, 3)
    state = first.initial((7,))
    for k in range(2):
        state = first.step(state, TIMES[k], data.measurements[k])
    assert np.array_equal(first.forecast(state, 0.25).mean, state.mean)
    node = first.node_times[1][0]
    wanted = first.node_fits[1][0]([*state.past.vector]).mean
    assert first.forecast(state, node).mean == pytest.approx(wanted)
    end = first.predict(state, 0.5).mean
    assert first.forecast(state, 0.5).mean == pytest.approx(end)
    early = first.forecast(state, 0.25 + 1e-9, "piecewise constant").mean
    assert np.array_equal(early, state.mean)
    times = np.array([0.0, 0.25, node, 0.5])
    y = np.full((4, 1, 7), np.nan)
    y[[0, 1, 3]] = data.measurements[:3]
    assert first.run(times, y).mean[2] == pytest.approx(wanted)


def test_the_filter_stays_in_its_range_whatever_is_measured(first):
    y = np.array([1e9, -1e9, 1e9, -1e9, 50.0])[:, None]
    mean = first.run(TIMES, y).mean
    assert np.isfinite(mean).all()
    assert np.abs(mean).max() <= 3.5


def test_it_compares_with_other_filters_and_wins(flip, first):
    other = synthesize(flip, large_order(1), ExactGaussian(), TIMES, paths=4000, seed=1)
    found = compare({"table": first, "affine": other}, flip, TIMES, 8000, 4, consistency=True)
    apart = found.difference("table", "affine")
    assert apart.average[0] < -10 * apart.average_error[0]
    says = first.predicted.rms[::3]
    assert (np.abs(found["table"].rms - says) < 4 * found["table"].rms_error).all()
    # the covariance is the mean one: normalised errors have the right mean
    assert found["table"].nees == pytest.approx(np.ones(5), abs=0.1)
    assert found["table"].nis is None


def test_it_prints_itself(table):
    text = str(table)
    assert "tables (density recursion) over measurements (97 nodes from -8 to 8)" in text
    assert "densities on a grid, without random numbers" in text
    assert "t = 1 " in text
    assert repr(table).startswith(f"<TableFilter of order {table.order}: ")
    assert table.bytes > 97 * 8


def test_wrong_order_of_steps(first):
    state = first.initial()
    with pytest.raises(ValueError, match="call predict first"):
        first.correct(state, np.array([1.0]))
    state = first.step(state, 0.0, np.array([1.0]))
    with pytest.raises(ValueError, match="call predict first"):
        first.correct(state, np.array([1.0]))
    with pytest.raises(ValueError, match=r"next measurement time 0\.25"):
        first.predict(state, 0.3)
    with pytest.raises(ValueError, match=r"wanted shape \(5, 1"):
        first.run(TIMES, np.zeros((5, 2)))


def test_files(tmp_path, flip, table):
    path, again = tmp_path / "a.npz", tmp_path / "b.npz"
    save(table, path)
    back = load(path, zoo.flip_process())
    save(back, again)
    assert path.read_bytes() == again.read_bytes()
    assert isinstance(back, TableFilter)
    assert str(back) == str(table)
    data = flip.simulate(TIMES, 20, 3)
    assert np.array_equal(
        back.run(TIMES, data.measurements).mean, table.run(TIMES, data.measurements).mean
    )
    state = table.step(table.initial(), 0.0, np.array([1.0]))
    assert np.array_equal(back.forecast(state, 0.1).mean, table.forecast(state, 0.1).mean)
    with pytest.raises(ValueError, match="designed for another model: its jump"):
        load(path, zoo.flip_process(flip=1.9))
    with pytest.raises(ValueError, match="designed for another model"):
        load(path, zoo.flip_process(sensor_noise=(0.3, 0.6)))
    with pytest.raises(ValueError, match="designed for another model: it has 1 state comp"):
        load(path, zoo.van_der_pol())


def test_files_that_contradict_themselves(tmp_path, first, header, rewrite):
    path = tmp_path / "b.npz"

    def refused(change, *given, **changes):
        save(first, path)
        change(path, *given, **changes)
        with pytest.raises(ValueError, match=r"b\.npz: the file contradicts itself"):
            load(path, first.system)

    save(first, path)
    with np.load(path) as archive:
        steps = json.loads(archive["header"].tobytes().decode())["filter"]["steps"]
    steps[1]["shown"]["axes"][0]["count"] += 1
    refused(header, steps=steps)
    refused(rewrite, **{"steps/2/shown/estimate": None})
    unknown = np.full(first.steps[1].shown.estimate.shape, np.nan)
    refused(rewrite, **{"steps/1/shown/estimate": unknown})
