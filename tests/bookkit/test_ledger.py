import json

import pytest

from bookkit import claims, claims_page, ledger
from bookkit.recording import MIME
from bookkit.tables import typeset


def test_a_sound_project_has_no_faults(project):
    assert ledger.faults(project) == []


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (
            "verdict: reproduced",
            "verdict: refuted",
            "TS-X1: ledger says refuted, notebooks/tiny.md finds reproduced",
        ),
        (
            "verdict: reproduced",
            "verdict: checked",
            "TS-X1: a claim whose origin is stated cannot be checked",
        ),
        (
            "origin: stated",
            "origin: ours",
            "TS-X1: printed numbers are a paper's; ours are a reference",
        ),
        ("printed: 7", "reference: 7", "TS-X1: a reference wants its source"),
        (
            "printed: 7",
            "reference: 7\n  source: benchmarks/none.py",
            "TS-X1: no source benchmarks/none.py",
        ),
        ("  printed: 7\n", "", "TS-X1: numbers and a tolerance want each other"),
        ("1.0e-9", "[1, 2]", "TS-X1: as many tolerances as numbers, or one for all"),
        ("1.0e-9", "7", "TS-X1: 7 ± 7: a tolerance as wide as the number"),
        ("1.0e-9", "0.6", "TS-X1: 7 ± 0.6: more than the last digit wants a because"),
        (
            "verdict: reproduced",
            "verdict: corrected",
            "TS-X1: corrected wants what is printed and what is right",
        ),
        ("verdict: reproduced", "verdict: open", "TS-X1: open wants a because: what is missing"),
        ("[tests/test_tiny.py::test_sum]", "[]", "TS-X1: wanted at least one test"),
        ("::test_sum", "::test_product", "TS-X1: no test tests/test_tiny.py::test_product"),
        ("test_tiny.py", "test_none.py", "TS-X1: no test tests/test_none.py::test_sum"),
        (
            "notebooks/tiny.md",
            "notebooks/other.md",
            "TS-X1: ledger says notebooks/other.md, recorded by notebooks/tiny.md",
        ),
        ("id: TS-X1", "id: TS-X2", "TS-X2: no notebook records it (ledger says notebooks/tiny.md)"),
    ],
)
def test_every_planted_fault_is_named(project, old, new, fault, spoil):
    spoil(project / "book" / "claims.yml", old, new)
    assert fault in ledger.faults(project)


@pytest.mark.parametrize("text", ["3", "true", "text", "a: 1"])
def test_a_ledger_that_is_no_list_is_refused(project, text):
    (project / "book" / "claims.yml").write_text(text)
    with pytest.raises(ValueError, match=r"claims\.yml: wanted a list"):
        ledger.faults(project)


@pytest.mark.parametrize("text", ["{", "{}", "[]"])
def test_a_notebook_that_is_none_is_named(project, text):
    (project / "notebooks" / "tiny.ipynb").write_text(text)
    with pytest.raises(ValueError, match=r"tiny\.ipynb: not an executed notebook"):
        ledger.faults(project)


@pytest.mark.parametrize(
    "code",
    ["def oracle():\n    def test_sum(): pass\n", "test_sum = 3\n", "def (", "class A: pass\n"],
)
def test_what_pytest_does_not_collect_is_no_test(project, code):
    (project / "tests" / "test_tiny.py").write_text(code)
    assert "TS-X1: no test tests/test_tiny.py::test_sum" in ledger.faults(project)


@pytest.mark.parametrize("name", ["oracle", "Helper::test_sum", "TestOther::test_sum"])
def test_neither_is_a_helper(project, name, spoil):
    code = "def oracle(): pass\nclass Helper:\n    def test_sum(self): pass\n"
    (project / "tests" / "test_tiny.py").write_text(code)
    spoil(project / "book" / "claims.yml", "::test_sum", f"::{name}")
    assert ledger.faults(project) == [f"TS-X1: no test tests/test_tiny.py::{name}"]


def test_a_test_may_stand_in_a_class(project, spoil):
    code = "class TestSums:\n    def test_sum(self): pass\n"
    (project / "tests" / "test_tiny.py").write_text(code)
    spoil(project / "book" / "claims.yml", "::test_sum", "::TestSums::test_sum")
    assert ledger.faults(project) == []


def test_a_record_without_a_claim_is_named(project):
    (project / "book" / "claims.yml").write_text("")
    assert ledger.faults(project) == ["TS-X1: recorded by notebooks/tiny.md, but not in the ledger"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("verdict: reproduced", "verdict: proven", "TS-X1: verdict = 'proven'"),
        ("  kind: number\n", "", "TS-X1: kind is not set"),
        ("kind: number", "kind: number\n  colour: red", "TS-X1: colour"),
        ("id: TS-X1", "id: X1", "X1: id = 'X1'"),
        ("printed: 7", "printed: seven", "TS-X1: printed"),
        ("- id", "- [", "not YAML"),
        ("verdict: reproduced", "verdict: open\n  verdict: reproduced", "'verdict' stands twice"),
    ],
)
def test_an_entry_that_is_no_claim_is_named(project, old, new, message, spoil):
    spoil(project / "book" / "claims.yml", old, new)
    with pytest.raises(ValueError, match=r"claims\.yml") as caught:
        claims.read_ledger(project / "book" / "claims.yml")
    assert message in str(caught.value)


def test_an_id_stands_once(project):
    path = project / "book" / "claims.yml"
    path.write_text(path.read_text() * 2)
    with pytest.raises(ValueError, match="TS-X1: stands 2 times"):
        claims.read_ledger(path)


def test_a_missing_ledger_is_named(tmp_path):
    with pytest.raises(ValueError, match="no such ledger"):
        claims.read_ledger(tmp_path / "claims.yml")


def test_the_page_counts_links_and_escapes(project, spoil):
    spoil(project / "book" / "claims.yml", "terms of the sum", "terms < 5 of the sum")
    page = claims_page.page(project)
    assert "The papers make 1 claims: 1 reproduced, 0 corrected, 0 refuted, 0 open." in page
    assert '<a href="../notebooks/tiny.html#TS-X1">TS-X1</a>' in page
    assert "terms &lt; 5" in page
    assert "computed 7<br>printed 7 (± 1e-09)<details>" in page
    assert "</summary>Would fail with: one term less<br>" in page


def test_an_empty_line_in_a_statement_does_not_end_the_table(project, spoil):
    spoil(project / "book" / "claims.yml", "The three terms of the sum make 7.", '"a\\n\\nb"')
    assert "<td>a b</td>" in claims_page.page(project)


def test_a_corrected_claim_shows_both_formulas(project, spoil):
    spoil(
        project / "book" / "claims.yml",
        "verdict:",
        "printed_formula: a + b\n  corrected_formula: a - b\n  verdict:",
    )
    page = claims_page.page(project)
    assert "printed: a + b<br>right: a - b" in page


def test_the_command_fails_with_the_place(project, command):
    assert command(project, "-m", "bookkit", "claims").returncode == 0
    path = project / "notebooks" / "tiny.ipynb"
    notebook = json.loads(path.read_text())
    text = json.dumps(notebook).replace('"verdict": "reproduced"', '"verdict": "open"')
    path.write_text(text)
    done = command(project, "-m", "bookkit", "claims")
    assert done.returncode == 1
    assert "TS-X1: ledger says reproduced, notebooks/tiny.md finds open" in done.stdout


def test_a_last_digit_gives_the_tolerance(project, spoil):
    spoil(project / "book" / "claims.yml", "1.0e-9", "0.5")
    assert ledger.faults(project) == []


def test_a_wide_tolerance_may_give_its_reason(project, spoil):
    spoil(project / "book" / "claims.yml", "1.0e-9", "0.6\n  because: read off a curve")
    assert ledger.faults(project) == []


def test_ours_stand_apart(project):
    path = project / "book" / "claims.yml"
    own = path.read_text().replace("TS-X1", "TS-X2").replace("stated", "ours")
    own = own.replace("printed: 7", "reference: 7\n  source: tests/test_tiny.py")
    path.write_text(path.read_text() + own.replace("reproduced", "checked"))
    page = claims_page.page(project)
    assert "1 findings\nof our own stand apart: 1 checked, 0 open." in page
    assert page.index("What the papers claim") < page.index("TS-X1</a>") < page.index("TS-X2</a>")


def record_of(project, **changes):
    """Write another record of the one claim into the executed notebook."""
    path = project / "notebooks" / "tiny.ipynb"
    content = json.loads(path.read_text())
    for cell in content["cells"]:
        for output in cell.get("outputs", []):
            for entry in output.get("data", {}).get(MIME, {}).get("claims", {}).values():
                entry.update(changes)
    path.write_text(json.dumps(content))


def test_a_decided_claim_says_what_it_would_fail_with(project):
    record_of(project, wrong=[])
    fault = "TS-X1: no planted fault: notebooks/tiny.md does not say what it would fail with"
    assert ledger.faults(project) == [fault]


def test_a_refuted_claim_shows_its_numbers(project, spoil):
    spoil(project / "book" / "claims.yml", "verdict: reproduced", "verdict: refuted")
    record_of(project, verdict="refuted", computed=[], note="")
    assert ledger.faults(project) == ["TS-X1: refuted wants our numbers, or what shows it"]


def test_a_fault_that_passes_is_named(project):
    record_of(project, missed=["one term less"])
    assert ledger.faults(project) == ["TS-X1: true as well with this fault: one term less"]


def test_mathematics_of_a_statement_is_set_and_may_be_broken():
    assert typeset("a < $x = 1$") == r'a &lt; <span class="math">\(x = 1\)</span>'
    long = r"$P_k = AP_{k-1}A^{\mathsf T} + B(Q + R)B^{\mathsf T} - K_kSK_k^{\mathsf T}$"
    begun = [part.partition(r"\(")[2][:6] for part in typeset(long).split("</span> ")]
    assert begun == [r"P_k\)", "{}= AP", "{}+ B(", "{}- K_"]
