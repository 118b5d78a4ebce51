from collections import Counter
from pathlib import Path

from bookkit import strips
from bookkit.claims import LEDGER, PAPERS, read_ledger

ROOT = Path(__file__).resolve().parents[2]


def test_a_strip_has_a_piece_a_verdict_as_wide_as_it_is_frequent():
    made = strips.strip(Counter(reproduced=3, open=1))
    assert '<span class="reproduced" style="flex-grow:3"></span>' in made
    assert '<span class="open">1 open</span>' in made
    assert "refuted" not in made


def test_the_strips_hold_every_claim_of_the_ledger_once():
    made = strips.strips(ROOT)
    claims = read_ledger(ROOT / LEDGER)
    total = sum(
        int(piece.split('"')[0])
        for paper in PAPERS
        for kind in ("verdicts", "findings")
        for piece in made[f"{kind}__{paper.replace('-', '_')}"].split("flex-grow:")[1:]
    )
    assert total == len(claims)


def test_the_landing_page_types_no_result():
    text = (ROOT / "book" / "index.md").read_text()
    results = text.split("## What comes out")[1].split("## Start here")[0]
    typed = results.replace("two hundred", "")
    for piece in typed.split("{{")[1:]:
        typed = typed.replace("{{" + piece.split("}}")[0] + "}}", "")
    numbers = {word for word in typed.replace("%", " ").split() if any(c.isdigit() for c in word)}
    assert numbers <= {"1", "2", "3", "5", "200", "100."}
