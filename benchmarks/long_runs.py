"""A million steps of every filter: do covariances stay covariances, and do the numbers drift.

Run by hand, ``nice python benchmarks/long_runs.py``; writes ``benchmarks/long_runs.csv`` beside
itself, row by row. Wants a C compiler for the rows in C.

One path of 10^6 steps, step by step, each filter in a process of its own. The state is one or two
numbers, moved and seen with Gaussian noise. `asymmetry` is the largest difference of a covariance
and its transpose, `least_eigenvalue` the smallest ratio of eigenvalues of a covariance, `drift` how
far covariances after the first 10^4 steps are from that of the last of them, in parts of it (where
it does not depend on the data), `probability` how far those of modes are from sum one. `nees` is
the mean of eᵀ P⁻¹ e over the number of components, e the error of the mean: one for a filter that
knows its errors; `nis` is the same of the innovations of the filters that are Kalman filters here.
Errors are from blocks of 10^4 steps. `kilobytes` is what the process has grown by after the first
10^4 steps.
"""

from __future__ import annotations

import csv
import math
import os
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

import seedslib.filters as online
from seedslib import models
from seedslib.delay import RECURSIONS, DelayKalmanFilter, DelaySystem
from seedslib.design import grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.extra import compiled
from seedslib.linearization import GaussHermite, Taylor
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem

BLOCK, SEED = 10_000, 1
F, H = np.array([[0.95, 0.2], [-0.1, 0.9]]), np.array([[1.0, 0.0]])
Q, R = np.array([[0.03, 0.01], [0.01, 0.02]]), np.array([[0.4]])
x1, x2, v1, v2, w = sympy.symbols("x1 x2 v1 v2 w", real=True)
STAY = [[0.98, 0.02], [0.05, 0.95]]


def pair(bend: float = 0.0) -> models.DiscreteSystem:
    """Two numbers that turn and fade, of which one is seen; with `bend` the turn is not linear."""
    turn = sympy.Matrix(F) * sympy.Matrix([x1, x2]) + sympy.Matrix([v1, v2 + bend * sympy.sin(x1)])
    return models.DiscreteSystem(
        models.StochasticMap((x1, x2), list(turn), models.Noise((v1, v2), cov=Q)),
        models.StochasticMap((x1, x2), [x1 + w], models.Noise((w,), cov=R)), [0, 0], np.eye(2),
    )  # fmt: skip


def single() -> models.DiscreteSystem:
    """One number."""
    return models.DiscreteSystem(
        models.StochasticMap((x1,), [0.9 * x1 + v1], models.Noise((v1,), cov=[[0.2]])),
        models.StochasticMap((x1,), [x1 + w], models.Noise((w,), cov=[[0.5]])), [0], [[1]],
    )  # fmt: skip


def modes() -> models.SwitchingSystem:
    """The same in two modes with noises of different sizes."""
    return models.SwitchingSystem(
        (x1,), [[0.9 * x1 + v1], [0.9 * x1 + 3 * v1]], models.Noise((v1,), cov=[[0.2]]), STAY,
        [[x1 + w]] * 2, models.Noise((w,), cov=[[0.5]]), [(0.5, [0], [[1]])] * 2,
    )  # fmt: skip


def motion() -> models.JumpDiffusion:
    """The same in continuous time, seen after each unit of it."""
    return models.JumpDiffusion(
        (x1,),
        [-x1 / 10],
        [[0.45]],
        [x1 + w],
        models.Noise((w,), cov=[[0.5]]),
        [0],
        [[1]],
        step=0.25,
    )


def lag(method: str) -> DelayKalmanFilter:
    """One number that moves by itself and by what it was two steps before."""
    return DelayKalmanFilter(DelaySystem({0: 0.6, 2: 0.3}, 1.0, 0.2, 0.5, 1.0), method)


def broken() -> PiecewiseLinearFilter:
    """One number with a slope of its own on each side of zero."""
    return PiecewiseLinearFilter(
        PiecewiseLinearSystem(
            [-np.inf, 0, np.inf], ([[0, 0]], [[[0.9, 0.8]]]), ([[0, 0]], [[[1, 1]]]),
            [[math.sqrt(0.5)]], np.zeros(1), np.eye(1), noise=[[math.sqrt(0.2)]],
        )
    )  # fmt: skip


def lasting():
    """A design without an end."""
    one = synthesize(pair(), Memory(1), Taylor(), np.arange(16.0), paths=2000, seed=SEED, nodes=0)
    return stationary(one, tolerance=0.5, paths=200)


def table():
    """A table without an end."""
    made = grid_synthesis(
        single(), large_order(1), np.arange(12.0), x=(-6, 6, 61), z=(-4, 4, 17), y=(-7, 7, 33),
        nodes=0,
    )  # fmt: skip
    return stationary(made, tolerance=0.5, paths=200)


FILTERS = {
    "Kalman": lambda: online.KalmanFilter(models.LinearSystem(F, Q, H, R, [0, 0], np.eye(2))),
    "Kalman, a diffuse start": lambda: online.KalmanFilter(
        models.LinearSystem(F, Q, H, R, [0, 0], np.zeros((2, 2)), diffuse=(0, 1))
    ),
    "extended": lambda: online.extended_kalman(pair()),
    "extended, a nonlinear turn": lambda: online.extended_kalman(pair(0.1)),
    "extended, in continuous time": lambda: online.extended_kalman(motion()),
    "assumed density, a nonlinear turn": lambda: online.assumed_density(pair(0.1)),
    "unscented": lambda: online.unscented_kalman(pair()),
    "cubature": lambda: online.cubature_kalman(pair()),
    "Gauss-Hermite": lambda: online.CovarianceFilter(pair(), GaussHermite(3)),
    "gated": lambda: online.Gated(online.extended_kalman(pair()), 0.9999),
    "IMM": lambda: SwitchingFilter(modes(), Taylor()),
    "known modes": lambda: online.KnownModeFilter(modes()),
    "Rao-Blackwell, 20 histories": lambda: online.RaoBlackwellFilter(modes(), 20),
    "particles, 100": lambda: online.ParticleFilter(single(), 100),
    "grid, 61 nodes": lambda: online.GridBayesFilter(single(), (-7, 7, 61)),
    **{f"delay, {method}": lambda method=method: lag(method) for method in RECURSIONS},
    "piecewise linear": broken,
    "design without an end": lasting,
    "table without an end": table,
}
IN_C = (
    "Kalman", "extended", "extended, a nonlinear turn", "extended, in continuous time",
    "assumed density, a nonlinear turn", "unscented", "cubature", "Gauss-Hermite", "IMM",
    "design without an end", "table without an end",
)  # fmt: skip
EXACT = ("Kalman", "Kalman, a diffuse start", "extended", "unscented", "cubature", "Gauss-Hermite")
STEADY = (*EXACT, *(f"delay, {method}" for method in RECURSIONS), "design without an end",
          "extended, in continuous time")  # fmt: skip


class Row(NamedTuple):
    """What a long run shows; None where there is no such number."""

    filter: str
    language: str
    steps: int
    finite: bool
    asymmetry: float
    least_eigenvalue: float
    drift: float | None
    probability: float | None
    least_probability: float | None
    nees: float
    nees_error: float
    nis: float | None
    nis_error: float | None
    kilobytes: int


ROOT_Q = np.linalg.cholesky(Q).tolist()


def truth(name: str, count: int):
    """Blocks of states (count, n), measurements (count, m) and modes, one after another."""
    rng, x, mode, past = np.random.default_rng(SEED), [0.0, 0.0], 0, [0.0, 0.0, 0.0]
    bend = 0.1 if "nonlinear" in name else 0.0
    kind, first = kind_of(name), True
    sensor = math.sqrt(R[0, 0] if kind == "pair" else 0.5)
    while True:
        drawn, chance = rng.standard_normal((count, 3)).tolist(), rng.random(count).tolist()
        states, shown = [], []
        for (a, b, _), u in zip(drawn, chance, strict=True):
            if first:
                x, first = ([a, b] if kind == "pair" else [a]), False
                mode, past = int(u < 0.5), [x[0], 0.0, 0.0]
            elif kind == "pair":
                (c, _), (d, e) = ROOT_Q
                p, q = x
                x = [F[0, 0] * p + F[0, 1] * q + c * a,
                     F[1, 0] * p + F[1, 1] * q + bend * math.sin(p) + d * a + e * b]  # fmt: skip
            elif kind == "modes":
                left, mode = mode, mode if u < STAY[mode][mode] else 1 - mode
                x = [0.9 * x[0] + (1.0, 3.0)[left] * math.sqrt(0.2) * a]
            elif kind == "motion":
                x = [math.exp(-0.1) * x[0] + 0.45 * math.sqrt((1 - math.exp(-0.2)) / 0.2) * a]
            elif kind == "lag":
                x = [0.6 * past[0] + 0.3 * past[2] + math.sqrt(0.2) * a]
                past = [x[0], *past[:2]]
            else:
                slope = 0.8 if kind == "broken" and x[0] >= 0 else 0.9
                x = [slope * x[0] + math.sqrt(0.2) * a]
            states.append(x)
            shown.append(mode)
        states = np.array(states)
        yield states, states[:, :1] + sensor * np.array(drawn)[:, 2:], np.array(shown)


def kind_of(name: str) -> str:
    """Which of the systems a filter is for."""
    kinds = {"delay": "lag", "piecewise": "broken", "IMM": "modes", "known": "modes",
             "Rao": "modes", "particles": "single", "grid": "single", "table": "single",
             "extended, in": "motion"}  # fmt: skip
    return next((kind for start, kind in kinds.items() if name.startswith(start)), "pair")


def grown() -> int:
    """Bytes that the process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def measure(name: str, steps: int, language: str = "Python", block: int = BLOCK) -> Row:
    """The numbers of one row."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        filter = FILTERS[name]()
        if language == "C":
            filter = compiled(filter)
    state, told, n = None, "modes" in filter.takes, filter.system.state_size
    asymmetry = drift = off = 0.0
    least = least_prob = 1.0
    settled, before, finite, nees, nis = None, 0, True, [], []
    blocks = truth(name, min(block, steps))
    for done, (x, y, mode) in zip(range(0, steps, block), blocks, strict=False):
        if kind_of(name) in ("lag", "broken") and done == 0:
            y[0] = np.nan  # nothing is measured at the first time
        if state is None:
            state = filter.initial(**({"mode": mode[0]} if told else {}))
        means, covs = np.empty((len(y), n)), np.empty((len(y), n, n))
        logliks, probs = np.empty(len(y)), []
        for k, now in enumerate(y):
            given = {"mode": mode[k]} if told else {}
            state = filter.step(state, float(done + k), now, **given)
            said = filter.report(state)
            means[k], covs[k] = said.mean, said.cov
            logliks[k] = np.nan if said.loglik is None else said.loglik
            if said.mode_prob is not None and not told:
                probs.append(np.array(said.mode_prob))
        if kind_of(name) == "pair" and "diffuse" in name and done == 0:
            x, means, covs, logliks = (part[2:] for part in (x, means, covs, logliks))
        finite &= bool(np.isfinite(means).all() and np.isfinite(covs).all())
        asymmetry = max(asymmetry, float(np.abs(covs - covs.mT).max()))
        values = np.linalg.eigvalsh(covs)
        least = min(least, float((values[:, 0] / values[:, -1]).min()))
        if settled is not None and name in STEADY:
            drift = max(drift, float(np.abs(covs - settled).max() / np.abs(settled).max()))
        if probs:
            off = max(off, float(np.abs(np.sum(probs, axis=1) - 1).max()))
            least_prob = min(least_prob, float(np.min(probs)))
        e = x - means
        each = np.einsum("ki,ki->k", e, np.linalg.solve(covs, e[..., None])[..., 0]) / n
        nees.append(each.mean())
        if name in EXACT and settled is not None:
            S = (H @ (F @ settled @ F.T + Q) @ H.T + R)[0, 0]
            nis.append((-2 * logliks - math.log(2 * math.pi * S)).mean())
        if settled is None:
            settled, before = covs[-1].copy(), grown()
    error = (np.std(part, ddof=1) / math.sqrt(len(part)) if len(part) > 1 else np.nan
             for part in (nees, nis))  # fmt: skip
    nees_error, nis_error = error
    exact = name in EXACT and bool(nis)
    return Row(
        name, language, steps, finite, asymmetry, least, drift if name in STEADY else None,
        off if probs else None, least_prob if probs else None, float(np.mean(nees)),
        float(nees_error), float(np.mean(nis)) if exact else None,
        float(nis_error) if exact else None, (grown() - before) // 1024,
    )  # fmt: skip


def main():
    path, rows = Path(__file__).with_suffix(".csv"), []
    plan = [(name, 10**6, "C") for name in IN_C] + [(name, 10**6, "Python") for name in FILTERS]
    with ProcessPoolExecutor(2, get_context("spawn"), max_tasks_per_child=1) as pool:
        for row in pool.map(measure, *zip(*plan, strict=True)):
            told = [f"{v:.4g}" if isinstance(v, float) else "" if v is None else v for v in row]
            rows.append(told)
            print(*told, flush=True)
            with path.open("w", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows([Row._fields, *rows])


if __name__ == "__main__":
    main()
