"""The style of the notebooks, and that what is committed was made from what is committed."""

import json
import re
from pathlib import Path

import pytest

from bookkit import execution
from bookkit.recording import MIME

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "notebooks").glob("*.md"))
FOLDED = {"remove-cell", "remove-input", "hide-input"}
"""Tags of cells whose code a page does not show, or shows when it is asked for."""
HOW_TO = "how_"
"""Names of pages that begin so show how something is written: there the code is the page, and it
may print. It stays in cells of at most eight lines, and the page is short.
"""
FIGURE, BOX = 18, 5
"""Lines of text that are as high as a figure and as the box of a claim."""
RAW_FLOAT = re.compile(r"(?<![\w.])-?\d+\.\d{9,}")


@pytest.fixture(params=SOURCES, ids=lambda path: path.stem)
def page(request):
    """The source of a notebook."""
    return request.param


@pytest.fixture
def all_cells(page):
    """Cells of one executed notebook."""
    return json.loads(page.with_suffix(".ipynb").read_text())["cells"]


@pytest.fixture
def cells(all_cells):
    """Its code cells."""
    return [cell for cell in all_cells if cell["cell_type"] == "code"]


def source(cell):
    return "".join(cell["source"])


def lines(cell):
    return [line for line in source(cell).splitlines() if line.strip()]


def shown(cells):
    """Cells whose code is seen on the page at once."""
    return [cell for cell in cells if not FOLDED & set(cell["metadata"].get("tags", []))]


def outputs(cells):
    return [(cell, output) for cell in cells for output in cell["outputs"]]


def test_every_text_notebook_has_its_executed_one_and_no_other():
    executed = {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert executed == {path.stem for path in SOURCES}


def test_every_notebook_is_in_the_book():
    toc = (ROOT / "_toc.yml").read_text()
    assert [path.stem for path in SOURCES if f"notebooks/{path.stem}\n" not in toc] == []


def test_nothing_is_stale():
    stale = [path.name for path in SOURCES if execution.is_stale(path)]
    assert stale == [], "run `make execute` and commit the notebooks"


def test_every_cell_was_executed_and_none_failed(cells):
    assert all(cell["execution_count"] for cell in cells if source(cell).strip())
    assert [o["evalue"] for _, o in outputs(cells) if o["output_type"] == "error"] == []


def test_no_cell_ends_in_a_semicolon_or_writes_to_stderr(cells):
    assert [source(c) for c in cells if source(c).rstrip().endswith(";")] == []
    assert [o["text"] for _, o in outputs(cells) if o.get("name") == "stderr"] == []


def test_code_that_is_shown_is_what_a_reader_would_write(page, cells):
    how_to = page.stem.startswith(HOW_TO)
    for cell in shown(cells):
        assert len(lines(cell)) <= 8, f"tag it {FOLDED}, or split it: {source(cell)}"
        assert [line for line in lines(cell) if len(line) > (80 if how_to else 88)] == []
        assert "claim(" not in source(cell)
        assert "record(" not in source(cell)
        assert how_to or "print(" not in source(cell)


def test_a_how_to_page_is_short(page):
    assert not page.stem.startswith(HOW_TO) or len(page.read_text().splitlines()) <= 150


def test_code_is_at_most_fifteen_per_cent_of_a_page(page, all_cells):
    if page.stem.startswith(HOW_TO):
        pytest.skip("on a page that shows how to write something the code is the page")
    code = [cell for cell in all_cells if cell["cell_type"] == "code"]
    prose = sum(len(lines(cell)) for cell in all_cells if cell["cell_type"] == "markdown")
    seen = sum(len(lines(cell)) for cell in shown(code))
    figures = sum("figure" in cell["metadata"].get("mystnb", {}) for cell in code)
    boxes = sum(len(o.get("data", {}).get(MIME, {}).get("claims", ())) for _, o in outputs(code))
    assert seen <= 0.15 * (seen + prose + FIGURE * figures + BOX * boxes)


def test_what_a_claim_says_is_on_the_page(cells):
    removed = [c for c in cells if "remove-cell" in c["metadata"].get("tags", [])]
    assert [o for _, o in outputs(removed) if o.get("data", {}).get(MIME, {}).get("claims")] == []
    assert [o for _, o in outputs(removed) if "image/png" in o.get("data", {})] == []


def test_parameters_are_checked_in_the_next_cell(cells):
    tagged = [i for i, c in enumerate(cells) if "parameters" in c["metadata"].get("tags", [])]
    assert len(tagged) <= 1
    for index in tagged:
        assert re.search(r"check\(\s*globals\(\)", source(cells[index + 1]))
        for line in source(cells[index]).splitlines():
            assert not line.strip() or re.match(r"\w+: \w[\w\[\], |]* = .+  # .+", line), line


def test_every_parameter_is_checked(cells):
    for index, cell in enumerate(cells):
        if "parameters" in cell["metadata"].get("tags", []):
            names = re.findall(r"^(\w+):", source(cell), re.M)
            assert [n for n in names if not re.search(rf"\b{n}=", source(cells[index + 1]))] == []


def test_no_cell_is_left_out_of_the_re_run(cells):
    marks = [tag for cell in cells for tag in cell["metadata"].get("tags", [])]
    marks += re.findall(r"#\s*(nbval\S*)", "\n".join(map(source, cells)), re.I)
    left_out = ("nbval", "skip", "raises-exception", "check_output")
    assert [mark for mark in marks if mark.lower().startswith(left_out)] == []


def test_every_figure_says_what_is_seen(cells):
    for cell, output in outputs(cells):
        data = output.get("data", {})
        assert "image/svg+xml" not in data
        if "image/png" in data:
            rich = [one for one in cell["outputs"] if "data" in one]
            assert len(rich) == 1, "the caption would be put under every one of them"
            shown = cell["metadata"].get("mystnb", {})
            assert len(shown.get("image", {}).get("alt", "")) > 20, source(cell)
            assert len(shown.get("figure", {}).get("caption", "")) > 20, source(cell)


def test_no_raw_floats_are_shown(cells):
    for cell, output in outputs(cells):
        if MIME in output.get("data", {}):
            continue
        text = "".join(output.get("text", output.get("data", {}).get("text/plain", "")))
        if "application/papermill.record/text/plain" not in output.get("data", {}):
            assert RAW_FLOAT.search(text) is None, source(cell)


def test_no_path_of_a_machine_is_in_a_notebook(cells):
    texts = [
        {k: v for k, v in o.get("data", o).items() if k != "image/png"} for _, o in outputs(cells)
    ]
    text = json.dumps([texts, [source(cell) for cell in cells]])
    for path in (str(ROOT), str(Path.home()), "/tmp/", "site-packages"):
        assert path not in text
