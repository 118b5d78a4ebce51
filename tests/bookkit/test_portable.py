"""Other processors, pretended: which there are, and how far a number is from its tolerance."""

import math

import pytest

from bookkit import portable
from bookkit.comparison import deviation
from bookkit.recording import MIME


def cell(rtol=1e-6, atol=0.0, **values):
    return [{"data": {MIME: {"values": values, "rtol": rtol, "atol": atol}}}]


def test_only_what_the_processor_can_do_is_pretended():
    old = portable.settings([])
    assert {part["OPENBLAS_CORETYPE"] for part in old.values()} == {"Prescott", "Nehalem"}
    assert all("NPY_DISABLE_CPU_FEATURES" not in part for part in old.values())
    new = portable.settings(["X86_V3", "X86_V4"])
    assert len(new) == 8
    first = next(iter(new.values()))
    assert first == {
        "OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"
    }  # fmt: skip
    assert portable.environment("own") == {}
    with pytest.raises(ValueError, match=r"processor: wanted one of own, farthest, .*got 'mine'"):
        portable.environment("mine")


def test_a_deviation_is_in_units_of_the_tolerance():
    stored = cell(rtol=1e-3, a=1.0, b=[2.0, 5.0], c="text")
    assert deviation(stored, stored) == (0.0, "c")
    size, name = deviation(stored, cell(rtol=1e-3, a=1.0, b=[2.0, 5.01], c="text"))
    assert name == "b"
    assert size == pytest.approx(0.01 / 5.01e-3)
    assert deviation(stored, cell(rtol=1e-3, a=1.0, b=[2.0], c="text")) == (math.inf, "b")
    assert deviation(stored, cell(rtol=1e-3, a=1.0, b=[2.0, 5.0], c="other")) == (math.inf, "c")
    assert deviation([], []) == (0.0, "")


def test_the_worst_cell_of_each_notebook_is_kept(tmp_path):
    log = tmp_path / "log"
    for notebook, found in (
        ("x/a.ipynb", (0.1, "p")),
        ("a.ipynb", (0.5, "q")),
        ("b.ipynb", (0, "")),
    ):
        portable.note(log, notebook, found)
    rows = portable._worst(log.read_text().splitlines())
    assert rows == [["a.ipynb", "0.5", "q"], ["b.ipynb", "0", ""]]
    portable.write([["own", *row] for row in rows], tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_text().splitlines()[1] == "own,a.ipynb,0.5,q"
