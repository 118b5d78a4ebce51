"""Errors and costs of filters of a random sine, by the published protocol.

Run by hand, ``python benchmarks/field_sine.py``, about 2 minutes on one core; writes
``benchmarks/field_sine.csv`` beside itself. The protocol is that of Table 3.1 of the manual of
the EKF/UKF toolbox (Hartikainen, Solin, Särkkä 2011); all equations are written anew here.

- rows of the published start: root-mean-square errors of angle, frequency, amplitude and signal
  over a run, means over the runs; `apart` is what the angle's error has more than the first-order
  extended filter's on the same runs;
- augmented: the unscented filter whose points carry the noises, and pass both maps;
- Rao-Blackwell: particles of the angle, each with a Kalman filter of frequency and amplitude;
- rows of a variance: starts drawn from the filters' own distribution of that variance; mean square
errors
  of the signal, and what they have more than the Rao-Blackwellised particles on the same runs.
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

from bookkit.experiments import averaged
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter, ParticleFilter, smooth
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

HERE = Path(__file__).parent
STEPS, RUNS, SOME = 500, 2000, 200
DT, SWAY, FADE = 0.01, 0.2, 0.1
"""Step, and the spectral densities of the noises of frequency and amplitude."""
START = (0.0, 10.0, 1.0)
PUSH = np.array(
    [[DT**3 / 3 * SWAY, DT**2 / 2 * SWAY, 0], [DT**2 / 2 * SWAY, DT * SWAY, 0], [0, 0, DT * FADE]]
)
PATHS = 8192
VARIANCES = (0.001, 0.03, 0.3, 3.0)
TIMES = np.arange(STEPS + 1.0)
SHOWN = np.arange(STEPS + 1)[:, None] > 0  # nothing is seen at k = 0


@dataclass(frozen=True)
class SecondOrder(Taylor):
    """The expansion to second order about the mean, with the third moments of a Gaussian."""

    def hessian(self, part, state):
        """Second derivatives of a component of the map."""
        return sympy.hessian(part, state)

    def formulas(self, map, mean, cov, spread=True):
        here = dict(zip(map.state, mean, strict=True))
        seen, noise, _ = map.conditional_expressions
        bend = [self.hessian(part, map.state).subs(here) * cov for part in seen]
        y = sympy.Matrix(
            [part.subs(here) + b.trace() / 2 for part, b in zip(seen, bend, strict=True)]
        )
        slope = sympy.Matrix(seen).jacobian(map.state).subs(here)
        if not spread:
            return y, cov * slope.T, None
        square = slope * cov * slope.T + sympy.Matrix(noise)
        for i, j in np.ndindex(square.shape):
            square[i, j] += (bend[i] * bend[j]).trace() / 2
        return y, cov * slope.T, square


def sine(cov):
    """The system whose state at the first time has the mean START and a covariance."""
    angle, frequency, amplitude = state = sympy.symbols("theta omega a", real=True)
    *e, r = sympy.symbols("e:3 r", real=True)
    step = [angle + sympy.Rational(1, 100) * frequency + e[0], frequency + e[1], amplitude + e[2]]
    return DiscreteSystem(
        StochasticMap(state, step, Noise(e, cov=PUSH)),
        StochasticMap(state, [amplitude * sympy.sin(angle) + r], Noise([r])),
        START,
        cov,
    )


def late(y):
    """Measurements of records 0, 1, ... of which the first has none."""
    return np.concatenate([np.full((1, *y.shape[1:]), np.nan), y])


def augmented(y, variance, alpha, beta, kappa):
    """Means of the unscented filter of state and noises, (K, 3, runs), of y (K, runs)."""
    count, runs = 7, y.shape[1]
    reach = alpha**2 * (count + kappa)
    weights = np.full(2 * count + 1, 0.5 / reach)
    weights[0] = 1 - count / reach
    centred = weights.copy()
    centred[0] += 1 - alpha**2 + beta
    spread = np.zeros((runs, count, count))
    spread[:, 3:6, 3:6], spread[:, 6, 6] = PUSH, 1.0
    mean, cov = np.tile(START, (runs, 1)), np.tile(variance * np.eye(3), (runs, 1, 1))
    found = []
    for shown in y:
        spread[:, :3, :3] = cov
        root = np.sqrt(reach) * np.linalg.cholesky(spread)
        points = np.concatenate([np.zeros((runs, count, 1)), root, -root], axis=2)
        x = mean[:, :, None] + points[:, :3]
        x[:, 0] += DT * x[:, 1]
        x += points[:, 3:6]
        seen = x[:, 2] * np.sin(x[:, 0]) + points[:, 6]
        ahead, expected = x @ weights, seen @ weights
        rest, off = x - ahead[:, :, None], seen - expected[:, None]
        cov = np.einsum("rip,rjp,p->rij", rest, rest, centred)
        square = off**2 @ centred
        gain = np.einsum("rip,rp,p->ri", rest, off, centred) / square[:, None]
        mean = ahead + gain * (shown - expected)[:, None]
        cov = cov - square[:, None, None] * gain[:, :, None] * gain[:, None]
        found.append(mean.T)
    return np.array(found)


def rao_blackwell(y, variance, count, seed):
    """Means of angle, frequency, amplitude and signal, (K, 4, runs), of y (K, runs).

    Given the angles, their increments are measurements of the frequency and y one of the
    amplitude, both linear; the frequency's variance is common to all particles.
    """
    rng, shape = np.random.default_rng(seed), (count, y.shape[1])
    angle = START[0] + np.sqrt(variance) * rng.standard_normal(shape)
    frequency, amplitude = np.full(shape, START[1]), np.full(shape, START[2])
    slow, fade, found = variance, np.full(shape, variance), []
    for shown in y:
        move, lean = DT**2 * slow + PUSH[0, 0], DT * slow + PUSH[0, 1]
        jump = np.sqrt(move) * rng.standard_normal(shape)
        angle = angle + DT * frequency + jump
        frequency = frequency + lean / move * jump
        slow = slow + PUSH[1, 1] - lean**2 / move
        fade, wave = fade + PUSH[2, 2], np.sin(angle)
        spread, rest = fade * wave**2 + 1.0, shown - amplitude * wave
        score = -0.5 * (rest**2 / spread + np.log(spread))
        prob = np.exp(score - score.max(axis=0))
        prob /= prob.sum(axis=0)
        gain = fade * wave / spread
        amplitude, fade = amplitude + gain * rest, fade - gain * wave * fade
        parts = angle, frequency, amplitude, amplitude * wave
        found.append([(prob * part).sum(axis=0) for part in parts])
        levels = (np.arange(count)[:, None] + rng.random(shape[1])) / count
        sums = np.cumsum(prob, axis=0)
        chosen = np.stack(
            [np.searchsorted(sums[:, j], levels[:, j]) for j in range(shape[1])], axis=1
        )
        chosen = np.minimum(chosen, count - 1)
        angle, frequency, amplitude, fade = (
            np.take_along_axis(part, chosen, axis=0) for part in (angle, frequency, amplitude, fade)
        )
    return np.array(found)


def with_signal(means):
    """Means (K, 3, runs) with the signal at them below."""
    return np.concatenate([means, means[:, 2:3] * np.sin(means[:, :1])], axis=1)


def of(values):
    """Mean over the runs and its standard error, as text."""
    return f"{values.mean():.5f}", f"{values.std() / np.sqrt(len(values)):.5f}"


def main() -> None:
    warnings.simplefilter("ignore")
    names = [
        f"{part}{end}"
        for part in ("theta", "omega", "a", "signal", "apart")
        for end in ("", "_error")
    ]
    file = (HERE / "field_sine.csv").open("w", newline="")
    table = csv.writer(file, lineterminator="\n")
    table.writerow(
        ("row", "runs", *names, "microseconds", "design_seconds", "square", "above", "above_error")
    )

    def put(row, spent, runs, means, truth, base=None, design=""):
        errors = np.sqrt(((means - truth) ** 2).mean(axis=0))
        base = errors[0] if base is None else base[:runs]
        parts = [text for values in (*errors, errors[0] - base) for text in of(values)]
        table.writerow((row, runs, *parts, f"{1e6 * spent / runs / STEPS:.3f}", design, "", "", ""))
        file.flush()
        print(row, *parts, flush=True)
        return errors[0]

    system = sine(3.0 * np.eye(3))
    data = sine(np.zeros((3, 3))).simulate(TIMES[1:], RUNS, 1)
    truth, y = with_signal(data.states), late(data.measurements)
    rules = {
        "EKF1": Taylor(),
        "EKF2": SecondOrder(),
        "exact Gaussian": ExactGaussian(),
        "UKF alpha .5": Unscented(0.5, 2.0, 0.0),
        "UKF alpha 1": Unscented(1.0, 0.0, 0.0),
        "CKF": Cubature(),
        "Gauss-Hermite 3": GaussHermite(3),
    }
    base = None
    for name, rule in rules.items():
        filter = CovarianceFilter(system, rule)
        for kind, run in (("", filter.run), (" smoother", lambda t, y, f=filter: smooth(f, t, y))):
            run(TIMES[:3], y[:3])
            if kind and name in ("UKF alpha 1", "CKF", "Gauss-Hermite 3"):
                continue
            begin = time.process_time()
            means = run(TIMES, y).mean[1:]
            spent = time.process_time() - begin
            found = put(name + kind, spent, RUNS, with_signal(means), truth, base)
            base = found if base is None else base
    begin = time.process_time()
    means = augmented(y[1:, 0], 3.0, 0.5, 2.0, -4.0)
    put(
        "UKF augmented alpha .5", time.process_time() - begin, RUNS, with_signal(means), truth, base
    )
    begin = time.process_time()
    means = rao_blackwell(y[1:, 0, :SOME], 3.0, 500, 5)
    put("Rao-Blackwell 500", time.process_time() - begin, SOME, means, truth[..., :SOME], base)
    begin = time.process_time()
    means = ParticleFilter(system, 1000).run(TIMES, y[..., :SOME], seed=5).mean[1:]
    put(
        "bootstrap 1000",
        time.process_time() - begin,
        SOME,
        with_signal(means),
        truth[..., :SOME],
        base,
    )
    orders = {f"designed, order {k}": Memory(k) for k in (1, 2, 4)}
    for name, memory in orders.items():
        begin = time.process_time()
        filter = synthesize(
            system, memory, ExactGaussian(), TIMES, paths=PATHS, seed=3, measured=SHOWN
        )
        design = time.process_time() - begin
        begin = time.process_time()
        means = filter.run(TIMES, y).mean[1:]
        spent = time.process_time() - begin
        put(name, spent, RUNS, with_signal(means), truth, base, f"{design:.1f}")

    for variance in VARIANCES:
        system, runs = sine(variance * np.eye(3)), 2 * SOME
        data, others = (
            system.simulate(TIMES, count, seed) for count, seed in ((runs, 11), (1000, 12))
        )
        y, others = late(data.measurements[1:]), late(others.measurements[1:])
        truth = with_signal(data.states)[1:, 3]
        signals = {"Rao-Blackwell 300": rao_blackwell(y[1:, 0], variance, 300, 5)[:, 3]}
        exact = CovarianceFilter(system, ExactGaussian())
        found = {
            "EKF1": CovarianceFilter(system, Taylor()).run(TIMES, y).mean,
            "exact Gaussian": exact.run(TIMES, y).mean,
            "exact Gaussian, covariances averaged": averaged(exact, TIMES, y, others),
        }
        for name, memory in orders.items():
            filter = synthesize(
                system, memory, ExactGaussian(), TIMES, paths=PATHS, seed=3, measured=SHOWN
            )
            found[name] = filter.run(TIMES, y).mean
        signals |= {name: with_signal(means[1:])[:, 3] for name, means in found.items()}
        least = None
        for name, signal in signals.items():
            square = ((signal - truth) ** 2).mean(axis=0)
            least = square if least is None else least
            numbers = f"{square.mean():.5f}", *of(square - least)
            table.writerow((f"variance {variance:g}: {name}", runs, *[""] * 12, *numbers))
            file.flush()
            print(variance, name, *numbers, flush=True)
    file.close()


if __name__ == "__main__":
    main()
