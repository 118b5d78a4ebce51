"""How far the library and other programs are apart on the models of ``tests/peers``.

Run by hand, ``python benchmarks/peers_table.py``; writes ``benchmarks/peers_table.csv`` beside
itself: what was compared, on how many models, the largest distance (relative to the largest entry
of theirs where that is above one), and where it is above 1e-10 the reason.
"""

from __future__ import annotations

import csv
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


class Keeper:
    """Pytest plugin that keeps what the tests say they have compared with each other."""

    def __init__(self) -> None:
        self.found: dict[tuple[str, str, str], list[float]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        told = [value for name, value in report.user_properties if name == "held"]
        for peer, what, distance, reason in told if report.when == "call" else ():
            self.found.setdefault((peer, what, reason), []).append(distance)


def versions() -> dict[str, str]:
    with (ROOT / "benchmarks" / "peers_dynamax.csv").open(newline="") as file:
        made_by = next(csv.DictReader(file))["made_by"]
    return {
        "dynamax": made_by.split(",")[0].removeprefix("dynamax "),
        **{name: version(name) for name in ("filterpy", "statsmodels")},
    }


def main() -> None:
    keeper = Keeper()
    failed = pytest.main(["-q", "-n0", str(ROOT / "tests" / "peers")], plugins=[keeper])
    if failed:
        raise SystemExit(int(failed))
    known = versions()
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["program", "what", "models", "distance", "why above 1e-10"])
        for (peer, what, reason), apart in sorted(keeper.found.items()):
            worst = max(apart)
            row = [f"{peer} {known[peer]}", what, len(apart), f"{worst:.0e}"]
            writer.writerow([*row, reason if worst > 1e-10 else ""])


if __name__ == "__main__":
    main()
