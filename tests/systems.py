"""Systems that the tests of several packages share.

The linear ones depend on time, are driven by inputs and have nothing symmetric about them. Each is
given twice: as numbers (for the independent routes of `oracles.linear`) and as a model of the
library. `coefficients` writes every entry once, for NumPy and for SymPy.
"""

from types import SimpleNamespace

import numpy as np
import sympy

from oracles.linear import Continuous, Linear, Switching
from seedslib.base import ELAPSED, Input
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
)

t = sympy.Symbol("t")
STATE = sympy.symbols("x1:4", real=True)
NOISE = sympy.symbols("v1:4", real=True)
SENSOR_NOISE = sympy.symbols("w1:3", real=True)
U, S = Input("u"), Input("s")

STEP = 0.4
EVEN = 1.5 + STEP * np.arange(7)
"""A late start and equal steps, for matrices that are functions of time alone."""
TIMES = np.array([1.5, 1.9, 2.7, 3.0, 3.3, 4.2, 4.6])
"""A late start and unequal steps."""
INPUTS = {
    U: np.array([0.5, -1.0, 2.0, 0.3, 1.0, -0.5, 0.8]),
    S: np.array([-0.4, 0.9, 0.1, -1.2, 0.6, 1.5, -0.7]),
}
"""Values on seven times; those of the last time act in the sensor only."""

MEAN0 = np.array([1.0, -0.5, 0.3])
COV0 = np.array([[1.0, 0.2, 0.1], [0.2, 0.8, -0.3], [0.1, -0.3, 1.5]])
NOISE_MEAN = np.array([0.2, -0.1, 0.3])
NOISE_COV = np.array([[0.5, 0.1, 0.0], [0.1, 0.3, -0.05], [0.0, -0.05, 0.4]])
SENSOR_MEAN = np.array([-0.4, 0.7])
SENSOR_COV = np.array([[1.0, 0.3], [0.3, 0.6]])


def coefficients(t, h=STEP, mode=0, m=np):
    """Entries at time t, for a step of length h: x' = F x + B u + c + G v, y = H x + D u + E w.

    With ``m=sympy`` they are formulas of t and h. Only modes above 0 have an offset c.
    """
    return SimpleNamespace(
        F=[
            [0.9, 0.4 * h + 0.3 * mode, 0.1],
            [-0.3 * h, 0.8 + 0.1 * m.sin(2 * t) - 0.4 * mode, 0.3 * m.cos(t)],
            [0.1, 0, 0.7 - 0.05 * t * h],
        ],
        B=[[h, 0.2], [0.3 * t, -0.5 - 0.3 * mode], [0.1, h * m.cos(t)]],
        c=[0.5 * mode, 0.3 * mode * m.cos(t), -0.2 * mode * h],
        G=[[0.6 + 0.3 * mode, 0, 0.1], [0.2 * h, 0.5, 0], [0.1, 0.1 * t, 0.4]],
        H=[[1, 0.5, -0.2 * t], [0.3, m.sin(t), 1 + 0.25 * mode]],
        D=[[0.4, 0.1 * t], [-0.3, 0.2]],
        E=[[0.5, 0], [0.2, 0.3 + 0.05 * t]],
    )


def linear_numbers(times=TIMES, inputs=INPUTS, *, means=True, mode=0):
    """The system as arrays; without `means` the noises have mean zero, as in a `LinearSystem`."""
    steps = np.append(np.diff(times), STEP)  # no step leaves the last time
    parts = [coefficients(now, h, mode) for now, h in zip(times, steps, strict=True)]
    F, B, c, G, H, D, E = (
        np.array([getattr(part, name) for part in parts], dtype=float) for name in "FBcGHDE"
    )
    u = np.stack([inputs[U], inputs[S]], axis=-1) if inputs else np.zeros((len(times), 2))
    move, shift = np.einsum("kij,kj->ki", B, u) + c, np.einsum("kij,kj->ki", D, u)
    if means:
        move, shift = move + G @ NOISE_MEAN, shift + E @ SENSOR_MEAN
    Q, R = G @ NOISE_COV @ G.swapaxes(1, 2), E @ SENSOR_COV @ E.swapaxes(1, 2)
    return Linear(F[:-1], move[:-1], Q[:-1], H, shift, R, MEAN0, COV0)


def linear_system(form="formulas", *, inputs=True, diffuse=()):
    """As a `LinearSystem`: of formulas (any steps), or of functions of time (steps of `STEP`).

    Diffuse components are uncorrelated with the others, and their mean is zero.
    """

    def spread(root, cov):
        return root @ cov @ root.T

    if form == "functions":

        def entries(name, time):
            return np.array(getattr(coefficients(time), name), dtype=float)

        F, H = (lambda time, name=name: entries(name, time) for name in "FH")
        Q, R = (
            lambda time: spread(entries("G", time), NOISE_COV),
            lambda time: spread(entries("E", time), SENSOR_COV),
        )
    else:
        made = vars(coefficients(t, ELAPSED, m=sympy))
        F, H, G, E = (np.array(made[name], dtype=object) for name in "FHGE")
        Q, R = spread(G, NOISE_COV), spread(E, SENSOR_COV)
    made = coefficients(t, STEP if form == "functions" else ELAPSED, m=sympy)
    added = {"b": np.array(made.B) @ [U, S], "d": np.array(made.D) @ [U, S]} if inputs else {}
    known = ~np.isin(np.arange(3), diffuse)
    start = MEAN0 * known, COV0 * np.outer(known, known)
    return LinearSystem(F, Q, H, R, *start, diffuse=diffuse, **added)


def linear_formulas(mode=0, *, inputs=True, step=ELAPSED):
    """Next state and measurement as lists of SymPy expressions, noises with their means.

    With a number as `step`, such as `STEP`, they do not mention the elapsed time.
    """
    made = vars(coefficients(t, step, mode, sympy))
    F, B, c, G, H, D, E = (np.array(made[name], dtype=object) for name in "FBcGHDE")
    u = np.array([U, S]) if inputs else np.zeros(2, dtype=int)
    return list(F @ STATE + B @ u + c + G @ NOISE), list(H @ STATE + D @ u + E @ SENSOR_NOISE)


def noises():
    """Noises of the dynamics and of the sensor, with means."""
    return Noise(NOISE, NOISE_MEAN, NOISE_COV), Noise(SENSOR_NOISE, SENSOR_MEAN, SENSOR_COV)


def discrete_system(*, inputs=True, step=ELAPSED):
    """As a `DiscreteSystem` of formulas."""
    maps = zip(linear_formulas(inputs=inputs, step=step), noises(), strict=True)
    dynamics, sensor = (StochasticMap(STATE, value, noise) for value, noise in maps)
    return DiscreteSystem(dynamics, sensor, MEAN0, COV0)


def with_gaps(y):
    """A record of seven times with missing parts: one component, both, both again."""
    y = np.array(y, dtype=float)
    y[[0, 1, 5], [1, 0, 0]] = np.nan
    y[[2, 3]] = np.nan
    return y


def record(model, seed=0):
    """States (K+1, n) and a measured record with gaps (K+1, m), drawn from a `Linear`."""
    rng = np.random.default_rng(seed)
    states = [rng.multivariate_normal(model.mean0, model.cov0)]
    for F, b, Q in zip(model.F, model.b, model.Q, strict=True):
        states.append(rng.multivariate_normal(F @ states[-1] + b, Q))
    y = [
        rng.multivariate_normal(H @ x + d, R)
        for H, x, d, R in zip(model.H, states, model.d, model.R, strict=True)
    ]
    return np.array(states), with_gaps(y)


# Modes: the same with three of them and an indicator of two values.

PROBABILITIES = np.array([0.5, 0.3, 0.2])
MEANS = MEAN0 + np.outer([0.0, 1.0, -0.5], [1.0, -1.0, 0.5])
COVS = COV0 * np.array([1.0, 0.7, 1.2])[:, None, None]
INDICATORS = np.array([0, 1, -1, 0, 1, -1, 1])
"""With missing values, at times with and without a measurement."""


def chances(t, u, m=np):
    """Probabilities of switches A (3, 3) and of values of the indicator B (3, 2)."""
    s, c, e = m.sin(t) ** 2, m.cos(2 * t) ** 2, u / (1 + u**2)
    leave = [
        [0.7 - 0.2 * s, 0.2, 0.1 + 0.2 * s],
        [0.1, 0.6 + 0.2 * c, 0.3 - 0.2 * c],
        [0.3, 0.3 - 0.2 * e, 0.4 + 0.2 * e],
    ]
    return leave, [[0.8, 0.2], [0.5 - 0.2 * s, 0.5 + 0.2 * s], [0.1 + 0.2 * c, 0.9 - 0.2 * c]]


def switching_numbers(times=TIMES, inputs=INPUTS, *, means=True):
    """The switching system as arrays."""
    modes = [
        linear_numbers(times, inputs, means=means, mode=i)._replace(mean0=MEANS[i], cov0=COVS[i])
        for i in range(3)
    ]
    u = inputs[U] if inputs else np.zeros(len(times))
    leave, tell = zip(*(chances(*now) for now in zip(times, u, strict=True)), strict=True)
    return Switching(modes, PROBABILITIES, np.array(leave[:-1]), np.array(tell))


def switching_system(drives="old", *, inputs=True, indicator=True, step=ELAPSED):
    """As a `SwitchingSystem` of formulas."""
    formulas = [linear_formulas(mode, inputs=inputs, step=step) for mode in range(3)]
    dynamics, sensor = zip(*formulas, strict=True)
    noise, sensor_noise = noises()
    leave, tell = chances(t, U if inputs else sympy.Integer(0), sympy)
    initial = list(zip(PROBABILITIES, MEANS, COVS, strict=True))
    options = {"indicator": tell if indicator else None, "drives": drives}
    return SwitchingSystem(STATE, dynamics, noise, leave, sensor, sensor_noise, initial, **options)


# Continuous time: two states, two measured components, one input.

MARK_MEAN, MARK_COV = 0.6, 0.5


def rates(t, m=np):
    """Drift A x + a + B u, diffusion G, jumps C x + k z of intensity mu, sensor H x + D u + w."""
    return SimpleNamespace(
        A=[[-1 - t / 2, 0.5], [0.3 * m.sin(t), -0.8]],
        a=[m.cos(3 * t), 0.2 * t],
        B=[0.7, 0.2 * t],
        G=[[0.6, 0.1 * t], [0.2, 0.5]],
        mu=0.5 + t / 4,
        C=[[-0.1 * t, 0.1], [0, -0.2]],
        k=[0.5, 0.3 * t],
        H=[[1, 0.4 * t], [0.2, 1]],
        D=[0.3, -0.1 * t],
    )


def continuous_numbers(*, jumps=True):
    """The continuous-time system as functions of time, see `oracles.linear.Continuous`."""

    def at(name):
        return lambda time: np.array(getattr(rates(time), name), dtype=float)

    mu = at("mu") if jumps else lambda time: 0.0
    return Continuous(
        *map(at, "AaBG"),
        mu,
        at("C"),
        at("k"),
        MARK_MEAN,
        MARK_COV,
        *map(at, "HD"),
        SENSOR_MEAN,
        SENSOR_COV,
        MEAN0[:2],
        COV0[:2, :2],
    )


def continuous_system(*, jumps=True, inputs=True, step=0.02):
    """As a `JumpDiffusion` of formulas with the input `U`."""
    x, z, u = np.array(STATE[:2]), sympy.Symbol("z", real=True), U if inputs else 0
    p = {k: np.array(value, dtype=object) for k, value in vars(rates(t, sympy)).items()}
    more = {"intensity": p["mu"][()], "jump": list(p["C"] @ x + p["k"] * z)} if jumps else {}
    marks = Noise((z,), MARK_MEAN, [[MARK_COV]]) if jumps else None
    return JumpDiffusion(
        x,
        p["A"] @ x + p["a"] + p["B"] * u,
        p["G"],
        p["H"] @ x + p["D"] * u + SENSOR_NOISE,
        noises()[1],
        MEAN0[:2],
        COV0[:2, :2],
        marks=marks,
        step=step,
        **more,
    )


# Small nonlinear standards.


def growth(variance=10.0, sensor_variance=1.0):
    """The growth model: x' = x/2 + 25 x/(1 + x²) + 8 cos 1.2 t + v, y = x²/20 + w."""
    x, v, w = sympy.symbols("x v w", real=True)
    move = x / 2 + 25 * x / (1 + x**2) + 8 * sympy.cos(1.2 * t) + v
    return DiscreteSystem(
        StochasticMap([x], [move], Noise([v], cov=[[variance]])),
        StochasticMap([x], [x**2 / 20 + w], Noise([w], cov=[[sensor_variance]])),
        [0.5],
        [[2.0]],
    )


def pendulum(step=0.1):
    """Angle and velocity of a pendulum, its sine measured."""
    x, y, v, w = sympy.symbols("x y v w", real=True)
    dynamics = StochasticMap(
        [x, y], [x + step * y, y - 9.8 * step * sympy.sin(x) + v], Noise([v], cov=[[0.04]])
    )
    sensor = StochasticMap([x, y], [sympy.sin(x) + w], Noise([w], cov=[[0.1]]))
    return DiscreteSystem(dynamics, sensor, [1.0, 0.0], np.diag([0.1, 0.2]))


def oscillator(step=0.01):
    """A Van der Pol oscillator with noise on its velocity, its place measured."""
    x, y, w = sympy.symbols("x y w", real=True)
    return JumpDiffusion(
        [x, y],
        [y, (1 - x**2) * y - x],
        [[0], [0.5]],
        [x + w],
        Noise([w], cov=[[0.2]]),
        [1.0, 0.0],
        np.diag([0.3, 0.2]),
        step=step,
    )


class Recording:
    """What `recorded` adds to a system."""

    def simulate(self, *arguments, **options):
        made = super().simulate(*arguments, **options)
        if self.change:
            self.change(made)
        self.made.append(made)
        return made

    def all(self, name):
        """States, measurements, modes or indicators of all paths so far."""
        return np.concatenate([getattr(made, name) for made in self.made], axis=-1)


def recorded(system, change=None):
    """The system, of its own kind, that keeps all that it simulates; `change` alters it first."""
    again = object.__new__(type("Recorded", (Recording, type(system)), {}))
    vars(again).update(vars(system), system=system, change=change, made=[])
    return again
