"""Time of a step of compiled filters beside C, NumPy and dynamax.

Run by hand, ``python benchmarks/native.py``; writes ``benchmarks/native.csv`` beside itself. Wants
a C compiler called ``cc``; dynamax takes part where it is installed. Four states,
two measured numbers, double precision, one core. A step is the forecast to a measurement and the
correction by it; mean, covariance and likelihood of every step are handed out, but by dynamax,
which gives the likelihood of a record only.

The Kalman filter of a target in a plane; an extended Kalman filter and one of finite order (one
estimate remembered, affine forecasts) of two coupled Duffing oscillators, which are polynomials; an
unscented filter of a target of which range and bearing are measured; an IMM filter of one that
moves in three ways.

"compiled" and "NumPy" are `run` of 4096 records of 31 measurements at once, dynamax is compiled and
vectorised over them. "C" is the exported header, one record after the other. "compiled, one record"
is a record step by step from Python, and "floats, one record" that of the filter itself; "floats,
whole record" is its `run`. All run in one process, repetitions interleaved; of each the shortest
processor time counts.
"""

from __future__ import annotations

import csv
import ctypes
import importlib.util
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.export import compiled, to_c
from seedslib.filters import KalmanFilter, extended_kalman, unscented_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap, SwitchingSystem

TIMES, TRACKS, ROUNDS = np.arange(31.0), 4096, 60

x = x1, x2, x3, x4 = sympy.symbols("x1:5", real=True)
w, v = sympy.symbols("w1:5", real=True), sympy.symbols("v1:3", real=True)

F = np.eye(4) + 0.1 * np.eye(4, k=2)
Q, H, R = 0.01 * np.eye(4), np.eye(2, 4), 0.1 * np.eye(2)
TARGET = np.array([8.0, 3.0, 0.2, -0.1]), np.diag([1.0, 1.0, 0.1, 0.1])
BEARING = np.diag([0.1, 1e-3])
TURNS, STAY = (0.0, 0.3, -0.3), np.array([[0.9, 0.05, 0.05], [0.1, 0.85, 0.05], [0.1, 0.05, 0.85]])


def duffing(x: Any) -> list[Any]:
    """Two coupled oscillators after a time step of 0.1."""
    p, q, a, b = x
    pull = 0.1 * (p - q)
    return [
        p + 0.1 * a,
        q + 0.1 * b,
        0.95 * a - 0.1 * p - 0.02 * p * p * p - pull,
        0.95 * b - 0.1 * q - 0.02 * q * q * q + pull,
    ]


def squares(x: Any) -> list[Any]:
    """What is measured of the oscillators."""
    return [x[0] + 0.1 * x[1] * x[1], x[1] + 0.1 * x[0] * x[2]]


def turned(x: Any, angle: float, cos: Any = np.cos, sin: Any = np.sin) -> list[Any]:
    """A target after a time step in which its velocity turns."""
    p, q, a, b = x
    return [p + a, q + b, cos(angle) * a - sin(angle) * b, sin(angle) * a + cos(angle) * b]


def noisy(map: list[Any], noises: Any, cov: np.ndarray) -> StochasticMap:
    return StochasticMap(
        x, [e + n for e, n in zip(map, noises, strict=True)], Noise(noises, cov=cov)
    )


def filters() -> dict[str, Any]:
    """Filters by name; the designed one on few trajectories: its accuracy is not asked for."""
    kalman = KalmanFilter(LinearSystem(F, Q, H, R, np.zeros(4), np.eye(4)))
    bend = DiscreteSystem(noisy(duffing(x), w, Q), noisy(squares(x), v, R), np.zeros(4), np.eye(4))
    shown = [sympy.sqrt(x1**2 + x2**2), sympy.atan2(x2, x1)]
    target = DiscreteSystem(noisy(turned(x, 0.0), w, Q), noisy(shown, v, BEARING), *TARGET)
    moves = [[e + n for e, n in zip(turned(x, g), w, strict=True)] for g in TURNS]
    modes = SwitchingSystem(
        x,
        moves,
        Noise(w, cov=Q),
        STAY.tolist(),
        [[x1 + v[0], x2 + v[1]]] * 3,
        Noise(v, cov=R),
        [(1 / 3, TARGET[0], TARGET[1])] * 3,
    )
    return {
        "Kalman": kalman,
        "extended, polynomial": extended_kalman(bend),
        "finite order": synthesize(bend, Memory(1), Taylor(), TIMES, paths=2000, seed=1, nodes=0),
        "unscented": unscented_kalman(target),
        "IMM, three modes": SwitchingFilter(modes, Taylor()),
    }


# Another program: work on records (tracks, K, 2), by filter


def dynamax(records: dict[str, np.ndarray]) -> dict[str, Callable[[], Any]]:
    if not importlib.util.find_spec("dynamax"):
        return {}
    import jax
    import jax.numpy as jnp
    from dynamax import linear_gaussian_ssm as plain
    from dynamax import nonlinear_gaussian_ssm as bends

    jax.config.update("jax_enable_x64", True)
    asarray = jnp.array
    linear = plain.inference.make_lgssm_params(*map(asarray, (np.zeros(4), np.eye(4), F, Q, H, R)))
    oscillators = bends.ParamsNLGSSM(
        *map(asarray, (np.zeros(4), np.eye(4))),
        lambda x: jnp.stack(duffing(x)),
        asarray(Q),
        lambda x: jnp.stack(squares(x)),
        asarray(R),
    )
    target = bends.ParamsNLGSSM(
        *map(asarray, TARGET),
        lambda x: jnp.stack([x[0] + x[2], x[1] + x[3], x[2], x[3]]),
        asarray(Q),
        lambda x: jnp.stack([jnp.sqrt(x[0] ** 2 + x[1] ** 2), jnp.arctan2(x[1], x[0])]),
        asarray(BEARING),
    )
    rule = bends.UKFHyperParams(1.0, 0.0, 0.0)
    each = {
        "Kalman": lambda y: plain.lgssm_filter(linear, y),
        "extended, polynomial": lambda y: bends.extended_kalman_filter(oscillators, y),
        "unscented": lambda y: bends.unscented_kalman_filter(target, y, rule),
    }

    def work(name: str, one: Callable[[Any], Any]) -> Callable[[], Any]:
        def parts(y: Any) -> Any:
            result = one(y)
            return result.filtered_means, result.filtered_covariances, result.marginal_loglik

        run, y = jax.jit(jax.vmap(parts)), asarray(records[name])
        return lambda: jax.block_until_ready(run(y))

    return {name: work(name, one) for name, one in each.items()}


# Ours

DRIVER = """
#include "NAME.h"
void NAME_records(int records, int count, const double *t, const double *y);
void NAME_records(int records, int count, const double *t, const double *y)
{
    volatile double sum = 0.0;
    (void)t;
    for (int i = 0; i < records; i++) {
        NAME_state s;
        NAME_init(&s);
        for (int k = 0; k < count; k++) NAME_step(&s, TIME y + (i * count + k) * 2);
        sum += s.mean[0];
    }
}
"""


def in_c(made: dict[str, Any], records: dict[str, np.ndarray], folder: str) -> dict[str, Any]:
    """Work of the exported headers on a tenth of the records."""
    sources = []
    for k, filter in enumerate(made.values()):
        text = to_c(filter, Path(folder) / f"f{k}.h", name=f"f{k}")
        timed = "t[k]," if "double time, const" in text else ""
        sources.append(DRIVER.replace("NAME", f"f{k}").replace("TIME", timed))
    (Path(folder) / "all.c").write_text("\n".join(sources))
    flags = ["-std=c99", "-O3", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "all.c", "-o", "all.so", "-lm"], cwd=folder, check=True)
    library, found = ctypes.CDLL(str(Path(folder) / "all.so")), {}
    for k, name in enumerate(made):
        function = getattr(library, f"f{k}_records")
        function.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
        given = TRACKS // 10, len(TIMES), TIMES.ctypes.data, records[name].ctypes.data
        found[name] = lambda f=function, given=given: f(*given)
    return found


def steps(filter: Any, y: np.ndarray) -> None:
    state = filter.initial()
    for t, row in zip(TIMES, y, strict=True):
        state = filter.step(state, t, row)


def programs(folder: str) -> Iterator[tuple[str, str, Callable[[], Any], int]]:
    """Filter, program, work, and how many records it is."""
    made = filters()
    y = {
        name: np.ascontiguousarray(f.system.simulate(TIMES, TRACKS, 3).measurements)
        for name, f in made.items()
    }
    records = {name: np.ascontiguousarray(np.moveaxis(part, -1, 0)) for name, part in y.items()}
    scalar = in_c(made, records, folder)
    peer = dynamax(records)
    for name, filter in made.items():
        twin, own = compiled(filter), y[name]
        more = {"covariances": True} if "covariances" in filter.takes else {}
        for program, one in (("compiled", twin), ("NumPy", filter)):
            yield name, program, lambda one=one, y=own, o=more: one.run(TIMES, y, **o), TRACKS
        yield name, "C", scalar[name], TRACKS // 10
        one = own[..., 0].copy()
        yield name, "compiled, one record", lambda f=twin, y=one: steps(f, y), 1
        yield name, "floats, one record", lambda f=filter, y=one: steps(f, y), 1
        yield name, "floats, whole record", lambda f=filter, y=one, o=more: f.run(TIMES, y, **o), 1
        if name in peer:
            yield name, "dynamax", peer[name], TRACKS


def processor() -> str:
    """Name of the processor, as the system gives it."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))


def main() -> None:
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    load, best = os.getloadavg()[0], {}
    with tempfile.TemporaryDirectory() as folder:
        known = list(programs(folder))
        for _, _, work, _ in known:
            work()
        for turn in range(ROUNDS):
            for name, program, work, count in known:
                if turn % 10 and not program.startswith("compiled"):
                    continue  # they take long
                for _ in range(30 if count == 1 else 1):
                    begin = time.process_time()
                    work()
                    spent = (time.process_time() - begin) / count / len(TIMES)
                    best[name, program] = min(best.get((name, program), np.inf), spent)
    about = f"{processor()}, load {load:.1f} to {os.getloadavg()[0]:.1f}"
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["filter", "program", "nanoseconds", "machine"])
        for k, ((name, program), seconds) in enumerate(best.items()):
            row = [name, program, f"{1e9 * seconds:.4g}", about if k == 0 else ""]
            writer.writerow(row)
            print(*row)


if __name__ == "__main__":
    main()
