"""Errors and costs of filters of a small Lorenz-96 system, five of ten components measured.

Run by hand, ``python benchmarks/field_lorenz96.py``, about 6 minutes on one core; writes
``benchmarks/field_lorenz96.csv`` beside itself; with words behind it, it prints the rows whose
names begin with them. The setting is that of Fig. 1 of M. Bocquet, C. Pires, L. Wu, Mon. Weather
Rev. 138 (2010) 2997-3023, as the package DAPPER has it in its file ``bocquet2010.py``; all
equations are written anew here. The error is the root of the mean over the ten components of the
squared error after a measurement, averaged over the measurements from time 20 to 64, and over
paths.

- rows of the library's filters of moments; the model has no noise, so their covariances are
  multiplied by an inflation before each measurement, or their model has a noise of variance q;
- ensemble: the square-root ensemble Kalman filter that takes components one after another
  (J. Whitaker, T. Hamill, 2002); jittered: particles with the rules of resampling of DAPPER;
- forecasts: `synthesize` with polynomial forecasts; polynomial: `BoundedPolynomial`; gain: the
  residual times polynomials of the forecast, all of bounded arguments; their last step is frozen;
- span: the unscented filter whose covariance forgets all but so many steps.
"""

from __future__ import annotations

import csv
import os
import sys
import time
import warnings
from dataclasses import replace
from itertools import combinations_with_replacement
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib.design import BoundedPolynomial, Polynomial, minimax_synthesis, synthesize
from seedslib.designed import Memory
from seedslib.filters import CovarianceFilter, ParticleFilter
from seedslib.linearization import Cubature, PointRule, Unscented
from seedslib.models import DiscreteSystem, Noise, StochasticMap

HERE = Path(__file__).parent
SIZE, STEP, MEASUREMENTS, SPIN, VARIANCE = 10, 0.05, 1281, 400, 2.25
RUNS, SOME = 60, 20
TIMES = STEP * np.arange(MEASUREMENTS)
SEEN = slice(0, SIZE, 2)
CLIMATE = 2.35, 3.63
"""Mean and deviation of a component in the long run."""

COLUMNS = (
    "filter",
    "setting",
    "design_paths",
    "design_seconds",
    "numbers",
    "runs",
    "rmse",
    "error",
    "largest",
    "microseconds",
)


def slope(x):
    """The right-hand side of the equations of Lorenz, components first."""
    return (np.roll(x, -1, 0) - np.roll(x, 2, 0)) * np.roll(x, 1, 0) - x + 8


def flow(t, x, v=None):
    """The state one step of Runge and Kutta later, and noise."""
    k1 = slope(x)
    k2 = slope(x + STEP / 2 * k1)
    k3 = slope(x + STEP / 2 * k2)
    x = x + STEP / 6 * (k1 + 2 * (k2 + k3) + slope(x + STEP * k3))
    return x if v is None or not len(v) else x + v


def fixed(value):
    """A matrix that does not depend on the state."""
    return lambda t, x: np.broadcast_to(
        value.reshape(*value.shape, *(1,) * (x.ndim - 1)), (*value.shape, *x.shape[1:])
    )


SENSOR = StochasticMap.from_functions(
    SIZE,
    5,
    lambda t, x, v: x[SEEN] + v,
    Noise(5, cov=VARIANCE * np.eye(5)),
    mean=lambda t, x: x[SEEN],
    cov=fixed(VARIANCE * np.eye(5)),
    log_density=lambda t, y, x: -0.5 / VARIANCE * ((y - x[SEEN]) ** 2).sum(axis=0),
)


def lorenz96(noise=0.0, **dist):
    """The system; by default from N(0, .001 I), with a variance of the noise of its model."""
    dist = dist or {"mean0": np.zeros(SIZE), "cov0": 0.001 * np.eye(SIZE)}
    spread = noise * np.eye(SIZE)
    given = (Noise(SIZE, cov=spread),) if noise else ()
    move = StochasticMap.from_functions(SIZE, SIZE, flow, *given, mean=flow, cov=fixed(spread))
    return DiscreteSystem(move, SENSOR, **dist)


def attractor(rng, count):
    """States that have forgotten their start."""
    x = 8.0 + np.asarray(rng.standard_normal((SIZE, count)))
    for _ in range(240):
        x = flow(0.0, x)
    return x


def settled():
    """The system from its distribution in the long run: that is where a filter for ever is
    designed."""
    mean, deviation = CLIMATE
    return lorenz96(mean0=np.full(SIZE, mean), cov0=deviation**2 * np.eye(SIZE), initial=attractor)


class Differences(PointRule):
    """The extended Kalman filter by central differences, for maps that are no formulas."""

    def rule(self, size):
        """Points, weights of means and weights of squares; the middle one is the mean."""
        reach = 1e-4
        points = reach * np.hstack([np.zeros((size, 1)), np.eye(size), -np.eye(size)])
        mean = np.zeros(2 * size + 1)
        mean[0] = 1.0
        return points, mean, (1.0 - mean) * 0.5 / reach**2


def inflated(filter, y, inflation):
    """Means of a filter of moments whose covariance is inflated before each measurement."""
    state, found = filter.initial((y.shape[2],)), []
    for t, seen in zip(TIMES, y, strict=False):
        state = filter.predict(state, t)
        state = filter.correct(state._replace(cov=inflation * state.cov), seen)
        found.append(state.mean)
    return np.array(found)


def ensemble(y, members, inflation, seed=0):
    """Means of the square-root ensemble Kalman filter, one measured component after another."""
    rng = np.random.default_rng(seed)
    x, found = np.sqrt(0.001) * rng.standard_normal((SIZE, members, y.shape[2])), []
    for k, seen in enumerate(y):
        x = flow(0.0, x) if k else x
        mean = x.mean(axis=1)
        apart = np.sqrt(inflation) * (x - mean[:, None])
        for number, component in enumerate(range(SIZE)[SEEN]):
            own = apart[component]
            spread = (own**2).sum(axis=0) / (members - 1) + VARIANCE
            gain = np.einsum("inp,np->ip", apart, own) / (members - 1) / spread
            mean = mean + gain * (seen[number] - mean[component])
            part = 1 / (1 + np.sqrt(VARIANCE / spread))
            apart = apart - (part * gain)[:, None] * own
        x = mean[:, None] + apart
        found.append(mean)
    return np.array(found)


def jittered(y, members, share, width, seed=0):
    """Means of particles that are resampled below a share of effective ones, copies jittered."""
    rng, runs = np.random.default_rng(seed), y.shape[2]
    x, found = np.sqrt(0.001) * rng.standard_normal((SIZE, members, runs)), []
    log_weight = np.zeros((members, runs))
    width = width * members ** (-1 / (SIZE + 4))
    for k, seen in enumerate(y):
        x = flow(0.0, x) if k else x
        log_weight = log_weight - ((seen[:, None] - x[SEEN]) ** 2).sum(axis=0) / (2 * VARIANCE)
        weight = np.exp(log_weight - log_weight.max(axis=0))
        weight = weight / weight.sum(axis=0)
        found.append(np.einsum("inp,np->ip", x, weight))
        log_weight = np.log(np.maximum(weight, 1e-300))
        few = (weight**2).sum(axis=0) * members * share >= 1
        for p in np.flatnonzero(few):
            w, own = weight[:, p], x[:, :, p]
            if 1 - w @ w < 1e-10:
                w = np.full(members, 1 / members)
            apart = own - (own @ w)[:, None]
            cov = (apart * w) @ apart.T / (1 - w @ w)
            root = np.linalg.cholesky(cov + 1e-12 * np.eye(SIZE))
            places = (rng.random() + np.arange(members)) / members
            chosen = np.searchsorted(np.cumsum(weight[:, p]), places).clip(max=members - 1)
            copies = np.bincount(chosen, minlength=members)[chosen] > 1
            noise = width * root @ rng.standard_normal((SIZE, members))
            x[:, :, p] = own[:, chosen] + noise * copies
            log_weight[:, p] = 0.0
    return np.array(found)


def scheduled(degree, near=SIZE // 2):
    """Basic corrections: the residual, times products of so many components of the forecast.

    Those of a measured component are up to `near` places from it. All are clipped, so that the
    correction is bounded whatever the forecast is.
    """
    around = [*range(-near, near + 1)] if 2 * near < SIZE else [*range(SIZE)]

    def zeta(t, x, y):
        rest = np.clip(y - x[SEEN], -6.0, 6.0)
        level = np.clip((x - CLIMATE[0]) / CLIMATE[1], -2.2, 2.2)
        parts = [rest]
        for number, component in enumerate(range(SIZE)[SEEN]):
            local = level[[(component + j) % SIZE for j in around]]
            for count in range(1, degree + 1):
                for group in combinations_with_replacement(range(len(around)), count):
                    parts.append(rest[[number]] * np.prod(local[list(group)], axis=0))
        return np.concatenate(parts)

    return zeta


def frozen(correction, remembered, paths, steps, seed=1):
    """A minimax filter with its last step frozen."""
    made = minimax_synthesis(
        settled(),
        Memory(remembered),
        STEP * np.arange(steps),
        paths=paths,
        seed=seed,
        correction=correction,
    )
    return replace(made, cycle=1)


def forecasts(mean_degree, cov_degree, paths, steps, seed=1):
    """A filter of polynomial forecasts of its last estimate, with its last step frozen."""
    made = synthesize(
        settled(),
        Memory(1),
        Cubature(),
        STEP * np.arange(steps),
        paths=paths,
        seed=seed,
        predictor=Polynomial(mean_degree, cov_degree),
    )
    return replace(made, cycle=1)


def forgetful(y, span, average):
    """Means of the unscented filter whose covariance is that of the last `span` steps alone.

    Before them it is `average`, (n, n). So the gain is a function of so many remembered
    estimates, and of nothing else.
    """
    filter, runs = CovarianceFilter(lorenz96(), Unscented(1.0, 2.0, 0.0)), y.shape[2]
    state = filter.initial((runs,))
    start, kept, found = np.broadcast_to(average[..., None], (SIZE, SIZE, runs)), [], []
    for k, (t, seen) in enumerate(zip(TIMES, y, strict=False)):
        past = kept[-span:] if span else []
        if k == 0 or not past:
            state = filter.predict(state, t)
        else:
            cov = start if k > span else filter.initial((runs,)).cov
            for age, mean in enumerate(past):
                if age:  # the covariance after that measurement, whose value does not matter
                    cov = filter.correct(state, np.zeros((5, runs))).cov
                state = state._replace(time=t - STEP, mean=mean, cov=cov)
                state = filter.predict(state, t)
        if not span and k:
            state = state._replace(cov=start)
        state = filter.correct(state, seen)
        kept.append(state.mean)
        found.append(state.mean)
    return np.array(found)


def average_covariance(y, after):
    """Mean covariance of the unscented filter after the measurement, or before it."""
    filter = CovarianceFilter(lorenz96(), Unscented(1.0, 2.0, 0.0))
    state, total = filter.initial((y.shape[2],)), 0.0
    for k, (t, seen) in enumerate(zip(TIMES, y, strict=False)):
        ahead = filter.predict(state, t)
        state = filter.correct(ahead, seen)
        if k >= SPIN:
            total = total + (state if after else ahead).cov.mean(axis=-1)
    return total / (len(y) - SPIN)


def errors(mean, data):
    """Errors of runs: the mean over the later measurements."""
    runs = mean.shape[2]
    return np.sqrt(((mean - data.states[..., :runs]) ** 2).mean(axis=1))[SPIN:]


def main(only=()) -> None:
    """Write the table, or print the rows whose names begin with one of `only`."""
    warnings.simplefilter("ignore")
    data = lorenz96().simulate(TIMES, 100, 1)
    y = data.measurements
    file = sys.stdout if only else (HERE / "field_lorenz96.csv").open("w", newline="")
    table = csv.writer(file, lineterminator="\n")
    table.writerow(COLUMNS)

    def put(name, setting, run, runs=RUNS, numbers="", paths="", design=None):
        if only and not any(f"{name} {setting}".startswith(part) for part in only):
            return
        spent = ""
        if design is not None:
            begin = time.process_time()
            filter = design()
            spent = f"{time.process_time() - begin:.0f}"
            run = lambda y: filter.run(TIMES, y).mean  # noqa: E731
        with np.errstate(all="ignore"):
            begin = time.process_time()
            mean = run(y[..., :runs])
            cost = (time.process_time() - begin) / runs / MEASUREMENTS
        found = errors(np.where(np.isfinite(mean), mean, 1e3), data)
        each = found.mean(axis=0)
        table.writerow(
            (
                name,
                setting,
                paths,
                spent,
                numbers,
                runs,
                f"{each.mean():.4f}",
                f"{each.std(ddof=1) / np.sqrt(runs):.4f}",
                f"{found.max():.2f}",
                f"{1e6 * cost:.2f}",
            )
        )
        file.flush()

    mean, _ = CLIMATE
    put("climate", "", lambda y: np.full((len(y), SIZE, y.shape[2]), mean), numbers=0)
    for members, inflation in ((8, 1.05), (8, 1.1), (12, 1.04), (20, 1.03)):
        put(
            f"ensemble {members}",
            f"inflation {inflation}",
            lambda y, a=members, b=inflation: ensemble(y, a, b),
            numbers=members * SIZE,
        )
    rules = {
        "extended": Differences(),
        "cubature": Cubature(),
        "unscented": Unscented(1.0, 2.0, 0.0),
    }
    for name, rule in rules.items():
        filter = CovarianceFilter(lorenz96(), rule)
        for inflation in (1.0, 1.02) if name == "unscented" else (1.0, 1.02, 1.05):
            put(
                name,
                f"inflation {inflation}",
                lambda y, f=filter, a=inflation: inflated(f, y, a),
                numbers=65,
            )
        if name == "unscented":
            continue
        filter = CovarianceFilter(lorenz96(0.01), rule)
        put(name, "q 0.01", lambda y, f=filter: f.run(TIMES, y).mean, numbers=65)
    for members, share, width in ((50, 0.3, 1.7), (100, 0.2, 1.3), (800, 0.2, 0.8)):
        put(
            f"jittered {members}",
            f"share {share} width {width}",
            lambda y, a=members, b=share, c=width: jittered(y, a, b, c),
            SOME,
            members * SIZE,
        )
    for members, noise in ((50, 0.3), (100, 0.1)):
        filter = ParticleFilter(lorenz96(noise), members)
        put(
            f"bootstrap {members}",
            f"q {noise}",
            lambda y, f=filter: f.run(TIMES, y, seed=1).mean,
            SOME,
            members * SIZE,
        )
    for first, second, paths in ((2, 0, 8192), (2, 1, 8192), (2, 2, 8192)):
        put(
            "forecasts",
            f"degrees {first} {second}",
            None,
            numbers=SIZE,
            paths=paths,
            design=lambda a=first, b=second, c=paths: forecasts(a, b, c, 60),
        )
    for degree, remembered, paths in ((2, 1, 8192),):
        put(
            f"polynomial {degree}",
            f"remembers {remembered}",
            None,
            numbers=SIZE * remembered,
            paths=paths,
            design=lambda a=degree, b=remembered, c=paths: frozen(BoundedPolynomial(a), b, c, 60),
        )
    for degree, near, paths, steps, runs in (
        (0, 5, 4096, 60, RUNS),
        (0, 5, 16384, 60, RUNS),
        (1, 5, 4096, 60, RUNS),
        (1, 5, 16384, 60, RUNS),
        (2, 2, 16384, 60, RUNS),
        (3, 2, 32768, 80, 100),
    ):
        put(
            f"gain {degree}",
            f"within {near} of {paths}",
            None,
            runs=runs,
            numbers=SIZE,
            paths=paths,
            design=lambda a=degree, b=near, c=paths, d=steps: frozen(scheduled(a, b), 1, c, d),
        )
    if not only or any(part.startswith("span") for part in only):
        before, after = (average_covariance(y[..., :40], after) for after in (False, True))
        for span in (0, 1, 2, 4, 8):
            put(
                f"span {span}",
                "",
                lambda y, a=span: forgetful(y, a, after if a else before),
                40,
                SIZE * span,
            )
    if not only:
        file.close()


if __name__ == "__main__":
    main(sys.argv[1:])
