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


@pytest.mark.parametrize(
    ("arguments", "verdict"),
    [
        ({"computed": 1.02, "printed": 1.0, "tolerance": 0.05}, "reproduced"),
        ({"computed": 1.06, "printed": 1.0, "tolerance": 0.05}, "refuted"),
        ({"computed": 1.06, "printed": 1, "tolerance": 0.05, "corrected": True}, "corrected"),
        ({"computed": [1, 2], "printed": [1, 2.5], "tolerance": [0.1, 1]}, "reproduced"),
        ({"computed": [1, 2], "printed": [1, 2.5], "tolerance": [0.1, 0.4]}, "refuted"),
        ({"holds": np.True_}, "reproduced"),
        ({"holds": False}, "refuted"),
        ({"holds": False, "corrected": True}, "corrected"),
        ({"holds": False, "corrected": False}, "refuted"),
        ({"computed": 3.0}, "open"),
        ({}, "open"),
    ],
)
def test_the_verdict_follows_from_the_numbers(shown, arguments, verdict):
    claim("TS-X1", **arguments)
    assert recording.read_records(cells(shown)).claims["TS-X1"]["verdict"] == verdict
    assert verdict in shown[0][0]["text/html"]


@pytest.mark.parametrize(
    "arguments",
    [
        {"computed": 1.0, "printed": 1.0},
        {"printed": 1.0, "tolerance": 0.1},
        {"computed": [1.0, 2.0], "printed": 1.0, "tolerance": 0.1},
        {"computed": 1.0, "printed": 1.0, "tolerance": 0.1, "holds": True},
        {"tolerance": 0.1},
        {"holds": "yes"},
    ],
)
def test_a_claim_without_a_clear_question_is_refused(shown, arguments):
    with pytest.raises(ValueError, match="TS-X1"):
        claim("TS-X1", **arguments)


def test_a_note_is_escaped(shown):
    claim("TS-X1", holds=True, note="a < b & c")
    assert "a &lt; b &amp; c" in shown[0][0]["text/html"]
