"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest
import sympy as sp

from oracles.diffusion import constant_diffusion
from seedslib.gaussian import NoClosedForm
from seedslib.two_step import LinearDiffusion, TwoStepEstimator, kalman_bucy, kalman_bucy_gains

X, Y, Z = sp.symbols("x y z", real=True)
NAN, EYE, ZERO = np.nan, np.eye(2), np.zeros((2, 2))
PLANAR, SIGNAL = constant_diffusion(), LinearDiffusion(-1, 0.5, 1, 0.1, [0], 4)
POWER, GROWING = TwoStepEstimator(SIGNAL, X**2, variables=[X]), constant_diffusion(drift=EYE)
TIMES = np.linspace(0, 1, 11)
PARTLY = np.zeros((10, 2, 3))
PARTLY[4, 1, 2] = NAN


def system(**changes):
    return lambda: constant_diffusion(**changes)


def steady(**changes):
    return lambda: constant_diffusion(**changes).steady_error_cov()


def estimator(f, variables=(X,), **options):
    return lambda: TwoStepEstimator(SIGNAL, f, variables=list(variables), **options)


REFUSALS = [
    (system(drift=np.eye(3)), ValueError, "drift"),
    (system(drift=[[1j, 0], [0, 1]]), TypeError, "drift"),
    (system(noise_intensity=-EYE), ValueError, "noise_intensity"),
    (system(noise_intensity=[[1.0]]), ValueError, "noise_intensity"),
    (system(noise_input=np.eye(3)), ValueError, "noise_input"),
    (system(sensor=[[1.0, 2.0, 3.0]]), ValueError, "sensor"),
    (system(sensor_intensity=ZERO), ValueError, "sensor_intensity"),
    (system(sensor_intensity=np.eye(3)), ValueError, "sensor_intensity"),
    (system(mean0=[0.0, 0.0, 0.0]), ValueError, "mean0"),
    (system(cov0=[[1, 2], [2, 1]]), ValueError, "cov0"),
    (lambda: PLANAR.simulate([1.0, 0.5], 3, 0), ValueError, "times"),
    (lambda: PLANAR.simulate(TIMES, 0, 0), ValueError, "paths"),
    (lambda: PLANAR.simulate(TIMES, 2, None), TypeError, "seed"),
    (lambda: constant_diffusion(drift=EYE).simulate([0.0, 500.0], 2, 0), ValueError, "times"),
    (lambda: PLANAR.moments([]), ValueError, "times"),
    (lambda: GROWING.moments([0, 500]), ValueError, "times"),
    (lambda: kalman_bucy(PLANAR, TIMES, np.zeros((9, 2))), ValueError, "increments"),
    (lambda: kalman_bucy(PLANAR, TIMES, PARTLY), ValueError, "increments"),
    (lambda: kalman_bucy(PLANAR, [0.0, 9.0], np.zeros((1, 2))), ValueError, "times"),
    (lambda: kalman_bucy_gains(PLANAR, TIMES, np.ones((9, 2))), ValueError, "observed"),
    (steady(drift=[[0.1, 0.0], [0.0, -1.0]], sensor=[[0, 1], [0, 2]]), ValueError, "system"),
    (steady(drift=[[0, 1.0], [-1, 0]], noise_intensity=ZERO), ValueError, "system"),
    (lambda: GROWING.steady_moments(), ValueError, "drift"),
    (estimator(X, (X, Y)), ValueError, "variables"),
    (estimator(X, estimate_variables=[Y, Z]), ValueError, "estimate_variables"),
    (estimator(X * Y), ValueError, "f"),
    (estimator(sp.gamma(X)), NoClosedForm, ""),
    (lambda: estimator(sp.exp(X**2))().errors([0.0]), ValueError, ""),
    (lambda: POWER.estimate([0.0, 1.0], EYE), ValueError, "mean"),
    (lambda: POWER.estimate([0.0], [[-1.0]]), ValueError, "cov"),
    (lambda: POWER.plugin([1e200]), ValueError, "mean"),
    (lambda: POWER.run([0.0, 0.1], np.full((1, 1), 1e200)), ValueError, "mean"),
    (lambda: POWER.errors([]), ValueError, "times"),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()
