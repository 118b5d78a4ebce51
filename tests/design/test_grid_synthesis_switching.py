"""Exact designs of switching systems on grids: against loops over all events, limits, paths."""

from itertools import product

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import grid_risk, grid_synthesis, optimal_risk, synthesize
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

SHOWN = {"A1H": (-16, 18, 137), "A1L": (-11, 13, 241), "A2": (-8, 26, 273)}


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


@pytest.mark.parametrize(
    ("sensor", "memory", "rms", "wrong"),
    [
        ("A1H", large_order(1), 1.1622, 0.3008),
        ("A2", large_order(1), 1.2811, 0.3589),
        ("A1L", finite_memory(1), 0.7832, 0.2043),
        ("A1H", finite_memory(2), 1.2698, 0.3253),
    ],
)
def test_settled_risk_is_that_of_the_paper(sensor, memory, rms, wrong):
    low, high, count = SHOWN[sensor]
    axes = {"x": (-8, 8, 61), "z": (-6, 6, 121), "y": (low, high, min(count, 121))}
    if memory.measurements > 1:
        axes["y"] = (low, high, 69)
    risk = optimal_risk(zoo.scalar_switching(sensor), memory, range(17), **axes)
    assert np.sqrt(risk.mse[12:].mean()) == pytest.approx(rms, abs=6e-3)
    assert risk.mode_error[12:].mean() == pytest.approx(wrong, abs=2e-3)
    assert np.abs(risk.bias).max() < 1e-10
    assert risk.clamped.max() < 1e-4


def linear(modes):
    """Parts of a system whose modes are all one linear system."""
    x, v, w = sympy.symbols("x v w")
    return {
        "state": (x,), "dynamics": [[0.9 * x + 0.4 * v]] * modes, "noise": Noise((v,)),
        "sensor": [[x + 0.7 * w]] * modes, "sensor_noise": Noise((w,)),
    }  # fmt: skip


@pytest.mark.parametrize("memory", [large_order(1), large_order(2), finite_memory(1)])
def test_equal_modes_are_one_mode_and_one_mode_is_an_ordinary_system(memory):
    axes = {"x": (-5, 5, 41), "z": (-4, 4, 33), "y": (-8, 8, 41)}
    one = SwitchingSystem(**linear(1), switching=[[1]], initial=[(1.0, [0.3], [[0.8]])])
    three = SwitchingSystem(
        **linear(3),
        switching=[[0.2, 0.3, 0.5]] * 3,
        initial=[(p, [0.3], [[0.8]]) for p in (0.2, 0.3, 0.5)],
    )
    x, v, w = sympy.symbols("x v w")
    ordinary = DiscreteSystem(
        StochasticMap((x,), [0.9 * x + 0.4 * v], Noise((v,))),
        StochasticMap((x,), [x + 0.7 * w], Noise((w,))), [0.3], [[0.8]],
    )  # fmt: skip
    found = [optimal_risk(system, memory, range(4), **axes) for system in (one, ordinary)]
    np.testing.assert_allclose(found[1].mse, found[0].mse, rtol=1e-5)
    assert found[0].mode_error.max() < 1e-14
    assert found[1].mode_error is None
    if memory == large_order(1):
        found.append(optimal_risk(three, memory, range(4), **axes))
        np.testing.assert_allclose(found[2].mse, found[0].mse, rtol=1e-10)
        np.testing.assert_allclose(found[2].mode_error, 0.5, atol=1e-12)


def test_an_indicator_that_shows_the_mode_decides_it():
    """Impossible readings, a mode that never starts and noise finer than the grid do no harm."""
    x, v, w = sympy.symbols("x v w")
    system = SwitchingSystem(
        state=(x,), dynamics=[[0.9 * x], [0.5 * x + 0.01 * v]], noise=Noise((v,)),
        switching=[[0.8, 0.2], [0.3, 0.7]], sensor=[[x + w], [x + 2 * w]],
        sensor_noise=Noise((w,)), indicator=[[1, 0], [0, 1]],
        initial=[(1.0, [0], [[1]]), (0.0, [0], [[1]])],
    )  # fmt: skip
    axes = {"x": (-5, 5, 101), "z": (-4, 4, 81), "y": (-16, 16, 129)}
    filter = grid_synthesis(system, large_order(1), range(5), **axes)
    assert filter.predicted.mode_rate.max() < 1e-12
    data = system.simulate(range(5), 4000, 3)
    found = filter.run(data.times, data.measurements, indicators=data.indicators)
    assert np.array_equal(found.modes, data.modes)
    square = (found.mean - data.states)[:, 0] ** 2
    apart = square.mean(axis=1) - filter.predicted.rms[:, 0] ** 2
    assert (np.abs(apart) < 4 * square.std(axis=1) / 4000**0.5 + 3e-3).all()
    # a missing indicator leaves the modes open
    found = filter.run(data.times, data.measurements, indicators=np.full((5, 4000), -1))
    assert 0.05 < np.mean(found.modes != data.modes) < 0.4


@pytest.mark.parametrize(
    ("name", "memory"),
    [
        ("A1H", large_order(1)),
        ("A1L", finite_memory(1)),
        ("C", Memory(1, 0, 1)),
        ("C", Memory(0, 1, 1)),
    ],
)
def test_risk_is_the_error_on_simulated_paths(name, memory):
    system, axes = zoo.dependent_switching(), {"x": (-6, 6, 91), "z": (-4, 4, 61)}
    axes["y"] = (-7, 11, 91)
    if name != "C":
        system = zoo.scalar_switching(name)
        axes = {"x": (-8, 8, 81), "z": (-6, 6, 121), "y": SHOWN[name]}
    filter = grid_synthesis(system, memory, range(5), **axes)
    data = system.simulate(range(5), 20_000, 7)
    told = {"indicators": data.indicators}
    found = filter.run(data.times, data.measurements, **told)
    square = (found.mean - data.states)[:, 0] ** 2
    apart = square.mean(axis=1) - filter.predicted.rms[:, 0] ** 2
    assert (np.abs(apart) < 4 * square.std(axis=1) / 20_000**0.5).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    error = np.sqrt(wrong * (1 - wrong) / 20_000)
    assert (np.abs(wrong - filter.predicted.mode_rate) < 4 * error).all()
    # tables of one kind come closer to each other, decisions too
    assert np.isnan(filter.changes[:, :2]).all()
    estimates, modes = filter.changes[:, 2:]
    assert (np.diff(estimates) < 0).all()
    assert (np.diff(modes) < 0).all()
    assert 0 < modes[0] < 0.2


def test_risk_of_a_simulated_design_with_modes_is_its_held_out_error():
    x, v, w = sympy.symbols("x v w")
    system = SwitchingSystem(
        (x,), [[0.9 * x + 0.4 + 0.3 * v], [0.5 * x - 0.7 + 0.8 * v]], Noise((v,)),
        [[0.85, 0.15], [0.3, 0.7]], [[x + 0.5 * w], [1.3 * x + 0.7 * w]], Noise((w,)),
        [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])], indicator=[[0.8, 0.2], [0.3, 0.7]],
    )  # fmt: skip
    filter = synthesize(system, Memory(1), Taylor(), range(3), paths=12_000, seed=1)
    risk = grid_risk(filter, x=(-7, 7, 57), z=(-6, 6, 41), y=(-11, 11, 61))
    held = filter.held_out
    assert (np.abs(np.sqrt(risk.mse) - held.rms[:, 0]) < 4 * held.error[:, 0]).all()
    assert (np.abs(risk.mode_error - held.mode_rate) < 4 * held.mode_error).all()
