"""Designed filters of a signal that depends on time: dX = cos t X dt + (1 + t) dW."""

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from seedslib import zoo
from seedslib.design import Continuous, grid_synthesis, synthesize
from seedslib.designed import Memory, large_order
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise

x, v, t = *sympy.symbols("x v", real=True), sympy.Symbol("t")
LOUD, INSTANTS, PATHS = 0.5, np.array([0.0, 0.5, 1.2, 1.5]), 10_000
SYSTEM = JumpDiffusion(
    (x,),
    [sympy.cos(t) * x],
    [[1 + t]],
    [x + v],
    Noise((v,), cov=[[LOUD]]),
    [1.0],
    [[0.4]],
    step=0.01,
)


def rates(now, moments, late=0.0):
    c = np.cos(now + late)
    return [c * moments[0], 2 * c * moments[1] + (1 + now + late) ** 2]


def kalman(y, late=0.0):
    """Means on the records and variances, with the functions of a time that is `late`."""
    mean, var, means, variances = np.ones(y.shape[-1]), 0.4, [], []
    for k, now in enumerate(INSTANTS):
        if k:
            span = INSTANTS[k - 1], now
            grown, var = solve_ivp(rates, span, [1.0, var], rtol=1e-10, args=(late,)).y[:, -1]
            mean = grown * mean
        gain = var / (var + LOUD)
        mean, var = mean + gain * (y[k, 0] - mean), (1 - gain) * var
        means.append(mean)
        variances.append(var)
    return np.array(means), np.array(variances)


@pytest.mark.parametrize("scheme", ["euler", "heun"])
def test_moments_of_the_paths(scheme):
    states = SYSTEM.simulate(INSTANTS, PATHS, 1, scheme=scheme).states[:, 0]
    mean, var = solve_ivp(rates, (0, 1.5), [1.0, 0.4], t_eval=INSTANTS, rtol=1e-10).y
    bias = 0.015 if scheme == "euler" else 0.002
    assert (np.abs(states.mean(axis=1) - mean) < 4 * np.sqrt(var / PATHS) + bias).all()
    assert (np.abs(states.var(axis=1) / var - 1) < 4 * np.sqrt(2 / PATHS) + bias).all()


@pytest.mark.parametrize(
    ("order", "rule", "predictor"),
    [(1, Taylor(), None), (2, ExactGaussian(), None), (1, Taylor(), Continuous())],
)
def test_designs_are_the_kalman_filter(order, rule, predictor):
    options = {} if predictor is None else {"predictor": predictor}
    filter = synthesize(SYSTEM, Memory(order), rule, INSTANTS, paths=PATHS, seed=2, **options)
    y = SYSTEM.simulate(INSTANTS, 2000, 3).measurements
    found = filter.run(INSTANTS, y).mean[:, 0]
    near, far = (np.sqrt(((found - kalman(y, late)[0]) ** 2).mean()) for late in (0.0, 0.2))
    assert near < 0.03 < far


def test_density_recursion_is_the_kalman_filter():
    axes = {"x": (-24, 24, 161), "z": (-18, 18, 289), "y": (-27, 27, 361)}
    found = grid_synthesis(SYSTEM, large_order(1), INSTANTS, nodes=0, **axes)
    _, wanted = kalman(np.zeros((4, 1, 1)))
    np.testing.assert_allclose(found.predicted.rms[:, 0] ** 2, wanted, rtol=0.015)
    assert np.abs(kalman(np.zeros((4, 1, 1)), 0.2)[1] / wanted - 1).max() > 0.02


def test_runge_kutta_forecast_of_a_linear_system():
    """Between measurements dZ/dt = A Z: Euler's run has its error of order one, the other none."""
    tacts = [0.0, 0.5]
    filter = synthesize(
        zoo.linear_gaussian(),
        Memory(1),
        Taylor(),
        tacts,
        paths=4000,
        seed=1,
        predictor=Continuous(),
    )
    drift, start = np.array([[0.0, 1.0], [-1.0, -0.4]]), filter.start
    # a first estimate: it has one free component, as the measurement
    z = start.mean[:, None] + start.moments.cross / start.moments.cov * 0.6
    fits = [*filter.node_fits[0], filter.fits[0]]
    h = 0.5 / (len(fits) - 1)
    euler, kutta = z, z
    for fit in fits[:-1]:
        euler = euler + h * drift @ fit.mean(euler)
    for j in range(0, len(fits) - 1, 2):
        one = drift @ fits[j].mean(kutta)
        two = drift @ fits[j + 1].mean(kutta + h * one)
        three = drift @ fits[j + 1].mean(kutta + h * two)
        four = drift @ fits[j + 2].mean(kutta + 2 * h * three)
        kutta = kutta + h / 3 * (one + 2 * two + 2 * three + four)
    exact = expm(0.5 * drift) @ z
    # the fits are those of simulated paths, along which Z and the state part by their noise
    assert np.abs(kutta - exact).max() < 0.02
    by_library = filter.rules.nodes(filter.node_fits[0], np.linspace(0, 0.5, len(fits)), _state(z))
    np.testing.assert_allclose(by_library[1], euler, rtol=1e-9)
    assert 1e-5 < np.abs(euler - kutta).max() < 0.01


def _state(z):
    from seedslib.designed.finite_order_rules import FiniteOrderState

    return FiniteOrderState(0, z, None, None, None, 0.0, None, True)
