"""Filters of switching systems as tables: verbs, missing data, the time after the design, files."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import grid_risk, grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, finite_memory, large_order, load, save
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import Noise, SwitchingSystem

TIMES = np.arange(8)
AXES = {"x": (-8, 8, 81), "z": (-6, 6, 61), "y": (-16, 18, 69)}
OTHER = {"x": (-6, 6, 61), "z": (-4, 4, 41), "y": (-7, 11, 61)}


@pytest.fixture(scope="module")
def system():
    return zoo.scalar_switching("A1H")


@pytest.fixture(scope="module")
def filter(system):
    return grid_synthesis(system, large_order(1), np.arange(16), **AXES, probabilities=True)


@pytest.fixture(scope="module")
def hinted():
    system = zoo.dependent_switching()
    return grid_synthesis(system, Memory(1, 0, 1), TIMES, **OTHER, probabilities=True)


# Verbs


def test_steps_are_the_run(filter, system):
    data = system.simulate(TIMES, 50, 1)
    shown = data.measurements.copy()
    shown[3, :, 10:20] = np.nan
    with pytest.warns(UserWarning, match="10 of 50 records have gaps, from 3 on"):
        found = filter.run(TIMES, shown, covariances=True)
    state = filter.initial((50,))
    for k, t in enumerate(TIMES):
        state = filter.step(state, t, shown[k])
        assert np.array_equal(state.mean, found.mean[k])
        assert np.array_equal(state.mode, found.modes[k])
        assert np.array_equal(state.mode_prob, found.mode_prob[k])
    # the design knows the error without gaps only
    whole = filter.run(TIMES, data.measurements, covariances=True).cov
    assert whole.shape == (8, 1, 1)
    wanted = np.repeat(whole[..., None], 50, axis=3)
    wanted[3:, :, :, 10:20] = np.nan
    assert np.array_equal(found.cov, wanted, equal_nan=True)
    one = filter.run(TIMES, shown[..., 15])
    assert np.array_equal(one.mean, found.mean[..., 15])
    assert one.modes.shape == (8,)
    grid = filter.run(TIMES, shown.reshape(8, 1, 5, 10))
    assert np.array_equal(grid.modes.reshape(8, 50), found.modes)


def test_paths_do_not_know_each_other(filter, system):
    data = system.simulate(TIMES, 20_000, 2)
    together = filter.run(TIMES, data.measurements, workers=2)
    apart = filter.run(TIMES, data.measurements[..., 9000:9100])
    assert np.array_equal(together.mean[..., 9000:9100], apart.mean)


def test_estimates_are_the_table_at_its_nodes(filter):
    table = filter.steps[5].shown
    y, _, z = (axis.nodes for axis in table.axes)
    state = filter.initial((2, 69, 61))._replace(
        index=4, time=4.0, corrected=True,
        past=filter.memory.push(
            filter.initial().past,
            estimate=np.broadcast_to(z, (1, 2, 69, 61)),
            mode=np.broadcast_to(np.arange(2)[:, None, None], (2, 69, 61)),
        ),
    )  # fmt: skip
    found = filter.step(state, 5.0, np.broadcast_to(y[:, None], (1, 2, 69, 61)))
    assert found.mean[0] == pytest.approx(table.estimate[0].transpose(1, 0, 2), abs=1e-11)
    assert np.array_equal(found.mode, table.mode.transpose(1, 0, 2))
    assert found.mode_prob.sum(axis=0) == pytest.approx(np.ones((2, 69, 61)))
    # half-way up the measurement's axis: the mean of two nodes
    middle = filter.step(state, 5.0, np.broadcast_to(y[:, None] + 0.25, (1, 2, 69, 61)))
    two = 0.5 * (found.mean[0, :, :-1] + found.mean[0, :, 1:])
    assert middle.mean[0, :, :-1] == pytest.approx(two, abs=1e-11)


def test_beyond_the_axes_the_end_holds(filter):
    shown = np.full((2, 1, 4), 3.0)
    shown[1, 0] = [-16.0, -40.0, 18.0, 1e9]
    found = filter.run([0, 1], shown).mean[1, 0]
    assert found[0] == found[1]
    assert found[2] == found[3]


# Missing data


def test_a_missing_measurement_leaves_the_forecast(filter, system):
    """Against the mean over simulated paths whose first measurement was nearly the same."""
    data = system.simulate([0, 1], 400_000, 3)
    first = data.measurements[0, 0]
    for low, high in ((-2.1, -1.9), (0.9, 1.1), (3.9, 4.1)):
        same = (first > low) & (first < high)
        shown = data.measurements[..., same].copy()
        shown[1] = np.nan
        found = filter.run([0, 1], shown)
        x, forecast = data.states[1, 0, same], found.mean[1, 0]
        assert abs(x.mean() - forecast.mean()) < 4 * x.std() / same.sum() ** 0.5
        rate, share = (data.modes[1, same] == 1).mean(), found.mode_prob[1, 1].mean()
        assert abs(rate - share) < 4 * (rate * (1 - rate) / same.sum()) ** 0.5
        assert (found.modes[1] == (share > 0.5)).all()


def test_missing_pieces_cost_what_they_tell():
    """Each estimate is a conditional mean: its error is orthogonal to it; each piece helps."""
    system = zoo.dependent_switching()
    filter = grid_synthesis(system, large_order(1), TIMES[:2], **OTHER)
    data = system.simulate(TIMES[:2], 100_000, 4)
    found = {}
    for name in ("both", "measurement", "indicator", "neither"):
        y, told = data.measurements.copy(), data.indicators.copy()
        if name in ("indicator", "neither"):
            y[1] = np.nan
        if name in ("measurement", "neither"):
            told[1] = -1
        run = filter.run(TIMES[:2], y, indicators=told)
        error = (data.states - run.mean)[1, 0]
        for part in (1.0, run.mean[1, 0], run.modes[0] == 1):
            off = error * part
            assert abs(off.mean()) < 4 * off.std() / 100_000**0.5 + 1e-3
        found[name] = (error**2).mean(), (run.modes != data.modes)[1].mean()
    for better, worse in (
        ("both", "measurement"), ("both", "indicator"), ("indicator", "neither"),
        ("measurement", "neither"),
    ):  # fmt: skip
        assert found[better][0] < 0.99 * found[worse][0]
        assert found[better][1] < found[worse][1]


def test_a_missing_indicator_is_the_mixture():
    """P(i | y) = sum_j P(j | y) P(i | j, y) at the first measurement, with P(j | y) from paths."""
    system = zoo.dependent_switching()
    filter = grid_synthesis(system, large_order(1), [0], **OTHER, probabilities=True)
    data = system.simulate([0], 400_000, 5)
    near = np.abs(data.measurements[0, 0] - 1.0) < 0.05
    told = data.indicators[0, near]
    rate = (told == 1).mean()
    y = np.ones((1, 1, 3))
    found = filter.run([0], y, indicators=np.array([[0, 1, -1]]))
    mixture = (1 - rate) * found.mean[0, 0, 0] + rate * found.mean[0, 0, 1]
    apart = abs(found.mean[0, 0, 1] - found.mean[0, 0, 0])
    assert (
        abs(mixture - found.mean[0, 0, 2])
        < 4 * apart * (rate * (1 - rate) / near.sum()) ** 0.5 + 2e-3
    )
    with pytest.raises(ValueError, match="indicators: wanted, the system has"):
        filter.run([0], y)


# After the design


def test_lasting_tables(filter, system):
    assert filter.change[0] < 0.01
    lasting = stationary(filter)
    assert "the last step serves all" in str(lasting)
    assert "the last step serves all" not in str(filter)
    long = np.arange(60)
    data = system.simulate(long, 4000, 6)
    found = lasting.run(long, data.measurements)
    short = filter.run(long[:16], data.measurements[:16])
    assert np.array_equal(found.mean[:16], short.mean)
    square = ((found.mean - data.states)[:, 0] ** 2)[20:].mean(axis=0)
    wanted = filter.predicted.rms[-1, 0] ** 2
    assert abs(square.mean() - wanted) < 4 * square.std() / 4000**0.5
    with pytest.raises(ValueError, match="times: wanted at most 15, where the design ends, got 59"):
        filter.run(long, data.measurements)
    with pytest.raises(ValueError, match="wanted all measurement times of the design, 16 is"):
        lasting.run([*range(16), 17], data.measurements[:17])


def test_tables_that_have_not_converged_are_refused(system):
    short = grid_synthesis(system, large_order(1), np.arange(5), **AXES)
    with pytest.raises(ValueError, match=r"last 1 steps, got 0\.\d+ and 0\.\d+ in the probability"):
        stationary(short)
    assert stationary(short, 0.5).cycle == 1
    first = grid_synthesis(system, large_order(2), [0, 1], **{**AXES, "z": (-6, 6, 13)})
    with pytest.raises(ValueError, match="a design of 4 steps or more"):
        stationary(first)
    with pytest.raises(ValueError, match="tolerance: wanted a positive"):
        stationary(short, 0.0)


# Errors


def test_bad_arguments(filter, hinted, system):
    y = np.zeros((2, 1, 3))
    state = filter.initial((3,))
    cases = [
        (lambda: filter.correct(state, y[0]), "state: wanted a forecast"),
        (lambda: filter.predict(filter.predict(state, 0), 1), "state: wanted a state after"),
        (lambda: filter.predict(state, 0.5), "wanted the next measurement time 0"),
        (lambda: filter.step(state, 0, y[0, :, :2]), r"y: wanted shape \(1, 3\)"),
        (lambda: filter.step(state, 0, y[0] + np.inf), "y: wanted finite"),
        (
            lambda: filter.run([0, 1], y, indicators=np.zeros((2, 3), int)),
            "system has no indicator",
        ),
        (lambda: hinted.run([0, 1], y, indicators=np.full((2, 3), 2)), "wanted 0 to 1"),
        (lambda: hinted.run([0, 1], y, indicators=np.full((2, 3), -1)), "wanted by the memory"),
        (
            lambda: filter.run([0, 2], y),
            "wanted all measurement times of the design, 1 is",
        ),
    ]
    for call, message in cases:
        with pytest.raises((TypeError, ValueError), match=message):
            call()
    window = grid_synthesis(system, finite_memory(1), [0, 1], x=(-8, 8, 81), y=(-16, 18, 69))
    with pytest.raises(ValueError, match="it is to be remembered"):
        window.run([0, 1], np.full((2, 1, 3), np.nan))


def test_a_designed_filter_does_not_change(filter):
    with pytest.raises(ValueError, match="read-only"):
        filter.steps[3].shown.estimate[0, 0, 0, 0] = 1.0


def test_the_filter_tells_what_it_is(filter, hinted):
    text = str(filter)
    for part in ("2 modes", "order 2", "density recursion", "without random numbers", "t = 15"):
        assert part in text
    assert filter.order == 2
    assert hinted.order == 3
    assert "TableFilter of order 2" in repr(filter)
    assert filter.bytes == sum(
        part.nbytes for step in filter.steps for table in step for part in table[1:]
    )


# Other filters of the same memory


def test_risk_of_other_filters_is_larger(system, filter):
    """The normal approximation on the grid: never better, and as on simulated paths."""
    times = filter.times[:6]
    normal = synthesize(system, large_order(1), ExactGaussian(), times, paths=8000, seed=1)
    risk = grid_risk(normal, **AXES)
    best = filter.predicted.rms[:6, 0] ** 2
    assert (risk.mse > best - 1e-12).all()
    assert (risk.mode_error > filter.predicted.mode_rate[:6] - 1e-12).all()
    data = system.simulate(times, 20_000, 8)
    found = normal.run(times, data.measurements)
    square = (found.mean - data.states)[:, 0] ** 2
    error = square.std(axis=1) / 20_000**0.5
    # the memory of the grid is rounded: up to a half per cent
    assert (np.abs(square.mean(axis=1) - risk.mse) < 4 * error + 5e-3 * risk.mse).all()


def test_risk_of_what_has_no_memory_is_refused(system):
    from seedslib.designed import SwitchingFilter

    with pytest.raises(ValueError, match="wanted one with a memory"):
        grid_risk(SwitchingFilter(system, Taylor()), **AXES)


# Files


def test_filters_of_every_memory_come_back(tmp_path):
    system = zoo.dependent_switching()
    coarse = {"x": (-6, 6, 41), "z": (-4, 4, 9), "y": (-7, 11, 31)}
    data = system.simulate(TIMES[:4], 20, 1)
    for memory in (Memory(0, 1, 1), large_order(2), finite_memory(2)):
        made = grid_synthesis(system, memory, TIMES[:4], **coarse)
        save(made, tmp_path / "a.npz")
        back = load(tmp_path / "a.npz", system)
        ours, theirs = (
            f.run(TIMES[:4], data.measurements, indicators=data.indicators) for f in (made, back)
        )
        assert np.array_equal(ours.mean, theirs.mean)
        assert back.memory == memory
    made = grid_synthesis(system, large_order(1), [0], **coarse)
    save(made, tmp_path / "a.npz")
    assert len(load(tmp_path / "a.npz", system).steps) == 1


def variant(change):
    """The scalar system written in another way, with one thing changed."""
    x, v, w = sympy.symbols("y a b", real=True)
    leave = 0.35 - 0.3 * sympy.exp(-x * x / 8)
    if change == "switching":
        leave += 0.001
    stay = 0.9 - 0.5 * sympy.exp(-(x**2) / 2)
    moved = x + 1.8 * sympy.sin(x) + (0.5001 if change == "dynamics" else 0.5) * v
    first = 0.501 if change == "start" else 0.5
    return SwitchingSystem(
        state=(x,), dynamics=[[moved], [0.6 * x - v / 2]], noise=Noise((v,)),
        switching=[[1 - leave, leave], [1 - stay, stay]],
        sensor=[[x - 2 * w], [(2.001 if change == "sensor" else 2) + x + 2 * w]],
        sensor_noise=Noise((w,)), initial=[(first, [0], [[1]]), (1 - first, [0], [[1]])],
    )  # fmt: skip


@pytest.mark.parametrize("change", ["switching", "dynamics", "start", "sensor"])
def test_another_model_is_refused(change, filter, tmp_path):
    save(filter, tmp_path / "a.npz")
    assert load(tmp_path / "a.npz", variant(None)).order == 2
    with pytest.raises(ValueError, match=r"designed for another model: its .* differs"):
        load(tmp_path / "a.npz", variant(change))


def test_noises_that_depend_in_another_way_are_another_model(hinted, tmp_path):
    """The sensor's noise turned about: the same marginal laws, another joint one."""
    save(hinted, tmp_path / "a.npz")
    system = zoo.dependent_switching()
    readings = [[branch.map for branch in row] for row in system.readings]
    noise = readings[0][0].noise
    w = noise.symbols[0]
    turned = [
        [
            type(map)(map.state, map.expressions, noise, map.weight_expression.subs(w, -w))
            for map in row
        ]
        for row in readings
    ]
    moves = [[branch.map for branch in row] for row in system.branches]
    other = SwitchingSystem.from_maps(moves, turned, system.initial, indicator=True)
    with pytest.raises(ValueError, match="designed for another model: its readings differs"):
        load(tmp_path / "a.npz", other)
