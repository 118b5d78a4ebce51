"""Time of Kalman-family filters against filterpy, statsmodels and dynamax, as ratios.

Run by hand, ``python benchmarks/peers_speed.py``; writes ``benchmarks/peers_speed.csv`` beside
itself. Four states, two measured numbers, 200 records; tracks go through filterpy and statsmodels
one after another. All run in one process with repetitions interleaved; of each the best counts.
`ratio` is the time of the other program over ours: above one ours is faster. dynamax takes part
where it is installed, compiled and vectorised over the tracks, with its compilation left out.
"""

from __future__ import annotations

import csv
import importlib.util
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np
from filterpy import kalman
from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

from peers.models import bent, linear, system
from seedslib.filters import KalmanFilter, extended_kalman, smooth, unscented_kalman

STEPS, TRACKS, FEW, ROUNDS = 200, 1000, 10, 3
MODEL = linear(1, 4, 2, steps=STEPS)
BENT = bent(2, 4, 2, steps=STEPS)
TIMES = np.arange(float(STEPS))


def filterpy_kalman(y):
    made = kalman.KalmanFilter(4, 2)
    made.x, made.P, made.F, made.Q = MODEL.mean, MODEL.cov, MODEL.F, MODEL.Q
    made.H, made.R = MODEL.H, MODEL.R
    return made, made.batch_filter(y)


def filterpy_smoother(y):
    made, (means, covs, _, _) = filterpy_kalman(y)
    return made.rts_smoother(means, covs)


class Extended(kalman.ExtendedKalmanFilter):
    def predict_x(self, u=0):
        self.x, self.F = BENT.move(self.x), BENT.move_slope(self.x)


def filterpy_extended(y):
    made = Extended(4, 2)
    made.x, made.P, made.Q, made.R = BENT.mean, BENT.cov, BENT.Q, BENT.R
    for row in y:
        made.predict()
        made.update(row, BENT.see_slope, BENT.see)


def filterpy_unscented(y):
    points = kalman.MerweScaledSigmaPoints(4, 0.8, 2.0, 1.0)
    made = kalman.UnscentedKalmanFilter(4, 2, 1.0, BENT.see, lambda x, dt: BENT.move(x), points)
    made.x, made.P, made.Q, made.R = BENT.mean, BENT.cov, BENT.Q, BENT.R
    made.batch_filter(y)


def statsmodels(y):
    made = KalmanSmoother(k_endog=2, k_states=4, k_posdef=4)
    made.bind(np.array(y, order="C"))
    made["transition"], made["state_cov"], made["selection"] = MODEL.F, MODEL.Q, np.eye(4)
    made["design"], made["obs_cov"] = MODEL.H, MODEL.R
    made.initialize_known(MODEL.mean, MODEL.cov)
    return made


def dynamax(y):
    """Work of dynamax on tracks (K, 2, tracks), by case; empty where it is not installed."""
    if not importlib.util.find_spec("dynamax"):
        return {}
    import jax
    from peers_dynamax import extended, kalman, unscented

    jax.config.update("jax_enable_x64", True)
    records, found = np.moveaxis(y, -1, 0), {}
    for name, method, model, part in (
        ("Kalman filter", kalman, MODEL, "filtered_means"),
        ("Kalman smoother", kalman, MODEL, "smoothed_means"),
        ("extended filter", extended, BENT, "filtered_means"),
        ("unscented filter", unscented, BENT, "filtered_means"),
    ):

        def one(record, method=method, model=model, part=part):
            return getattr(method(model._replace(y=record)), part)

        work = jax.jit(jax.vmap(one))
        work(records).block_until_ready()
        found[name] = lambda work=work: work(records).block_until_ready()
    return found


def cases(count):
    """Work by case and program, and how many of the tracks each does."""
    linear_y = np.repeat(MODEL.y[..., None], count, axis=-1)
    bent_y = np.repeat(BENT.y[..., None], count, axis=-1)
    kf, ekf = KalmanFilter(system(MODEL)), extended_kalman(system(BENT))
    ukf = unscented_kalman(system(BENT), alpha=0.8, beta=2.0, kappa=1.0)
    if count == 1:
        linear_y, bent_y = MODEL.y, BENT.y
    few = min(count, FEW)
    there = dynamax(bent_y.reshape(STEPS, 2, count))
    for name, ours, other in (
        ("Kalman filter", lambda: kf.run(TIMES, linear_y), filterpy_kalman),
        ("Kalman smoother", lambda: smooth(kf, TIMES, linear_y), filterpy_smoother),
        ("extended filter", lambda: ekf.run(TIMES, bent_y), filterpy_extended),
        ("unscented filter", lambda: ukf.run(TIMES, bent_y), filterpy_unscented),
    ):
        y = MODEL.y if "Kalman" in name else BENT.y
        work = {"ours": (ours, 1)}
        work["filterpy"] = (lambda y=y, other=other: [other(y) for _ in range(few)], count / few)
        if "Kalman" in name:
            made, part = statsmodels(y), "smooth" if "smoother" in name else "filter"
            run = getattr(made, part)
            work["statsmodels"] = (lambda run=run: [run() for _ in range(few)], count / few)
        if name in there:
            work["dynamax"] = (there[name], 1)
        yield name, work
    made = statsmodels(MODEL.y)
    yield (
        "log-likelihood",
        {
            "ours": (lambda: kf.run(TIMES, linear_y).loglik.sum(axis=0), 1),
            "statsmodels": (lambda: [made.loglike() for _ in range(few)], count / few),
        },
    )


def main() -> None:
    rows = []
    for count in (1, TRACKS):
        for name, work in cases(count):
            best = dict.fromkeys(work, np.inf)
            for _ in range(ROUNDS):
                for program, (run, share) in work.items():
                    begin = time.perf_counter()
                    run()
                    spent = (time.perf_counter() - begin) * share
                    best[program] = min(best[program], spent)
            for program in work:
                if program != "ours":
                    ratio = float(f"{best[program] / best['ours']:.2g}")
                    rows.append([name, count, program, f"{ratio:g}"])
                    print(*rows[-1], flush=True)
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([["case", "tracks", "program", "ratio"], *rows])


if __name__ == "__main__":
    main()
