"""Illegal and extreme input: nothing is silently wrong, crashes or hangs."""

import csv

import pytest
from attempts import commands, files, grids, numerical, programs
from attempts.judge import VERDICTS, Attempt, judged

from oracles.programs import BENCHMARKS

SAMPLES = {"numerical": 97, "grids": 4, "programs": 83, "commands": 97, "files": 103}
"""Each so many attempts one is repeated here."""

MODULES = {m.__name__.rpartition(".")[2]: m for m in (commands, files, grids, numerical, programs)}


def sample(name):
    listed = MODULES[name].attempts(*[("plain",)] * (name == "files"))
    return [a for a in listed if "bomb" not in a.what][:: SAMPLES[name]]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", SAMPLES)
def test_a_sample_is_refused_right_or_flagged(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = {a.what: judged(a) for a in sample(name)}
    assert len(found) >= 15
    assert {what: v for what, v in found.items() if v[0] not in VERDICTS[:3]} == {}


def test_the_committed_table_has_nothing_left():
    with (BENCHMARKS / "abuse.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["category"] for row in rows} >= {*SAMPLES, "exported", "security"}
    counts = [{k: int(v) for k, v in row.items() if k != "category"} for row in rows]
    assert sum(row["attempts"] for row in counts) >= 8000
    for row in counts:
        assert sum(row[verdict] for verdict in VERDICTS[:3]) == row["attempts"] > 0
        assert not any(row[verdict] for verdict in VERDICTS[3:])
    assert not (BENCHMARKS / "abuse_findings.csv").exists()


def raising(error):
    def call():
        raise error

    return call


@pytest.mark.parametrize(
    ("call", "right", "verdict"),
    [
        (raising(ValueError("x: wanted a number, got none")), None, "refused"),
        (raising(ValueError("operands could not be broadcast together")), None, "crashed"),
        (raising(KeyError("x")), None, "crashed"),
        (raising(MemoryError()), None, "hung"),
        (lambda: 1.0, None, "silently_wrong"),
        (lambda: 1.0, lambda value: value == 2.0, "silently_wrong"),
        (lambda: 2.0, lambda value: value == 2.0, "right"),
    ],
)
def test_the_judge_tells_them_apart(call, right, verdict):
    assert judged(Attempt("", call, right))[0] == verdict
    if verdict == "refused":
        assert judged(Attempt("", call, right, legal=True))[0] == "wrongly_refused"
