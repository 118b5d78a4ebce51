"""The filter with known modes against least squares, and as a bound; averaged switching."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.designed import SwitchingFilter
from seedslib.evaluation import compare, evaluate
from seedslib.filters import GridBayesFilter, KnownModeFilter, extended_kalman
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import (
    DiscreteSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
    averaged_switching,
)

x, v, w = sympy.symbols("x v w", real=True)


@pytest.fixture(scope="module")
def dependent():
    return zoo.dependent_switching()


def least_squares(modes, y):
    """Conditional mean and covariance of the last state: one joint Gaussian law of everything.

    States are linear in X0 and the noises v_0 .. v_{K-1}; the gain is one solve.
    """
    steps = len(y)
    size = 2 + steps - 1
    prior = np.diag([4.0, 1.0] + [1.0] * (steps - 1))
    row, constant, rows, offsets = np.eye(2, size), np.zeros(2), [], []
    for k, i in enumerate(modes):
        rows.append(row[0])
        offsets.append(constant[0])
        if k + 1 < steps:
            matrix = np.array([[1, 1], [0, (0.98, 0.9)[i]]])
            row, constant = matrix @ row, matrix @ constant + (0, 1)[i] * np.array([0.5, 1.0])
            row[:, 2 + k] += (0.1, 0.5)[i] * np.array([0.5, 1.0])
    seen = ~np.isnan(y)
    h = np.array(rows)[seen]
    s = h @ prior @ h.T + np.diag(np.array([1.0, 9.0])[modes][seen])
    gain = np.linalg.solve(s, h @ prior).T
    mean = gain @ (y - offsets)[seen]
    return row @ mean + constant, row @ (prior - gain @ h @ prior) @ row.T


def test_jump_linear_systems_against_least_squares():
    system, times = zoo.manoeuvring_target("noisy"), np.arange(9.0)
    data = system.simulate(times, 12, 1)
    data.measurements[4, 0, :6] = np.nan
    found = KnownModeFilter(system).run(
        times, data.measurements, modes=data.modes, indicators=data.indicators
    )
    for path in range(12):
        mean, cov = least_squares(data.modes[:, path], data.measurements[:, 0, path])
        np.testing.assert_allclose(found.mean[-1, :, path], mean, atol=1e-10)
        np.testing.assert_allclose(found.cov[-1, :, :, path], cov, atol=1e-10)
    np.testing.assert_array_equal(found.modes, data.modes)
    assert (found.mode_prob.sum(axis=1) == 1).all()
    assert (np.take_along_axis(found.mode_prob, data.modes[:, None], axis=1) == 1).all()


def test_one_mode_is_the_kalman_filter():
    system = SwitchingSystem(
        (x,), [[0.9 * x + v]], Noise((v,)), [[1]], [[x + w]], Noise((w,)), [(1, [0.5], [[1]])]
    )
    alone = DiscreteSystem(
        StochasticMap((x,), [0.9 * x + v], Noise((v,))),
        StochasticMap((x,), [x + w], Noise((w,))), [0.5], [[1]],
    )  # fmt: skip
    record = alone.simulate(np.arange(6.0), 5, 1).measurements
    exact = extended_kalman(alone).run(np.arange(6.0), record)
    found = KnownModeFilter(system).run(np.arange(6.0), record, modes=np.zeros((6, 5), int))
    np.testing.assert_allclose(found.mean, exact.mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.loglik, exact.loglik, rtol=1e-12)


def test_bound_of_the_manoeuvring_target():
    """The reference: position .9518 ± .0022 on 40 000 paths; velocity .4010 on 2000."""
    system = zoo.manoeuvring_target("none")
    found = evaluate(KnownModeFilter(system), system, np.arange(41.0), 8000, 5, window=(10, 40))
    assert abs(found.average[0] - 0.9518) < 4 * np.hypot(found.average_error[0], 0.0022)
    assert abs(found.average[1] - 0.4010) < 4 * np.hypot(found.average_error[1], 0.0045)
    assert found.average_mode_error == 0


def test_seeing_a_switch_tells_of_the_state(dependent):
    """One step of SW-C from N(m, D): moments of the next state given the switch, by quadrature."""
    system = dependent
    filter = KnownModeFilter(system, GaussHermite(12))
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    weights = weights / weights.sum()
    state = filter.initial((2,), mode=np.array([0, 1]))
    state = filter.predict(state, 0.0)
    later = filter.predict(state, 1.0, np.array([1, 0]))
    for path, (i, l) in enumerate([(0, 1), (1, 0)]):
        start = (0.0, 1.0) if i == 0 else (0.5, np.sqrt(0.5))
        here, push = (part.ravel() for part in np.meshgrid(start[0] + start[1] * nodes, nodes))
        mass = np.outer(weights, weights).ravel()
        branch = system.branches[i][l].map
        mass = mass * branch.weight(0.0, here[None], push[None])
        moved = branch.value(0.0, here[None], push[None])[0]
        mean = (mass * moved).sum() / mass.sum()
        spread = (mass * (moved - mean) ** 2).sum() / mass.sum()
        assert later.mean[0, path] == pytest.approx(mean, abs=1e-4)
        assert later.cov[0, 0, path] == pytest.approx(spread, abs=1e-4)


def test_knowing_the_modes_is_better_than_the_best_guess(dependent):
    system = dependent
    filters = {
        "known": KnownModeFilter(system, GaussHermite(5)),
        "guessed": GridBayesFilter(system, (-9, 9, 91)),
    }
    table = compare(filters, system, np.arange(13.0), 500, 3, window=(5, 12))
    apart = table.difference("known", "guessed")
    assert apart.average_square < -3 * apart.average_square_error
    assert table["known"].average_mode_error == 0
    assert 0.1 < table["guessed"].average_mode_error < 0.25


def test_verbs_make_up_a_run():
    system, times = zoo.manoeuvring_target("noisy"), np.arange(5.0)
    data = system.simulate(times, 20, 1)
    filter = KnownModeFilter(system, ExactGaussian())
    whole = filter.run(times, data.measurements, modes=data.modes, indicators=data.indicators)
    state = filter.initial((20,), mode=data.modes[0])
    for k, t in enumerate(times):
        state = filter.step(state, t, data.measurements[k], data.indicators[k], mode=data.modes[k])
    np.testing.assert_array_equal(state.mean, whole.mean[-1])
    single = filter.run(
        times, data.measurements[..., 0], modes=data.modes[:, 0], indicators=data.indicators[:, 0]
    )
    np.testing.assert_allclose(single.mean, whole.mean[..., 0], rtol=1e-12)
    assert single.cov.shape == (5, 2, 2)


def test_bad_modes():
    absorbing = SwitchingSystem(
        (x,), [[x + v]] * 2, Noise((v,)), [[1, 0], [0.5, 0.5]], [[x + w]] * 2, Noise((w,)),
        [(0.5, [0], [[1]])] * 2,
    )  # fmt: skip
    filter, y = KnownModeFilter(absorbing), np.zeros((3, 1, 2))
    with pytest.raises(ValueError, match="mode: wanted possible switches, got one from 0 to 1"):
        filter.run(range(3), y, modes=np.array([[0, 0], [0, 1], [0, 1]]))
    with pytest.raises(ValueError, match="modes: wanted numbers from 0 to 1, got 2"):
        filter.run(range(3), y, modes=np.full((3, 2), 2))
    with pytest.raises(ValueError, match=r"modes: wanted shape \(3, 2\)"):
        filter.run(range(3), y, modes=np.zeros((3, 1), int))
    with pytest.raises(TypeError, match="modes: wanted whole numbers"):
        filter.run(range(3), y, modes=np.zeros((3, 2)))
    with pytest.raises(ValueError, match="mode: wanted the mode at the later time"):
        filter.predict(filter.predict(filter.initial((2,)), 0.0), 1.0)
    with pytest.raises(TypeError, match="linearization: wanted"):
        KnownModeFilter(absorbing, 5)
    with pytest.raises(TypeError, match="system: wanted a SwitchingSystem"):
        KnownModeFilter(zoo.linear_gaussian())
    assert KnownModeFilter(absorbing, Taylor()).initial((3,)).mean.shape == (1, 3)


# The same system with constant switching


def test_averages_are_the_shares_of_switches():
    """Mean probabilities against counted switches of other paths."""
    system, times = zoo.scalar_switching(), np.arange(31.0)
    average = averaged_switching(system, times, 20_000, 1)
    data = system.simulate(times, 20_000, 2)
    old, new = data.modes[15:-1].ravel(), data.modes[16:].ravel()
    for i in range(2):
        share = np.mean(new[old == i])
        error = np.sqrt(share * (1 - share) / (old == i).sum())
        probability = float(average.branches[i][1].probability(0.0, np.zeros(1)))
        # the averages have an error too, below half of that of the counts
        assert abs(probability - share) < 5 * error
    assert average.branches[0][0].constant
    assert average.dynamics[0].expressions[0] == system.dynamics[0].expressions[0]


def test_filters_for_averaged_switching_are_worse_but_not_bad():
    """The grid filter that is told the wrong switching loses; the reference has .02 for AOF-G."""
    system, times = zoo.scalar_switching(), np.arange(31.0)
    filters = {
        "right": GridBayesFilter(system, (-8, 8, 81)),
        "constant": GridBayesFilter(averaged_switching(system, times, 8000, 1), (-8, 8, 81)),
    }
    table = compare(filters, system, times, 1000, 4, window=(10, 30))
    apart = table.difference("constant", "right")
    assert 0.01 < apart.average_mode < 0.04
    assert apart.average_mode > 4 * apart.average_mode_error


def test_gaussian_filter_for_averaged_switching():
    """The reference: AOF-G of A1L .1295/.6606, with constant switching .1541/.7042."""
    system, times = zoo.scalar_switching("A1L"), np.arange(31.0)
    filters = {
        "right": SwitchingFilter(system, ExactGaussian()),
        "constant": SwitchingFilter(averaged_switching(system, times, 8000, 1), ExactGaussian()),
    }
    table = compare(filters, system, times, 3000, 5, window=(10, 30))
    for name, wrong, rms in (("right", 0.1295, 0.6606), ("constant", 0.1541, 0.7042)):
        row, scale = table[name], 4 * np.sqrt(1 + 3000 / 4000)
        assert abs(row.average_mode_error - wrong) < scale * row.average_mode_error_error
        assert abs(row.average[0] - rms) < scale * row.average_error[0]
    apart = table.difference("constant", "right")
    assert apart.average_square > 8 * apart.average_square_error


def test_impossible_switches_and_indicators_stay_impossible():
    system = zoo.manoeuvring_target("exact")
    same = averaged_switching(system, np.arange(6.0), 4000, 1)
    assert same.readings[0][1] is None
    assert same.indicators
    for i in range(2):
        for l in range(2):
            expected = system.branches[i][l].probability(0.0, np.zeros(2))
            assert same.branches[i][l].probability(0.0, np.zeros(2)) == pytest.approx(expected)


def test_bad_averages():
    with pytest.raises(TypeError, match="system: wanted a SwitchingSystem"):
        averaged_switching(zoo.linear_gaussian(), [0, 1], 10, 1)
    with pytest.raises(ValueError, match="paths: wanted at least 1"):
        averaged_switching(zoo.scalar_switching(), [0, 1], 0, 1)
    with pytest.raises(ValueError, match="paths: wanted some in mode"):
        averaged_switching(zoo.scalar_switching(), [0, 1], 1, 1)
