"""The pages of the book: links, names, pictures and versions are those of today."""

import base64
import importlib
import json
import re
import tomllib
from itertools import pairwise
from pathlib import Path

import pytest
import yaml

import seedslib
from bookkit import claims

ROOT = Path(__file__).resolve().parents[1]


def test_links_of_the_readme_lead_somewhere_and_its_picture_is_that_of_a_notebook():
    text = (ROOT / "README.md").read_text()
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert [link for link in links if "://" not in link and not (ROOT / link).exists()] == []
    pictures = [(ROOT / name).read_bytes() for name in re.findall(r"!\[[^\]]+\]\((\S+)\)", text)]
    shown = {
        base64.b64decode(output["data"]["image/png"])
        for path in (ROOT / "notebooks").glob("*.ipynb")
        for cell in json.loads(path.read_text())["cells"]
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    }
    assert pictures
    assert set(pictures) <= shown, "copy the notebook's figure to book/_static"


PAPERS = {
    "Choi, Song, Shin": {"two-step"},
    "Kolessa": {"piecewise"},
    "Babello": {"delay"},
    "Rudenko: large-order filter for jump-diffusions": {"jump-diffusion"},
    "Rudenko: large-order filter for switching systems": {"switching"},
    "surviving pages": {"compromise", "riemann"},
}


def test_verdicts_in_the_readme_are_those_of_the_ledger():
    text, ledger = (ROOT / "README.md").read_text(), claims.read_ledger(ROOT / claims.LEDGER)
    for row, papers in PAPERS.items():
        (numbers,) = re.findall(rf"^\| {re.escape(row)}.*?\|(( \d+ \|){{4}})$", text, re.M)
        verdicts = [c.verdict for c in ledger if c.paper in papers and c.origin != "ours"]
        wanted = [verdicts.count(v) for v in ("reproduced", "corrected", "refuted", "open")]
        assert [int(n) for n in numbers[0].split("|")[:4]] == wanted, row


def test_lines_of_the_scans_name_claims_of_their_paper_and_have_readings_that_can_be_set():
    papers = {c.id: c.paper for c in claims.read_ledger(ROOT / claims.LEDGER)}
    rows = yaml.safe_load((ROOT / "book/concordance.yml").read_text())
    places = [(row["paper"], row["place"]) for row in rows]
    assert len(set(places)) == len(places)
    for row in rows:
        assert {papers[id] for id in row.get("claims", [])} <= {row["paper"]}, row["place"]
        assert row["line"].strip("`") == row["line"] != "", row["place"]
        reading = re.sub(r"\\[{}]", "", row["reading"])
        depths = [
            reading[:end].count("{") - reading[:end].count("}") for end in range(len(reading))
        ]
        assert min(depths) == 0 == reading.count("{") - reading.count("}"), row["place"]


def test_filters_that_the_readme_names_are_in_the_library():
    table = (ROOT / "README.md").read_text().partition("| your problem |")[2].partition("\n\n")[0]
    names = re.findall(r"`(\w+)\.(\w+)`", table)
    assert len(names) > 6
    for package, name in names:
        assert name in importlib.import_module(f"seedslib.{package}").__all__


def test_the_contents_name_every_page_and_notebook_once():
    toc = (ROOT / "_toc.yml").read_text()
    files = [*re.findall(r"file: (\S+)", toc), yaml.safe_load(toc)["root"]]
    assert len(files) == len(set(files))
    sources = [*ROOT.glob("book/*.md"), *ROOT.glob("notebooks/*.md")]
    assert {f"{path.parent.name}/{path.stem}" for path in sources} <= set(files)


def test_no_line_of_a_sentence_becomes_an_item_of_a_list():
    for path in [*ROOT.glob("book/*.md"), *ROOT.glob("notebooks/*.md")]:
        text = re.sub(r"(?ms)^( *)(```|\$\$).*?^\1\2", "", path.read_text())
        for before, line in pairwise(text.splitlines()):
            item = re.match(r"(\d+[.)]|[-+*]) ", line)
            assert not (
                item and re.match(r"[\w$(\[]", before) and not re.match(r"\d+[.)] ", before)
            ), line


@pytest.mark.parametrize("path", sorted(ROOT.glob("book/_static/*.svg")), ids=lambda p: p.stem)
def test_every_drawing_has_a_title_and_a_description(path):
    svg = path.read_text()
    assert len(re.search(r"<title[^>]*>(.*?)</title>", svg)[1]) > 10
    assert len(re.search(r"<desc.*?>(.*?)<", svg, re.S)[1]) > 60


def test_names_among_the_words_are_names_of_the_library():
    packages = [importlib.import_module(f"seedslib.{name}") for name in seedslib.__all__]
    known = {name for package in packages for name in getattr(package, "__all__", ())}
    text = (ROOT / "book" / "notation.md").read_text().partition("## Words")[2]
    named = set(re.findall(r"(?<!\})`([A-Za-z_]+)(?:\([^`]*\))?`", text))
    assert len(named) > 10
    assert named - known == set()


def test_a_verdict_under_one_reading_says_so_wherever_it_is_mentioned():
    one = {c.id for c in claims.read_ledger(ROOT / claims.LEDGER) if c.readings == "one"}
    missing, mentioned = [], set()
    for path in [*ROOT.glob("book/*.md"), ROOT / "README.md"]:
        for section in re.split(r"\n(?=#+ )", path.read_text()):
            heading = section.partition("\n")[0]
            for block in re.split(r"\n(?=[-*] |\*\*|\| |\n)", section):
                names = one & set(re.findall(r'#([A-Z]{2}-\w+)"', block))
                mentioned |= names
                if names and not re.search(r"\bread(s|ing|ings)?\b", heading + block, re.I):
                    missing.append((path.name, names))
    assert len(mentioned) > 15
    assert missing == []


def test_the_citation_has_the_version_of_the_project():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
