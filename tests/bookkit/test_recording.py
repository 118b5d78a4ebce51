"""Numbers and verdicts that leave a notebook: what is written, what is refused."""

import json

import numpy as np
import pytest
import yaml

from bookkit import claim, record, recording


@pytest.fixture
def shown(monkeypatch):
    """What was displayed: a list of (data, metadata)."""
    seen = []
    monkeypatch.setattr(
        recording, "_publish", lambda data, metadata=None: seen.append((data, metadata))
    )
    return seen


def read(shown):
    """What a reader of the notebook finds, as if it had been written to a file."""
    cells = [{"outputs": [{"data": data} for data, _ in shown]}]
    return recording.read_records(json.loads(json.dumps({"cells": cells})))


def test_values_are_plain_numbers_that_are_read_back_and_glued(shown):
    record(a=np.float64(1.5), n=np.int64(3), ok=np.True_, s="text", v=np.array([1.0, 2.0]))
    found = read(shown).values
    assert found == {"a": 1.5, "n": 3, "ok": True, "s": "text", "v": [1.0, 2.0]}
    assert [type(found[k]) for k in ("a", "n", "ok")] == [float, int, bool]
    glued = {m["scrapbook"]["name"]: d[recording.GLUE + "text/plain"] for d, m in shown if m}
    assert float(glued["a"]) == 1.5
    assert glued["v"] == "1, 2"


@pytest.mark.parametrize("value", [np.nan, [1.0, np.inf], [[1.0]], object(), 10**400])
def test_a_value_that_is_no_finite_number_is_refused_by_its_name(shown, value):
    with pytest.raises((TypeError, ValueError), match="speed"):
        record(speed=value)
    assert not shown


def test_a_name_that_is_recorded_twice_is_refused(shown):
    record(a=1.0)
    record(a=2.0)
    with pytest.raises(ValueError, match="a is recorded twice"):
        read(shown)


@pytest.fixture
def known(monkeypatch, tmp_path):
    """Put one entry into a ledger of its own: what it is to have, by name."""

    def put(**fields):
        (tmp_path / "book").mkdir()
        (tmp_path / "book" / "claims.yml").write_text(json.dumps([yaml.safe_load(ENTRY) | fields]))
        monkeypatch.chdir(tmp_path)

    return put


ENTRY = """{id: TS-X1, paper: two-step, origin: stated, place: example 0, statement: a < b,
    notebook: notebooks/tiny.md, proved: numbers, verdict: reproduced}"""
ONE, TWO = {"printed": 1.0, "tolerance": 0.05}, {"printed": [1, 2.5], "tolerance": [0.1, 0.6]}


@pytest.mark.parametrize(
    ("ledger", "arguments", "verdict"),
    [
        (ONE, {"computed": 1.02}, "reproduced"),
        (ONE, {"computed": 1.06}, "refuted"),
        (ONE, {"computed": 1.06, "corrected": True}, "corrected"),
        (ONE, {"computed": 1.02, "holds": False}, "refuted"),
        (ONE, {"computed": 1.02, "undecided": True}, "open"),
        (ONE | {"origin": "ours"}, {"computed": 1.02}, "checked"),
        (TWO, {"computed": [1, 1.8]}, "refuted"),
        ({}, {"holds": np.True_}, "reproduced"),
        ({}, {"holds": False}, "refuted"),
        ({}, {"holds": False, "corrected": True}, "corrected"),
        ({}, {}, "open"),
    ],
)
def test_the_verdict_follows_from_numbers_and_conditions(known, shown, ledger, arguments, verdict):
    known(**ledger)
    claim("TS-X1", **arguments)
    assert read(shown).claims["TS-X1"]["verdict"] == verdict
    assert verdict in shown[0][0]["text/html"]


@pytest.mark.parametrize(
    ("ledger", "arguments", "message"),
    [
        (ONE, {}, "computed"),
        (ONE, {"computed": [1.0, 2.0]}, "wanted 1 numbers"),
        ({}, {"holds": "yes"}, "holds"),
        ({}, {"holds": True, "wrong": {"no sign": 1.0}}, "no numbers"),
    ],
)
def test_a_claim_without_a_clear_question_is_refused(known, shown, ledger, arguments, message):
    known(**ledger)
    with pytest.raises(ValueError, match=f"TS-X1.*{message}"):
        claim("TS-X1", **arguments)
    assert not shown


@pytest.mark.parametrize(
    ("ledger", "arguments", "missed"),
    [
        (ONE, {"computed": 1.0, "wrong": {"no sign": -1.0, "half": np.False_}}, []),
        (ONE, {"computed": 1.0, "wrong": {"no sign": 0.97, "half": 0.5}}, ["no sign"]),
        ({}, {"holds": True, "wrong": {"no sign": np.True_, "half": False}}, ["no sign"]),
    ],
)
def test_a_planted_fault_that_leaves_the_verdict_is_missed(known, shown, ledger, arguments, missed):
    known(**ledger, place="part 2: example 0")
    claim("TS-X1", **arguments, note="a < b & c")
    found = read(shown).claims["TS-X1"]
    assert found["wrong"] == ["no sign", "half"]
    assert found.get("missed", []) == missed
    box = shown[0][0]["text/html"]
    assert ("Would not fail with: no sign" in box) == bool(missed)
    assert "part 2: example 0</summary><p>a &lt; b</p>" in box
    assert "a &lt; b &amp; c" in box
