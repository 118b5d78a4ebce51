"""``python -m bookkit chapter``: what it writes, where it enters it, what it refuses."""

import contextlib
import io
import re
import shutil
from pathlib import Path

import jupytext
import pytest
import yaml

from bookkit import cli

ROOT = Path(__file__).resolve().parents[2]
FILES = "_toc.yml", "README.md"
FLOW = "parts: [{caption: A, chapters: [{file: PAGE}]}]\n"
TITLE = "How the tide comes in"


@pytest.fixture
def book(tmp_path, monkeypatch):
    """The contents and the README of this book, without its pages."""
    for name in (*FILES, "requirements.lock"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "notebooks").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def begin(name="switching_tides", title=TITLE, *more):
    return cli.main(["chapter", name, "--title", title, *more])


def gained(book, name):
    """The one place where a file has become longer, and what is there now."""
    old, new = (ROOT / name).read_text(), (book / name).read_text()
    start = next(k for k in range(len(new)) if old[k : k + 1] != new[k])
    more = len(new) - len(old)
    assert new[:start] + new[start + more :] == old
    return new[start : start + more]


@pytest.mark.parametrize(
    ("name", "more", "part"),
    [
        ("switching_tides", (), "Large-order filter for switching systems"),
        ("field_tides", (), "Held against the field"),
        ("tides", (), "Held against the field"),
        ("tides", ("--part", "Two fragments"), "Two fragments"),
    ],
)
def test_it_closes_a_part_in_contents_and_table(book, capsys, name, more, part):
    assert begin(name, TITLE, *more) == 0
    assert repr(part) in capsys.readouterr().out
    assert sorted(p.name for p in book.rglob("*") if p.is_file()) == sorted(
        [*FILES, "requirements.lock", f"{name}.md"]
    )
    assert f"file: notebooks/{name}\n" in gained(book, "_toc.yml")
    assert f"[{TITLE}](notebooks/{name}.ipynb)" in gained(book, "README.md")
    parts = yaml.safe_load((book / "_toc.yml").read_text())["parts"]
    pages = {p["caption"]: [c["file"] for c in p["chapters"]] for p in parts}
    assert pages[part][-1] == f"notebooks/{name}"
    order = [page for part in pages.values() for page in part]
    links = re.findall(r"\]\((notebooks/\w+|book/peers)\.\w+\)", (book / "README.md").read_text())
    assert links[1:] == [page for page in order if page in links[1:]]


def test_the_template_is_a_chapter_that_runs(book):
    assert begin() == 0
    text = (book / "notebooks" / "switching_tides.md").read_text()
    assert text.count(f"\n# {TITLE}\n") == 1
    assert "@" not in text
    cells = [c for c in jupytext.reads(text, "md:myst").cells if c.cell_type == "code"]
    names, said = {}, io.StringIO()
    with contextlib.redirect_stdout(said):
        for cell in cells:
            exec(cell.source, names)  # the check cell is given these names as its globals
    assert names["settled"] == pytest.approx(names["before"] - names["q"], abs=1e-9)
    (picture,) = [c for c in cells if "figure" in c.metadata.get("mystnb", {})]
    assert len(picture.metadata["mystnb"]["image"]["alt"]) > 20
    shown = [c for c in cells if not c.metadata.get("tags")]
    assert [len(c.source.splitlines()) for c in shown] == [3]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("Tides",), "name: wanted words of a-z and 0-9 joined by '_', got 'Tides'"),
        (("tides__in",), "name: wanted words"),
        (("../tides",), "name: wanted words"),
        (("delay_loss",), "name: notebooks/delay_loss is in _toc.yml already, wanted a new name"),
        (("tides", "a | b"), "title: wanted one line without"),
        (("tides", " "), "title: wanted one line without"),
        (("tides", TITLE, "--part", "Tides"), "part: wanted one of Before you start, "),
        (("tides", TITLE, "--part", "References"), "README.md: wanted a row of the table"),
    ],
)
def test_what_cannot_be_a_chapter_is_refused_and_nothing_written(book, capsys, arguments, told):
    assert begin(*arguments) == 2
    assert capsys.readouterr().err.startswith(f"bookkit: {told}")
    assert list((book / "notebooks").iterdir()) == []
    assert [(book / name).read_text() for name in FILES] == [
        (ROOT / name).read_text() for name in FILES
    ]


def test_a_chapter_that_is_there_is_left_as_it_is(book, capsys):
    assert begin() == 0
    source = book / "notebooks" / "switching_tides.md"
    source.write_text("mine")
    assert begin() == 2
    assert "notebooks/switching_tides.md is there already" in capsys.readouterr().err
    assert source.read_text() == "mine"
    source.rename(source.with_suffix(".ipynb"))
    assert begin() == 2
    assert "notebooks/switching_tides.ipynb is there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("_toc.yml", None, "_toc.yml: no such file"),
        ("_toc.yml", "root: x\n", "_toc.yml: wanted parts with captions"),
        ("_toc.yml", FLOW.replace("PAGE", "book/a"), "_toc.yml: wanted a part with a notebook"),
        ("_toc.yml", FLOW.replace("PAGE", "notebooks/a"), "_toc.yml: wanted a line"),
        ("README.md", "", "README.md: wanted a row"),
    ],
)  # fmt: skip
def test_a_project_without_its_files_is_refused(book, capsys, name, text, told):
    (book / name).unlink()
    if text is not None:
        (book / name).write_text(text)
    assert begin() == 2
    assert capsys.readouterr().err.startswith(f"bookkit: {told}")
