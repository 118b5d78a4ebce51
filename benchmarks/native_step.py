"""Time of one step in exported C and JavaScript against the same filters in Python.

Run by hand, ``python benchmarks/native_step.py``; writes ``benchmarks/native_step.csv`` beside
itself. Wants a C compiler called ``cc``, and node where JavaScript is to be timed. Seven
measurements of a record; a step is the forecast to a measurement and the correction by it, its
covariance and likelihood included, but for tables, which have none.

The Van der Pol oscillator, two numbers measured: filters of finite order n' l = 2 l with exact
Gaussian means; the extended Kalman filter (EKF) and the assumed-density filter (FNA), which move by
Runge-Kutta or Euler steps of 0.02, 25 to an interval. A target in the plane, four numbers in
discrete time, range and bearing measured: extended and unscented Kalman filters. The same target
in three ways of moving, position measured: an IMM filter. The flip process: a table.

C runs 512 records one after another (``cc -O3 -ffp-contract=off``), JavaScript does the same in
node, step by step and by its `run`, which hands out all means and covariances; "from Python" is one
path, step by step, by `compiled`, and "Python" by the filter itself. 4096 paths are run together by
either (there in Python the likelihood too, for orders 2 and 4 not the covariance). All run in one
process but node, their repetitions interleaved; the time of each is its shortest. `load` is the
load average of the machine before and after.
"""

from __future__ import annotations

import csv
import ctypes
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import sympy

from seedslib import zoo
from seedslib.design import Polynomial, grid_synthesis, synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.extra import compiled, to_c, to_js
from seedslib.filters import assumed_density, extended_kalman, unscented_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

TIMES = 0.5 * np.arange(7)
BATCH, RECORDS, SINGLE, ROUNDS = 4096, 512, 5, 15

DRIVER = """
#include "NAME.h"
double NAME_records(int records, int count, const double *t, const double *y);
double NAME_records(int records, int count, const double *t, const double *y)
{
    double sum = 0.0;
    int i, k;
    (void)t;
    for (i = 0; i < records; i++) {
        NAME_state s;
        NAME_init(&s);
        for (k = 0; k < count; k++) {
            NAME_step(&s, TIME y + (i * count + k) * BIG_MEASUREMENT);
        }
        sum += s.mean[0];
    }
    return sum;
}
"""

SCRIPT = """
import { init, step, run, rows } from './NAME.mjs';
import { readFileSync } from 'fs';
const whole = new Float64Array(Uint8Array.from(readFileSync('NAME.bin')).buffer);
const [records, count, m] = [RECORDS, COUNT, SIZE], y = [], each = [], room = rows(COUNT);
const times = Float64Array.from({ length: count }, (_, k) => 0.5 * k);
for (let k = 0; k < records * count; k++) y.push(whole.subarray(k * m, (k + 1) * m));
for (let i = 0; i < records; i++) each.push(whole.subarray(i * count * m, (i + 1) * count * m));
function byStep() {
  let sum = 0;
  for (let i = 0; i < records; i++) {
    const s = init();
    for (let k = 0; k < count; k++) step(s, TIMEy[i * count + k]);
    sum += s.mean[0];
  }
  return sum;
}
function byRecord() {
  let sum = 0;
  for (let i = 0; i < records; i++) {
    sum += run(init(), TIMESeach[i], room).mean[room.mean.length * (count - 1) / count];
  }
  return sum;
}
const work = process.argv[2] === 'run' ? byRecord : byStep;
let best = Infinity, sum = 0;
for (let turn = 0; turn < 150; turn++) {
  const begin = process.hrtime.bigint();
  sum = work();
  best = Math.min(best, Number(process.hrtime.bigint() - begin) / records / count);
}
console.log(best, sum);
"""


def target(modes=1):
    """A target in the plane: range and bearing; with three ways of moving, its position."""
    state = x, y, p, q = sympy.symbols("x y p q", real=True)
    a, b, v, w = sympy.symbols("a b v w", real=True)
    push, noise = Noise((a, b), cov=0.01 * np.eye(2)), Noise((v, w), cov=np.diag([0.1, 1e-3]))
    mean0, cov0 = [8.0, 3.0, 0.2, -0.1], np.diag([1.0, 1.0, 0.1, 0.1])
    if modes == 1:
        move = StochasticMap(state, [x + p, y + q, p + a, q + b], push)
        see = StochasticMap(state, [sympy.sqrt(x**2 + y**2) + v, sympy.atan2(y, x) + w], noise)
        return DiscreteSystem(move, see, mean0, cov0)
    turns = (0.0, 0.3, -0.3)
    moves = [
        [x + p, y + q, np.cos(g) * p - np.sin(g) * q + a, np.sin(g) * p + np.cos(g) * q + b]
        for g in turns
    ]
    stay = [[0.9, 0.05, 0.05], [0.1, 0.85, 0.05], [0.1, 0.05, 0.85]]
    initial = [(1 / 3, mean0, cov0)] * 3
    return SwitchingSystem(state, moves, push, stay, [[x + v, y + w]] * 3, noise, initial)


def filters() -> dict:
    """Filters by name; designed on few paths, as their accuracy is not asked for here."""
    system, rule = zoo.van_der_pol(), ExactGaussian()
    design = {"paths": 2000, "seed": 1, "nodes": 0}
    one, two = large_order(1), large_order(2)
    return {
        "order 2": synthesize(system, one, rule, TIMES, **design),
        "order 4": synthesize(system, two, rule, TIMES, **design),
        "order 2, polynomial": synthesize(
            system, one, rule, TIMES, predictor=Polynomial(3, 2), **design
        ),
        "table of two numbers": grid_synthesis(
            zoo.flip_process(),
            one,
            TIMES,
            x=(-3.5, 3.5, 101),
            z=(-3, 3, 61),
            y=(-9, 9, 101),
            nodes=0,
        ),
        "EKF, Runge-Kutta": extended_kalman(system, step=0.02),
        "EKF, Euler": extended_kalman(system, step=0.02, integrator="euler"),
        "FNA, Runge-Kutta": assumed_density(system, step=0.02),
        "extended, n = 4": extended_kalman(target()),
        "unscented, n = 4": unscented_kalman(target()),
        "IMM, three modes, n = 4": SwitchingFilter(target(3), Taylor()),
    }


def in_c(made, folder) -> dict:
    """One library with all filters: its functions, seconds of which are to be measured."""
    sources = []
    for number, filter in enumerate(made.values()):
        prefix = f"f{number}"
        text = to_c(filter, Path(folder) / f"{prefix}.h", name=prefix)
        timed = "t[k]," if "double t, const double *y" in text else ""
        source = DRIVER.replace("NAME", prefix).replace("TIME", timed)
        sources.append(source.replace("BIG", prefix.upper()))
    (Path(folder) / "all.c").write_text("\n".join(sources))
    flags = ["-std=c99", "-O3", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "all.c", "-o", "all.so", "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(Path(folder) / "all.so"))
    found = {}
    for number, name in enumerate(made):
        function = getattr(library, f"f{number}_records")
        function.restype = ctypes.c_double
        function.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
        found[name] = function
    return found


def in_javascript(made, records, folder) -> tuple[dict, dict]:
    """Least seconds a step in node, and sums; nothing where there is no node."""
    if shutil.which("node") is None:
        return {}, {}
    seconds, sums = {}, {}
    for number, (name, filter) in enumerate(made.items()):
        text = to_js(filter, Path(folder) / f"j{number}.mjs")
        given = np.ascontiguousarray(records[name][:RECORDS])
        given.tofile(Path(folder) / f"j{number}.bin")
        timed = "export function step(state, t, y" in text
        script = SCRIPT.replace("NAME", f"j{number}").replace("RECORDS", str(RECORDS))
        script = script.replace("TIMES", "times, " * timed).replace("TIME", "times[k], " * timed)
        script = script.replace("COUNT", str(len(TIMES))).replace("SIZE", str(given.shape[2]))
        (Path(folder) / f"run{number}.mjs").write_text(script)
    for _ in range(5):
        for number, name in enumerate(made):
            for form, way in (("JavaScript", "step"), ("JavaScript, whole records", "run")):
                line = ["node", f"run{number}.mjs", way]
                done = subprocess.run(line, cwd=folder, check=True, capture_output=True, text=True)
                best, total = map(float, done.stdout.split())
                seconds[name, form] = min(seconds.get((name, form), np.inf), 1e-9 * best)
                sums[name] = total
    return seconds, sums


def measure() -> tuple[dict, float]:
    """Least seconds a step by (filter, form), and how far C, JavaScript and Python are apart."""
    made = filters()
    y = {name: f.system.simulate(TIMES, BATCH, 3).measurements for name, f in made.items()}
    records = {name: np.ascontiguousarray(np.moveaxis(part, -1, 0)) for name, part in y.items()}
    best: dict = {}

    def note(key, work, steps):
        begin = time.perf_counter()
        result = work()
        best[key] = min(best.get(key, np.inf), (time.perf_counter() - begin) / steps)
        return result

    apart, count = 0.0, len(TIMES)
    with tempfile.TemporaryDirectory() as folder:
        functions, quick = in_c(made, folder), {name: compiled(f) for name, f in made.items()}
        scripted, sums = in_javascript(made, records, folder)
        for turn in range(ROUNDS):
            for name, filter in made.items():
                given = (RECORDS, count, TIMES.ctypes.data, records[name].ctypes.data)
                for _ in range(8):  # short enough to fit between interruptions
                    run = lambda f=functions[name], a=given: f(*a)  # noqa: E731
                    total = note((name, "C"), run, RECORDS * count)
                own, twin, paths = y[name], quick[name], SINGLE * count
                for _ in range(4):
                    note((name, "from Python, one path"), lambda f=twin, a=own: steps(f, a), paths)
                note((name, "Python, one path"), lambda f=filter, a=own: steps(f, a), paths)
                for form, each in (("from Python", twin), ("Python", filter)):
                    run = lambda f=each, a=own: f.run(TIMES, a)  # noqa: E731
                    note((name, f"{form}, 4096 paths"), run, BATCH * count)
                if turn == 0:
                    wanted = filter.run(TIMES, own[..., :RECORDS]).mean[-1, 0].sum()
                    for found in (total, sums.get(name, wanted)):
                        apart = max(apart, abs(found / wanted - 1.0))
    return {**best, **scripted}, apart


def steps(filter, y):
    """Some paths, one after another, measurement by measurement."""
    for i in range(SINGLE):
        state = filter.initial()
        for t, shown in zip(TIMES, y[..., i], strict=True):
            state = filter.step(state, t, shown)


def main():
    load = os.getloadavg()[0]
    best, apart = measure()
    load = f"{load:.2f} to {os.getloadavg()[0]:.2f}"
    print(f"load average {load}; sums of C, JavaScript and Python differ by {apart:.1e}")
    rows = []
    for (name, form), seconds in sorted(best.items(), key=lambda row: str(row[0])):
        own = seconds / best[name, "C"]
        rows.append([name, form, f"{1e9 * seconds:.4g}", f"{own:.3g}", load])
        print(f"{name:24s} {form:24s} {1e9 * seconds:12.1f} ns {own:10.3g}")
    with open(Path(__file__).with_suffix(".csv"), "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["filter", "form", "nanoseconds_per_step", "ratio_to_c", "load"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
