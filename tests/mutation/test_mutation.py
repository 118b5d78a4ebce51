"""Frozen mutants and planted faults: what they are, and that they are found again."""

import csv
from collections import Counter
from dataclasses import replace

import mutants
import pytest

TEXT = '''"""Words: 1 + 1."""

from __future__ import annotations


def half(x: float = 3.0) -> float:
    """Half of x."""
    if x < 0:
        raise ValueError(f"x: got {x + 1}")
    assert x == x
    return sum(a * b for a, b in zip([x], [0.5], strict=True))
'''


@pytest.fixture
def library(tmp_path):
    (tmp_path / "halves").mkdir()
    (tmp_path / "halves" / "a.py").write_text(TEXT)
    return tmp_path


def test_mutants_change_what_is_computed_and_neither_sentences_nor_assertions(library):
    drawn = list(mutants.draw("halves", 0, library))
    changes = {(m.before.strip(), m.after.strip()) for m in drawn}
    assert ("if x < 0:", "if x <= 0:") in changes
    assert {m.line for m in drawn} == {6, 8, 11}
    assert all(m.function == "half" and "strict=True" in m.after for m in drawn if m.line == 11)
    assert [m.after for m in mutants.draw("halves", 0, library)] == [m.after for m in drawn]


def test_a_mutant_is_found_again_in_another_file_and_gone_when_its_lines_are(library):
    mutant = next(m for m in mutants.draw("halves", 0, library) if m.line == 8)
    (library / "halves" / "a.py").rename(library / "halves.py")
    joined = "def before():\n    return 1\n\n\n" + TEXT.partition("annotations\n")[2]
    (library / "halves.py").write_text(joined)
    file, line, text = mutants.located(mutant, library)
    assert (file, text) == ("halves.py", joined.replace(mutant.before, mutant.after))
    assert joined.splitlines()[line - 1] == mutant.before.rstrip()
    assert mutants.located(replace(mutant, before="    if y < 0:\n"), library) is None


def test_frozen_mutants_are_those_that_the_table_of_the_book_counts():
    frozen = mutants.read()
    with (mutants.HERE / "caught.csv").open() as file:
        there = {row["package"]: int(row["still in the library"]) for row in csv.DictReader(file)}
    assert Counter(m.package for m in frozen) == there
    assert len(set(frozen)) == len(frozen)
    assert all(m.before != m.after and m.killed_by for m in frozen)


def test_every_planted_fault_has_its_place_in_the_library():
    assert [fault.function for fault in mutants.faults() if mutants.located(fault) is None] == []
