"""The same numbers on other processors: NumPy and OpenBLAS made to use other kernels than here.

Both choose their code by the processor. Variables of the environment make them choose as on
another one, as long as this one has the instructions.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

NEEDED = {"Prescott": "", "Nehalem": "", "Haswell": "X86_V3", "SkylakeX": "X86_V4"}
"""Kernels of OpenBLAS, and the group of instructions that each wants beyond the common ones."""

ROOMS = (
    "models",
    "two_step",
    "delay",
    "piecewise",
    "filters",
    "designed",
    "design",
    "evaluation",
    "zoo",
    "base",
)
"""Tests of what draws random numbers."""


def settings(found: Sequence[str] | None = None) -> dict[str, dict[str, str]]:
    """What this processor can pretend to be: variables of the environment by a name.

    The first is the farthest from any recent processor: the oldest kernels and plain loops.

    Parameters
    ----------
    found : sequence of str, optional
        The groups of instructions that NumPy can use beyond its baseline; those of this
        processor by default.
    """
    if found is None:
        found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    plain = {"NPY_DISABLE_CPU_FEATURES": " ".join(found)} if found else {}
    made = {}
    for name, group in NEEDED.items():
        if not group or group in found:
            kernels = {"OPENBLAS_CORETYPE": name}
            made |= {f"{name}, plain loops": kernels | plain} if plain else {}
            made[name] = kernels
    return made


def environment(name: str) -> dict[str, str]:
    """Variables of a setting by its name; none for "own", and "farthest" is the first one.

    Raises
    ------
    ValueError
        Another name.
    """
    known = settings()
    known = {"own": {}, "farthest": next(iter(known.values()))} | known
    if name not in known:
        raise ValueError(f"processor: wanted one of {', '.join(known)}; got {name!r}")
    return known[name]


def try_all(root: Path, names: Sequence[str], tests: bool) -> tuple[list[list[str]], bool]:
    """Run the notebooks again under some settings, and the tests that simulate.

    Returns
    -------
    rows : list of list of str
        Setting, notebook, worst deviation in units of its tolerance, and the number it is of.
    passed : bool
    """
    rows, passed = [], True
    where = ["notebooks", *(f"tests/{room}" for room in ROOMS if tests)]
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "deviations"
            done = subprocess.run(
                [
                    sys.executable,
                    "-m",
                    "pytest",
                    "-q",
                    "-n",
                    "3",
                    "--dist=loadscope",
                    "--deviations",
                    log,
                    *where,
                ],
                cwd=root,
                env={**os.environ, **environment(name)},
            )
            passed &= done.returncode == 0
            rows += [[name, *row] for row in _worst(log.read_text().splitlines())]
    return rows, passed


def _worst(lines: Sequence[str]) -> list[list[str]]:
    worst: dict[str, tuple[float, str]] = {}
    for notebook, size, name in map(json.loads, lines):
        worst[notebook] = max(worst.get(notebook, (0.0, "")), (size, name))
    return [[notebook, f"{size:.2g}", name] for notebook, (size, name) in sorted(worst.items())]


def write(rows: Sequence[Sequence[str]], path: Path) -> None:
    """Write the table of `try_all`."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([["setting", "notebook", "deviation", "number"], *rows])


def note(log: str, notebook: str, found: tuple[float, str]) -> None:
    """Add the deviation of a cell to the log that `try_all` reads."""
    line = json.dumps([Path(notebook).name, *found]) + "\n"
    with open(log, "a") as file:
        file.write(line)
