"""What counts as a mutant, and what the committed tables have to say."""

import ast
import csv
from argparse import Namespace
from pathlib import Path

import mutants
import pytest
import runner
import table

from oracles.programs import load

TEXT = '''"""Words: 1 + 1."""

from __future__ import annotations

__all__ = ["half"]


def half(x: float = 3.0) -> float:
    """Half of x."""
    if x < 0:
        raise ValueError(f"x: got {x + 1}")
    assert x == x
    return sum(a * b for a, b in zip([x], [0.5], strict=True))


def other(x):
    return x
'''


@pytest.fixture
def library(tmp_path):
    (tmp_path / "a.py").write_text(TEXT)
    return tmp_path


def test_a_mutant_is_one_piece_of_text_replaced(library):
    found = mutants.mutants_of("a.py", library)
    pairs = {(TEXT[m.start : m.stop].strip(), m.after.strip()) for m in found}
    assert {("< 0", "<= 0"), ("a * b", "a / b"), ("3.0", "4.0"), ("0.5", "1.5")} <= pairs
    assert "    if x <= 0:\n" in {m.applied(TEXT).splitlines(True)[9] for m in found}
    assert all(TEXT[m.start : m.stop] != m.after for m in found)
    assert {m.function for m in found} == {"half"}  # nothing of `other` can be mutated
    for m in found:
        lines = TEXT[: m.start].count("\n") + 1, TEXT[: m.stop].count("\n") + 1
        assert (m.line, m.end) == lines


def test_sentences_and_assertions_are_no_mutants(library):
    for m in mutants.mutants_of("a.py", library):
        if mutants.sound(m, library):
            text = m.applied(TEXT)
            for kept in ('raise ValueError(f"x: got {x + 1}")', "assert x == x", "-> float:"):
                assert kept in text
            assert "zip(" not in text or "strict=True" in text
            assert ast.get_docstring(ast.parse(text)) == "Words: 1 + 1."


def test_a_mutant_keeps_its_name_when_another_function_changes(library):
    names = {m.key for m in mutants.mutants_of("a.py", library)}
    print_before = mutants.fingerprint("a.py", library)
    (library / "a.py").write_text(TEXT.replace("return x\n", "return x + 1\n"))
    later = {m.key for m in mutants.mutants_of("a.py", library)}
    assert names < later
    assert mutants.fingerprint("a.py", library) != print_before
    (library / "a.py").write_text("# a comment\n" + TEXT)
    assert mutants.fingerprint("a.py", library) == print_before


def test_every_room_has_files_of_its_own():
    files = [file for room in mutants.ROOMS for file in mutants.files_of(room)]
    assert len(files) == len(set(files)) > 150


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_nine_of_ten_fresh_mutants_are_caught():
    """Survivors that were not judged count as if a test could tell; in no room there are many."""
    found, whole = table.read(), []
    reasons = table.equivalent()
    assert set(reasons) & {row.key for row in found if row.verdict != "survived"} == set()
    assert all(len(reason) > 20 for reason in reasons.values())
    told = {row["room"]: row for row in rows(table.SUMMARY)}
    for room in mutants.ROOMS:
        score = table.score(found, room, table.fresh(found, room))
        assert score.tried == 100
        assert score.killed >= 0.85 * (score.tried - score.equivalent), room
        words = [told[room][word] for word in ("tried", "equivalent", "caught", "per cent")]
        assert words == score.words()
        whole.append(score)
    tried, alike, killed = map(sum, zip(*whole, strict=True))
    assert killed >= 0.9 * (tried - alike)


def test_mutants_of_every_changed_file_are_tried(monkeypatch, capsys):
    """A file with few mutants does not end it, and tests that are gone are not asked for."""
    program = load("__main__", Path(table.__file__).parent)
    few, many = "pareto/result.py", "riemann/problem.py"
    known = {f: mutants.fingerprint(f) for r in mutants.ROOMS for f in mutants.files_of(r)}
    monkeypatch.setattr(table, "fingerprints", lambda: known | {few: "", many: ""})
    there = {row.by for row in table.read() if row.room == "riemann"}
    monkeypatch.setattr(program, "preload", lambda: there)
    monkeypatch.setattr(
        program, "sample", lambda files, *_: mutants.sample(files, 0, 2 if files == [few] else 5)
    )
    asked = []

    def tried(jobs, folder):
        for m, file, text, tests, _ in jobs:
            asked.append((file, set(tests) <= there, text == m.applied(library_text(file))))
            yield m, runner.Outcome("killed" if file == few else "survived", "", len(tests))

    monkeypatch.setattr(program, "outcomes", tried)
    assert program.command_changed(Namespace(seconds=60.0, each=5)) == 0
    assert sorted(asked) == [(few, True, True)] * 2 + [(many, True, True)] * 5
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "2 files have changed since the table was written"
    assert [line.startswith(f"not caught: {many}:") for line in told[1:-1]] == [True] * 5
    assert told[-1] == "2 of 7 mutants of changed files were caught"


def library_text(file):
    return (mutants.ROOT / "seedslib" / file).read_text()


def test_every_planted_fault_is_caught():
    names = [fault.function for fault in mutants.planted()]  # their texts stand in the files
    told = rows(table.FAULTS)
    assert [row["fault"] for row in told] == names
    assert all(row["verdict"] == "killed" for row in told)
