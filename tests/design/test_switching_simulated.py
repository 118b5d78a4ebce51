"""Tables of switching systems by regression on simulated paths."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import grid_synthesis, optimal_risk, simulated_synthesis
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.models import Noise, StochasticMap, SwitchingSystem

TIMES = np.arange(15)
AXES = {"z": (-6, 6, 61), "y": (-16, 18, 69)}


@pytest.fixture(scope="module")
def system():
    return zoo.scalar_switching("A1H")


@pytest.fixture(scope="module")
def data(system):
    return system.simulate(TIMES, 4000, 11)


def errors(filter, data):
    """RMSE over k = 10.. and part of wrong modes, with their standard errors over paths."""
    found = filter.run(data.times, data.measurements, indicators=data.indicators)
    square = ((found.mean - data.states)[10:, 0] ** 2).mean(axis=0)
    wrong = (found.modes != data.modes)[10:].mean(axis=0)
    rms, paths = np.sqrt(square.mean()), len(square)
    return rms, square.std() / paths**0.5 / 2 / rms, wrong.mean(), wrong.std() / paths**0.5


@pytest.mark.parametrize(
    ("method", "rms", "wrong"), [("likelihood", 1.1619, 0.3013), ("histogram", 1.1918, 0.3075)]
)
def test_errors_of_filters_of_order_one(system, data, method, rms, wrong):
    """The values of a design on 300 000 paths without smoothing; ours smooths and needs fewer."""
    made = simulated_synthesis(
        system, large_order(1), TIMES, paths=12_000, seed=5, method=method, **AXES
    )
    found, error, rate, doubt = errors(made, data)
    # our histogram is smoothed: it may be better than the plain one, but not than the optimum
    assert found < rms + 4 * 2**0.5 * error
    assert rate < wrong + 4 * 2**0.5 * doubt
    assert found > 1.1622 - 4 * 2**0.5 * error
    assert rate > 0.3008 - 4 * 2**0.5 * doubt
    if method == "likelihood":
        assert abs(found - rms) < 4 * 2**0.5 * error
        assert abs(rate - wrong) < 4 * 2**0.5 * doubt
    # what the design says is what others find
    said, doubted = made.predicted.rms[10:, 0], made.predicted.error[10:, 0]
    assert abs(np.sqrt((said**2).mean()) - found) < 4 * np.hypot(error, doubted.mean() / 2)
    assert abs(made.predicted.mode_rate[10:].mean() - rate) < 4 * np.hypot(doubt, 2e-3)


def test_more_paths_come_closer_to_the_grid(system):
    """Mean-square distance of the estimates to those of the exact filter falls with the paths."""
    times = np.arange(4)
    exact = grid_synthesis(
        system, large_order(1), times, x=(-8, 8, 81), z=(-6, 6, 121), y=(-16, 18, 137)
    )
    data = system.simulate(times, 4000, 12)
    wanted = exact.run(times, data.measurements)
    apart = []
    for paths in (1000, 16_000):
        made = simulated_synthesis(system, large_order(1), times, paths=paths, seed=1, **AXES)
        found = made.run(times, data.measurements)
        apart.append(((found.mean - wanted.mean)[3] ** 2).mean())
    assert apart[1] < 0.4 * apart[0]
    assert apart[1] < 0.02


@pytest.mark.parametrize("method", ["likelihood", "histogram"])
@pytest.mark.parametrize("memory", [large_order(1), Memory(1, 0, 1), Memory(0, 1, 1)])
def test_indicators(memory, method):
    """Two values of an indicator, dependent noises: near the optimum of the same memory."""
    system, times = zoo.dependent_switching(), np.arange(3)
    axes = {"z": (-4, 4, 41), "y": (-7, 11, 61)}
    best = optimal_risk(system, memory, times, x=(-6, 6, 61), **axes)
    made = simulated_synthesis(
        system, memory, times, paths=8000, seed=3, method=method, probabilities=True, **axes
    )
    data = system.simulate(times, 20_000, 4)
    found = made.run(times, data.measurements, indicators=data.indicators)
    square = (found.mean - data.states)[:, 0] ** 2
    error = square.std(axis=1) / 20_000**0.5
    loose = 1.03 if method == "likelihood" else 1.08
    assert (square.mean(axis=1) < loose * best.mse + 4 * error).all()
    assert (square.mean(axis=1) > best.mse - 4 * error).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    assert (np.abs(wrong - best.mode_error) < 0.012 + 4 * np.sqrt(wrong / 20_000)).all()
    assert found.mode_prob.sum(axis=1) == pytest.approx(np.ones((3, 20_000)))
    if memory.indicators:
        return
    # a missing indicator: worse than seen, better than nothing known
    unseen = made.run(times[:1], data.measurements[:1], indicators=np.full((1, 20_000), -1))
    loss = ((unseen.mean - data.states[:1]) ** 2).mean()
    assert square[0].mean() < loss < data.states[0].var()


def test_one_component_of_two():
    """Position of the target; a filter of two numbers for a state of four with its mode."""
    system, times = zoo.manoeuvring_target("noisy"), np.arange(4)
    made = simulated_synthesis(
        system, large_order(1), times, paths=8000, seed=3, components=1, z=(-14, 20, 69),
        y=(-18, 24, 85),
    )  # fmt: skip
    data = system.simulate(times, 20_000, 4)
    found = made.run(times, data.measurements, indicators=data.indicators)
    assert found.mean.shape == (4, 1, 20_000)
    square = (found.mean[:, 0] - data.states[:, 0]) ** 2
    error = square.std(axis=1) / 20_000**0.5
    said = made.predicted.rms[:, 0] ** 2
    assert (np.abs(square.mean(axis=1) - said) < 4 * np.sqrt(1 + 20_000 / 8000) * error).all()
    raw = ((data.measurements[:, 0] - data.states[:, 0]) ** 2).mean(axis=1)
    assert (square.mean(axis=1) < 0.9 * raw).all()
    both = simulated_synthesis(
        system, large_order(1), times[:2], paths=8000, seed=3, z=[(-10, 10, 21), (-5, 6, 12)],
        y=(-14, 16, 41),
    )  # fmt: skip
    found = both.run(times[:2], data.measurements[:2], indicators=data.indicators[:2])
    assert found.mean.shape == (2, 2, 20_000)
    speed = (found.mean[1, 1] - data.states[1, 1]).std()
    assert speed < 0.95 * data.states[1, 1].std()
    assert both.order == 3


def test_the_same_seed_gives_the_same_tables(system):
    first, second = (
        simulated_synthesis(system, finite_memory(1), [0, 1], paths=500, seed=s, y=(-16, 18, 35))
        for s in (7, 7)
    )
    for one, two in zip(first.steps, second.steps, strict=True):
        assert np.array_equal(one.shown.estimate, two.shown.estimate)
    assert "1000 paths, seed 7" in str(first)


def test_what_does_not_fit_is_refused(system):
    given = {"paths": 100, "seed": 1}
    for memory in (Memory(1, 1), Memory(1, 0, 1), Memory(1, log_odds=True)):
        with pytest.raises(ValueError, match="estimates or measurements alone"):
            simulated_synthesis(system, memory, [0, 1], **given)
    with pytest.raises(ValueError, match="entries; wanted"):
        simulated_synthesis(
            system, large_order(3), [0, 1], z=(-6, 6, 201), y=(-16, 18, 201), **given
        )
    with pytest.raises(ValueError, match="probabilities: wanted False"):
        simulated_synthesis(
            zoo.flip_process(), large_order(1), [0, 0.25], probabilities=True, **given
        )


def test_a_sensor_without_density_takes_the_histogram():
    """The same system as array functions, which know no density."""
    noise = Noise(1)
    move = StochasticMap.from_functions(1, 1, lambda t, x, v: 0.9 * x + 0.4 * v, noise)
    show = StochasticMap.from_functions(1, 1, lambda t, x, v: x + 0.7 * v, noise)
    system = SwitchingSystem.from_maps([[move]], [[show]], [(1.0, [0.3], [[0.8]])])
    with pytest.raises(ValueError, match="likelihood wants a sensor"):
        simulated_synthesis(system, large_order(1), [0, 1], paths=100, seed=1)
    made = simulated_synthesis(
        system, large_order(1), np.arange(3), paths=20_000, seed=1, method="histogram"
    )
    variance = 0.8
    for k in range(3):
        variance = variance * 0.49 / (variance + 0.49)
        assert made.predicted.rms[k, 0] ** 2 == pytest.approx(variance, rel=0.06)
        variance = 0.81 * variance + 0.16
