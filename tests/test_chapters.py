"""What every chapter of the book promises its reader."""

import ast
import base64
import builtins
import json
import os
import re
import struct
import subprocess
import symtable
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PARTS = yaml.safe_load((ROOT / "_toc.yml").read_text())["parts"]
BOOK, RECORD, LIBRARY = PARTS[:-2], PARTS[-2], PARTS[-1]
CHAPTERS = [
    chapter["file"].partition("/")[2]
    for part in BOOK
    for chapter in part["chapters"]
    if chapter["file"].startswith("notebooks/")
]
RECORDED = re.findall(r"notebooks/(\w+)", yaml.safe_dump(RECORD))
PAGES = [ROOT / "README.md", *sorted((ROOT / "book").glob("*.md"))]
PAGES = [page for page in PAGES if page.stem not in ("claims", "bibliography")]


@pytest.fixture(params=CHAPTERS)
def chapter(request):
    """Cells of an executed chapter."""
    return json.loads((ROOT / "notebooks" / f"{request.param}.ipynb").read_text())["cells"]


def source(cell):
    return "".join(cell["source"])


def tags(cell):
    return set(cell["metadata"].get("tags", []))


def hidden(cell):
    return bool({"remove-cell", "remove-input"} & tags(cell))


def tables(text):
    """How many tables a Markdown text has."""
    return len(re.findall(r"(?m)^\s*\|[\s:|-]*--[\s:|-]*\|\s*$", text))


def code(cells):
    return [cell for cell in cells if cell["cell_type"] == "code"]


def pictures(cells):
    for cell in code(cells):
        for output in cell["outputs"]:
            if "image/png" in output.get("data", {}):
                yield cell, base64.b64decode(output["data"]["image/png"])


def prose(text):
    """The words of a page: no code, formula, address or name of a thing."""
    text = re.sub(
        r"(?ms)^(`{3,}|~{3,})[^\n]*\n.*?^\1", "", re.sub(r"\A---.*?\n---\n", "", text, flags=re.S)
    )
    text = re.sub(
        r"\$\$.*?\$\$|\$[^$]*\$|``.*?``|`[^`]*`|\{\{.*?\}\}|\]\([^)]*\)|<[^>]*>",
        " ",
        text,
        flags=re.S,
    )
    return " ".join(re.sub(r"(?m)^:\w+:.*$", "", text).split())


def test_the_contents_are_a_book_a_record_and_a_library():
    assert RECORD["caption"] == "Replication record"
    assert LIBRARY["caption"] == "seedslib"
    assert 19 <= len(CHAPTERS) <= 26
    assert len(list((ROOT / "notebooks").glob("*.md"))) <= 44


def names_of(program):
    """The global names that a program binds, and those that it reads and does not bind itself."""
    bound, read, tables = set(), set(), [symtable.symtable(program, "cell", "exec")]
    while tables:
        table = tables.pop()
        tables += table.get_children()
        for symbol in table.get_symbols():
            top = table.get_type() == "module"
            if (top or symbol.is_declared_global()) and (
                symbol.is_assigned() or symbol.is_imported() or symbol.is_namespace()
            ):
                bound.add(symbol.get_name())
            if symbol.is_referenced() and (top or symbol.is_global()):
                read.add(symbol.get_name())
    return bound, read - bound


def needs_of_a_chapter(cells):
    """What the visible code of a chapter wants from elsewhere: names and packages."""
    known, wanted, concealed, packages = {*dir(builtins), "display"}, set(), set(), set()
    for cell in code(cells):
        bound, read = names_of(source(cell))
        if hidden(cell) and "parameters" not in tags(cell):
            concealed |= bound
            continue
        wanted |= (read - known) | (read & concealed)
        known |= bound
        for node in ast.walk(ast.parse(source(cell))):
            if isinstance(node, ast.ImportFrom):
                packages.add((node.module or "").partition(".")[0])
            elif isinstance(node, ast.Import):
                packages |= {alias.name.partition(".")[0] for alias in node.names}
    return wanted, packages - set(sys.stdlib_module_names)


def test_visible_code_wants_nothing_from_hidden_cells(chapter):
    """With the run of the whole notebook this says that the visible code runs by itself."""
    wanted, packages = needs_of_a_chapter(chapter)
    assert wanted == set()
    assert packages <= {"seedslib", "numpy", "scipy", "sympy", "matplotlib"}


@pytest.mark.parametrize(
    ("concealed", "name"), [("import numpy as np", "np"), ("size = 3", "size")]
)
def test_visible_code_that_wants_a_hidden_cell_is_found(concealed, name):
    def cell(text, *names):
        return {"cell_type": "code", "source": text, "metadata": {"tags": names}, "outputs": []}

    shown = ["import numpy as np", "size = 3", "def f():\n    return np.zeros(size)", "f()"]
    cells = [cell(text, *(["remove-cell"] if text == concealed else [])) for text in shown]
    assert needs_of_a_chapter(cells)[0] == {name}


def test_visible_code_runs_by_itself(tmp_path):
    """The shortest chapter, in a process of its own without the harness of the book."""
    cells = json.loads((ROOT / "notebooks/first_filter.ipynb").read_text())["cells"]
    shown = [c for c in code(cells) if not hidden(c) or "parameters" in tags(c)]
    program = "\n\n".join(map(source, shown))
    (tmp_path / "chapter.py").write_text("from IPython.display import display\n" + program)
    (tmp_path / "bookkit.py").write_text("raise ImportError('only in the book')")
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT}", "MPLBACKEND": "agg"}
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "chapter.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-2000:]


def test_the_harness_is_at_most_two_hidden_cells(chapter):
    harness = [c for c in code(chapter) if hidden(c) and "parameters" not in tags(c)]
    assert len(harness) <= 2
    for cell in code(chapter):
        assert hidden(cell) or "bookkit" not in source(cell)


def test_lines_of_code_are_no_wider_than_the_page(chapter):
    shown = [c for c in code(chapter) if not hidden(c)]
    read = [c for c in shown if "hide-input" not in tags(c)]
    lines = [line for cell in read for line in source(cell).splitlines()]
    assert [line for line in lines if len(line) > 84] == []


def test_the_first_figure_is_a_signal(chapter):
    cell, _ = next(pictures(chapter))
    over_time = re.search(r"label=[\"'(]?.*\b(time|year|day|step)", source(cell))
    assert over_time or cell["metadata"]["mystnb"]["figure"]["caption"].startswith("One run")


def test_figures_are_transparent_and_as_wide_as_their_text_needs(chapter):
    shown = list(pictures(chapter))
    assert 1 <= len(shown) <= 6
    for cell, picture in shown:
        width, _, _, colours = struct.unpack(">IIBB", picture[16:26])
        assert width <= 1250, source(cell)  # 5.6 inches at 220 dots
        assert b"tRNS" in picture or colours == 6, source(cell)


def test_at_most_three_tables(chapter):
    text = "\n".join(source(cell) for cell in chapter if cell["cell_type"] == "markdown")
    count = tables(text)
    for cell in code(chapter):
        for output in cell["outputs"]:
            data = output.get("data", {})
            count += "".join(data.get("text/html", "")).count("<table")
            count += tables("".join(data.get("text/markdown", "")))
    assert count <= 3


def test_chapters_say_which_filter_to_take_and_set_exercises(chapter):
    headings = re.findall(
        r"(?m)^#+ (.*)", "\n".join(source(c) for c in chapter if c["cell_type"] == "markdown")
    )
    assert [h for h in headings if h.startswith("Which to take")]
    assert [h for h in headings if h.startswith("Exercises")]


OLD_WORDS = re.compile(
    r"""\b(?:
        (?<!total\ )laws?(?!\ of\ total) | (?<!standard\ )deviations? | blunt | umpires? | frozen
        | planted\ faults? | held\ against | oftener | beforehand | one-estimate | ours
        | printed\ filter | (?:is|are)\ told | numbers\ stand | next\ to\ nothing
    )\b""",
    re.I | re.X,
)


@pytest.mark.parametrize("name", [*CHAPTERS, *RECORDED, *(page.stem for page in PAGES)])
def test_words_are_those_of_the_field(name):
    path = ROOT / "notebooks" / f"{name}.md"
    path = path if path.exists() else next(p for p in PAGES if p.stem == name)
    assert OLD_WORDS.findall(prose(path.read_text())) == []
