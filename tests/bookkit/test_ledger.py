"""The ledger of claims: each rule is broken once, and the fault is named with the claim."""

import json
from pathlib import Path

import pytest

from bookkit import claims, pages, recording
from bookkit.__main__ import main
from bookkit.recording import MIME, read_verdicts

ROOT = Path(__file__).resolve().parents[2]


def disagreements(root):
    return claims.disagreements(root, read_verdicts(root))


def record_of(project, **changes):
    """Write another record of the one claim into the executed notebook."""
    path = project / "notebooks" / "tiny.ipynb"
    content = json.loads(path.read_text())
    for cell in content["cells"]:
        for output in cell.get("outputs", []):
            for entry in output.get("data", {}).get(MIME, {}).get("claims", {}).values():
                entry.update(changes)
    path.write_text(json.dumps(content))


def test_every_decided_claim_of_the_book_has_a_planted_fault_that_turns_it():
    assert disagreements(ROOT) == []
    recorded = read_verdicts(ROOT)
    decided = [c for c in claims.read_ledger(ROOT / claims.LEDGER) if c.verdict != "open"]
    entries = {c.id: recorded[c.id][c.notebook] for c in decided}
    assert len(entries) > 140
    assert [name for name, e in entries.items() if not e["wrong"] or e.get("missed")] == []


def test_a_sound_entry_has_no_faults(project, spoil):
    assert disagreements(project) == []
    spoil(project / "book" / "claims.yml", "1.0e-9", "0.5")  # half a unit of the last digit
    assert disagreements(project) == []


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("verdict: reproduced", "verdict: refuted", "ledger says refuted, notebooks/tiny.md finds"),
        ("verdict: reproduced", "verdict: checked", "origin is stated cannot be checked"),
        ("verdict: reproduced", "verdict: corrected", "corrected wants what is printed and"),
        ("verdict: reproduced", "verdict: open", "open wants a because"),
        ("origin: stated", "origin: ours", "printed numbers are a paper's"),
        ("printed: 7", "reference: 7", "a reference wants its source or a because"),
        ("printed: 7", "reference: 7\n  source: benchmarks/none.py", "no source benchmarks/none"),
        ("  printed: 7\n", "", "numbers and a tolerance want each other"),
        ("1.0e-9", "7", "a tolerance as wide as the number"),
        ("1.0e-9", "0.6", "more than the last digit wants a because"),
        ("notebooks/tiny.md", "notebooks/other.md", "recorded by notebooks/tiny.md"),
        ("id: TS-X1", "id: TS-X2", "recorded by no notebook"),
        ("origin: stated", "origin: restored", "restored wants readings"),
        ("verdict: reproduced", "readings: one\n  verdict: reproduced", "readings want a reading"),
        (
            "verdict: reproduced",
            "reading: the 7 is a 1\n  readings: one\n  verdict: refuted",
            "refuted under one reading of what cannot be read: wanted open",
        ),
        ("proved: numbers", "proved: symbols", "proved by symbols, but notebooks/tiny.md shows"),
    ],
)
def test_an_entry_that_breaks_a_rule_is_named(project, old, new, fault, spoil):
    spoil(project / "book" / "claims.yml", old, new)
    found = disagreements(project)
    assert any(line.startswith("TS-X") and fault in line for line in found), found


@pytest.mark.parametrize(
    ("record", "fault"),
    [
        ({"wrong": []}, "no planted fault: notebooks/tiny.md"),
        ({"missed": ["one term less"]}, "true as well with this fault: one term less"),
        ({"verdict": "open"}, "notebooks/tiny.md finds open"),
        ({"verdict": "refuted", "computed": [], "note": ""}, "refuted wants our numbers"),
    ],
)
def test_a_record_that_breaks_a_rule_is_named(project, record, fault, spoil, capsys, monkeypatch):
    if record.get("verdict") == "refuted":
        spoil(project / "book" / "claims.yml", "verdict: reproduced", "verdict: refuted")
    record_of(project, **record)
    (found,) = disagreements(project)
    assert found.startswith("TS-X1: ")
    assert fault in found
    monkeypatch.chdir(project)
    assert main(["claims"]) == 1
    assert found in capsys.readouterr().out


def test_an_open_claim_needs_no_planted_fault(project, spoil):
    spoil(project / "book" / "claims.yml", "reproduced", "open\n  because: the scan is illegible")
    record_of(project, verdict="open", wrong=[])
    assert disagreements(project) == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("verdict: reproduced", "verdict: proven", "TS-X1: verdict"),
        ("  proved: numbers\n", "", "TS-X1: proved"),
        ("  place: example 0\n", "", "TS-X1: place"),
        ("origin: stated", "origin: stated\n  tests: []", "TS-X1: tests"),
        ("- id", "- [", "not YAML"),
    ],
)
def test_an_entry_that_is_no_claim_is_named(project, old, new, message, spoil):
    spoil(project / "book" / "claims.yml", old, new)
    with pytest.raises(ValueError, match=r"claims\.yml") as caught:
        claims.read_ledger(project / "book" / "claims.yml")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("readings", "verdict"), [("one", "open"), ("all", "corrected"), (None, "corrected")]
)
def test_what_one_reading_denies_is_open(project, monkeypatch, capsys, readings, verdict):
    path = project / "book" / "claims.yml"
    supplied = f"reading: the 7 is a 1\n  readings: {readings}\n  verdict"
    if readings:
        path.write_text(path.read_text().replace("verdict", supplied))
    monkeypatch.chdir(project)
    recording.claim("TS-X1", computed=1.0, corrected=True)
    assert f"TS-X1: {verdict}" in capsys.readouterr().out
    recording.claim("TS-X1", computed=7.0)
    assert "TS-X1: reproduced" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("exact", "given", "verdict"),
    [
        ([True, True], {}, "reproduced"),
        ([True, False], {}, "refuted"),
        ([True, True], {"computed": 1.0}, "corrected"),
        ([True, False], {"computed": 1.0}, "refuted"),
        ([True, True], {"computed": 1.0, "corrected": False}, "refuted"),
    ],
)
def test_identities_decide_what_they_prove(project, monkeypatch, capsys, exact, given, verdict):
    monkeypatch.chdir(project)
    names = dict(zip(("first", "second"), exact, strict=True))
    recording.claim("TS-X1", **({"computed": 7.0} | given), identities=names)
    assert f"TS-X1: {verdict}" in capsys.readouterr().out


def test_what_a_paper_only_implies_is_counted_apart(project):
    (one,) = claims.read_ledger(project / "book" / "claims.yml")
    implied = one.model_copy(update={"origin": "implied", "verdict": "corrected"})
    assert pages.paper_counts([one, implied]) == "1 reproduced; of what it only implies 1 corrected"


def test_a_claim_that_stands_twice_or_not_at_all_is_named(project):
    path = project / "book" / "claims.yml"
    path.write_text(path.read_text() * 2)
    with pytest.raises(ValueError, match="TS-X1: stands 2 times"):
        disagreements(project)
    path.write_text("")
    assert disagreements(project) == ["TS-X1: recorded, but not in the ledger"]


def test_the_page_shows_counts_and_the_boxes_of_the_notebooks(project, spoil):
    path, notebook = project / "book" / "claims.yml", project / "notebooks" / "tiny.ipynb"
    own = path.read_text().replace("TS-X1", "TS-X2").replace("stated", "ours")
    own = own.replace("printed: 7", "reference: 7").replace("reproduced", "checked")
    path.write_text(path.read_text() + own)
    content = json.loads(notebook.read_text())
    for cell in content["cells"]:
        for output in cell.get("outputs", []):
            if entries := output.get("data", {}).get(MIME, {}).get("claims"):
                entries["TS-X2"] = entries["TS-X1"] | {"says": "terms < 5 of $a + b$"}
    notebook.write_text(json.dumps(content))
    page = pages.claims_page(project)
    assert "The papers make 1 claims: 1 reproduced. 0 more follow from them" in page
    assert "1 findings of our own" in page
    assert "| example 0 | {index}`TS-X1` | reproduced | numbers |" in page
    assert "- example 0 (TS-X1): ``a |> h``\n\n  $a + b$" in page
    assert page.count(":::{dropdown}") == 1
    assert page.index("What the papers claim") < page.index("TS-X1</b>") < page.index("TS-X2</b>")
    assert '<a href="../notebooks/tiny.html#TS-X1">tiny</a>' in page
    assert r'terms &lt; 5 of <span class="math">\(a + b\)</span>' in page
    assert "computed 7; printed 7 (± 1e-09); Would fail with: one term less" in page
