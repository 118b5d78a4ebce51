"""What the filters of the library give for the arguments of a reference."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import sympy

from references.record import STEPS, wave
from seedslib.delay import DelaySystem, optimal_gains
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.filters import (
    KalmanFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.linearization import Taylor
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
    van_loan,
)
from seedslib.two_step import LinearDiffusion, TwoStepEstimator
from seedslib.two_step import kalman_bucy as filtered

x1, x2, v, w = sympy.symbols("x1 x2 v w", real=True)


def dist_values(mean, cov, prefix=""):
    n = len(mean)
    found = {f"{prefix}mean {i}": mean[i] for i in range(n)}
    return found | {f"{prefix}cov {i}{j}": cov[i, j] for i in range(n) for j in range(i + 1)}


def matrix_values(found, name):
    return {f"{name} {i}{j}": entry for (i, j), entry in np.ndenumerate(found)}


def waves(steps, m, size=1.0, offset=0.0):
    return offset + size * np.array([[wave(k, j) for j in range(m)] for k in range(steps)])


def linear(F, Q, H, R, mean0, cov0, offset, size, steps=STEPS, **options):
    made = KalmanFilter(LinearSystem(F, Q, H, R, mean0, cov0, **options))
    return made, np.arange(steps + 1.0), waves(steps + 1, len(H), size, offset)


def kalman(**told):
    made, times, record = linear(**told)
    found = made.run(times, record)
    return {**dist_values(found.mean[-1], found.cov[-1]), "loglik": found.loglik.sum()}


def smoother(**told):
    found, values = smooth(*linear(**told, steps=STEPS // 2)), {}
    for k in (0, STEPS // 4, STEPS // 2 - 1):
        values |= dist_values(found.mean[k], found.cov[k], f"step {k} ")
    return values


KINDS = {
    "extended": extended_kalman,
    "unscented": unscented_kalman,
    "cubature": cubature_kalman,
    "exact": assumed_density,
}


def nonlinear(kind, step, pull, damping, Q, R, mean0, cov0, size):
    slow = x2 - step * pull * sympy.sin(x1) - step * damping * x2
    dynamics = StochasticMap((x1, x2), [x1 + step * x2 + v, slow + w], Noise((v, w), cov=Q))
    sensor = StochasticMap((x1, x2), [sympy.sin(x1) + v], Noise((v,), cov=[[R]]))
    made = KINDS[kind](DiscreteSystem(dynamics, sensor, mean0, cov0))
    found = made.run(np.arange(STEPS + 1.0), waves(STEPS + 1, 1, size))
    return {**dist_values(found.mean[-1], found.cov[-1]), "loglik": found.loglik.sum()}


def discretisation(drift, diffusion, step):
    move, noise = van_loan(np.array(drift), np.array(diffusion), step)
    spread = dist_values([0, 0], noise, "noise ")
    return matrix_values(move, "transition") | {
        k.replace("noise cov", "noise"): c for k, c in spread.items() if "cov" in k
    }


def diffusion_system(drift, diffusion, sensor, intensity, mean0=(0.0, 0.0), cov0=None):
    cov0 = np.eye(2) if cov0 is None else cov0
    return LinearDiffusion(drift, diffusion, sensor, intensity, mean0, cov0)


def riccati(**told):
    found = diffusion_system(**told).steady_error_cov()
    return {k: c for k, c in dist_values([0, 0], found).items() if k.startswith("cov")}


def kalman_bucy(step, **told):
    times = np.arange(51) * step
    rate = waves(50, len(told["sensor"])) / 16
    found = filtered(diffusion_system(**told), times, (rate * step)[:, :, None])
    return dist_values(found.mean[-1, :, 0], found.cov[-1])


FUNCTIONS = {
    "product": x1 * x2,
    "sine": sympy.sin(x1),
    "modulus": abs(x1),
    "maximum": sympy.Max(x1, x2),
}


def two_step(time, **told):
    found = {}
    for name, f in FUNCTIONS.items():
        made = TwoStepEstimator(diffusion_system(**told), f, variables=[x1, x2])
        errors = made.errors([0.0, time])
        found |= {f"{name} optimal": errors.optimal[-1], f"{name} plugin": errors.plugin[-1]}
    return found


def designed(mean0, cov0, drift, diffusion, sensor, step, noise, memory):
    velocity = sympy.Matrix(drift) * sympy.Matrix([x1, x2])
    root = np.sqrt(diffusion).tolist()
    shown = (sympy.Matrix(sensor) * sympy.Matrix([x1, x2]))[0] + v
    system = JumpDiffusion(
        (x1, x2), list(velocity), root, [shown], Noise((v,), cov=[[noise]]), mean0, cov0
    )
    times = np.arange(13) * step
    past = Memory(memory) if memory > 0 else Memory(0, -memory)
    made = synthesize(system, past, Taylor(), times, exact_moments=True)
    found = made.run(times, waves(13, 1) / 16, covariances=True)
    return dist_values(found.mean[-1], found.cov[-1])


def delay(A, delays, C, Q, R, cov0, past):
    system = DelaySystem(dict(zip(delays, A, strict=True)), C, Q, R, cov0, past)
    gains = optimal_gains(system, 60)
    gain, innovation_cov, cov = (table[-1] for table in gains)
    dist = {k: c for k, c in dist_values(cov, cov).items() if k.startswith("cov")}
    return {
        **matrix_values(gain.reshape(-1, 1), "gain"),
        "innovation": innovation_cov[0, 0],
        **dist,
    }


def two_modes(a, q, h, r, A, p, mean0, var0, drives):
    moves = [[a[0] * x1 + v], [a[1] * x1 + w]]
    shows = [[h[0] * x1 + v], [h[1] * x1 + w]]
    dist = [(p[i], [mean0[i]], [[var0[i]]]) for i in range(2)]
    return SwitchingSystem(
        (x1,),
        moves,
        Noise((v, w), cov=np.diag(q)),
        A,
        shows,
        Noise((v, w), cov=np.diag(r)),
        dist,
        drives=drives,
    )


def switching(**told):
    made, size = SwitchingFilter(two_modes(**told), Taylor()), 1.0 if told["r"][0] > 0.01 else 2**-6
    found = made.run(np.arange(STEPS + 1.0), waves(STEPS + 1, 1, size), covariances=True)
    sides = {f"probability {i}": found.mode_prob[-1, i] for i in range(2)}
    return {**sides, "loglik": found.loglik.sum(), **dist_values(found.mean[-1], found.cov[-1])}


def fixed_mode(count, apart, r):
    told = {
        "a": [0, 0],
        "q": [0, 0],
        "h": [0, 0],
        "r": [r, r],
        "A": [[1, 0], [0, 1]],
        "p": [0.5, 0.5],
        "mean0": [0, 0],
        "var0": [1, 1],
        "drives": "old",
    }
    system = two_modes(**told)
    shows = [[v], [apart + w]]
    made = SwitchingFilter(
        SwitchingSystem(
            (x1,),
            [[x1]] * 2,
            system.noise,
            told["A"],
            shows,
            system.sensor_noise,
            [(0.5, [0.0], [[1.0]])] * 2,
        ),
        Taylor(),
    )
    record, state = waves(count, 1) / 16, made.initial()
    for k, y in enumerate(record):
        state = made.correct(made.predict(state, float(k)), y)
    first, second = state.dist.log_prob
    return {"log odds": second - first, "lesser": min(first, second)}


CALLS: dict[str, Callable[..., dict[str, Any]]] = {
    "Kalman filter": kalman,
    "diffuse Kalman filter": kalman,
    "smoother": smoother,
    "nonlinear filters": nonlinear,
    "discretisation": discretisation,
    "Riccati equation": riccati,
    "Kalman-Bucy filter": kalman_bucy,
    "two-step estimator": two_step,
    "designed filter": designed,
    "delay filter": delay,
    "switching filter": switching,
    "multiple models (IMM)": switching,
    "fixed mode": fixed_mode,
}
