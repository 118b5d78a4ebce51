"""A re-run of a notebook: numbers within their tolerance, the rest to the letter."""

import json
import shutil
import subprocess
import sys
from xml.etree import ElementTree

import pytest

from bookkit.comparison import differences
from bookkit.recording import GLUE, MIME


def cell(values=None, claims=None, **tolerances):
    return [{"data": {MIME: {"values": values or {}, "claims": claims or {}, **tolerances}}}]


REPRODUCED, REFUTED = (
    {"TS-X1": {"verdict": verdict, "computed": [1.0]}} for verdict in ("reproduced", "refuted")
)


@pytest.mark.parametrize(
    ("stored", "computed", "names"),
    [
        (cell({"x": 0.5407}), cell({"x": 0.5407 * (1 + 1e-9)}), []),
        (cell({"x": 0.5407}), cell({"x": 0.4407}), ["x"]),
        (cell({"v": [1.0, 2.0]}), cell({"v": [1.0, 2.0 + 1e-9]}), []),
        (cell({"v": [1.0, 2.0]}), cell({"v": [1.0, 2.1]}), ["v"]),
        (cell({"s": "a"}), cell({"s": "b"}), ["s"]),
        (cell({"x": 1.0}, rtol=1e-3), cell({"x": 1.0005}, rtol=1e-3), []),
        (cell({"x": 1.0}, rtol=1.0), cell({"x": 1.0}), ["x"]),  # another tolerance
        (cell({"n": 20_000_001}), cell({"n": 20_000_000}), ["n"]),
        (cell({"n": 20_000_001}, rtol=1e-3), cell({"n": 20_000_000}, rtol=1e-3), []),
        (cell({"x": True}), cell({"x": 1}), ["x"]),
        (cell({"x": 1.0}), cell({"y": 1.0}), ["x", "y"]),
        (cell(claims=REPRODUCED), cell(claims=REFUTED), ["TS-X1.verdict"]),
    ],
)
def test_differences_name_what_is_not_within_its_stored_tolerance(stored, computed, names):
    assert [line.split(":")[0] for line in differences(stored, computed)] == names


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
