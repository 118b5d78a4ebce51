"""The ledger of claims: what the papers say, what was found, and where it is checked.

A verdict stands in the ledger and is computed by a notebook; `faults` says where the two, or
the tests named for them, do not fit.
"""

from __future__ import annotations

import ast
import html
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bookkit.files import read_yaml
from bookkit.parameters import explain
from bookkit.recording import read_records

PAPERS = {
    "two-step": "Two-step estimator",
    "piecewise": "Piecewise-linear filter",
    "delay": "Kalman filter with delay",
    "compromise": "Compromise of criteria by bisection",
    "riemann": "Riemann problem",
    "jump-diffusion": "Large-order filter for jump-diffusions",
    "switching": "Large-order filter for switching systems",
}
VERDICTS = ("reproduced", "corrected", "refuted", "open")
Number = Annotated[float, Field(allow_inf_nan=False)]


class Claim(BaseModel):
    """One theorem, formula, number or statement of a paper."""

    model_config = ConfigDict(extra="forbid")
    id: Annotated[str, Field(pattern=r"^[A-Z]{2}-[A-Za-z0-9]+$")]
    paper: Literal[tuple(PAPERS)]
    place: str
    statement: str
    kind: Literal["identity", "number", "figure", "qualitative"]
    notebook: Annotated[str, Field(pattern=r"^notebooks/\w+\.md$")]
    test: Annotated[str, Field(pattern=r"^tests/[\w/]+\.py(::\w+){1,2}$")]
    expected: Number | list[Number] | None = None
    tolerance: Number | list[Number] | None = None
    printed_formula: str | None = None
    corrected_formula: str | None = None
    verdict: Literal[VERDICTS]


def read_ledger(path: Path) -> list[Claim]:
    """The claims of a ledger file.

    Raises
    ------
    ValueError
        No such file, not YAML, or an entry that is not a claim; the entry is named.
    """
    entries = read_yaml(path, "ledger") or []
    if not isinstance(entries, list):
        raise ValueError(f"{path}: wanted a list of claims")
    claims, problems = [], []
    for position, entry in enumerate(entries):
        name = entry.get("id", f"entry {position}") if isinstance(entry, dict) else str(entry)
        try:
            claims.append(Claim.model_validate(entry))
        except ValidationError as error:
            problems.append(f"{name}: {explain(error)}")
    counts = Counter(claim.id for claim in claims)
    problems += [f"{name}: stands {n} times in the ledger" for name, n in counts.items() if n > 1]
    if problems:
        raise ValueError(f"{path.name}: " + "; ".join(problems))
    return claims


def faults(root: Path) -> list[str]:
    """Everything that does not fit between the ledger, the notebooks and the tests.

    Parameters
    ----------
    root : Path
        The project's folder.
    """
    claims = read_ledger(root / "book" / "claims.yml")
    recorded = _recorded(sorted((root / "notebooks").glob("*.ipynb")))
    found = []
    for claim in claims:
        home = f"{claim.id}: ledger says {claim.notebook}"
        places = recorded.get(claim.id, {})
        if not places:
            found.append(f"{claim.id}: no notebook records it (ledger says {claim.notebook})")
        elif set(places) != {claim.notebook}:
            found.append(f"{home}, recorded by {', '.join(places)}")
        else:
            found += _disagreements(claim, places[claim.notebook])
        if not _test_exists(root, claim.test):
            found.append(f"{claim.id}: no test {claim.test}")
    known = {claim.id for claim in claims}
    found += [
        f"{name}: recorded by {', '.join(places)}, but not in the ledger"
        for name, places in recorded.items()
        if name not in known
    ]
    return found


def _recorded(notebooks: Iterable[Path]) -> dict[str, dict[str, dict]]:
    places: dict[str, dict[str, dict]] = {}
    for path in notebooks:
        try:
            claims = read_records(json.loads(path.read_text(encoding="utf-8"))).claims
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path.name}: not an executed notebook: {error}") from None
        for name, entry in claims.items():
            places.setdefault(name, {})[f"notebooks/{path.stem}.md"] = entry
    return places


def _disagreements(claim: Claim, entry: dict) -> list[str]:
    found = []
    if entry["verdict"] != claim.verdict:
        found.append(
            f"{claim.id}: ledger says {claim.verdict}, {claim.notebook} finds {entry['verdict']}"
        )
    for ledger_name, entry_name in (("expected", "printed"), ("tolerance", "tolerance")):
        ours, theirs = getattr(claim, ledger_name), entry.get(entry_name)
        if _listed(ours) != _listed(theirs):
            found.append(
                f"{claim.id}: ledger's {ledger_name} is {ours}, {claim.notebook} has {theirs}"
            )
    return found


def _listed(value: object) -> list:
    if value is None:
        return []
    return [float(v) for v in value] if isinstance(value, list) else [float(value)]


def _test_exists(root: Path, node: str) -> bool:
    """Whether pytest would collect a test of this name: a helper or a fixture is none."""
    path, *names = node.split("::")
    file = root / path
    if not file.is_file() or not file.name.startswith("test_"):
        return False
    try:
        body: list[ast.stmt] = ast.parse(file.read_text(encoding="utf-8")).body
    except SyntaxError:
        return False
    for name in names[:-1]:
        classes = [n for n in body if isinstance(n, ast.ClassDef) and n.name == name]
        body = classes[0].body if classes and name.startswith("Test") else []
    return names[-1].startswith("test") and any(
        isinstance(n, ast.FunctionDef) and n.name == names[-1] for n in body
    )


def page(root: Path) -> str:
    """The claims page of the book, as MyST text."""
    claims = read_ledger(root / "book" / "claims.yml")
    recorded = _recorded(sorted((root / "notebooks").glob("*.ipynb")))
    counts = Counter(claim.verdict for claim in claims)
    summary = ", ".join(f"{counts[v]} {v}" for v in VERDICTS)
    lines = [
        "# Claims",
        "",
        f"{len(claims)} claims: {summary}. Each verdict is computed by the notebook it links to;",
        "a test fails when the notebook and this ledger differ. What the verdicts mean is said in",
        "[](reading.md).",
        "",
        _table(
            ["paper", *VERDICTS],
            [
                [
                    name,
                    *(
                        str(sum(c.paper == key and c.verdict == v for c in claims))
                        for v in VERDICTS
                    ),
                ]
                for key, name in PAPERS.items()
                if any(c.paper == key for c in claims)
            ],
        ),
    ]
    for key, name in PAPERS.items():
        chosen = [claim for claim in claims if claim.paper == key]
        if chosen:
            rows = [_row(claim, recorded) for claim in chosen]
            head = ["claim", "statement", "numbers", "verdict", "test"]
            lines += ["", f"## {name}", "", _table(head, rows)]
    return "\n".join(lines) + "\n"


def _row(claim: Claim, recorded: dict[str, dict[str, dict]]) -> list[str]:
    entry = recorded.get(claim.id, {}).get(claim.notebook, {})
    target = f"../{claim.notebook.removesuffix('.md')}.html#{claim.id}"
    statement = html.escape(" ".join(claim.statement.split()))
    if claim.printed_formula and claim.corrected_formula:
        statement += (
            f"<br>printed: {html.escape(claim.printed_formula)}"
            f"<br>right: {html.escape(claim.corrected_formula)}"
        )
    numbers = []
    if entry.get("printed"):
        numbers.append("printed " + _numbers(entry["printed"]))
    if entry.get("computed"):
        numbers.append("computed " + _numbers(entry["computed"]))
    if entry.get("note"):
        numbers.append(html.escape(" ".join(entry["note"].split())))
    return [
        f'<a href="{target}">{claim.id}</a><br>{html.escape(claim.place)}',
        statement,
        "<br>".join(numbers),
        f'<span class="claim {claim.verdict}"><span class="verdict">{claim.verdict}</span></span>',
        f"<code>{claim.test.removeprefix('tests/').replace('::', '<br>')}</code>",
    ]


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>\n" for row in rows)
    heads = "".join(f"<th>{c}</th>" for c in head)
    return (
        f'<table class="claims table">\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}</tbody>\n'
        "</table>"
    )
