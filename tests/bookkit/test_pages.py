"""What pages take from notebooks, and what is refused in built pages."""

import base64
import doctest
import re
import struct
from pathlib import Path

import pytest
from docutils import nodes

import seedslib
from bookkit import html_check, pages, programs
from bookkit.recording import MIME

ROOT = Path(__file__).resolve().parents[2]


def test_a_page_leaves_records_out_and_keeps_boxes_and_figures_at_half_their_pixels():
    png = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 640, 480)
    record, box = {MIME: {}, "text/plain": "x = 1"}, {MIME: {}, "text/html": "<div></div>"}
    figure = {"image/png": base64.b64encode(png).decode()}
    cell = {"metadata": {}, "outputs": [{"data": data} for data in (record, box, figure)]}
    pages.as_shown({"cells": [cell]})
    assert [output["data"] for output in cell["outputs"]] == [box, figure]
    assert cell["metadata"]["mystnb"]["image"]["width"] == "320px"


def test_every_package_has_a_page_in_the_reference():
    described = {path.stem for path in (ROOT / "book" / "api").glob("*.md")}
    assert described == set(seedslib.__all__) - {"commands"}  # its `--help` describes it


def test_the_program_of_the_readme_prints_what_the_readme_shows(capsys):
    text = (ROOT / "README.md").read_text()
    exec(compile(programs.program(text), "README.md", "exec"), {})
    assert f"\n```\n{capsys.readouterr().out}```\n" in text


FIRST = [ROOT / "book" / name for name in ("index.md", "overview_how.md")]
SHOWN = [*FIRST, *sorted((ROOT / "book" / "api").glob("*.md"))]


@pytest.mark.parametrize("page", SHOWN, ids=lambda p: p.stem)
def test_examples_of_the_reference_and_of_first_pages_print_what_they_show(page):
    tried = doctest.testfile(str(page), module_relative=False)
    assert tried.failed == 0
    assert tried.attempted > 1 or page.stem in ("base", "tape", "extra")


def test_printed_sentences_are_told_from_printed_tables():
    def block(text):
        return nodes.literal_block(text, text, language="myst-ansi")

    words = "y: wanted numbers, " + 15 * "and more "
    sentence, table, titled = block(words), block(30 * "1.23  "), block(words + 2 * "\nrow  1")
    pages._mark_sentences(None, nodes.container("", sentence, table, titled), "page")
    assert sentence["classes"] == ["sentences"]
    assert table["classes"] == titled["classes"] == []


def test_programs_have_the_lines_of_their_page(tmp_path):
    programs.write(ROOT, tmp_path / "programs")
    page = (ROOT / "notebooks" / "first_filter.md").read_text().splitlines()
    lines = (tmp_path / "programs" / "first_filter.py").read_text().splitlines()
    code = [(k, line) for k, line in enumerate(lines) if line and "# pyright" not in line]
    assert len(code) > 20
    assert [line for k, line in code if page[k] != line] == []


def test_the_search_knows_every_built_page_and_puts_chapters_first(tmp_path):
    names = ("notebooks/one", "notebooks/two", "book/trust")
    for name in names:
        path = tmp_path / f"{name}.html"
        path.parent.mkdir(exist_ok=True)
        path.write_text('<article class="bd-article"><p>A &lt; b<pre>code</pre></p></article>')
    contents = {"parts": [{"chapters": [{"file": names[0]}]}, {}, {}]}
    found = pages.texts(tmp_path, names, contents)
    assert {name: page["text"] for name, page in found.items()} == dict.fromkeys(names, "A < b")
    assert found[names[0]]["weight"] > found[names[2]]["weight"] > found[names[1]]["weight"]


OUTSIDE = "//cdn.example.org/a"


@pytest.mark.parametrize(
    "loads",
    [
        f'<script src="https:{OUTSIDE}"></script>',
        f'<link rel="stylesheet" href="{OUTSIDE}">',
        f'<img alt="x" src="x.png" srcset="x.png, {OUTSIDE} 2x">',
        f'<div style="background: url({OUTSIDE})"></div>',
        f"<style>p {{ background: url('{OUTSIDE}') }}</style>",
        "css",
    ],
)
def test_what_a_page_loads_from_the_network_is_named(tmp_path, loads):
    page = tmp_path / "page.html"
    sound = '<a href="https://example.org/">outside</a><img src="x.png"><link href="a.css">'
    sound += '<img src="data:image/png;base64,//8A">'
    page.write_text(sound)
    assert html_check.network_loads(tmp_path) == []
    if loads == "css":
        (tmp_path / "style.css").write_text(f'@import "{OUTSIDE}";')
    else:
        page.write_text(sound + loads)
    (found,) = html_check.network_loads(tmp_path)
    assert re.match(r"(page\.html|style\.css): loads (https:)?//cdn", found)
