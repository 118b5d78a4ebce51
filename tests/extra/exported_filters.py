"""One filter of each kind that can be written as C, with a record for it.

The models depend on time (and mostly on the length of a step), start late, have unlike and
correlated components, noises with means and, where they may, inputs and jumps. The records miss
measurements as a whole and in part.
"""

import math
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import sympy

import systems
from seedslib import zoo
from seedslib.base import ELAPSED, Input, assigned
from seedslib.design import (
    Continuous,
    Polynomial,
    grid_synthesis,
    simulated_synthesis,
    stationary,
    synthesize,
)
from seedslib.designed import Memory, SwitchingFilter, finite_memory, large_order
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem
from systems import TIMES

PATHS = 6
a, b, t = sympy.symbols("a b t", real=True)
v, w = sympy.symbols("v1:3", real=True), sympy.symbols("w1:3", real=True)
z = sympy.Symbol("z", real=True)
FORCE, BIAS = Input("force"), Input("bias")


# Models


def moves(inputs=False):
    """What leaves the next state without its noise."""
    push = FORCE if inputs else sympy.cos(2 * t)
    return [a + ELAPSED * b, 0.9 * b + ELAPSED * (push - sympy.sin(a + t))]


def noises(mean=True):
    return (
        Noise(v, [0.1, -0.2] if mean else None, [[0.1, 0.03], [0.03, 0.2]]),
        Noise(w, [0.2, -0.1] if mean else None, [[0.2, 0.05], [0.05, 0.1]]),
    )


def cart(inputs=False, covered=False):
    """A cart on a spring: its range and its bearing, which turns at pi, or a bent one of both.

    If `covered`, noises enter in a bent way, so that rules with points must cover them.
    """
    move, (noise, sensor_noise) = moves(inputs), noises()
    bias = BIAS if inputs else 0
    if covered:
        move = [move[0] + sympy.exp(v[0] / 3), move[1] + v[1] * (1 + v[0]) / 2]
        shows = [a + a**2 / 9 + w[0] + bias, sympy.sin(b) + w[1] ** 2 * t / 9 + w[0]]
    else:
        move = [move[0] + v[0] / 2, move[1] + (1 + b / 4) * v[1]]
        shows = [sympy.sqrt(1 + a**2 + b**2) + w[0] + bias, sympy.atan2(b, a) + w[1] * (1 + t / 9)]
    return DiscreteSystem(
        StochasticMap((a, b), move, noise, time=t),
        StochasticMap(
            (a, b), shows, sensor_noise, time=t, period=None if covered else {1: 2 * math.pi}
        ),
        [-2.0, 0.3],
        [[0.5, 0.1], [0.1, 0.8]],
    )


def smooth(inputs=False):
    """The cart with means in closed form; inputs act in its dynamics only."""
    move = moves(inputs)
    shows = [a + a**2 / 9 + w[0], sympy.sin(b) * t / 3 + a + w[1]]
    noise, sensor_noise = noises()
    return DiscreteSystem(
        StochasticMap((a, b), [move[0] + v[0] / 2, move[1] + (1 + b / 4) * v[1]], noise, time=t),
        StochasticMap((a, b), shows, sensor_noise, time=t),
        [0.5, 0.3],
        [[0.5, 0.1], [0.1, 0.8]],
    )


def functions():
    """All functions of one number that C has, and choices."""
    s = sympy.tanh(a) / 2
    moved = [
        sympy.asin(s) + sympy.acos(s) / 3 + sympy.atan(a) / 3 + sympy.asinh(a) / 4
        + sympy.acosh(2 + s) + sympy.atanh(s) + sympy.sinh(s) + sympy.cosh(s) / 3
        + sympy.erf(a) / 2 - sympy.erfc(2 * a) / 3 + sympy.tan(s) - sympy.Abs(a) / 5,
        ELAPSED * b + sympy.sign(a) + sympy.Heaviside(b, 0.5) / 3 + sympy.Max(a, b) / 3
        - sympy.Min(a, 2) / 3 + sympy.floor(a) / 3 - sympy.ceiling(b) / 5 + sympy.cbrt(2 + s),
    ]  # fmt: skip
    shown = [
        sympy.log(2 + a**2)
        + sympy.exp(-(b**2))
        + (1 + a**2) ** -2
        + (2 + s) ** sympy.Rational(5, 2),
        sympy.Piecewise((a * b, a < 0), (b**3 / 5, a <= 1), (a, b >= -1), (b, True)),
    ]
    return DiscreteSystem(
        StochasticMap((a, b), [m + n for m, n in zip(moved, v, strict=True)], noises()[0]),
        StochasticMap((a, b), [m + n for m, n in zip(shown, w, strict=True)], noises()[1]),
        [0.3, -0.2],
        [[1.0, 0.2], [0.2, 0.7]],
    )


def kicked(inputs=False):
    """A driven oscillator in continuous time that is kicked, the oftener the farther it is out."""
    push = FORCE if inputs else sympy.cos(2 * t)
    return JumpDiffusion(
        (a, b),
        [b, push - a - a**3 / 5 - b * t / 9],
        [[0.2, 0.1 * t], [0, 0.3 + a**2 / 9]],
        [a + t * b / 9 + w[0] + (BIAS if inputs else 0), a * b / 3 + b + w[1]],
        noises()[1],
        [0.5, 0.2],
        [[0.3, 0.1], [0.1, 0.4]],
        intensity=0.3 + a**2 / 5,
        jump=[-a / 5, z * (1 + t / 9)],
        marks=Noise((z,), [0.3], [[0.2]]),
        time=t,
        step=0.1,
    )


def tide():
    """A number driven with the period 2, seen by two sensors of the same period."""
    turn = sympy.sin(sympy.pi * t)
    return JumpDiffusion(
        (a,), [-a + sympy.cos(sympy.pi * t)], [[0.5]],
        [(2 + turn) * a + w[0], a - turn * a**2 / 9 + w[1]], noises()[1], [0.0], [[1.0]],
        time=t, step=0.1,
    )  # fmt: skip


def driven(drives, told=True):
    """Two modes; the state moves the switch and the indicator, and the bearing turns at pi."""
    far = sympy.exp(-((a - 1) ** 2) / 4)
    leave = far * (1 + sympy.sin(t)) / 4
    return SwitchingSystem(
        (a,), [[0.9 * a + v[0]], [0.3 * a + ELAPSED + v[0] / 2]], Noise(v[:1], [0.1], [[0.8]]),
        [[1 - leave, leave], [0.4, 0.6]],
        [[a + w[0], a * t / 3 + w[1]], [a / 2 + w[0], 2 * a + w[1]]], noises()[1],
        [(0.6, [0.0], [[1.0]]), (0.4, [1.0], [[0.7]])], drives=drives, time=t, period={0: 6.0},
        indicator=[[1 - far / 2, far / 2], [far / 3, 1 - far / 3]] if told else None,
    )  # fmt: skip


def shrinking():
    """Modes without noise, whose indicator the state moves, so that forecasts are split by it."""
    far = sympy.exp(-((a - 1) ** 2) / 4)
    return SwitchingSystem(
        (a,), [[a / 2 + sympy.sin(t)], [-0.7 * a]], Noise(()), [[0.9, 0.1], [0.3, 0.7]],
        [[a + w[0]], [a / 2 + w[0]]], Noise(w[:1]), [(0.6, [0.0], [[1.0]]), (0.4, [1.0], [[2.0]])],
        time=t, indicator=[[1 - far / 2, far / 2], [far / 3, 1 - far / 3]],
    )  # fmt: skip


# Filters


def design(system, memory, rule, times=TIMES, **options):
    return synthesize(
        system, memory, rule, times, **{"paths": 500, "seed": 1, "nodes": 1, **options}
    )


def lasting(filter, **options):
    return stationary(filter, **{"tolerance": 9.0, "paths": 50, **options})


def schedule():
    """The second component is read at every other time, and the first not at the beginning."""
    mask = np.ones((7, 2), dtype=bool)
    mask[::2, 1] = mask[0, 0] = False
    return mask


def tables(memory, count=4, nodes=2):
    return grid_synthesis(
        zoo.flip_process(), memory, 0.25 * np.arange(float(count)), x=(-3.5, 3.5, 61),
        z=(-2.5, 2.5, 9), y=(-8, 8, 25), nodes=nodes,
    )  # fmt: skip


def mode_tables(system, memory, **options):
    return simulated_synthesis(
        system, memory, np.arange(6.0), y=(-12, 12, 9), z=[(-8, 8, 7)] * system.state_size,
        paths=2000, seed=1, nodes=0, **options,
    )  # fmt: skip


CARRIED = {
    "Kalman, inputs": lambda: KalmanFilter(systems.linear_system()),
    "Kalman": lambda: KalmanFilter(systems.linear_system(inputs=False)),
    "extended": lambda: extended_kalman(cart()),
    "extended, inputs": lambda: extended_kalman(cart(inputs=True)),
    "assumed density": lambda: assumed_density(smooth()),
    "unscented": lambda: unscented_kalman(cart(), alpha=0.6, beta=2.0, kappa=1.0),
    "unscented, all functions": lambda: unscented_kalman(functions()),
    "cubature, covered noise": lambda: cubature_kalman(cart(covered=True)),
    "Gauss-Hermite, covered noise, inputs": lambda: CovarianceFilter(
        cart(inputs=True, covered=True), GaussHermite(3)
    ),
    "Gauss-Hermite, loops": lambda: CovarianceFilter(cart(), GaussHermite(9)),
    "Gauss-Hermite, loops, inputs": lambda: CovarianceFilter(cart(inputs=True), GaussHermite(9)),
    "extended, continuous": lambda: extended_kalman(kicked()),
    "assumed density, Euler, inputs": lambda: assumed_density(
        kicked(inputs=True), integrator="euler", step=0.02
    ),
    "assumed density, Runge-Kutta": lambda: assumed_density(kicked(), step=0.07),
    "unscented, continuous, inputs": lambda: unscented_kalman(kicked(inputs=True)),
    "cubature, Euler": lambda: cubature_kalman(kicked(), integrator="euler", step=0.03),
}
DESIGNED = {
    "affine": lambda: design(kicked(), Memory(2, 1), ExactGaussian(), nodes=2),
    "affine, part of the state": lambda: design(
        kicked(), finite_memory(2), Taylor(), components=1, horizon=5.1
    ).forecasting("piecewise constant"),
    "affine, inputs": lambda: design(
        smooth(inputs=True), Memory(1), Taylor(), inputs={FORCE: systems.INPUTS[systems.U]}
    ),
    "affine, points": lambda: design(
        kicked(), Memory(2), Unscented(), measured_nodes=True
    ).forecasting("constant"),
    "affine, many points": lambda: design(cart(), Memory(1), GaussHermite(9)),
    "polynomial": lambda: design(kicked(), Memory(1), Taylor(), predictor=Polynomial(3, 2)),
    "polynomial means": lambda: design(
        kicked(), Memory(2, 1), Taylor(), predictor=Polynomial(2, 0)
    ),
    "continuous": lambda: design(
        kicked(), Memory(1), ExactGaussian(), predictor=Continuous(), horizon=5.1
    ),
    "continuous, points": lambda: design(kicked(), Memory(1), Cubature(), predictor=Continuous()),
    "schedule": lambda: design(cart(), Memory(1, 1), Taylor(), measured=schedule()),
    "classes": lambda: design(kicked(), Memory(1), Taylor(), availability=[0.7, 1.0]),
    "schedule and classes": lambda: design(
        smooth(), Memory(2), Taylor(), measured=schedule(), availability=[0.7, 0.8],
        measured_nodes=True,
    ),
    "stationary": lambda: lasting(
        design(tide(), Memory(2), Taylor(), 0.5 * np.arange(13.0)), cycle=4
    ),
    "stationary, short": lambda: lasting(
        design(tide(), Memory(1, 1), Taylor(), 0.5 * np.arange(13.0), availability=[0.8, 1.0]),
        cycle=4, transient=3,
    ),
    "stationary, continuous": lambda: lasting(
        design(tide(), Memory(1), Taylor(), 0.5 * np.arange(13.0), predictor=Continuous()), cycle=4
    ),
    "table": lambda: tables(large_order(2)),
    "table of measurements": lambda: tables(finite_memory(1)),
    "stationary table": lambda: lasting(tables(large_order(1), 8, nodes=1), tolerance=1.0),
}  # fmt: skip
MODES = {
    "IMM, old mode": lambda: SwitchingFilter(systems.switching_system(inputs=False), Taylor()),
    "IMM, new mode": lambda: SwitchingFilter(
        systems.switching_system("new", inputs=False), Taylor()
    ),
    "IMM, no indicator": lambda: SwitchingFilter(driven("old", told=False), ExactGaussian()),
    "IMM, old mode, moved by the state": lambda: SwitchingFilter(
        driven("old"), Taylor(), split=False
    ),
    "IMM, old mode, split": lambda: SwitchingFilter(shrinking(), Taylor()),
    "IMM, new mode, moved by the state": lambda: SwitchingFilter(
        driven("new"), Taylor(), split=False
    ),
    "modes and measurements": lambda: design(driven("old"), Memory(1, 2), Taylor(), split=False),
    "modes and log-odds": lambda: design(
        driven("new"), Memory(2, 0, 1, log_odds=True), Taylor(), split=False
    ),
    "modes of measurements": lambda: design(
        systems.switching_system(inputs=False, indicator=False), finite_memory(2), Taylor(),
        paths=2000,
    ),
    "modes on a schedule": lambda: design(
        driven("old"), Memory(1), Taylor(), split=False,
        measured=np.column_stack([schedule(), np.arange(7) % 3 > 0]),
    ),
    "stationary modes": lambda: lasting(
        design(zoo.scalar_switching(), large_order(2), Taylor(), np.arange(12.0)), cycle=2
    ),
    "table of modes": lambda: mode_tables(
        zoo.scalar_switching(), large_order(1), probabilities=True
    ),
    "table with indicator": lambda: mode_tables(zoo.manoeuvring_target(), large_order(1)),
    "table of indicators": lambda: mode_tables(zoo.manoeuvring_target(), Memory(1, 0, 1)),
}  # fmt: skip
FILTERS = CARRIED | DESIGNED | MODES


# Records


@dataclass
class Case:
    """A filter, records (K+1, m, N) with gaps, indicators (K+1, N) and inputs (K+1, N)."""

    filter: Any
    times: np.ndarray
    y: np.ndarray
    indicators: np.ndarray | None
    inputs: dict[Any, np.ndarray]

    @property
    def carried(self):
        """Whether the filter carries mean and covariance."""
        return isinstance(self.filter, CovarianceFilter)

    @property
    def designed(self):
        """Whether the filter is known at certain times only."""
        return getattr(self.filter, "memory", None) is not None

    @property
    def modes(self):
        return getattr(self.filter.system, "modes", 0)

    def later(self, k):
        """Times after measurement k that the filter can forecast to, up to the next measurement."""
        filter = self.filter
        if self.modes:
            return np.array([])
        if self.carried:
            return self.times[k] + np.array([0.0, 0.35, 1.1])
        served = filter.served(k)
        nodes = list(filter.node_times[served]) if served < len(filter.node_times) else []
        start = filter.times[served]
        last = served + 1 == len(filter.times)
        end = (nodes or [start])[-1] if last else filter.times[served + 1]
        found = np.array([start, *nodes, 0.3 * start + 0.7 * end, end])
        return self.times[k] - start + found

    def at(self, k, i=0):
        """The inputs at measurement k of a record, as a context."""
        return assigned({p: values[k, i] for p, values in self.inputs.items()})


@lru_cache
def case(name):
    """A kind of filter and its records, made once."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        filter = FILTERS[name]()
    rng = np.random.default_rng(len(name))
    system, memory = filter.system, getattr(filter, "memory", None)
    times = 1.0 * np.arange(7) if name == "IMM, old mode, split" else TIMES
    if memory is not None:
        count = 30 if filter.cycle else len(filter.times)
        times = np.array([filter.clock.moment(k, filter.cycle) for k in range(count)])
    inputs = {}
    if name.endswith("inputs"):
        told = systems.INPUTS if "Kalman" in name else (FORCE, BIAS)
        inputs = {p: rng.normal(size=(len(times), PATHS)) for p in told}
    if name == "affine, inputs":  # those of the design
        inputs = {FORCE: np.tile(systems.INPUTS[systems.U][:, None], PATHS)}
    data = system.simulate(times, PATHS, 3, **({"inputs": inputs} if inputs else {}))
    y, indicators = data.measurements.copy(), data.indicators
    whole = memory is not None and "table" in name
    if not (whole and memory.measurements):
        lost = rng.random(y.shape) < (0.0 if whole else 0.2)
        lost |= (rng.random((len(y), 1, PATHS)) < 0.15) & (np.arange(PATHS) > 0)
        lost[2, :, 0] = True
        y[lost] = np.nan
    if indicators is not None and not (memory and memory.indicators):
        indicators = np.where(rng.random(indicators.shape) < 0.2, -1, indicators)
    mask = None if memory is None else getattr(filter, "measured", None)
    if mask is not None:
        y[~mask[:, : y.shape[1]]] = np.nan
        if indicators is not None:
            indicators = np.where(mask[:, -1:], indicators, -1)
    if whole:
        y[1, 0, 1] = 99.0  # beyond the ends of a table
    return Case(filter, times, y, indicators, inputs)
