"""Theorem 2 of the switching paper on grids: against loops, numbers, limits and simulation."""

from itertools import product

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import grid_risk, grid_synthesis, optimal_risk
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.models import FellerChain, JumpDiffusion, Noise, SwitchingChain, SwitchingSystem

TIMES = np.arange(21.0)
SHOWN = {"A1H": (-16, 18, 137), "A1L": (-11, 13, 241), "A2": (-8, 26, 545)}


def grids(sensor, nodes=241):
    return {"x": (-8, 8, 81), "z": (-6, 6, nodes), "y": SHOWN[sensor]}


def averages(mse, wrong):
    """RMSE and probability of a wrong mode over k = 10..30; the last of 21 steps is stationary."""
    weight = np.zeros(21)
    weight[10:] = 1.0
    weight[20] += 10.0
    return np.sqrt(np.average(mse, weights=weight)), np.average(wrong, weights=weight)


# Loops


def dependent_laws():
    """(1.3), (1.4) of the system with dependent noises, from its parameters by hand."""
    alpha, beta, rho = (1.2, -0.3), (-0.8, 0.5), (0.6, -0.4)
    a0, a1, s = (0.2, -0.5), (0.9, 0.5), (0.6, 0.8)
    tau, delta, shown = (1.0, -0.2), (-0.7, 0.4), (0.5, -0.3)
    b0, b1, b2, r = (0.0, 1.0), (1.0, 0.7), (0.1, -0.05), (0.7, 0.5)

    def beyond(threshold, correlation, noise):
        return norm.sf((threshold - correlation * noise) / np.sqrt(1 - correlation**2))

    def move(l, there, i, x):
        v = (there - a0[i] - a1[i] * x) / s[i]
        other = beyond(alpha[i] + beta[i] * x, rho[i], v)
        return norm.pdf(v) / s[i] * (other if l else 1 - other)

    def show(j, y, i, x):
        w = (y - b0[i] - b1[i] * x - b2[i] * x**2) / r[i]
        other = beyond(tau[i] + delta[i] * x, shown[i], w)
        return norm.pdf(w) / r[i] * (other if j else 1 - other)

    def first(i, x):
        return (0.6, 0.4)[i] * norm.pdf(x, (0, 0.5)[i], (1, 0.5**0.5)[i])

    return move, show, first, 2


def scalar_laws():
    """The same for the system A1H, without an indicator."""

    def move(l, there, i, x):
        other = 0.9 - 0.5 * np.exp(-(x**2) / 2) if i else 0.35 - 0.3 * np.exp(-(x**2) / 8)
        mean = 0.6 * x if i else x + 1.8 * np.sin(x)
        return norm.pdf(there, mean, 0.5) * (other if l else 1 - other)

    def show(j, y, i, x):
        return norm.pdf(y, x + 2 * i, 2.0)

    def first(i, x):
        return 0.5 * norm.pdf(x)

    return move, show, first, 1


def recursion_by_loops(laws, x, y, z, steps, length, remembered, told=False):
    """(4.6) to (4.8) one event at a time; the memory is a tuple of blocks, newest first.

    Returns for each step the estimates and modes by (j, y, memory), and the risk. Indicator -1
    stands for a missing one.
    """
    move, show, first, indicators = laws
    modes, hidden = (0, 1), [(i, a) for i in (0, 1) for a in range(len(x))]
    weight = np.full(len(y), y[1] - y[0])
    weight[[0, -1]] /= 2
    events = list(product(range(indicators), range(len(y))))
    beta = {
        s: np.array([show(j, y[b], s[0], x[s[1]]) * weight[b] for j, b in events]) for s in hidden
    }
    beta = {s: row / row.sum() for s, row in beta.items()}
    alpha = {}
    for i, a in hidden:
        row = np.array([move(l, x[b], i, x[a]) for l, b in hidden])
        alpha[i, a] = row / row.sum()
    start = {}
    for i in modes:
        row = np.array([first(i, value) for value in x])
        row *= sum(first(i, value) for value in np.linspace(-9, 9, 901)) * 0.02 / row.sum()
        start.update({(i, a): part for a, part in enumerate(row)})
    joint, found = {(): start}, []
    for _ in range(steps):
        new, best, mse, right = {}, {}, 0.0, 0.0
        for u, law in joint.items():
            for e, (j, b) in enumerate(events):
                mass = {s: part * beta[s][e] for s, part in law.items()}
                for seen in (j, -1) if indicators > 1 else (j,):
                    same = mass
                    if seen < 0:
                        same = {
                            s: part * sum(beta[s][events.index((m, b))] for m in range(indicators))
                            for s, part in law.items()
                        }
                    total = sum(same.values())
                    if total < 1e-13:
                        continue
                    prob = [sum(p for s, p in same.items() if s[0] == i) / total for i in modes]
                    mean = sum(p * x[s[1]] for s, p in same.items()) / total
                    best[seen, b, u] = mean, int(prob[1] > prob[0]), prob[1], total
                if (j, b, u) not in best:
                    continue
                mean, mode, *_ = best[j, b, u]
                mse += sum(p * (x[s[1]] - mean) ** 2 for s, p in mass.items())
                right += sum(p for s, p in mass.items() if s[0] == mode)
                tell = (j,) if told else ()
                if remembered == "measurements":
                    blocks = [((*tell, b), 1.0)]
                else:
                    place = np.clip((mean - z[0]) / (z[1] - z[0]), 0, len(z) - 1)
                    node = min(int(place), len(z) - 2)
                    share = place - node
                    blocks = [((mode, *tell, node), 1 - share), ((mode, *tell, node + 1), share)]
                for block, part in blocks:
                    memory = (block, *u)[:length]
                    into = new.setdefault(memory, dict.fromkeys(hidden, 0.0))
                    for s, p in mass.items():
                        into[s] += part * p
        found.append((best, mse, 1 - right))
        joint = {}
        for u, law in new.items():
            vector = np.array([law[s] for s in hidden])
            moved = sum(p * alpha[s] for s, p in zip(hidden, vector, strict=True))
            joint[u] = dict(zip(hidden, moved, strict=True))
    return found


CASES = {
    "large order 1": (scalar_laws, "A1H", large_order(1), 4),
    "large order 2": (scalar_laws, "A1H", large_order(2), 4),
    "finite memory 2": (scalar_laws, "A1H", finite_memory(2), 4),
    "indicator": (dependent_laws, "C", large_order(1), 3),
    "indicator remembered": (dependent_laws, "C", Memory(1, 0, 1), 3),
    "finite memory with indicator": (dependent_laws, "C", Memory(0, 1, 1), 3),
    "finite memory without it": (dependent_laws, "C", Memory(0, 1), 3),
}


@pytest.mark.filterwarnings("ignore:[xyz]. :UserWarning")  # the axes are short and coarse
@pytest.mark.parametrize("case", CASES)
def test_recursion_against_loops(case):
    laws, name, memory, steps = CASES[case]
    system = zoo.dependent_switching() if name == "C" else zoo.scalar_switching(name)
    axes = {"x": Axis(-3.0, 3.0, 13), "z": Axis(-2.0, 2.0, 4), "y": Axis(-5.0, 6.0, 6)}
    filter = grid_synthesis(system, memory, np.arange(steps), **axes, probabilities=True)
    again = grid_risk(filter, **axes)
    kind = "estimates" if memory.estimates else "measurements"
    found = recursion_by_loops(
        laws(), *(axes[name].nodes for name in "xyz"), steps, memory.depth, kind,
        bool(memory.indicators),
    )  # fmt: skip
    wanted = np.array([[mse**0.5, wrong] for _, mse, wrong in found])
    ours = np.stack([filter.predicted.rms[:, 0], filter.predicted.mode_rate], axis=1)
    assert np.abs(ours - wanted).max() < 1e-9
    assert np.abs(np.stack([again.mse**0.5, again.mode_error], axis=1) - wanted).max() < 1e-9
    compared = 0
    for (best, _, _), step in zip(found, filter.steps, strict=True):
        shape = tuple(axis.count for axis in step.shown.axes)
        assert step.shown.mode.shape == shape == step.shown.prob.shape[1:]
        for (j, b, u), (mean, mode, prob, mass) in best.items():
            if mass < 1e-6:
                continue  # events of probability 1e-15 are left out: digits of rare ones are lost
            told = ((j if j >= 0 else 2),) if system.indicators else ()
            place = (*told, b, *(part for block in u for part in block))
            assert step.shown.estimate[(0, *place)] == pytest.approx(mean, abs=1e-8)
            assert step.shown.prob[(1, *place)] == pytest.approx(prob, abs=1e-8)
            if abs(prob - 0.5) > 1e-6:
                assert step.shown.mode[place] == mode
            compared += 1
    assert compared > 100


# Numbers


@pytest.mark.parametrize(
    ("sensor", "rms", "wrong", "first"),
    [
        ("A1H", 1.1622, 0.3008, (0.9128, 1.2662)),
        ("A1L", 0.6416, 0.1195, (0.7294,)),
        ("A2", 1.2811, 0.3589, (0.8912,)),
    ],
)
def test_risk_of_the_filter_of_order_one(sensor, rms, wrong, first):
    risk = optimal_risk(zoo.scalar_switching(sensor), large_order(1), TIMES, **grids(sensor))
    assert averages(risk.mse, risk.mode_error) == pytest.approx((rms, wrong), abs=5e-4)
    assert np.sqrt(risk.mse[: len(first)]) == pytest.approx(first, abs=2e-4)
    assert np.abs(risk.bias).max() < 1e-10
    assert risk.clamped.max() < 1e-4


@pytest.mark.parametrize(
    ("sensor", "rms", "wrong"),
    [("A1H", 1.3728, 0.3549), ("A1L", 0.7832, 0.2043), ("A2", 1.5602, 0.3824)],
)
def test_risk_of_the_filter_with_finite_memory(sensor, rms, wrong):
    low, high, count = SHOWN[sensor]
    axes = {"x": (-8, 8, 81), "y": (low, high, min(count, 241))}
    risk = optimal_risk(zoo.scalar_switching(sensor), finite_memory(1), TIMES, **axes)
    assert averages(risk.mse, risk.mode_error) == pytest.approx((rms, wrong), abs=5e-4)


def test_coarse_memory_costs_what_it_should():
    risk = optimal_risk(zoo.scalar_switching("A1H"), large_order(1), TIMES, **grids("A1H", 61))
    assert averages(risk.mse, risk.mode_error)[0] == pytest.approx(1.1640, abs=1e-4)


def test_second_estimate():
    """Coarse grids; the fine ones are in the table that the book reads."""
    system, coarse = zoo.scalar_switching("A1H"), {"x": (-8, 8, 61), "y": (-16, 18, 69)}
    orders = {
        l: optimal_risk(system, large_order(l), np.arange(6), z=(-6, 6, 31), **coarse)
        for l in (1, 2)
    }
    apart = orders[1].mse - orders[2].mse
    # all that is known at k = 0, 1 is remembered by both
    assert np.abs(apart[:2]).max() < 1e-13
    assert (apart[2:] > 1e-3).all()
    assert np.abs(orders[1].mode_error - orders[2].mode_error)[:2].max() < 1e-13
    assert (orders[1].mode_error > orders[2].mode_error)[2:].all()
    # the limits of fine grids are 1.1485 and .2968; rounding costs as much as with order 1
    long = optimal_risk(system, large_order(2), TIMES, z=(-6, 6, 31), **coarse)
    found = np.array(averages(long.mse, long.mode_error)) - (1.1485, 0.2968)
    assert (found > 0).all()
    assert (found < (1.1690 - 1.1621 + 1.5e-3, 0.3026 - 0.3008 + 1e-3)).all()


def test_two_measurements():
    system, coarse = zoo.scalar_switching("A1H"), {"x": (-8, 8, 61), "y": (-16, 18, 69)}
    windows = {l: optimal_risk(system, finite_memory(l), TIMES, **coarse) for l in (1, 2)}
    long = averages(windows[2].mse, windows[2].mode_error)
    assert long == pytest.approx((1.2698, 0.3253), abs=1e-3)
    # the first estimate says as much as the first measurement: that of the fine grid of order 1
    assert windows[1].mse[1] == pytest.approx(1.2662**2, abs=5e-4)


# Limits


def linear(sensor_deviation=0.7):
    x, v, w = sympy.symbols("x v w")
    return {
        "state": (x,), "dynamics": [[0.9 * x + 0.4 * v]], "noise": Noise((v,)),
        "sensor": [[x + sensor_deviation * w]], "sensor_noise": Noise((w,)),
    }  # fmt: skip


def test_one_linear_mode_is_the_kalman_filter():
    system = SwitchingSystem(**linear(), switching=[[1]], initial=[(1.0, [0.3], [[0.8]])])
    risk = optimal_risk(
        system, large_order(1), np.arange(8), x=(-6, 6, 161), z=(-4.5, 4.5, 361), y=(-9, 9, 181)
    )
    variance, wanted = 0.8, []
    for _ in range(8):
        variance = variance * 0.49 / (variance + 0.49)
        wanted.append(variance)
        variance = 0.81 * variance + 0.16
    assert risk.mse == pytest.approx(wanted, rel=1e-3)
    assert risk.mode_error.max() < 1e-14


def test_equal_modes_are_one_mode():
    parts = linear()
    one = SwitchingSystem(**parts, switching=[[1]], initial=[(1.0, [0.3], [[0.8]])])
    parts = {**parts, "dynamics": parts["dynamics"] * 3, "sensor": parts["sensor"] * 3}
    three = SwitchingSystem(
        **parts,
        switching=[[0.2, 0.3, 0.5]] * 3,
        initial=[(p, [0.3], [[0.8]]) for p in (0.2, 0.3, 0.5)],
    )
    axes = {"x": (-5, 5, 81), "z": (-4, 4, 81), "y": (-8, 8, 81)}
    found = [optimal_risk(system, large_order(1), np.arange(5), **axes) for system in (one, three)]
    assert found[1].mse == pytest.approx(found[0].mse, rel=1e-11)
    assert found[1].mode_error == pytest.approx(np.full(5, 0.5), abs=1e-12)


@pytest.mark.parametrize("memory", [large_order(1), large_order(2), finite_memory(1)])
def test_one_mode_is_the_recursion_of_an_ordinary_system(memory, monkeypatch):
    """The same chain given as a jump-diffusion and as a system of one mode."""
    x, v = sympy.symbols("x v")
    diffusion = JumpDiffusion(
        state=(x,), drift=[-x], diffusion=[[0.5]], sensor=[x + 0.7 * v], noise=Noise((v,)),
        mean0=[0.3], cov0=[[0.8]],
    )  # fmt: skip
    one = SwitchingSystem(**linear(), switching=[[1]], initial=[(1.0, [0.3], [[0.8]])])
    axes = {"x": (-5, 5, 41), "z": (-4, 4, 33), "y": (-8, 8, 41)}
    chain = SwitchingChain(one, Axis(-5, 5, 41))
    monkeypatch.setattr(FellerChain, "transition", lambda self, a, b: chain.transition(a, b))
    found = [optimal_risk(system, memory, np.arange(5), **axes) for system in (one, diffusion)]
    assert found[0].mse == pytest.approx(found[1].mse, rel=1e-10)


def test_constant_switching_keeps_the_laws_of_the_modes():
    """Chain with columns that sum to one, whose modes follow the transition probabilities."""
    system = zoo.scalar_switching("A1H")
    chain = SwitchingChain(system, Axis(-8, 8, 161))
    moves = chain.transition(0.0, 1.0)
    assert np.abs(moves.sum(axis=0) - 1).max() < 1e-13
    assert moves.min() >= 0
    leave = 0.35 - 0.3 * np.exp(-(chain.axis.nodes**2) / 8)
    assert moves[161:, :161].sum(axis=0) == pytest.approx(leave, abs=1e-12)
    law = chain.start()
    for _ in range(30):
        law = moves @ law
    # stationary: P(mode 1) about .404, deviation about 2.42
    assert law[161:].sum() == pytest.approx(0.404, abs=2e-3)
    x = chain.values[0]
    assert np.sqrt(law @ x**2 - (law @ x) ** 2) == pytest.approx(2.42, abs=0.01)


def test_an_indicator_that_shows_the_mode():
    """Impossible readings, a mode that never starts and noise finer than the grid do no harm."""
    x, v, w = sympy.symbols("x v w")
    system = SwitchingSystem(
        state=(x,), dynamics=[[0.9 * x], [0.5 * x + 0.01 * v]], noise=Noise((v,)),
        switching=[[0.8, 0.2], [0.3, 0.7]], sensor=[[x + w], [x + 2 * w]],
        sensor_noise=Noise((w,)), indicator=[[1, 0], [0, 1]],
        initial=[(1.0, [0], [[1]]), (0.0, [0], [[1]])],
    )  # fmt: skip
    axes = {"x": (-5, 5, 101), "z": (-4, 4, 81), "y": (-16, 16, 129)}
    filter = grid_synthesis(system, large_order(1), np.arange(5), **axes)
    assert filter.predicted.mode_rate.max() < 1e-12
    for step in filter.steps:
        for table in step:
            assert np.isfinite(table.estimate).all()
    data = system.simulate(np.arange(5), 4000, 3)
    found = filter.run(np.arange(5), data.measurements, indicators=data.indicators)
    assert np.array_equal(found.modes, data.modes)
    square = (found.mean - data.states)[:, 0] ** 2
    apart = square.mean(axis=1) - filter.predicted.rms[:, 0] ** 2
    assert (np.abs(apart) < 4 * square.std(axis=1) / 4000**0.5 + 3e-3).all()
    # a missing indicator leaves the modes open
    found = filter.run(np.arange(5), data.measurements, indicators=np.full((5, 4000), -1))
    assert 0.05 < np.mean(found.modes != data.modes) < 0.4


# Simulation


@pytest.mark.parametrize(
    ("name", "memory"),
    [
        ("A1H", large_order(1)),
        ("A1L", finite_memory(1)),
        ("C", large_order(1)),
        ("C", Memory(1, 0, 1)),
        ("C", Memory(0, 1, 1)),
    ],
)
def test_risk_is_the_error_on_simulated_paths(name, memory):
    times = np.arange(7)
    if name == "C":
        system, axes = (
            zoo.dependent_switching(),
            {"x": (-6, 6, 121), "z": (-4, 4, 81), "y": (-7, 11, 121)},
        )
    else:
        system, axes = zoo.scalar_switching(name), {**grids(name, 121)}
    filter = grid_synthesis(system, memory, times, **axes)
    data = system.simulate(times, 20_000, 7)
    found = filter.run(times, data.measurements, indicators=data.indicators)
    square = (found.mean - data.states)[:, 0] ** 2
    apart = square.mean(axis=1) - filter.predicted.rms[:, 0] ** 2
    assert (np.abs(apart) < 4 * square.std(axis=1) / 20_000**0.5).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    error = np.sqrt(wrong * (1 - wrong) / 20_000)
    assert (np.abs(wrong - filter.predicted.mode_rate) < 4 * error).all()


# Arguments


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"memory": Memory(1, 1)}, "estimates or measurements alone"),
        ({"memory": Memory(1, 0, 1)}, "estimates or measurements alone"),
        ({"memory": Memory(1, log_odds=True)}, "estimates or measurements alone"),
        ({"memory": large_order(4)}, "numbers on the grid"),
        ({"y": [(-1, 1, 5), (-1, 1, 5)]}, "wanted 1 axes"),
        ({"y": (100, 101, 5)}, "wanted axes that hold"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    system = zoo.scalar_switching("A1H")
    given = {"memory": large_order(1), "x": (-8, 8, 41), "z": (-6, 6, 31), "y": (-16, 18, 35)}
    given.update(change)
    with pytest.raises(ValueError, match=message):
        grid_synthesis(system, given.pop("memory"), TIMES, **given)


def test_systems_of_several_components_are_refused():
    with pytest.raises(ValueError, match="one state component"):
        grid_synthesis(zoo.manoeuvring_target(), large_order(1), TIMES, x=(-8, 8, 41))


@pytest.mark.filterwarnings("ignore:z. :UserWarning")
def test_an_axis_that_is_too_short_is_told():
    with pytest.warns(UserWarning, match="outermost cell"):
        optimal_risk(
            zoo.scalar_switching("A1H"), large_order(1), np.arange(6), x=(-4, 4, 41), z=(-3, 3, 31),
            y=(-14, 16, 61),
        )  # fmt: skip
