"""Where the committed tables come from: each has a row, and the program that wrote it exists."""

import csv
from pathlib import Path

from oracles.programs import load

ROOT = Path(__file__).resolve().parents[1]


def test_every_table_has_its_provenance():
    """Its program exists and had this hash, or it is said why there is none."""
    with (ROOT / "benchmarks" / "provenance.csv").open(newline="") as file:
        told = {row["file"]: row for row in csv.DictReader(file)}
    there = {f"benchmarks/{path.name}" for path in (ROOT / "benchmarks").glob("*.csv")}
    assert there - set(told) == {"benchmarks/provenance.csv"}
    assert set(told) <= there
    for row in told.values():
        assert row["what"]
        assert len(row["date"].split("-")) == 3
        if row["program"]:
            assert (ROOT / row["program"]).is_file(), row["program"]
            assert len(row["sha256"]) == 64
            assert set(row["sha256"]) <= set("0123456789abcdef")
        else:
            assert "separate implementation" in row["what"]
            assert "not part of the project" in row["what"]


def test_programs_of_the_switching_tables_can_be_loaded():
    for path in sorted((ROOT / "benchmarks").glob("switching_*.py")):
        assert callable(load(path.stem).main)
