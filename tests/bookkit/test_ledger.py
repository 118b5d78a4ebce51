import json

import pytest

from bookkit import ledger


def spoil(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


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
            "expected: 7.0",
            "expected: 7.1",
            "TS-X1: ledger's expected is 7.1, notebooks/tiny.md has [7.0]",
        ),
        (
            "tolerance: 1.0e-9",
            "tolerance: 1.0e-2",
            "TS-X1: ledger's tolerance is 0.01, notebooks/tiny.md has 1e-09",
        ),
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
def test_every_planted_fault_is_named(project, old, new, fault):
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
def test_neither_is_a_helper(project, name):
    code = "def oracle(): pass\nclass Helper:\n    def test_sum(self): pass\n"
    (project / "tests" / "test_tiny.py").write_text(code)
    spoil(project / "book" / "claims.yml", "::test_sum", f"::{name}")
    assert ledger.faults(project) == [f"TS-X1: no test tests/test_tiny.py::{name}"]


def test_a_test_may_stand_in_a_class(project):
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
        ("expected: 7.0", "expected: seven", "TS-X1: expected"),
        ("- id", "- [", "not YAML"),
        ("verdict: reproduced", "verdict: open\n  verdict: reproduced", "'verdict' stands twice"),
    ],
)
def test_an_entry_that_is_no_claim_is_named(project, old, new, message):
    spoil(project / "book" / "claims.yml", old, new)
    with pytest.raises(ValueError, match=r"claims\.yml") as caught:
        ledger.read_ledger(project / "book" / "claims.yml")
    assert message in str(caught.value)


def test_an_id_stands_once(project):
    path = project / "book" / "claims.yml"
    path.write_text(path.read_text() * 2)
    with pytest.raises(ValueError, match="TS-X1: stands 2 times"):
        ledger.read_ledger(path)


def test_a_missing_ledger_is_named(tmp_path):
    with pytest.raises(ValueError, match="no such ledger"):
        ledger.read_ledger(tmp_path / "claims.yml")


def test_the_page_counts_links_and_escapes(project):
    spoil(project / "book" / "claims.yml", "terms of the sum", "terms < 5 of the sum")
    page = ledger.page(project)
    assert "1 claims: 1 reproduced, 0 corrected, 0 refuted, 0 open." in page
    assert '<a href="../notebooks/tiny.html#TS-X1">TS-X1</a>' in page
    assert "terms &lt; 5" in page
    assert "printed 7<br>computed 7" in page


def test_an_empty_line_in_a_statement_does_not_end_the_table(project):
    spoil(project / "book" / "claims.yml", "The three terms of the sum make 7.", '"a\\n\\nb"')
    assert "<td>a b</td>" in ledger.page(project)


def test_a_corrected_claim_shows_both_formulas(project):
    spoil(
        project / "book" / "claims.yml",
        "verdict:",
        "printed_formula: a + b\n  corrected_formula: a - b\n  verdict:",
    )
    page = ledger.page(project)
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
