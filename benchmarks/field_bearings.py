"""Errors and costs of filters of a target that two sensors see the bearings of.

Run by hand, ``python benchmarks/field_bearings.py``, about 4 minutes on one core; writes
``benchmarks/field_bearings.csv`` beside itself. The protocol is that of Table 3.3 of the manual of
the EKF/UKF toolbox (Hartikainen, Solin, Särkkä 2011); all equations are written anew here.

- rows of the protocol: root-mean-square distance from the target over a run, mean over the runs;
  `apart` is what it has more than the first-order extended filter's on the same runs;
- misprinted: the second-order extended filter with the second derivatives as printed;
- rows of a variance: the same targets for filters that are told another variance of the first
  velocity; the designed ones are designed with it. Averaged: the covariances of the extended filter
  are, before each correction, means over paths of the model. Drawn: the targets too are such paths.
"""

from __future__ import annotations

import csv
import os
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy
from field_sine import PATHS, SHOWN, STEPS, TIMES, SecondOrder, averaged, late, of

from seedslib.design import Polynomial, synthesize
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter, ParticleFilter, smooth
from seedslib.linearization import Cubature, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap, van_loan

HERE = Path(__file__).parent
RUNS, SOME, DT = 1000, 100, 0.01
SENSORS = (-1, -2), (1, 1)
VARIANCES = (0.1, 1.0, 10.0)
STATE = sympy.symbols("p_x p_y v_x v_y", real=True)
SIGHTS = [sympy.atan2(STATE[1] - b, STATE[0] - a) for a, b in SENSORS]


@dataclass(frozen=True)
class Misprinted(SecondOrder):
    """With the second derivatives of a bearing as the manual has them."""

    def hessian(self, part, state):
        right = sympy.hessian(part, state)
        for angle in part.atoms(sympy.atan2):
            up, along = angle.args
            right[0, 0], right[1, 1] = (-2 * leg / (up**2 + along**2) ** 2 for leg in (along, up))
        return right


def tracked(variance):
    """Constant velocity with a variance of the first one, and both bearings."""
    spread = np.zeros((4, 4))
    spread[2:, 2:] = 0.1 * np.eye(2)
    matrix, push = van_loan(np.eye(4, k=2), spread, DT)
    q, e = sympy.symbols("q:4", real=True), sympy.symbols("e:2", real=True)
    step = sympy.Matrix(matrix) * sympy.Matrix(STATE) + sympy.Matrix(q)
    see = [sight + noise for sight, noise in zip(SIGHTS, e, strict=True)]
    return DiscreteSystem(
        StochasticMap(STATE, list(step), Noise(q, cov=push)),
        StochasticMap(
            STATE, see, Noise(e, cov=0.05**2 * np.eye(2)), period=dict.fromkeys((0, 1), 2 * np.pi)
        ),
        np.zeros(4),
        np.diag([0.1, 0.1, variance, variance]),
    )


def target(runs, seed):
    """Positions (STEPS, 2, runs) of the target, which turns to the right thrice, and bearings."""
    rng = np.random.default_rng(seed)
    turn = np.zeros((STEPS, runs))  # angle of a step
    for start, stop in ((50, 100), (200, 250), (350, 400)):
        count = stop - start + 1
        turn[start - 1 : stop] = np.pi / 2 / count + DT * 0.01 * rng.standard_normal((count, runs))
    # on an arc a step goes along its chord, in the direction half-way
    heading = -np.cumsum(turn, axis=0) + turn / 2
    chord = DT * np.sinc(turn / (2 * np.pi))
    place = np.cumsum(chord * np.stack([np.cos(heading), np.sin(heading)]), axis=1)
    apart = place[:, None] - np.array(SENSORS).T[:, :, None, None]
    bearing = np.arctan2(apart[1], apart[0]) + 0.05 * rng.standard_normal((2, STEPS, runs))
    return np.moveaxis(place, 0, 1), np.moveaxis(np.pi - (np.pi - bearing) % (2 * np.pi), 0, 1)


def errors(means, place):
    """Root-mean-square distance over each run."""
    return np.sqrt(((means[1:, :2] - place) ** 2).sum(axis=1).mean(axis=0))


def main() -> None:
    warnings.simplefilter("ignore")
    file = (HERE / "field_bearings.csv").open("w", newline="")
    table = csv.writer(file, lineterminator="\n")
    head = "row", "runs", "rmse", "error", "apart", "apart_error", "microseconds", "design_seconds"
    table.writerow((*head, "predicted", "median"))

    def put(row, found, base, spent=None, design=None, predicted=None):
        cost = "" if spent is None else f"{1e6 * spent / len(found) / STEPS:.3f}"
        apart = *of(found), *of(found - base[: len(found)])
        told = (
            "" if design is None else f"{design:.1f}",
            "" if predicted is None else f"{predicted:.4f}",
        )
        table.writerow((row, len(found), *apart, cost, *told, f"{np.median(found):.5f}"))
        file.flush()
        print(row, *apart, flush=True)

    system = tracked(10.0)
    place, bearing = target(RUNS, 1)
    y = late(bearing)
    rules = {
        "EKF1": Taylor(),
        "EKF2": SecondOrder(),
        "EKF2 misprinted": Misprinted(),
        "UKF alpha 1": Unscented(1.0, 0.0, -1.0),
        "UKF alpha .5": Unscented(0.5, 2.0, -1.0),
        "CKF": Cubature(),
        "Gauss-Hermite 3": GaussHermite(3),
    }
    base = errors(CovarianceFilter(system, Taylor()).run(TIMES, y).mean, place)
    for name, rule in rules.items():
        filter = CovarianceFilter(system, rule)
        for kind, run in (("", filter.run), (" smoother", lambda t, y, f=filter: smooth(f, t, y))):
            if kind and "3" in name:
                continue
            run(TIMES[:3], y[:3])
            begin = time.process_time()
            means = run(TIMES, y).mean
            spent = time.process_time() - begin
            put(name + kind, errors(means, place), base, spent)
    few = y[..., :SOME]
    begin = time.process_time()
    means = ParticleFilter(system, 1000).run(TIMES, few, seed=5).mean
    put("bootstrap 1000", errors(means, place[..., :SOME]), base, time.process_time() - begin)

    seen = np.broadcast_to(SHOWN, (STEPS + 1, 2))
    for variance in reversed(VARIANCES):
        system = tracked(variance)
        filter = CovarianceFilter(system, Taylor())
        base = errors(filter.run(TIMES, y).mean, place)
        put(f"variance {variance:g}: EKF1", base, base)
        others = late(system.simulate(TIMES, 2000, 5).measurements[1:])
        found = errors(averaged(filter, TIMES, y, others), place)
        put(f"variance {variance:g}: EKF1, covariances averaged", found, base)
        if variance < 10.0:
            means = ParticleFilter(system, 1000).run(TIMES, few, seed=5).mean
            put(f"variance {variance:g}: bootstrap 1000", errors(means, place[..., :SOME]), base)
        drawn = system.simulate(TIMES, RUNS // 2, 6)
        own_place, own_y = drawn.states[1:, :2], late(drawn.measurements[1:])
        own_base = errors(filter.run(TIMES, own_y).mean, own_place)
        put(f"drawn, {variance:g}: EKF1", own_base, own_base)
        found = errors(averaged(filter, TIMES, own_y, others), own_place)
        put(f"drawn, {variance:g}: EKF1, covariances averaged", found, own_base)
        designs = {f"designed, order {k}": (Memory(k), {}) for k in (1, 2, 4)}
        bent = {"predictor": Polynomial(1, 2)}
        designs["designed, order 2, covariance of degree 2"] = Memory(2), bent
        for name, (memory, options) in designs.items():
            begin = time.process_time()
            filter = synthesize(
                system, memory, Taylor(), TIMES, paths=PATHS, seed=3, measured=seen, **options
            )
            design = time.process_time() - begin
            begin = time.process_time()
            means = filter.run(TIMES, y).mean
            spent, rms = time.process_time() - begin, filter.predicted.rms[1:, :2]
            predicted = np.sqrt((rms**2).sum(axis=1).mean())
            put(
                f"variance {variance:g}: {name}",
                errors(means, place),
                base,
                spent,
                design,
                predicted,
            )
            if memory.estimates == 4:
                found = errors(filter.run(TIMES, own_y).mean, own_place)
                put(f"drawn, {variance:g}: {name}", found, own_base)
    file.close()


if __name__ == "__main__":
    main()
