"""Measure the library's errors against the references: ``python tests/references/measure.py``.

Under every kernel of OpenBLAS and every set of loops of NumPy that this processor can pretend to
have; `errors.csv` keeps the largest error of each value, and the bound that the test holds it to:
twice that, and at least four units of the last place of one. `families.csv` sums it up.
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
FILE = Path(__file__).with_name("errors.csv")
KERNELS = "OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES"
LEAST = 4 * 2.0**-52


def bound(family: str, error: float) -> float:
    """Two digits, rounded up."""
    value = f"{2.05 * error:.1e}" if error else "0"
    return max(LEAST, float(value))


def settings() -> dict[str, dict[str, str]]:
    """Kernels that this processor can use: variables of the environment by a name."""
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    plain = {"NPY_DISABLE_CPU_FEATURES": " ".join(found)} if found else {}
    needed = {"Prescott": "", "Nehalem": "", "Haswell": "X86_V3", "SkylakeX": "X86_V4"}
    made = {}
    for name, group in needed.items():
        if not group or group in found:
            kernels = {"OPENBLAS_CORETYPE": name}
            made |= {f"{name}, plain loops": kernels | plain, name: kernels}
    return made


def main() -> None:
    from references.comparison import found_errors, summary, table

    if "--own" in sys.argv:
        for key, error in found_errors().items():
            print("\t".join(key), error, sep="\t")
        return
    if any(name in os.environ for name in KERNELS):
        sys.exit(f"wanted an environment without {' and '.join(KERNELS)}")
    worst: dict[tuple[str, ...], float] = {}
    for name, more in settings().items():
        told = subprocess.run(
            [sys.executable, __file__, "--own"],
            env=os.environ | more,
            text=True,
            check=True,
            stdout=subprocess.PIPE,
        ).stdout
        print(name, len(told.splitlines()))
        for line in told.splitlines():
            *key, error = line.split("\t")
            worst[tuple(key)] = max(worst.get(tuple(key), 0.0), float(error))
    with FILE.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["family", "case", "quantity", "error", "bound"])
        writer.writerows(
            [*key, f"{e:.1e}", f"{bound(key[0], e):.3g}"]
            for key in table("values.csv")
            for e in [worst[key]]
        )
    with FILE.with_name("families.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["family", "values", "worst error", "median error", "computed by"])
        writer.writerows(
            [family, count, f"{largest:.0e}", f"{middle:.0e}", provenance]
            for family, count, largest, middle, provenance in summary()
        )


if __name__ == "__main__":
    sys.path[:1] = [str(ROOT / "tests"), str(ROOT / "book"), str(ROOT)]
    main()
