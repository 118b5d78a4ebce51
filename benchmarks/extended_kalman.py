"""Time of the extended Kalman filter on 20 000 paths against hand-written NumPy.

Run by hand, ``python benchmarks/extended_kalman.py``; writes ``benchmarks/extended_kalman.csv``
beside itself. Two cases: 30 steps in discrete time, and the continuous-discrete Van der Pol
filter (300 Runge-Kutta steps, 7 corrections). The peers use the same layout, one array per
component, and the symmetry of the covariance. Where dynamax is installed it runs the discrete
case too. All run in one process with repetitions interleaved; the figure of each is its best;
`ratio` is own time over that of the hand-written code of the case.
"""

from __future__ import annotations

import csv
import importlib.util
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

from seedslib import zoo
from seedslib.filters import extended_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap

PATHS, STEPS, ROUNDS = 20_000, 30, 7
STEP, STIFFNESS = 0.05, 0.1


def discrete_system() -> DiscreteSystem:
    """Van der Pol oscillator in steps of 0.05, both sensors with unit noise."""
    x1, x2, w, v1, v2 = sympy.symbols("x1 x2 w v1 v2")
    moved = [x1 + STEP * x2, x2 + STEP * (2 * x2 * (1 - x1**2) - STIFFNESS * x1) + 0.1 * x1 * w]
    return DiscreteSystem(
        StochasticMap((x1, x2), moved, Noise((w,))),
        StochasticMap((x1, x2), [x1**2 + v1, x2 + v2], Noise((v1, v2))),
        mean0=[2, 0],
        cov0=[[0.15, 0], [0, 0.15]],
    )


def hand_correct(m1, m2, p11, p12, p22, y1, y2):
    """Correction by y1 = x1² + v1 and y2 = x2 + v2 through the inverse of a 2 x 2 matrix."""
    c = 2 * m1
    a, b = c * p11, c * p12
    s11, s12, s22 = c * a + 1, b, p22 + 1
    scale = 1 / (s11 * s22 - s12 * s12)
    g11, g12 = (a * s22 - p12 * s12) * scale, (p12 * s11 - a * s12) * scale
    g21, g22 = (b * s22 - p22 * s12) * scale, (p22 * s11 - b * s12) * scale
    e1, e2 = y1 - m1 * m1, y2 - m2
    m1, m2 = m1 + g11 * e1 + g12 * e2, m2 + g21 * e1 + g22 * e2
    return (
        m1, m2, p11 - g11 * a - g12 * p12, p12 - g11 * b - g12 * p22, p22 - g21 * b - g22 * p22,
    )  # fmt: skip


def start():
    return (
        np.full(PATHS, 2.0), np.zeros(PATHS), np.full(PATHS, 0.15), np.zeros(PATHS),
        np.full(PATHS, 0.15),
    )  # fmt: skip


def hand_discrete(y: np.ndarray) -> np.ndarray:
    state, record = start(), []
    for k in range(len(y)):
        if k > 0:
            m1, m2, p11, p12, p22 = state
            f21 = STEP * (-4 * m1 * m2 - STIFFNESS)
            f22 = 1 + STEP * (2 * (1 - m1 * m1))
            u, v = p11 + STEP * p12, p12 + STEP * p22
            n2 = m2 + STEP * (2 * m2 * (1 - m1 * m1) - STIFFNESS * m1)
            q12 = f21 * u + f22 * v
            q22 = f21 * (f21 * p11 + f22 * p12) + f22 * (f21 * p12 + f22 * p22) + 0.01 * m1 * m1
            state = (m1 + STEP * m2, n2, u + STEP * v, q12, q22)
        state = hand_correct(*state, y[k, 0], y[k, 1])
        record.append(state)
    return np.array(record)


def hand_rate(state):
    stiffness = (0.1 * np.pi) ** 2
    m1, m2, p11, p12, p22 = state
    square = m1 * m1
    a21, a22 = -4 * m1 * m2 - stiffness, 2 * (1 - square)
    return (
        m2, m2 * a22 - stiffness * m1, 2 * p12, a21 * p11 + a22 * p12 + p22,
        2 * (a21 * p12 + a22 * p22) + square,
    )  # fmt: skip


def hand_continuous(y: np.ndarray) -> np.ndarray:
    state, record, h = start(), [], 0.01
    for k in range(len(y)):
        for _ in range(50 if k > 0 else 0):
            k1 = hand_rate(state)
            k2 = hand_rate([a + 0.5 * h * b for a, b in zip(state, k1, strict=True)])
            k3 = hand_rate([a + 0.5 * h * b for a, b in zip(state, k2, strict=True)])
            k4 = hand_rate([a + h * b for a, b in zip(state, k3, strict=True)])
            state = [
                a + h / 6 * (b + 2 * (c + d) + e)
                for a, b, c, d, e in zip(state, k1, k2, k3, k4, strict=True)
            ]
        state = hand_correct(*state, y[k, 0], y[k, 1])
        record.append(state)
    return np.array(record)


def dynamax_runner(y: np.ndarray):
    """The discrete case in dynamax, compiled and vectorised over the paths."""
    import jax
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_filter

    jax.config.update("jax_enable_x64", True)

    def dynamics(x):
        pull = 2 * x[1] * (1 - x[0] ** 2) - STIFFNESS * x[0]
        return jnp.array([x[0] + STEP * x[1], x[1] + STEP * pull])

    model = ParamsNLGSSM(
        initial_mean=jnp.array([2.0, 0.0]),
        initial_covariance=0.15 * jnp.eye(2),
        dynamics_function=dynamics,
        # dynamax takes additive noise only: a constant covariance, the same amount of work
        dynamics_covariance=jnp.diag(jnp.array([0.0, 0.01])),
        emission_function=lambda x: jnp.array([x[0] ** 2, x[1]]),
        emission_covariance=jnp.eye(2),
    )
    filtered = jax.jit(
        jax.vmap(lambda record: extended_kalman_filter(model, record).filtered_means)
    )
    records = jnp.asarray(np.moveaxis(y, -1, 0))
    filtered(records).block_until_ready()
    return lambda: filtered(records).block_until_ready()


def main() -> None:
    system = discrete_system()
    grid = np.arange(STEPS, dtype=float)
    y = system.simulate(grid, PATHS, 1).measurements
    filter_ = extended_kalman(system)
    reference, ours = hand_discrete(y), filter_.run(grid, y)
    assert np.allclose(reference[:, :2], ours.mean, rtol=1e-8, atol=1e-8)
    runs = {
        ("discrete", "hand-written"): lambda: hand_discrete(y),
        ("discrete", "seedslib"): lambda: filter_.run(grid, y),
        ("discrete", "seedslib, 2 threads"): lambda: filter_.run(grid, y, workers=2),
    }
    if importlib.util.find_spec("dynamax"):
        runs["discrete", "dynamax"] = dynamax_runner(y)
    oscillator, times = zoo.van_der_pol(), 0.5 * np.arange(7)
    z = oscillator.simulate(times, PATHS, 2).measurements
    mixed = extended_kalman(oscillator)
    reference, ours = hand_continuous(z), mixed.run(times, z)
    assert np.allclose(reference[:, :2], ours.mean, rtol=1e-6, atol=1e-6)
    runs |= {
        ("continuous", "hand-written"): lambda: hand_continuous(z),
        ("continuous", "seedslib"): lambda: mixed.run(times, z),
        ("continuous", "seedslib, 2 threads"): lambda: mixed.run(times, z, workers=2),
    }
    seconds: dict[tuple, list[float]] = {run: [] for run in runs}
    for _ in range(ROUNDS):
        for run, work in runs.items():
            begin = time.perf_counter()
            work()
            seconds[run].append(time.perf_counter() - begin)
    rows = []
    for (case, code), values in seconds.items():
        best = float(min(values))
        base = float(min(seconds[case, "hand-written"]))
        rows.append([case, code, f"{1e3 * best:.1f}", f"{best / base:.2f}"])
    header = ["case", "code", "milliseconds", "ratio"]
    for row in [header, *rows]:
        print("{:12s}{:22s}{:>14s}{:>8s}".format(*row))
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


if __name__ == "__main__":
    main()
