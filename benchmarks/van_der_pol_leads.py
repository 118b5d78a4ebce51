"""How far filters of the Van der Pol oscillator are ahead of the extended Kalman filter.

Run by hand, ``python benchmarks/van_der_pol_leads.py``; writes ``benchmarks/van_der_pol_leads.csv``
beside itself. Sixteen sets of 32 768 paths each, other than those of the designs; the lead is the
RMS error of x1 of the extended filter less that of another on the same paths, after each
measurement and a step of 0.01 before it. Object, extended filter and continuous forecast by
Euler's method.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from seedslib import zoo
from seedslib.design import Continuous, synthesize
from seedslib.designed import Memory, finite_memory
from seedslib.evaluation import compare
from seedslib.filters import Filter, extended_kalman
from seedslib.linearization import Taylor

TACTS = np.arange(7) * 0.5
SETS, PATHS, DESIGN = 16, 32_768, 16_384
DESIGNED = {
    "one estimate, continuous": (Memory(1), {"predictor": Continuous()}),
    "one estimate": (Memory(1), {}),
    "four estimates": (Memory(4), {}),
    "four measurements": (finite_memory(4), {}),
}


def main() -> None:
    system = zoo.van_der_pol()
    clock = np.unique(np.round(np.concatenate([TACTS, TACTS[1:] - 0.01]), 9))
    filters: dict[str, Filter] = {"extended": extended_kalman(system, integrator="euler")}
    for name, (memory, options) in DESIGNED.items():
        made = synthesize(system, memory, Taylor(), TACTS, paths=DESIGN, seed=1, **options)
        filters[name] = made.forecasting("piecewise constant")
    rows = []
    for number in range(SETS):
        table = compare(filters, system, clock, PATHS, 100 + number, components=1)
        for name in DESIGNED:
            lead = table.difference("extended", name).rms[:, 0]
            for k in range(1, len(TACTS)):
                at = np.searchsorted(clock, TACTS[k] - 1e-6)
                for when, place in (("before", at - 1), ("after", at)):
                    rows.append([number, name, f"{TACTS[k]:g}", when, f"{lead[place]:.6f}"])
        print(number, *rows[-1])
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["set", "filter", "measurement", "when", "lead"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
