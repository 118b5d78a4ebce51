"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest
import sympy as sp

from oracles.diffusion import constant_diffusion
from seedslib.gaussian import NoClosedForm, gauss_hermite
from seedslib.two_step import (
    AugmentedDiffusion,
    KalmanBucyFilter,
    LinearDiffusion,
    TwoStepEstimator,
    augmented_extended_kalman,
)

X, Y, Z = sp.symbols("x y z", real=True)
NAN, EYE, ZERO = np.nan, np.eye(2), np.zeros((2, 2))
PLANAR, SIGNAL = constant_diffusion(), LinearDiffusion(-1, 0.5, 1, 0.1, [0], 4)
KALMAN, POWER = KalmanBucyFilter(PLANAR), TwoStepEstimator(SIGNAL, X**2, variables=[X])
AUGMENTED, TABLE = AugmentedDiffusion(SIGNAL, X**2, [X], Z), POWER.table([0.0, 0.1])
GROWING = KalmanBucyFilter(constant_diffusion(drift=EYE))
TIMES = np.linspace(0, 1, 11)
PARTLY = np.zeros((10, 2, 3))
PARTLY[4, 1, 2] = NAN


def system(**changes):
    return lambda: constant_diffusion(**changes)


def steady(**changes):
    return lambda: KalmanBucyFilter(constant_diffusion(**changes)).steady_error_cov()


def estimator(f, variables=(X,), **options):
    return lambda: TwoStepEstimator(SIGNAL, f, variables=list(variables), **options)


def augmented(*args, **options):
    return lambda: AugmentedDiffusion(SIGNAL, *args, **options)


REFUSALS = [
    (system(drift=np.eye(3)), ValueError, "drift"),
    (system(drift=[[1j, 0], [0, 1]]), TypeError, "drift"),
    (system(drift=lambda t: np.eye(3)), ValueError, "drift"),
    (system(noise_intensity=-EYE), ValueError, "noise_intensity"),
    (system(noise_intensity=[[1.0]]), ValueError, "noise_intensity"),
    (system(noise_input=np.eye(3)), ValueError, "noise_input"),
    (system(sensor=[[1.0, 2.0, 3.0]]), ValueError, "sensor"),
    (system(sensor=np.zeros((0, 2)), sensor_intensity=np.zeros((0, 0))), ValueError, "sensor"),
    (system(sensor_intensity=ZERO), ValueError, "sensor_intensity"),
    (system(sensor_intensity=np.eye(3)), ValueError, "sensor_intensity"),
    (system(mean0=[0.0, 0.0, 0.0]), ValueError, "mean0"),
    (system(mean0=[], cov0=np.zeros((0, 0))), ValueError, "mean0"),
    (system(cov0=[[1, 2], [2, 1]]), ValueError, "cov0"),
    (lambda: PLANAR.transition(1.0, 0.5), ValueError, "start, stop"),
    (lambda: PLANAR.simulate([1.0, 0.5], 3, 0), ValueError, "times"),
    (lambda: PLANAR.simulate(TIMES, 0, 0), ValueError, "paths"),
    (lambda: PLANAR.simulate(TIMES, 2, None), TypeError, "seed"),
    (lambda: constant_diffusion(drift=EYE).simulate([0.0, 500.0], 2, 0), ValueError, "times"),
    (lambda: KalmanBucyFilter("no system"), TypeError, "system"),
    (lambda: KALMAN.moments([]), ValueError, "times"),
    (lambda: KALMAN.moments(TIMES, lead=-1.0), ValueError, "lead"),
    (lambda: GROWING.moments([0, 500]), ValueError, "times"),
    (lambda: KALMAN.predict([1.0], EYE, 0, 1), ValueError, "mean"),
    (lambda: KALMAN.predict([1.0, 0.0], -EYE, 0, 1), ValueError, "cov"),
    (lambda: KALMAN.run(TIMES, np.zeros((9, 2))), ValueError, "increments"),
    (lambda: KALMAN.run(TIMES, PARTLY), ValueError, "increments"),
    (lambda: KALMAN.run([0.0, 9.0], np.zeros((1, 2))), ValueError, "times"),
    (lambda: KALMAN.design(TIMES, np.ones((9, 2), bool)), ValueError, "seen"),
    (lambda: KALMAN.smoothed_moments([0, 1], lag=0), ValueError, "lag"),
    (steady(drift=lambda t: EYE), ValueError, "steady_error_cov"),
    (steady(drift=[[0.1, 0.0], [0.0, -1.0]], sensor=[[0, 1], [0, 2]]), ValueError, "system"),
    (steady(drift=[[0, 1.0], [-1, 0]], noise_intensity=ZERO), ValueError, "system"),
    (lambda: GROWING.steady_moments(), ValueError, "drift"),
    (lambda: TwoStepEstimator("signal", X, variables=[X]), TypeError, "system"),
    (lambda: TwoStepEstimator(SIGNAL, X), ValueError, "variables"),
    (estimator(X, (X, Y)), ValueError, "variables"),
    (estimator(X, estimate_variables=[Y, Z]), ValueError, "estimate_variables"),
    (estimator(X * Y), ValueError, "f"),
    (estimator(sp.gamma(X)), NoClosedForm, ""),
    (estimator(lambda p: p[0]), TypeError, "f"),
    (estimator(X, quadrature=5), TypeError, "quadrature"),
    (estimator(X, quadrature=gauss_hermite(2, 5)), ValueError, "quadrature"),
    (estimator(X, lead=-1.0), ValueError, "lead"),
    (lambda: estimator(sp.log(X), quadrature=gauss_hermite(1, 5))().errors([0]), ValueError, "f"),
    (estimator(lambda p: np.ones(3), (X,), quadrature=gauss_hermite(1, 5)), ValueError, "f"),
    (lambda: estimator(sp.exp(X**2))().errors([0.0]), ValueError, ""),
    (lambda: POWER.estimate([0.0, 1.0], EYE), ValueError, "mean"),
    (lambda: POWER.estimate([0.0], [[-1.0]]), ValueError, "cov"),
    (lambda: POWER.plugin([1e200]), ValueError, "mean"),
    (lambda: POWER.run([0.0, 0.1], np.full((1, 1), 1e200)), ValueError, "mean"),
    (lambda: POWER.errors([]), ValueError, "times"),
    (lambda: estimator(X, lead=0.5)().smooth([0, 0.1], np.zeros((1, 1))), ValueError, "lead"),
    (lambda: estimator(X, lead=0.5)().smoothed_errors([0, 0.1]), ValueError, "lead"),
    (lambda: TABLE.update(1, [0.0], [0.0]), ValueError, "k"),
    (lambda: TABLE.update(0, [0.0], [0.0, 1.0]), ValueError, "increment"),
    (lambda: TABLE.estimate(2, [0.0]), ValueError, "k"),
    (lambda: TABLE.estimate(1, [1e200]), ValueError, "mean"),
    (lambda: AugmentedDiffusion(constant_diffusion(drift=lambda t: EYE), X, [X, Y], Z), ValueError,
     "system"),
    (augmented(X, [X, Y], Z), ValueError, "variables"),
    (augmented(X, [X], X), ValueError, ".*symbol"),
    (augmented(X * Y, [X], Z), ValueError, "f"),
    (augmented(sp.Abs(X), [X], Z), ValueError, "f"),
    (augmented(X**2, [X], Z, drift=-2 * Z), ValueError, "drift"),
    (augmented(X**2, [X], Z, drift=Y), ValueError, "drift"),
    (lambda: augmented(sp.sin(X), [X], Z)().rewritten(), ValueError, "f"),
    (lambda: augmented_extended_kalman(AUGMENTED, [0.1, 0.2], PARTLY), ValueError, "times"),
    (lambda: augmented_extended_kalman(AUGMENTED, [0.0, 0.2], ZERO), ValueError, "increments"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()
