"""What the ledger of claims is: its entries, and the rules that no entry may break."""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from bookkit.files import read_yaml
from bookkit.parameters import explain

PAPERS = {
    "two-step": "Two-step estimator",
    "piecewise": "Piecewise-linear filter",
    "delay": "Kalman filter with delay",
    "compromise": "Compromise of criteria by bisection",
    "riemann": "Riemann problem",
    "jump-diffusion": "Large-order filter for jump-diffusions",
    "switching": "Large-order filter for switching systems",
    "field": "Held against the field",
}
ORIGINS = {
    "stated": "the paper says it",
    "restored": "the paper says it, and we supplied signs that the scan has lost",
    "implied": "it follows from the paper, which does not say it",
    "ours": "we found it",
}
VERDICTS = ("reproduced", "corrected", "refuted", "open", "checked")
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
    found, or what an open claim lacks; `reading` what we had to assume where the paper does not
    say it.
    """

    model_config = ConfigDict(extra="forbid")
    id: Annotated[str, Field(pattern=r"^[A-Z]{2}-[A-Za-z0-9]+$")]
    paper: Literal[tuple(PAPERS)]
    origin: Literal[tuple(ORIGINS)]
    place: str
    statement: str
    reading: str = ""
    kind: Literal["identity", "number", "figure", "qualitative"]
    notebook: Annotated[str, Field(pattern=r"^notebooks/\w+\.md$")]
    printed: Numbers = None
    reference: Numbers = None
    source: Annotated[str, Field(pattern=r"^benchmarks/[\w/]+\.(py|csv)$")] | None = None
    tolerance: Numbers = None
    because: str = ""
    printed_formula: str | None = None
    corrected_formula: str | None = None
    verdict: Literal[VERDICTS]

    @property
    def expected(self) -> list[float] | None:
        """The numbers that ours are held against, the paper's or those of a second route."""
        return self.printed if self.printed is not None else self.reference

    @property
    def widths(self) -> list[float]:
        """The tolerance of each expected number."""
        count, given = len(self.expected or ()), self.tolerance or []
        return given * count if len(given) == 1 else given

    def faults(self) -> list[str]:
        """The rules that this entry breaks, a sentence each."""
        ours, found = self.origin == "ours", []
        if ours != (self.verdict == "checked") and self.verdict != "open":
            found.append(f"a claim whose origin is {self.origin} cannot be {self.verdict}")
        if ours and self.printed is not None:
            found.append("printed numbers are a paper's; ours are a reference")
        if self.printed is not None and self.reference is not None:
            found.append("printed and reference: wanted one of them")
        if self.reference is not None and not (self.source or self.because):
            found.append("a reference wants its source or a because")
        if (self.tolerance is None) != (self.expected is None):
            found.append("numbers and a tolerance want each other")
        elif len(self.widths) != len(self.expected or ()):
            found.append("as many tolerances as numbers, or one for all")
        for value, width in zip(self.expected or (), self.widths, strict=False):
            if width >= abs(value) and width > 0:
                found.append(f"{value:g} ± {width:g}: a tolerance as wide as the number")
            elif self.printed is not None and not self.because and width > 1.001 * _half(value):
                found.append(f"{value:g} ± {width:g}: more than the last digit wants a because")
        if self.verdict == "corrected" and not (self.printed_formula and self.corrected_formula):
            found.append("corrected wants what is printed and what is right")
        if self.verdict == "open" and not self.because:
            found.append("open wants a because: what is missing")
        return found


def _half(value: float) -> float:
    """Half a unit of the last digit that a number is written with."""
    _, _, decimals = f"{value:.12f}".rstrip("0").partition(".")
    return 0.5 * 10.0 ** -len(decimals)


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
        name = f"entry {position}"
        if isinstance(entry, dict | str):
            name = entry.get("id", name) if isinstance(entry, dict) else entry
        try:
            claims.append(Claim.model_validate(entry))
        except ValidationError as error:
            problems.append(f"{name}: {explain(error)}")
    counts = Counter(claim.id for claim in claims)
    problems += [f"{name}: stands {n} times in the ledger" for name, n in counts.items() if n > 1]
    if problems:
        raise ValueError(f"{path.name}: " + "; ".join(problems))
    return claims


def look_up(name: str) -> Claim:
    """A claim of the ledger of the project that runs, which is at or above the present folder.

    Raises
    ------
    ValueError
        The ledger has no such entry.
    """
    here = Path.cwd()
    beside = Path(__file__).parents[2]
    for folder in (here, *here.parents, beside):
        if (folder / LEDGER).is_file():
            known = _by_name(folder / LEDGER)
            if name in known:
                return known[name]
            raise ValueError(f"claim {name}: not in the ledger {LEDGER}")
    raise ValueError(f"claim {name}: no ledger {LEDGER} at or above this folder")


def own_claims(path: Path, notebook: str) -> list[Claim]:
    """The claims of a ledger that one notebook decides; none where there is no ledger."""
    if not path.is_file():
        return []
    return [claim for claim in _by_name(path).values() if claim.notebook == notebook]


@cache
def _read(path: Path, changed: int) -> dict[str, Claim]:
    return {claim.id: claim for claim in read_ledger(path)}


def _by_name(path: Path) -> dict[str, Claim]:
    return _read(path, path.stat().st_mtime_ns)
