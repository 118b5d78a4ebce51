import json
import shutil
import subprocess
import sys
from xml.etree import ElementTree

import pytest

from bookkit.comparison import differences, without_records
from bookkit.recording import GLUE, MIME


def cell(values=None, claims=None, **tolerances):
    return [{"data": {MIME: {"values": values or {}, "claims": claims or {}, **tolerances}}}]


def test_round_off_is_no_difference_and_a_digit_is():
    stored = cell({"x": 0.5407, "v": [1.0, 2.0], "n": 3, "s": "a", "b": True})
    near = cell({"x": 0.5407 * (1 + 1e-9), "v": [1.0, 2.0 + 1e-9], "n": 3, "s": "a", "b": True})
    assert differences(stored, near) == []
    far = cell({"x": 0.4407, "v": [1.0, 2.1], "n": 4, "s": "b", "b": False})
    assert [line.split(":")[0] for line in differences(stored, far)] == ["x", "v", "n", "s", "b"]
    assert differences(stored, far)[0] == "x: stored 0.5407, computed 0.4407 (rtol 1e-07)"


def test_the_stored_tolerance_is_what_counts():
    wide, narrow = {"rtol": 1e-3, "atol": 0}, {"rtol": 1e-4, "atol": 0}
    assert differences(cell({"x": 1.0}, **wide), cell({"x": 1.0005}, **wide)) == []
    assert differences(cell({"x": 1.0}, **narrow), cell({"x": 1.0005}, **narrow)) != []


def test_a_changed_tolerance_is_a_difference():
    assert differences(cell({"x": 1.0}, rtol=1.0), cell({"x": 1.0}, rtol=1e-7)) == [
        "x: stored with rtol 1, atol 1e-12, now with rtol 1e-07, atol 1e-12"
    ]


def test_a_count_is_exact_unless_the_record_says_otherwise():
    assert differences(cell({"n": 20_000_001}), cell({"n": 20_000_000})) != []
    loose = {"rtol": 1e-3}
    assert differences(cell({"n": 20_000_001}, **loose), cell({"n": 20_000_000}, **loose)) == []


def test_a_true_is_not_a_one():
    assert differences(cell({"x": True}), cell({"x": 1})) != []


def test_missing_and_new_names_are_told_apart():
    assert differences(cell({"x": 1.0}), cell({"y": 1.0})) == [
        "x: stored, but not recorded by the re-run",
        "y: recorded by the re-run, but not stored",
    ]


def test_a_changed_verdict_is_a_difference():
    before = cell(claims={"TS-X1": {"verdict": "reproduced", "computed": [1.0]}})
    after = cell(claims={"TS-X1": {"verdict": "refuted", "computed": [1.0]}})
    assert differences(before, after) == [
        "TS-X1.verdict: stored 'reproduced', computed 'refuted' (rtol 1e-07)"
    ]


def test_only_records_are_taken_out():
    outputs = [
        {"data": {MIME: {}}},
        {"data": {GLUE + "text/plain": "1"}},
        {"data": {"text/plain": 1}},
    ]
    assert without_records(outputs) == [{"data": {"text/plain": 1}}]


# Re-runs of notebooks that were spoilt


def shifted(shift):
    def change(data):
        if "total" in data.get(MIME, {}).get("values", {}):
            data[MIME]["values"]["total"] += shift
        if data.get(GLUE + "text/plain") == "7.0":
            data[GLUE + "text/plain"] = repr(7.0 + shift)

    return change


def wrong(mime):
    def change(data):
        if mime in data:
            data[mime] = "WRONG"

    return change


SPOILT = {  # what is done to the outputs, and what the re-run finds
    "round-off": (shifted(1e-12), None),
    "record": (shifted(1e-3), "total: stored 7.001, computed 7.0 (rtol 1e-07)"),
    "page": (wrong("text/plain"), "the page shows what is not recorded: WRONG"),
    "box": (wrong("text/html"), "TS-X1: the box on the page is not what is recorded"),
    "glued": (wrong(GLUE + "text/plain"), "total: glued as WRONG, recorded as 7.0"),
}


@pytest.fixture(scope="module")
def found(executed_project, tmp_path_factory):
    """Results of the cells of every spoilt notebook, from one re-run of all of them."""
    root = shutil.copytree(executed_project, tmp_path_factory.mktemp("spoilt") / "project")
    (tiny,) = (root / "notebooks").glob("*.ipynb")
    content = tiny.read_text()
    tiny.unlink()
    for name, (change, _) in SPOILT.items():
        notebook = json.loads(content)
        for one in notebook["cells"]:
            for output in one.get("outputs", []):
                change(output.get("data", {}))
        tiny.with_stem(name).write_text(json.dumps(notebook))
    command = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--junitxml=found.xml", "notebooks"]
    done = subprocess.run(
        [sys.executable, *command], cwd=root, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 1, done.stdout + done.stderr
    cells = {}
    for case in ElementTree.parse(root / "found.xml").iter("testcase"):
        notebook = case.get("classname").removeprefix("notebooks.").removesuffix(".ipynb")
        cells.setdefault(notebook, []).append("".join(part.text for part in case))
    return cells


@pytest.mark.parametrize("name", SPOILT)
def test_a_wrong_digit_in_what_is_stored_or_shown_fails_the_re_run(found, name):
    message = SPOILT[name][1]
    assert len(found[name]) == 3
    told = [text for text in found[name] if text]
    assert len(told) == (message is not None)
    assert message is None or message in told[0]
