import json

import numpy as np
import pytest

from bookkit import claim, record, recording


@pytest.fixture
def shown(monkeypatch):
    """What was displayed: a list of (data, metadata)."""
    seen = []
    monkeypatch.setattr(
        recording, "_publish", lambda data, metadata=None: seen.append((data, metadata))
    )
    return seen


def cells(shown):
    return {"cells": [{"outputs": [{"data": data} for data, _ in shown]}]}


def test_values_are_plain_json_and_read_back(shown):
    record(a=np.float64(1.5), n=np.int64(3), ok=np.True_, s="text", v=np.array([1.0, 2.0]))
    found = recording.read_records(json.loads(json.dumps(cells(shown)))).values
    assert found == {"a": 1.5, "n": 3, "ok": True, "s": "text", "v": [1.0, 2.0]}
    assert [type(found[k]) for k in ("a", "n", "ok")] == [float, int, bool]


def test_each_name_can_be_glued(shown):
    record(a=1.25, v=[1.0, 2.0])
    names = {m["scrapbook"]["name"]: d for d, m in shown if m}
    assert float(names["a"][recording.GLUE + "text/plain"]) == 1.25
    assert names["v"][recording.GLUE + "text/plain"] == "1, 2"


@pytest.mark.parametrize(
    ("value", "error"),
    [
        (np.nan, ValueError),
        ([1.0, np.inf], ValueError),
        ([[1.0]], TypeError),
        (object(), TypeError),
    ],
)
def test_what_cannot_be_recorded_is_refused_by_name(shown, value, error):
    with pytest.raises(error, match="speed"):
        record(speed=value)
    assert not shown


def test_nothing_to_record_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        record()


def test_a_name_recorded_twice_is_refused(shown):
    record(a=1.0)
    record(a=2.0)
    with pytest.raises(ValueError, match="a is recorded twice"):
        recording.read_records(cells(shown))


@pytest.fixture
def known(monkeypatch, tmp_path):
    """Put one entry into a ledger of its own: what it is to have, by name."""

    def put(**fields):
        entry = {
            "id": "TS-X1",
            "paper": "two-step",
            "origin": "stated",
            "place": "example 0",
            "statement": "a < b",
            "kind": "number",
            "notebook": "notebooks/tiny.md",
            "tests": ["tests/test_tiny.py::test_sum"],
            "verdict": "reproduced",
            **fields,
        }
        (tmp_path / "book").mkdir()
        (tmp_path / "book" / "claims.yml").write_text(json.dumps([entry]))
        monkeypatch.chdir(tmp_path)

    return put


ONE, TWO = {"printed": 1.0, "tolerance": 0.05}, {"printed": [1, 2.5], "tolerance": [0.1, 0.6]}


@pytest.mark.parametrize(
    ("ledger", "arguments", "verdict"),
    [
        (ONE, {"computed": 1.02}, "reproduced"),
        (ONE, {"computed": 1.06}, "refuted"),
        (ONE, {"computed": 1.06, "corrected": True}, "corrected"),
        (ONE, {"computed": 1.02, "holds": False}, "refuted"),
        (ONE, {"computed": 1.06, "holds": True}, "refuted"),
        (ONE, {"computed": 1.02, "undecided": True}, "open"),
        (ONE | {"origin": "ours"}, {"computed": 1.02}, "checked"),
        (TWO, {"computed": [1, 2]}, "reproduced"),
        (TWO, {"computed": [1, 1.8]}, "refuted"),
        ({}, {"holds": np.True_}, "reproduced"),
        ({"origin": "ours"}, {"holds": True}, "checked"),
        ({"origin": "implied"}, {"holds": True}, "reproduced"),
        ({}, {"holds": False}, "refuted"),
        ({}, {"holds": False, "corrected": True}, "corrected"),
        ({}, {"holds": False, "corrected": False}, "refuted"),
        ({}, {"computed": 3.0}, "open"),
        ({}, {}, "open"),
    ],
)
def test_the_verdict_follows_from_the_numbers(known, shown, ledger, arguments, verdict):
    known(**ledger)
    claim("TS-X1", **arguments)
    assert recording.read_records(cells(shown)).claims["TS-X1"]["verdict"] == verdict
    assert verdict in shown[0][0]["text/html"]


@pytest.mark.parametrize(
    ("ledger", "arguments", "message"),
    [
        (ONE, {}, "wanted computed ones"),
        (ONE, {"computed": [1.0, 2.0]}, "wanted 1 numbers as in the ledger, got 2"),
        ({}, {"holds": "yes"}, "holds: wanted a boolean"),
        ({}, {"holds": True, "wrong": {"no sign": 1.0}}, "no numbers to hold these against"),
    ],
)
def test_a_claim_without_a_clear_question_is_refused(known, shown, ledger, arguments, message):
    known(**ledger)
    with pytest.raises(ValueError, match=f"TS-X1.*{message}"):
        claim("TS-X1", **arguments)
    assert not shown


def test_a_claim_that_the_ledger_does_not_know_is_refused(known):
    known()
    with pytest.raises(ValueError, match="TS-X2: not in the ledger"):
        claim("TS-X2", holds=True)


def test_a_fault_that_turns_the_verdict_is_shown(known, shown):
    known(**ONE)
    claim("TS-X1", computed=1.0, wrong={"no sign": -1.0, "half": np.False_})
    assert "Would fail with: no sign, half" in shown[0][0]["text/html"]


@pytest.mark.parametrize(
    ("ledger", "arguments"),
    [
        (ONE, {"computed": 1.0, "wrong": {"no sign": 0.97, "half": 0.5}}),
        ({}, {"holds": True, "wrong": {"no sign": np.True_, "half": False}}),
    ],
)
def test_a_fault_that_passes_is_shown_as_missed(known, shown, ledger, arguments):
    known(**ledger)
    claim("TS-X1", **arguments)
    assert recording.read_records(cells(shown)).claims["TS-X1"]["missed"] == ["no sign"]
    assert "Would fail with: half; Would not fail with: no sign" in shown[0][0]["text/html"]


def test_of_many_numbers_only_the_farthest_is_shown(known, shown):
    known(printed=[1.0] * 9, tolerance=0.05)
    claim("TS-X1", computed=[1.0] * 8 + [1.04])
    assert "9 numbers held against printed ones; the farthest is 0.80" in shown[0][0]["text/html"]


def test_statement_and_note_are_escaped(known, shown):
    known()
    claim("TS-X1", holds=True, note="a < b & c")
    assert "example 0: a &lt; b<br>a &lt; b &amp; c" in shown[0][0]["text/html"]
