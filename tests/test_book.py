"""The project as a whole: its ledger, its public names, what importing it costs."""

import base64
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from bookkit import ledger, places

ROOT = Path(__file__).resolve().parents[1]
ROOMS = (
    "seedslib.base",
    "seedslib.delay",
    "seedslib.design",
    "seedslib.designed",
    "seedslib.evaluation",
    "seedslib.extra",
    "seedslib.filters",
    "seedslib.gaussian",
    "seedslib.linearization",
    "seedslib.models",
    "seedslib.pareto",
    "seedslib.piecewise",
    "seedslib.riemann",
    "seedslib.two_step",
    "seedslib.zoo",
    "bookkit",
)


def test_the_ledger_agrees_with_notebooks_and_tests():
    assert ledger.faults(ROOT) == []


def test_every_item_of_the_papers_has_its_place():
    assert places.faults(ROOT) == []


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_is_there_and_documented(room):
    package = importlib.import_module(room)
    for name in package.__all__:
        assert getattr(package, name).__doc__, f"{room}.{name} has no docstring"
    assert set(package.__all__) <= set(dir(package))
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = package.no_such_name


def test_no_module_hides_a_public_name():
    code = """
import importlib, pkgutil, types, seedslib
rooms = [m.name for m in pkgutil.walk_packages(seedslib.__path__, "seedslib.")]
rooms = [name for name in rooms if not name.endswith("__main__")]
modules = {name: importlib.import_module(name) for name in rooms}
for name, module in modules.items():
    for public in getattr(module, "__all__", ()):
        if isinstance(getattr(module, public), types.ModuleType):
            print(name, public)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules_on_purpose = {
        "seedslib.delay examples", "seedslib.piecewise examples",
        "seedslib.designed lemmas", "seedslib.gaussian forms",
    }  # fmt: skip
    assert set(done.stdout.splitlines()) == modules_on_purpose


def test_importing_the_library_is_light():
    heavy = ["sympy", "scipy", "dask", "papermill", "matplotlib", "IPython", "pydantic"]
    code = f"import sys, seedslib; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_files_are_of_one_idea():
    long = {
        p.relative_to(ROOT).as_posix(): n
        for p in (ROOT / "seedslib").rglob("*.py")
        if (n := len(p.read_text().splitlines())) > 300
    }
    assert long == {}


def test_the_picture_of_the_readme_is_one_of_the_book():
    picture = (ROOT / "book" / "_static" / "plugin_loss.png").read_bytes()
    notebook = json.loads((ROOT / "notebooks" / "two_step_power.ipynb").read_text())
    shown = [
        base64.b64decode(output["data"]["image/png"])
        for cell in notebook["cells"]
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert picture in shown, "copy the notebook's figure to book/_static/plugin_loss.png"


def test_the_readme_lists_every_notebook_and_its_links_lead_somewhere():
    text = (ROOT / "README.md").read_text()
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert [link for link in links if not (ROOT / link).exists()] == []
    names = {path.stem for path in (ROOT / "notebooks").glob("*.md")}
    assert {name for name in names if f"notebooks/{name}.ipynb" not in text} == set()


def test_readme_and_contents_name_the_pages_in_the_same_order():
    parts = yaml.safe_load((ROOT / "_toc.yml").read_text())["parts"]
    order = [chapter["file"] for part in parts for chapter in part["chapters"]]
    listed = re.findall(
        r"\[([^\]]*)\]\((notebooks/\w+|book/peers)\.\w+\)", (ROOT / "README.md").read_text()
    )
    table = listed[1:]  # the first is the picture's source
    assert [page for _, page in table] == [
        page for page in order if page in dict(map(reversed, table))
    ]
    for title, page in table:
        assert f"\n# {title}\n" in "\n" + (ROOT / f"{page}.md").read_text()


def test_every_part_with_a_paper_opens_with_its_overview():
    parts = yaml.safe_load((ROOT / "_toc.yml").read_text())["parts"]
    chapters = {part["caption"]: [c["file"] for c in part["chapters"]] for part in parts}
    subjects = [pages for pages in chapters.values() if any("notebooks/" in page for page in pages)]
    overviews = {f"book/{path.stem}" for path in (ROOT / "book").glob("overview_*.md")}
    assert {pages[0] for pages in subjects} == overviews
    assert len(subjects) == len(overviews)
