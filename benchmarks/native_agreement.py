"""How far exported C and JavaScript are from Python along 100 000 steps.

Run by hand, ``python benchmarks/native_agreement.py``; writes ``benchmarks/native_agreement.csv``
beside itself. Wants a C compiler and node; takes some minutes on four cores. Records are 100
simulated ones of 1000 measurements, one behind the other, so that every filter is surprised a
hundred times; 10 000 steps of the IMM filter, whose Python is slow. A row tells after so many steps
the largest distance of an estimate from that of Python, in deviations that the filter claims there;
`bound` is what the header of ``float`` says of itself, four times the worst of 100 records of 1000
steps. `odd` says whether gaps, infinite numbers and 1e300 are answered alike: the same codes, and
the same means and variances within 1e-9 (of float not asked).

The polynomial design is one of few paths: surprised, in about a step of four hundred it is thrown
to where no path was, and there its cubic forecasts make any difference larger, until Python, C and
JavaScript go their own ways. That is the filter's, not the language's.
"""

from __future__ import annotations

import csv
import ctypes
import re
import shutil
import subprocess
import tempfile
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import sympy

from seedslib import zoo
from seedslib.design import Polynomial, grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, SwitchingFilter, large_order
from seedslib.extra import to_c, to_js
from seedslib.filters import extended_kalman, unscented_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

STEPS = (100, 1000, 10_000, 100_000)
PART = 1000
ODD = {3: (np.nan, np.nan), 6: (np.nan, 0.3), 9: (np.inf, 0.1), 12: (0.2, -np.inf)}
HUGE = {15: (1e300, 0.1), 18: (-1e300, 1e300)}

RECORD = """
int record(int count, const double *t, const double *y, double *out);
int record(int count, const double *t, const double *y, double *out)
{
    REAL shown[F_MEASUREMENT];
    f_state s;
    int i, k;
    (void)t;
    f_init(&s);
    for (k = 0; k < count; k++) {
        for (i = 0; i < F_MEASUREMENT; i++) shown[i] = (REAL)y[k * F_MEASUREMENT + i];
        *out++ = f_step(&s, TIMEshown);
        for (i = 0; i < SIZE; i++) *out++ = s.mean[i];
        for (i = 0; i < SIZE; i++) *out++ = s.cov[i][i];
    }
    return 0;
}
"""

SCRIPT = """
import { init, step } from './f.mjs';
import { readFileSync, writeFileSync } from 'fs';
const read = (name) => new Float64Array(Uint8Array.from(readFileSync(name)).buffer);
const t = read('t.bin'), y = read('y.bin'), m = y.length / t.length, out = [], s = init();
for (let k = 0; k < t.length; k++) {
  out.push(step(s, TIMEy.subarray(m * k, m * k + m)));
  const mean = s.mean, cov = s.cov;
  out.push(...mean, ...mean.map((_, i) => cov[i * (mean.length + 1)]));
}
writeFileSync('out.bin', Float64Array.from(out));
"""


def walk():
    """A walk in the plane, seen through a sine and an angle."""
    a, b, u, v, w = sympy.symbols("a b u v w", real=True)
    move = StochasticMap((a, b), [0.9 * a + b, 0.7 * b + v], Noise((v,), cov=[[0.1]]))
    seen = [sympy.sin(a) + a + w, sympy.atan2(b, 3 + a**2) + u]
    return DiscreteSystem(move, StochasticMap((a, b), seen, Noise((w, u))), [0, 0.1], np.eye(2) / 2)


def lasting(**options):
    """A design of the oscillator that goes on for ever."""
    design = {"paths": 800, "seed": 1, "nodes": 0}
    times = 0.5 * np.arange(12.0)
    made = synthesize(zoo.van_der_pol(), Memory(1), ExactGaussian(), times, **design, **options)
    return stationary(made, tolerance=5.0, paths=100, cycle=2)


def table():
    """A table of the flip process that goes on for ever."""
    made = grid_synthesis(
        zoo.flip_process(), large_order(2), 0.25 * np.arange(12.0), x=(-3.5, 3.5, 61),
        z=(-2.5, 2.5, 13), y=(-8, 8, 25), nodes=0,
    )  # fmt: skip
    return stationary(made, tolerance=1.0, paths=200)


FILTERS = {
    "unscented": lambda: unscented_kalman(walk()),
    "extended": lambda: extended_kalman(walk()),
    "designed, polynomial": lambda: lasting(predictor=Polynomial(3, 2)),
    "designed": lasting,
    "table": table,
    "IMM": lambda: SwitchingFilter(zoo.scalar_switching(), Taylor()),
}
FEWER = {"IMM": 10_000}


def record(filter, count):
    """Times and measurements."""
    times = np.arange(float(count))
    if getattr(filter, "memory", None) is not None:
        times = np.array([filter.clock.moment(k, filter.cycle) for k in range(count)])
    each = min(count, PART)
    y = filter.system.simulate(times[:each], -(-count // each), 2).measurements
    return times, np.ascontiguousarray(np.moveaxis(y, -1, 0).reshape(-1, y.shape[1])[:count])


def by_python(filter, times, y):
    """Codes, means and variances; an infinite measurement is refused with code 2."""
    codes = 2.0 * np.isinf(y).any(axis=1)
    options = {"covariances": True} if "covariances" in filter.takes else {}
    if not codes.any():
        found = filter.run(times, y, **options)
        return np.column_stack([codes, found.mean, np.einsum("kii->ki", found.cov)])
    rows, state = [], filter.initial()
    for t, shown, code in zip(times, y, codes, strict=True):
        try:
            state = filter.step(state, t, shown)
            code = 0.0
        except ValueError:
            code = 2.0
        told = filter.report(state)
        cov = np.full(2 * [len(told.mean)], np.nan) if told.cov is None else told.cov
        rows.append(np.concatenate([[code], told.mean, np.diag(cov)]))
    return np.array(rows)


def by_c(filter, times, y, real, folder):
    """The same by C, and the bound that its header states."""
    text = to_c(filter, name="f", real=real)
    timed = f"({real})t[k], " * bool(re.search(r"_step\(f_state \*s, \w+ t,", text))
    size = "F_ESTIMATE" if "#define F_ESTIMATE " in text else "F_STATE"
    made = RECORD.replace("REAL", real).replace("TIME", timed).replace("SIZE", size)
    (folder / f"{real}.c").write_text(text + made)
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC"]
    line = ["cc", *flags, f"{real}.c", "-o", f"{real}.so", "-lm"]
    subprocess.run(line, cwd=folder, check=True)
    n = getattr(filter, "components", None) or filter.system.state_size
    found = np.empty((len(times), 1 + 2 * n))
    places = [ctypes.c_void_p(part.ctypes.data) for part in (times, y, found)]
    ctypes.CDLL(str(folder / f"{real}.so")).record(len(times), *places)
    told = re.search(r"by at most (\S+) of the", text.replace("\n * ", " "))
    return found, told[1] if told else ""


def by_javascript(filter, times, y, folder):
    """The same by node."""
    text = to_js(filter, folder / "f.mjs")
    timed = "t[k], " * ("step(state, t, y" in text)
    (folder / "run.mjs").write_text(SCRIPT.replace("TIME", timed))
    times.tofile(folder / "t.bin")
    y.tofile(folder / "y.bin")
    subprocess.run(["node", "run.mjs"], cwd=folder, check=True)
    return np.fromfile(folder / "out.bin").reshape(len(times), -1)


def apart(found, wanted):
    """Distances of the means of each step, in deviations claimed; infinite where only one is."""
    n = (wanted.shape[1] - 1) // 2
    with np.errstate(all="ignore"):
        scale = np.sqrt(np.abs(wanted[:, 1 + n :]))
        away = np.abs(found[:, 1 : 1 + n] - wanted[:, 1 : 1 + n]) / np.where(scale > 0, scale, 1.0)
    same = found[:, 1 : 1 + n] == wanted[:, 1 : 1 + n]
    lost = ~np.isfinite(wanted[:, 1 : 1 + n]) & ~np.isfinite(found[:, 1 : 1 + n])
    away = np.where(same | lost, 0.0, away)
    return np.where(np.isnan(away), np.inf, away).max(axis=1)


def odd(filter, count=24):
    """Whether all three answer gaps, infinite and absurd numbers alike, by language."""
    times, y = record(filter, count)
    for k, row in (ODD | HUGE).items():
        y[k] = np.nan if np.isnan(row).all() else np.resize(row, y.shape[1])
        if y.shape[1] == 1:
            y[k] = next((x for x in row if not abs(x) < 1), row[0])
    # what is refused is followed by another measurement of the same time
    times = times[np.cumsum(~np.isinf(np.roll(y, 1, axis=0)).any(axis=1)) - 1]
    with np.errstate(all="ignore"), tempfile.TemporaryDirectory() as made:
        wanted, folder = by_python(filter, times, y), Path(made)
        found = {"C": by_c(filter, times, y, "double", folder)[0]}
        if shutil.which("node"):
            found["JavaScript"] = by_javascript(filter, times, y, folder)
    return {
        name: np.allclose(part, wanted, rtol=1e-9, atol=1e-9, equal_nan=True)
        for name, part in found.items()
    }


def compare(name, count=None):
    """Rows of the table of one filter."""
    warnings.simplefilter("ignore")
    count = count or FEWER.get(name, STEPS[-1])
    filter = FILTERS[name]()
    times, y = record(filter, count)
    wanted, alike, rows = by_python(filter, times, y), odd(filter), []
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        found = {("C", real): by_c(filter, times, y, real, folder) for real in ("double", "float")}
        if shutil.which("node"):
            found["JavaScript", "double"] = by_javascript(filter, times, y, folder), ""
    for (language, real), (part, bound) in found.items():
        away = apart(part, wanted)
        for steps in STEPS:
            if steps <= count:
                said = alike.get(language, "") if real == "double" else ""
                row = [name, language, real, steps, f"{away[:steps].max():.1e}", bound, said]
                rows.append(row)
    return rows


def main():
    rows = []
    with ProcessPoolExecutor(4) as crew:
        for part in crew.map(compare, FILTERS):
            rows += part
            print(*map(str, part), sep="\n", flush=True)
    with open(Path(__file__).with_suffix(".csv"), "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["filter", "language", "real", "steps", "apart", "bound", "odd"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
