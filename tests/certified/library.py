"""What the library gives for the arguments of the enclosures: for each quantity its numbers."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import sympy

from seedslib import gaussian
from seedslib.delay import DelaySystem, optimal_gains
from seedslib.designed import FiniteOrderFilter, Memory, SwitchingFilter
from seedslib.designed.accuracy import Accuracy, Design
from seedslib.designed.finite_order import Start
from seedslib.designed.predictors import Affine, AffineFit
from seedslib.filters import KalmanFilter
from seedslib.linearization import Taylor
from seedslib.linearization.moments import Moments
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap, SwitchingSystem
from seedslib.two_step import LinearDiffusion, TwoStepEstimator


def polygon(mean, cov, vertices):
    found = gaussian.polygon(mean, cov, vertices)
    return {"mass": found.mass, "mean": found.mean, "covariance": found.cov[np.tril_indices(2)]}


def bivariate_normal_cdf(h, k, rho):
    return {"probability": gaussian.bivariate_normal_cdf(h, k, rho)}


def _functions(moments, errors):
    quantities = "mean", "variance", "optimal error", "plug-in error"
    return dict(zip(quantities, (*moments, *errors), strict=True))


def sine(mean, var, error_var):
    errors = gaussian.sine_errors(mean, var, error_var)
    return _functions(gaussian.sine_moments(mean, var), errors)


def modulus(mean, var, error_var):
    errors = gaussian.abs_errors(mean, var, error_var)
    return _functions(gaussian.abs_moments(mean, var), errors)


def maximum(mean, cov, error_cov):
    errors = [gaussian.max_errors(*dist) for dist in zip(mean, cov, error_cov, strict=True)]
    moments = gaussian.max_moments(np.transpose(mean), np.moveaxis(cov, 0, -1))
    return _functions(moments, zip(*errors, strict=True))


def _errors(signal, function, variables):
    found = TwoStepEstimator(signal, function, variables=variables).steady_errors()
    return {"optimal error": found.optimal, "plug-in error": found.plugin}


def steady_power(drift, noise, sensor_noise):
    a, q, r = (float(Fraction(part)) for part in (drift, noise, sensor_noise))
    x = sympy.Symbol("x", real=True)
    return _errors(LinearDiffusion(a, q, 1, r, 0, 1), x**2, [x])


def steady_energy(drift, noise, sensor_noise, weights):
    drift, weights = (
        [[float(Fraction(part)) for part in row] for row in rows] for rows in (drift, weights)
    )
    q, r = float(Fraction(noise)), float(Fraction(sensor_noise))
    x = sympy.Matrix(sympy.symbols("x1:3", real=True))
    form = (x.T * sympy.Matrix(weights) * x)[0]
    signal = LinearDiffusion(drift, q * np.eye(2), [[0, 1]], [[r]], [0, 0], np.eye(2))
    return _errors(signal, form, list(x))


def delay_gains(dynamics, sensor_var, steps):
    matrices = {int(d): matrix for d, matrix in dynamics.items()}
    system = DelaySystem(matrices, [[1, 0]], np.eye(2), sensor_var, np.eye(2), 1.0)
    found = optimal_gains(system, steps)
    return {"gain": found.gain[1:], "variance": np.einsum("kii->ki", found.cov[1:])}


def _run(found, **more):
    variances = np.einsum("kii->ki", found.cov)
    return {"mean": found.mean, "variance": variances, "log density": found.loglik} | more


def kalman(F, Q, H, R, mean0, cov0, y):
    plant = KalmanFilter(LinearSystem(F, Q, H, R, mean0, cov0))
    return _run(plant.run(np.arange(len(y)), y))


def _maps(F, Q, H, R):
    """State, dynamics and sensor in symbols; the noises have unit variances."""
    x, w, v = sympy.symbols("x1:3"), sympy.symbols("w1:3"), sympy.Symbol("v")
    roots = np.sqrt(np.diag(Q)).tolist()
    moved = [F[i][0] * x[0] + F[i][1] * x[1] + sympy.Float(roots[i], 17) * w[i] for i in range(2)]
    seen = [H[0][0] * x[0] + H[0][1] * x[1] + sympy.sqrt(sympy.Rational(R[0][0])) * v]
    return x, w, v, moved, seen


def designed(fits, start, H, R, y):
    x, w, v, moved, seen = _maps(np.eye(2).tolist(), np.eye(2), H, R)
    mean, cov = (np.array(part) for part in start)
    system = DiscreteSystem(
        StochasticMap(x, moved, Noise(w)), StochasticMap(x, seen, Noise([v])), mean, cov
    )
    h = np.array(H)
    first = Start(mean, cov, Moments(h @ mean, cov @ h.T, h @ cov @ h.T + R))
    fits = tuple(AffineFit(*(np.array(part) for part in fit)) for fit in fits)
    times, none = np.arange(len(y)), ((),) * len(fits)
    nothing = Accuracy(times, *[np.zeros((0, 2))] * 2), Design(1, 1, 0, ())
    rules = system, Memory(1), Affine(), Taylor()
    found = FiniteOrderFilter(*rules, times, none, 2, first, fits, none, *nothing)
    return _run(found.run(times, y, covariances=True))


def imm(chain, F, Q, H, R, starts, y):
    maps = [_maps(f, q, H, R) for f, q in zip(F, Q, strict=True)]
    x, w, v, _, seen = maps[0]
    system = SwitchingSystem(
        state=x,
        noise=Noise(w),
        sensor_noise=Noise([v]),
        drives="new",
        initial=[tuple(start) for start in starts],
        dynamics=[moved for *_, moved, _ in maps],
        switching=chain,
        sensor=[seen] * len(F),
    )
    found = SwitchingFilter(system, Taylor()).run(np.arange(len(y)), y, covariances=True)
    return _run(found, probability=found.mode_prob[:, 1])


def numbers(function: str, arguments: dict[str, Any]) -> dict[str, list[float]]:
    """The numbers of each quantity, in one list."""
    found = globals()[function](**arguments)
    return {name: np.ravel(values).tolist() for name, values in found.items()}
