"""What is committed was made from what is committed, and a reader can use all of it."""

import json
import re
from itertools import pairwise
from pathlib import Path

import pytest

from bookkit import execution
from bookkit.recording import MIME

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "notebooks").glob("*.md"))


@pytest.fixture(params=SOURCES, ids=lambda path: path.stem)
def cells(request):
    """Code cells of an executed notebook."""
    notebook = json.loads(request.param.with_suffix(".ipynb").read_text())
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def source(cell):
    return "".join(cell["source"])


def tags(cell):
    return cell["metadata"].get("tags", [])


def outputs(cells):
    return [(cell, output) for cell in cells for output in cell["outputs"]]


def test_every_notebook_is_executed_and_none_is_stale():
    executed = {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert executed == {path.stem for path in SOURCES}
    stale = [path.name for path in SOURCES if execution.is_stale(path)]
    assert stale == [], "run `make execute` and commit the notebooks"


def test_every_cell_was_executed_and_none_failed(cells):
    assert all(cell["execution_count"] for cell in cells if source(cell).strip())
    assert [o["evalue"] for _, o in outputs(cells) if o["output_type"] == "error"] == []
    assert [o["text"] for _, o in outputs(cells) if o.get("name") == "stderr"] == []


def test_no_cell_is_left_out_of_the_re_run(cells):
    marks = [tag for cell in cells for tag in tags(cell)]
    marks += re.findall(r"#\s*(nbval\S*)", "\n".join(map(source, cells)), re.I)
    left_out = ("nbval", "skip", "raises-exception", "check_output")
    assert [mark for mark in marks if mark.lower().startswith(left_out)] == []


def test_claims_and_figures_are_on_the_page(cells):
    removed = [
        output["data"]
        for cell, output in outputs(cells)
        if "data" in output and "remove-cell" in tags(cell)
    ]
    assert [data for data in removed if data.get(MIME, {}).get("claims")] == []
    assert [data for data in removed if "image/png" in data] == []


def test_every_parameter_is_checked_in_the_next_cell(cells):
    for cell, following in pairwise(cells):
        if "parameters" in tags(cell):
            assert re.search(r"check\(\s*globals\(\)", source(following))
            names = re.findall(r"^(\w+):", source(cell), re.M)
            assert [n for n in names if not re.search(rf"\b{n}=", source(following))] == []


def test_every_figure_has_a_caption_and_alternative_text(cells):
    for cell, output in outputs(cells):
        if "image/png" in output.get("data", {}):
            options = cell["metadata"].get("mystnb", {})
            assert len(options.get("image", {}).get("alt", "")) > 20, source(cell)
            assert len(options.get("figure", {}).get("caption", "")) > 20, source(cell)


def test_no_path_of_a_machine_is_in_a_notebook(cells):
    texts = [
        {k: v for k, v in o.get("data", o).items() if k != "image/png"} for _, o in outputs(cells)
    ]
    text = json.dumps([texts, [source(cell) for cell in cells]])
    for path in (str(ROOT), str(Path.home()), "/tmp/", "site-packages"):
        assert path not in text
