"""The ledger of claims: its entries, their rules, and where it differs from the notebooks.

A verdict is written in the ledger and computed by a notebook, which also lists the planted faults
that would change it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from bookkit.parameters import explain

PAPERS = {
    "two-step": "Two-step estimator",
    "piecewise": "Piecewise-linear filter",
    "delay": "Kalman filter with delay",
    "compromise": "Compromise of criteria by bisection",
    "riemann": "Riemann problem",
    "jump-diffusion": "Large-order filter for jump-diffusions",
    "switching": "Large-order filter for switching systems",
    "learned": "Learned filters, the tables of others",
    "field": "Compared with the field",
}
ORIGINS = {
    "stated": "the paper says it",
    "restored": "the paper says it, and we supplied signs that the scan has lost",
    "implied": "it follows from the paper, which does not say it",
    "ours": "we found it",
}
VERDICTS = ("refuted", "corrected", "open", "reproduced", "checked")
"""In the order in which a reader of the papers wants to see them."""
PROOFS = {
    "symbols": "identities that SymPy brings to zero, in a cell that is shown",
    "fractions": "exact arithmetic, in a cell that is shown",
    "enclosure": "balls or intervals that hold the exact value, in a cell that is shown",
    "words": "a proof or the paper's own words, on the page; numbers only try it",
    "numbers": "two routes that agree in floating point",
}
LEDGER = "book/claims.yml"


def _listed(value: object) -> object:
    return value if value is None or isinstance(value, list) else [value]


Number = Annotated[float, Field(allow_inf_nan=False)]
Numbers = Annotated[list[Number] | None, BeforeValidator(_listed)]


class Claim(BaseModel):
    """One theorem, formula, number or statement of a paper, or a finding of ours.

    `printed` are numbers that can be read in the paper; `reference` those of a second route of
    ours, which the file `source` computes or holds. `because` is the sentence that says why a
    tolerance is wider than the last printed digit, by which route a reference without a file was
    computed, or what an open claim lacks; `reading` what we had to assume where the paper does not
    say it. Where the reading supplies what cannot be read any more, `readings` says whether the
    verdict is that of one reading or of all that were tried: what one reading denies is open.
    `proved` is what carries the verdict.
    """

    model_config = ConfigDict(extra="forbid")
    id: Annotated[str, Field(pattern=r"^[A-Z]{2}-[A-Za-z0-9]+$")]
    paper: Literal[tuple(PAPERS)]
    origin: Literal[tuple(ORIGINS)]
    place: str
    statement: str
    reading: str = ""
    readings: Literal["one", "all"] | None = None
    notebook: Annotated[str, Field(pattern=r"^notebooks/\w+\.md$")]
    printed: Numbers = None
    reference: Numbers = None
    source: (
        Annotated[str, Field(pattern=r"^(benchmarks|tests/oracles)/[\w/]+\.(py|csv)$")] | None
    ) = None
    tolerance: Numbers = None
    because: str = ""
    printed_formula: str | None = None
    corrected_formula: str | None = None
    proved: Literal[tuple(PROOFS)]
    verdict: Literal[VERDICTS]

    def decided(self, verdict: str) -> str:
        """A verdict, or "open" where it would deny what one reading of a damaged text says."""
        denied = verdict in ("refuted", "corrected")
        return "open" if denied and self.readings == "one" else verdict

    @property
    def expected(self) -> list[float] | None:
        """The numbers that ours are compared with, the paper's or those of a second route."""
        return self.printed if self.printed is not None else self.reference

    @property
    def widths(self) -> list[float]:
        """The tolerance of each expected number."""
        count, given = len(self.expected or ()), self.tolerance or []
        return given * count if len(given) == 1 else given

    def errors(self) -> Iterable[str]:
        """The rules that this entry breaks, a sentence each."""
        ours = self.origin == "ours"
        if ours != (self.verdict == "checked") and self.verdict != "open":
            yield f"a claim whose origin is {self.origin} cannot be {self.verdict}"
        if ours and self.printed is not None:
            yield "printed numbers are a paper's; ours are a reference"
        if self.printed is not None and self.reference is not None:
            yield "printed and reference: wanted one of them"
        if self.reference is not None and not (self.source or self.because):
            yield "a reference wants its source or a because"
        if (self.tolerance is None) != (self.expected is None):
            yield "numbers and a tolerance want each other"
        elif len(self.widths) != len(self.expected or ()):
            yield "as many tolerances as numbers, or one for all"
        for value, width in zip(self.expected or (), self.widths, strict=False):
            if width >= abs(value) and width > 0:
                yield f"{value:g} ± {width:g}: a tolerance as wide as the number"
            elif self.printed is not None and not self.because and width > 1.001 * _half(value):
                yield f"{value:g} ± {width:g}: more than the last digit wants a because"
        if self.decided(self.verdict) != self.verdict:
            yield f"{self.verdict} under one reading of what cannot be read: wanted open"
        if self.readings and not self.reading:
            yield "readings want a reading: what was supplied"
        if self.origin == "restored" and not self.readings:
            yield "restored wants readings: one or all"
        if self.verdict == "corrected" and not (self.printed_formula and self.corrected_formula):
            yield "corrected wants what is printed and what is right"
        if self.verdict == "open" and not self.because:
            yield "open wants a because: what is missing"


def _half(value: float) -> float:
    """Half a unit of the last digit that a number is written with."""
    _, _, decimals = f"{value:.12f}".rstrip("0").partition(".")
    return 0.5 * 10.0 ** -len(decimals)


def read_ledger(path: Path) -> list[Claim]:
    """The claims of a ledger file.

    Raises
    ------
    ValueError
        Not YAML, or an entry that is not a claim; the entry is named.
    """
    try:
        return _parsed(path.read_text())
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None


@lru_cache(maxsize=2)  # every notebook asks for the same ledger
def _parsed(text: str) -> list[Claim]:
    try:
        entries = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)) or []
    except yaml.YAMLError as error:
        raise ValueError(f"not YAML: {error}") from None
    claims, problems = [], []
    for position, entry in enumerate(entries):
        try:
            claims.append(Claim.model_validate(entry))
        except ValidationError as error:
            name = entry.get("id") if isinstance(entry, dict) else f"entry {position}"
            problems.append(f"{name}: {explain(error)}")
    counts = Counter(claim.id for claim in claims)
    problems += [f"{name}: stands {n} times in the ledger" for name, n in counts.items() if n > 1]
    if problems:
        raise ValueError("; ".join(problems))
    return claims


def look_up(name: str) -> Claim:
    """A claim of the ledger of the project at or above the working directory.

    Raises
    ------
    ValueError
        No ledger, or no such entry.
    """
    for folder in (Path.cwd(), *Path.cwd().parents):
        if (folder / LEDGER).is_file():
            for claim in read_ledger(folder / LEDGER):
                if claim.id == name:
                    return claim
            raise ValueError(f"claim {name}: not in the ledger {LEDGER}")
    raise ValueError(f"claim {name}: no ledger {LEDGER} at or above this folder")


def disagreements(root: Path, recorded: dict[str, dict[str, dict]]) -> list[str]:
    """Rules that the ledger breaks, and where it differs from what the notebooks compute.

    Parameters
    ----------
    root : Path
        The project's folder.
    recorded : mapping
        What `read_verdicts` reads.
    """
    claims, recorded = read_ledger(root / LEDGER), dict(recorded)
    errors = []
    for claim in claims:
        errors += [f"{claim.id}: {error}" for error in claim.errors()]
        if claim.source and not (root / claim.source).is_file():
            errors.append(f"{claim.id}: no source {claim.source}")
        entries = recorded.pop(claim.id, {})
        if set(entries) != {claim.notebook}:
            where = ", ".join(entries) or "no notebook"
            errors.append(f"{claim.id}: ledger says {claim.notebook}, recorded by {where}")
        else:
            errors += [f"{claim.id}: {text}" for text in _differences(claim, *entries.values())]
    return errors + [f"{name}: recorded, but not in the ledger" for name in recorded]


def _differences(claim: Claim, entry: dict) -> Iterable[str]:
    if entry["verdict"] != claim.verdict:
        yield f"ledger says {claim.verdict}, {claim.notebook} finds {entry['verdict']}"
    if claim.verdict != "open" and not entry.get("wrong"):
        yield f"no planted fault: {claim.notebook} does not say what it would fail with"
    if (claim.proved in ("symbols", "fractions", "enclosure")) != bool(entry.get("identities")):
        yield f"proved by {claim.proved}, but {claim.notebook} shows other than that"
    for fault in entry.get("missed", []):
        yield f"true as well with this fault: {fault}"
    if claim.verdict == "refuted" and not (entry.get("computed") or entry["note"]):
        yield "refuted wants our numbers, or what shows it"
