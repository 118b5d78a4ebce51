"""Errors and costs of filters and smoothers of a vehicle that enters the atmosphere.

Run by hand, ``python benchmarks/field_reentry.py``, about 5 minutes on one core; writes
``benchmarks/field_reentry.csv`` beside itself; with words behind it, it prints the rows whose
names begin with them, after that of the extended filter. The setting is that of Table 3.4 of the
manual of the EKF/UKF toolbox (Hartikainen, Solin, Särkkä 2011), after Julier and Uhlmann 2004; all
equations are written anew here. The error of a run is the root of the mean over 2000 steps of the
squared distance in km; that of the drag is taken over the last 1000 steps.

- smoother rows are of the filter before them; "backward x 3" is the recursion of the cubature
  smoother written once more, with three times the noise of the model in the backward pass;
- forecasts: `synthesize` with affine forecasts; minimax: the conditionally minimax filter, with the
  residual of the radar or with the residual turned into the plane of the flight;
- settings of designed filters are the deviation of the drag parameter in their prior. Where it is
  1 its mean is 0, as published; otherwise it is the truth.
"""

from __future__ import annotations

import csv
import os
import sys
import time
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy as sp

from seedslib.design import minimax_synthesis, synthesize
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter, ParticleFilter, smooth
from seedslib.linearization import Cubature, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

HERE = Path(__file__).parent
STEP, STEPS, RUNS, PATHS = 0.1, 2000, 200, 1000
TIMES = STEP * np.arange(STEPS + 1)
RADIUS, START, DRAG = 6374.0, [6500.4, 349.14, -1.8093, -6.7967], 0.6932
DRIVE, WANDER = 2.4064e-5, 1e-6
RADAR = 1e-3, 0.17e-3
"""Deviations of range, in km, and bearing, in radians."""

X, W, V = (sp.symbols(f"{name}1:{n + 1}", real=True) for name, n in (("x", 5), ("w", 3), ("v", 2)))
COLUMNS = (
    "row",
    "setting",
    "runs",
    "rmse",
    "error",
    "above",
    "above_error",
    "drag",
    "own",
    "microseconds",
    "design_seconds",
)


def move(wander):
    """One Euler step; the drag parameter x5 wanders with this variance."""
    distance, speed = sp.sqrt(X[0] ** 2 + X[1] ** 2), sp.sqrt(X[2] ** 2 + X[3] ** 2)
    drag = -0.59783 * sp.exp(X[4] + (RADIUS - distance) / 13.406) * speed
    pull = -3.986e5 / distance**3
    rate = [X[2], X[3], *(drag * X[k + 2] + pull * X[k] for k in (0, 1)), 0]
    value = [x + STEP * r for x, r in zip(X, rate, strict=True)]
    value[2:] = [a + w for a, w in zip(value[2:], W, strict=True)]
    return StochasticMap(X, value, Noise(W, cov=np.diag([DRIVE, DRIVE, wander])))


SENSOR = StochasticMap(
    X,
    [
        sp.sqrt((X[0] - RADIUS) ** 2 + X[1] ** 2) + V[0],
        sp.atan2(X[1], X[0] - RADIUS) + V[1],
    ],
    Noise(V, cov=np.diag(np.square(RADAR))),
    period={1: 2 * np.pi},
)


def reentry(mean=0.0, deviation=1.0, wander=WANDER):
    """The system with a distribution of the drag parameter at the start."""
    return DiscreteSystem(
        move(wander), SENSOR, [*START, mean], np.diag([1e-6] * 4 + [deviation**2])
    )


def truth():
    """What is simulated: the drag parameter is a constant."""
    return reentry(DRAG, 0.0, 0.0)


def turned(t, x, y):
    """Basic corrections: the residuals of range and of place across, along the axes of the plane.

    Where the radar looks is known from the forecast; so one constant gain serves every direction.
    """
    along, across = x[0] - RADIUS, x[1]
    distance = np.sqrt(along**2 + across**2)
    cosine, sine = along / distance, across / distance
    far = y[0] - distance
    side = distance * np.sin(y[1] - np.arctan2(across, along))
    return np.stack([far * cosine, far * sine, -side * sine, side * cosine, far, side])


def designed(kind, deviation, paths=PATHS, times=TIMES[1:]):
    """A filter designed for a deviation of the prior of the drag parameter, from k = 1 on.

    Nothing is measured at k = 0, so its first distribution is that of the state a step later.
    """
    before = reentry(0.0 if deviation == 1 else DRAG, deviation)
    moments = Cubature().moments(before.dynamics)
    mean, _, cov = moments(0.0, before.mean0, before.cov0)
    system = DiscreteSystem(before.dynamics, SENSOR, mean, cov)
    if kind == "forecasts":
        return synthesize(system, Memory(1), Cubature(), times, paths=paths, seed=1)
    basic = turned if kind == "minimax turned" else None
    return minimax_synthesis(system, Memory(1), times, paths=paths, seed=1, correction=basic)


def backward(estimates, times, factor):
    """Means of the cubature smoother, by the recursion of its textbook, from k = 1 on.

    The backward pass has `factor` times the noise of the forward one.
    """
    moments = Cubature().moments(move(WANDER))
    more = (factor - 1) * np.diag([0, 0, DRIVE, DRIVE, WANDER])[:, :, None]
    mean, found = estimates.mean[-1], [estimates.mean[-1]]
    for k in range(len(times) - 2, 0, -1):
        ahead, cross, cov = moments(times[k], estimates.mean[k], estimates.cov[k])
        cov, cross = np.moveaxis(cov + more, 2, 0), np.moveaxis(cross, 2, 0)
        gain = np.swapaxes(np.linalg.solve(cov, np.swapaxes(cross, 1, 2)), 1, 2)
        mean = estimates.mean[k] + np.einsum("pij,jp->ip", gain, mean - ahead)
        found.append(mean)
    return np.array(found[::-1])


def errors(mean, states):
    """Root of the mean squared distance of each run; both from k = 1 on."""
    return np.sqrt(((mean - states)[:, :2] ** 2).sum(axis=1).mean(axis=0))


def main(only=()) -> None:
    """Write the table, or print the rows whose names begin with one of `only`."""
    warnings.simplefilter("ignore")
    data = truth().simulate(TIMES, RUNS, 1)
    states, y = data.states[1:], data.measurements.copy()
    y[0] = np.nan
    file = sys.stdout if only else (HERE / "field_reentry.csv").open("w", newline="")
    table = csv.writer(file, lineterminator="\n")
    table.writerow(COLUMNS)
    least = None

    def wanted(name):
        return not only or any(name.startswith(part) for part in only)

    def put(name, setting, mean, begin, own=None, design=""):
        nonlocal least
        cost = (time.process_time() - begin) / mean.shape[2] / STEPS
        runs = mean.shape[2]
        found = errors(mean, states[..., :runs])
        least = found if least is None else least
        above = found - least[:runs]
        drag = np.sqrt(((mean - states[..., :runs])[STEPS // 2 :, 4] ** 2).mean())
        told = "" if own is None else f"{np.sqrt((own[1:, 0, 0] + own[1:, 1, 1]).mean()):.6f}"
        table.writerow(
            (
                name,
                setting,
                runs,
                *(
                    f"{v:.7f}"
                    for a in (found, above)
                    for v in (a.mean(), a.std(ddof=1) / runs**0.5)
                ),
                f"{drag:.5f}",
                told,
                f"{1e6 * cost:.2f}",
                design,
            )
        )
        file.flush()

    rules = {
        "extended": ("", Taylor()),
        "unscented": ("alpha 1 beta 0 kappa -2", Unscented()),
        "unscented .5": ("alpha .5 beta 2 kappa -2", Unscented(0.5, 2.0, -2.0)),
        "cubature": ("", Cubature()),
        "Gauss-Hermite 3": ("", GaussHermite(3)),
    }
    system = reentry()
    for name, (setting, rule) in rules.items():
        if name != "extended" and not wanted(name):
            continue
        filter = CovarianceFilter(system, rule)
        filter.run(TIMES[:3], y[:3])
        begin = time.process_time()
        kept = filter.run(TIMES, y)
        put(name, setting, kept.mean[1:], begin, kept.cov)
        if name == "cubature":
            for factor in (1, 3):
                begin = time.process_time()
                put(f"backward x {factor}", "", backward(kept, TIMES, factor), begin)
        begin = time.process_time()
        kept = smooth(filter, TIMES, y[..., :20] if "Hermite" in name else y)
        put(f"{name} smoother", setting, kept.mean[1:], begin, kept.cov)
    for kind, deviations in (
        ("forecasts", (1,)),
        ("minimax residual", (1, 0.1)),
        ("minimax turned", (1,)),
    ):
        for deviation in deviations if wanted(kind) else ():
            begin = time.process_time()
            filter = designed(kind, deviation)
            spent = f"{time.process_time() - begin:.0f}"
            filter.run(TIMES[1:4], y[1:4])
            begin = time.process_time()
            put(kind, deviation, filter.run(TIMES[1:], y[1:]).mean, begin, design=spent)
    for particles in (50, 100) if wanted("bootstrap") else ():
        filter, some = ParticleFilter(system, particles), y[..., :20]
        begin = time.process_time()
        put(f"bootstrap {particles}", "", filter.run(TIMES, some, seed=1).mean[1:], begin)
    if not only:
        file.close()


if __name__ == "__main__":
    main(sys.argv[1:])
