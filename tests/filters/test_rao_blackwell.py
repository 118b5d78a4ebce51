"""The Rao-Blackwellised particle filter against enumeration of all histories, and limits."""

from itertools import product

import numpy as np
import pytest
import sympy
from scipy.stats import multivariate_normal

from seedslib import zoo
from seedslib.filters import KnownModeFilter, RaoBlackwellFilter
from seedslib.models import Noise, SwitchingSystem

TIMES = np.arange(5.0)
MATRICES = [np.array([[1, 1], [0, decay]]) for decay in (0.98, 0.9)]
INPUTS = [np.zeros(2), np.array([0.5, 1.0])]
PUSH = np.array([0.5, 1.0])
NOISES = [s**2 * np.outer(PUSH, PUSH) for s in (0.1, 0.5)]
SENSORS = [1.0, 9.0]
SWITCH = np.array([[0.95, 0.05], [0.15, 0.85]])
TELLS = np.array([[0.9, 0.1], [0.2, 0.8]])


def enumerated(y, shown):
    """Mode probabilities, mean and covariance by Kalman filters for all 2⁵ histories of modes."""
    found = []
    for k in range(len(y)):
        parts = []
        for modes in product(range(2), repeat=k + 1):
            weight = (0.8, 0.2)[modes[0]]
            mean, cov = np.zeros(2), np.diag([4.0, 1.0])
            for q, i in enumerate(modes):
                if q:
                    old = modes[q - 1]
                    weight *= SWITCH[old, i]
                    mean = MATRICES[old] @ mean + INPUTS[old]
                    cov = MATRICES[old] @ cov @ MATRICES[old].T + NOISES[old]
                if shown[q] >= 0:
                    weight *= TELLS[i, shown[q]]
                if np.isnan(y[q]):
                    continue
                s = cov[0, 0] + SENSORS[i]
                weight *= multivariate_normal.pdf(y[q], mean[0], s)
                gain = cov[:, 0] / s
                mean = mean + gain * (y[q] - mean[0])
                cov = cov - np.outer(gain, cov[0])
            parts.append((weight, modes[-1], mean, cov))
        total = sum(p[0] for p in parts)
        prob = [sum(p[0] for p in parts if p[1] == i) / total for i in range(2)]
        mean = sum(p[0] * p[2] for p in parts) / total
        cov = sum(p[0] * (p[3] + np.outer(p[2] - mean, p[2] - mean)) for p in parts) / total
        found.append((prob, mean, cov, total))
    return found


def test_exact_while_nothing_is_drawn():
    """32 histories at the last of five measurements; some are missing."""
    system = zoo.manoeuvring_target("noisy")
    data = system.simulate(TIMES, 3, 4)
    data.measurements[2, :, 1] = np.nan
    data.indicators[3, 2] = -1
    got = RaoBlackwellFilter(system, 16).run(
        TIMES, data.measurements, indicators=data.indicators, seed=1
    )
    for path in range(3):
        exact = enumerated(data.measurements[:, 0, path], data.indicators[:, path])
        total = 1.0
        for k, (prob, mean, cov, evidence) in enumerate(exact):
            np.testing.assert_allclose(got.mode_prob[k, :, path], prob, atol=1e-12)
            np.testing.assert_allclose(got.mean[k, :, path], mean, atol=1e-11)
            np.testing.assert_allclose(got.cov[k, :, :, path], cov, atol=1e-11)
            assert got.loglik[k, path] == pytest.approx(np.log(evidence / total), abs=1e-10)
            total = evidence


def test_few_particles_come_close_and_more_come_closer():
    """Drawn histories against enumeration: the error falls with the number of particles."""
    system = zoo.manoeuvring_target("none")
    times = np.arange(9.0)
    data = system.simulate(times, 60, 5)
    exact = RaoBlackwellFilter(system, 256).run(times, data.measurements, seed=1)
    distance = []
    for count in (4, 64):
        got = RaoBlackwellFilter(system, count).run(times, data.measurements, seed=2)
        distance.append(np.sqrt(((got.mode_prob - exact.mode_prob)[5:] ** 2).mean()))
    assert distance[1] < 0.03
    assert distance[0] > 3 * distance[1]


def test_drawing_is_unbiased():
    """Mean over 600 seeds of the likelihood estimate from two particles against the exact one."""
    system = zoo.manoeuvring_target("none")
    y = np.array([0.5, 2.5, 1.0, 6.0])[:, None]
    exact = RaoBlackwellFilter(system, 8).run(np.arange(4.0), y).loglik.sum()
    repeated = np.broadcast_to(y[..., None], (4, 1, 4000))
    drawn = RaoBlackwellFilter(system, 2).run(np.arange(4.0), repeated, seed=3).loglik
    ratio = np.exp(drawn.sum(axis=0) - exact)
    assert ratio.std() > 0.01
    assert abs(ratio.mean() - 1) < 4 * ratio.std() / np.sqrt(4000)


def test_exact_indicator_gives_the_filter_with_known_modes():
    system = zoo.manoeuvring_target("exact")
    times = np.arange(21.0)
    data = system.simulate(times, 40, 6)
    got = RaoBlackwellFilter(system, 3).run(
        times, data.measurements, indicators=data.indicators, seed=1
    )
    known = KnownModeFilter(system).run(
        times, data.measurements, modes=data.modes, indicators=data.indicators
    )
    np.testing.assert_allclose(got.mean, known.mean, atol=1e-9)
    np.testing.assert_allclose(got.cov, known.cov, atol=1e-9)
    np.testing.assert_array_equal(got.modes, data.modes)


@pytest.mark.parametrize(
    ("indicator", "wrong", "errors"),
    [("noisy", 0.0735, [1.0271, 0.4594]), ("none", 0.1332, [1.1322, 0.5364])],
)
def test_table_of_the_manoeuvring_target(indicator, wrong, errors):
    """The reference has 500 paths and 100 histories; with 100 here, fewer paths."""
    from seedslib.evaluation import evaluate

    system, paths = zoo.manoeuvring_target(indicator), 200
    found = evaluate(
        RaoBlackwellFilter(system, 100), system, np.arange(41.0), paths, 3, window=(10, 40)
    )
    scale = 4 * np.sqrt(1 + paths / 500)
    assert abs(found.average_mode_error - wrong) < scale * found.average_mode_error_error
    assert (np.abs(found.average - errors) < scale * found.average_error).all()


def test_threads_verbs_and_shapes():
    system = zoo.manoeuvring_target("noisy")
    data = system.simulate(TIMES, 300, 1)
    filter = RaoBlackwellFilter(system, 100)
    one, two, other = (
        filter.run(TIMES, data.measurements, indicators=data.indicators, seed=s, workers=n)
        for s, n in ((7, 1), (7, 2), (8, 1))
    )
    np.testing.assert_array_equal(one.mean, two.mean)
    few = RaoBlackwellFilter(system, 4)
    state = few.initial((300,), seed=7)
    for k, t in enumerate(TIMES):
        state = few.step(state, t, data.measurements[k], data.indicators[k])
    assert state.log_prob.shape == (2, 4, 300)
    assert state.mean.shape == (2, 300)
    ahead = few.forecast(state, 5.0)
    np.testing.assert_array_equal(ahead.mean, few.forecast(state, 5.0).mean)
    np.testing.assert_allclose(ahead.mode_prob.sum(axis=0), 1.0)
    assert other.cov.shape == (5, 2, 2, 300)
    single = filter.run(TIMES, data.measurements[..., 0], indicators=data.indicators[:, 0])
    assert single.mean.shape == (5, 2)
    np.testing.assert_allclose(single.mean, one.mean[..., 0], atol=1e-9)


def test_impossible_indicator_is_marked():
    """A mode that never shows 1, and no way out of it."""
    x, v, w = sympy.symbols("x v w")
    system = SwitchingSystem(
        (x,), [[x + v]] * 2, Noise((v,)), [[1, 0], [0, 1]], [[x + w]] * 2, Noise((w,)),
        [(1, [0], [[1]]), (0, [0], [[1]])], indicator=[[1, 0], [0.5, 0.5]],
    )  # fmt: skip
    got = RaoBlackwellFilter(system, 5).run(
        [0, 1], np.zeros((2, 1, 2)), indicators=np.array([[0, 0], [0, 1]])
    )
    assert got.diverged.tolist() == [False, True]
    assert np.isneginf(got.loglik[1, 1])
    assert np.isfinite(got.mean).all()


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (zoo.scalar_switching, "dynamics: wanted symbolic maps affine"),
        (zoo.dependent_switching, "switching: wanted probabilities that depend on neither"),
    ],
)
def test_what_is_not_jump_linear_is_refused(system, message):
    with pytest.raises(ValueError, match=message):
        RaoBlackwellFilter(system())


def test_sensor_and_noise_are_looked_at_too():
    x, v, w = sympy.symbols("x v w")
    given = {
        "state": (x,), "dynamics": [[x + v]], "noise": Noise((v,)), "switching": [[1]],
        "sensor": [[x + w]], "sensor_noise": Noise((w,)), "initial": [(1, [0], [[1]])],
    }  # fmt: skip
    RaoBlackwellFilter(SwitchingSystem(**given))
    with pytest.raises(ValueError, match="sensor: wanted symbolic maps affine"):
        RaoBlackwellFilter(SwitchingSystem(**given | {"sensor": [[x**2 + w]]}))
    with pytest.raises(ValueError, match="sensor: wanted symbolic maps affine"):
        RaoBlackwellFilter(SwitchingSystem(**given | {"sensor": [[x * w]]}))
    uniform = Noise((v,), cov=[[1 / 3]], sample=lambda rng, n: rng.uniform(-1, 1, (1, n)))
    with pytest.raises(ValueError, match="dynamics: wanted Gaussian noise"):
        RaoBlackwellFilter(SwitchingSystem(**given | {"noise": uniform}))
    with pytest.raises(ValueError, match="particles: wanted at least 1"):
        RaoBlackwellFilter(SwitchingSystem(**given), 0)
    with pytest.raises(TypeError, match="system: wanted a SwitchingSystem"):
        RaoBlackwellFilter(zoo.linear_gaussian())
