"""One filter of each kind that can be written as C, with a record for it.

The models depend on time (and mostly on the length of a step), start late, have unlike and
correlated components, noises with means and, where they may, inputs and jumps. The records miss
measurements as a whole and in part.
"""

import math
import warnings
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
import sympy

import systems
from seedslib import zoo
from seedslib.base import ELAPSED, Input
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
NOISE = Noise(v, [0.1, -0.2], [[0.1, 0.03], [0.03, 0.2]])
COV = [[0.5, 0.1], [0.1, 0.8]]
SENSOR_NOISE = Noise(w, [0.2, -0.1], [[0.2, 0.05], [0.05, 0.1]])


# Models


def cart(shows="bearing", inputs=False):
    """A cart on a spring: its range and its bearing, which turns at pi.

    Or a sensor that is "smooth", with means in closed form and without inputs, or noises that enter
    in a bent way in both maps, which rules with points must have "covered".
    """
    push, bias = (FORCE, BIAS) if inputs else (sympy.cos(2 * t), 0)
    move = [a + ELAPSED * b, 0.9 * b + ELAPSED * (push - sympy.sin(a + t))]
    spread, period = [v[0] / 2, (1 + b / 4) * v[1]], None
    if shows == "bearing":
        shown = [sympy.sqrt(1 + a**2 + b**2) + w[0] + bias, sympy.atan2(b, a) + w[1] * (1 + t / 9)]
        period = {1: 2 * math.pi}
    elif shows == "smooth":
        shown = [a + a**2 / 9 + w[0], sympy.sin(b) * t / 3 + a + w[1]]
    else:
        spread = [sympy.exp(v[0] / 3), v[1] * (1 + v[0]) / 2]
        shown = [a + a**2 / 9 + w[0] + bias, sympy.sin(b) + w[1] ** 2 * t / 9 + w[0]]
    move = [part + noise for part, noise in zip(move, spread, strict=True)]
    dynamics = StochasticMap((a, b), move, NOISE, time=t)
    sensor = StochasticMap((a, b), shown, SENSOR_NOISE, time=t, period=period)
    return DiscreteSystem(dynamics, sensor, [-2.0, 0.3], COV)


def functions():
    """All functions of one number that C has, and choices."""
    s, inside = sympy.tanh(a) / 2, (sympy.asin, sympy.acos, sympy.atanh, sympy.sinh, sympy.tan)
    anywhere = (sympy.atan, sympy.asinh, sympy.erf, sympy.erfc, sympy.Abs, sympy.sign, sympy.floor)
    moved = [
        sum(f(s) / (k + 2) for k, f in enumerate(inside)) + sympy.acosh(2 + s) + sympy.cosh(s),
        ELAPSED * b + sum(f(a) / (k + 2) for k, f in enumerate(anywhere)) - sympy.ceiling(b) / 5,
    ]
    shown = [
        sympy.log(2 + a**2) + sympy.exp(-(b**2)) + (1 + a**2) ** -2 + sympy.cbrt(2 + s),
        sympy.Piecewise((a * b, a < 0), (b**3 / 5, a <= 1), (a, b >= -1), (b, True))
        + (2 + s) ** 2.5
        + sympy.Heaviside(b, 0.5) / 3
        + sympy.Max(a, b) / 3
        - sympy.Min(a, 2) / 3,
    ]
    dynamics = StochasticMap((a, b), [moved[0] + v[0], moved[1] + v[1]], NOISE)
    sensor = StochasticMap((a, b), [shown[0] + w[0], shown[1] + w[1]], SENSOR_NOISE)
    return DiscreteSystem(dynamics, sensor, [0.3, -0.2], COV)


def kicked(inputs=False):
    """A driven oscillator in continuous time that is kicked, the more often the farther it is
    out."""
    push, bias = (FORCE, BIAS) if inputs else (sympy.cos(2 * t), 0)
    drift, diffusion = [b, push - a - a**3 / 5 - b * t / 9], [[0.2, 0.1 * t], [0, 0.3 + a**2 / 9]]
    shown = [a + t * b / 9 + w[0] + bias, a * b / 3 + b + w[1]]
    jumps = {"intensity": 0.3 + a**2 / 5, "jump": [-a / 5, z * (1 + t / 9)]}
    jumps["marks"] = Noise((z,), [0.3], [[0.2]])
    options = {"time": t, "step": 0.1, **jumps}
    return JumpDiffusion((a, b), drift, diffusion, shown, SENSOR_NOISE, [0.5, 0.2], COV, **options)


def tide():
    """A number driven with the period 2, seen by two sensors of the same period."""
    turn, drift, options = sympy.sin(sympy.pi * t), [-a + sympy.cos(sympy.pi * t)], {"time": t}
    shown = [(2 + turn) * a + w[0], a - turn * a**2 / 9 + w[1]]
    return JumpDiffusion((a,), drift, [[0.5]], shown, SENSOR_NOISE, [0], [[1]], step=0.1, **options)


INITIAL = [(0.6, [0.0], [[1.0]]), (0.4, [1.0], [[0.7]])]
FAR = sympy.exp(-((a - 1) ** 2) / 4)
INDICATOR = [[1 - FAR / 2, FAR / 2], [FAR / 3, 1 - FAR / 3]]


def driven(drives, told=True):
    """Two modes; the state moves the switch and the indicator, and the bearing turns at three."""
    leave = FAR * (1 + sympy.sin(t)) / 4
    moves = [[0.9 * a + v[0]], [0.3 * a + ELAPSED + v[0] / 2]], Noise(v[:1], [0.1], [[0.8]])
    switch = [[1 - leave, leave], [0.4, 0.6]]
    shows = [[a + w[0], a * t / 3 + w[1]], [a / 2 + w[0], 2 * a + w[1]]], SENSOR_NOISE
    options = {"drives": drives, "time": t, "period": {0: 6.0}}
    options["indicator"] = INDICATOR if told else None
    return SwitchingSystem((a,), *moves, switch, *shows, INITIAL, **options)


def shrinking():
    """Modes without noise, so that forecasts are split by the indicator in closed form."""
    moves, shows = [[a / 2 + sympy.sin(t)], [-0.7 * a]], [[a + w[0]], [a / 2 + w[0]]]
    switch, options = [[0.9, 0.1], [0.3, 0.7]], {"time": t, "indicator": INDICATOR}
    noises = Noise(()), Noise(w[:1])
    return SwitchingSystem((a,), moves, noises[0], switch, shows, noises[1], INITIAL, **options)


# Filters


def design(system, memory, rule, *, lasting=None, **options):
    """A designed filter, without an end where it is said how to make it so."""
    options = {"times": TIMES, "paths": 500, "seed": 1, "nodes": 1, **options}
    found = synthesize(system, memory, rule, options.pop("times"), **options)
    if lasting is not None:
        found = stationary(found, **{"tolerance": 9.0, "paths": 50, **lasting})
    return found


def tables(system, memory, *, steps=4, lasting=None):
    axes = {"x": (-3.5, 3.5, 61), "z": (-2.5, 2.5, 9), "y": (-8, 8, 25)}
    found = grid_synthesis(system, memory, 0.25 * np.arange(steps), **axes)
    return found if lasting is None else stationary(found, paths=50, **lasting)


def mode_tables(system, memory, **options):
    axes = {"y": (-12, 12, 9), "z": [(-8, 8, 7)] * system.state_size}
    options = {"paths": 2000, "seed": 1, **options, **axes}
    return simulated_synthesis(system, memory, np.arange(6.0), **options)


def schedule(columns=2):
    """The second component is read at every other time, and the first not at the beginning."""
    mask = np.ones((7, columns), dtype=bool)
    mask[::2, 1] = mask[0, 0] = mask[::3, 2:] = False
    return mask


EULER, CONTINUOUS = {"integrator": "euler", "step": 0.03}, {"predictor": Continuous()}
ENDLESS = {"times": 0.5 * np.arange(13.0), "lasting": {"cycle": 4}}
SHORT = ENDLESS | {"lasting": {"cycle": 4, "transient": 3}}
PART = {"components": 1}
SCHEDULE = {"measured": schedule()}
LASTING_TABLE = {"steps": 8, "lasting": {"tolerance": 1.0}}
LASTING_MODES = {"times": np.arange(12.0), "lasting": {"cycle": 2}}
old, new = partial(driven, "old"), partial(driven, "new")
linear, bent = partial(systems.linear_system, inputs=False), partial(cart, "covered")
jumping = partial(systems.switching_system, inputs=False)
unmarked = partial(jumping, indicator=False)

FILTERS = {
    "Kalman, inputs": (KalmanFilter, systems.linear_system, {}),
    "Kalman": (KalmanFilter, linear, {}),
    "extended": (extended_kalman, cart, {}),
    "extended, inputs": (extended_kalman, cart, {}),
    "assumed density": (assumed_density, partial(cart, "smooth"), {}),
    "unscented": (unscented_kalman, cart, {"alpha": 0.6, "beta": 2.0, "kappa": 1.0}),
    "unscented, all functions": (unscented_kalman, functions, {}),
    "cubature, covered noise": (cubature_kalman, bent, {}),
    "Gauss-Hermite, covered noise, inputs": (CovarianceFilter, bent, GaussHermite(3), {}),
    "Gauss-Hermite, loops": (CovarianceFilter, cart, GaussHermite(9), {}),
    "Gauss-Hermite, loops, inputs": (CovarianceFilter, cart, GaussHermite(9), {}),
    "extended, continuous": (extended_kalman, kicked, {}),
    "assumed density, Euler, inputs": (assumed_density, kicked, EULER),
    "assumed density, Runge-Kutta": (assumed_density, kicked, {"step": 0.07}),
    "unscented, continuous, inputs": (unscented_kalman, kicked, {}),
    "cubature, Euler": (cubature_kalman, kicked, EULER),
    # designed
    "affine": (design, kicked, Memory(2, 1), ExactGaussian(), {"nodes": 2}),
    "affine, part of the state": (design, kicked, finite_memory(2), Taylor(), PART),
    "affine, points": (design, kicked, Memory(2), Unscented(), {}),
    "affine, many points": (design, cart, Memory(1), GaussHermite(9), {}),
    "polynomial": (design, kicked, Memory(1), Taylor(), {"predictor": Polynomial(3, 2)}),
    "polynomial means": (design, kicked, Memory(2, 1), Taylor(), {"predictor": Polynomial(2, 0)}),
    "continuous": (design, kicked, Memory(1), ExactGaussian(), CONTINUOUS),
    "continuous, points": (design, kicked, Memory(1), Cubature(), CONTINUOUS),
    "schedule": (design, cart, Memory(1, 1), Taylor(), SCHEDULE),
    "stationary": (design, tide, Memory(2), Taylor(), ENDLESS),
    "stationary, short": (design, tide, Memory(1, 1), Taylor(), SHORT),
    "stationary, continuous": (design, tide, Memory(1), Taylor(), ENDLESS | CONTINUOUS),
    "table": (tables, zoo.flip_process, large_order(2), {}),
    "table of measurements": (tables, zoo.flip_process, finite_memory(1), {}),
    "stationary table": (tables, zoo.flip_process, large_order(1), LASTING_TABLE),
    # with modes
    "IMM, old mode": (SwitchingFilter, jumping, Taylor(), {}),
    "IMM, new mode": (SwitchingFilter, partial(jumping, "new"), Taylor(), {}),
    "IMM, no indicator": (SwitchingFilter, partial(old, told=False), ExactGaussian(), {}),
    "IMM, old mode, moved by the state": (SwitchingFilter, old, Taylor(), {}),
    "IMM, new mode, moved by the state": (SwitchingFilter, new, Taylor(), {}),
    "IMM, old mode, split": (SwitchingFilter, shrinking, Taylor(), {}),
    "modes and measurements": (design, old, Memory(1, 2), Taylor(), {}),
    "modes and log-odds": (design, new, Memory(2, 0, 2, log_odds=True), Taylor(), {}),
    "modes of measurements": (design, unmarked, finite_memory(2), Taylor(), {"paths": 2000}),
    "stationary modes": (design, old, large_order(2), Taylor(), LASTING_MODES),
    "table of modes": (mode_tables, zoo.scalar_switching, large_order(1), {}),
    "table with indicator": (mode_tables, zoo.manoeuvring_target, large_order(1), {}),
    "table of indicators": (mode_tables, zoo.manoeuvring_target, Memory(1, 0, 1), {}),
}
"""By name: what makes it, its system, further arguments, options."""


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

    def at(self, k, i=0):
        """The inputs at measurement k of a record."""
        return {p: values[k, i] for p, values in self.inputs.items()}


@lru_cache
def case(name):
    """A kind of filter and its records, made once."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        make, system, *more, options = FILTERS[name]
        filter = make(
            system(inputs=True) if name.endswith("inputs") else system(), *more, **options
        )
    rng = np.random.default_rng(len(name))
    system, memory = filter.system, getattr(filter, "memory", None)
    times = 1.0 * np.arange(7) if name == "IMM, old mode, split" else TIMES
    if memory is not None:
        times = filter.times
        if "stationary" in name:
            times = times[0] + (times[1] - times[0]) * np.arange(30)
    inputs = {}
    if name.endswith("inputs"):
        told = systems.INPUTS if "Kalman" in name else (FORCE, BIAS)
        inputs = {p: rng.normal(size=(len(times), PATHS)) for p in told}
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


def near(found, wanted, part=1e-12):
    """Equal but for rounding, of the largest value; NaN and infinities where they are wanted."""
    found, wanted = np.asarray(found, dtype=float), np.asarray(wanted, dtype=float)
    assert found.shape == wanted.shape
    lost = ~np.isfinite(wanted)
    np.testing.assert_array_equal(found[lost], wanted[lost])
    size = np.abs(wanted[~lost]).max(initial=0.0)
    np.testing.assert_allclose(found[~lost], wanted[~lost], rtol=part, atol=part * size)
