"""Where the ledger of claims and the notebooks differ.

A verdict is written in the ledger and computed by a notebook, which also lists the planted faults
that would change it.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bookkit.claims import LEDGER, Claim, read_ledger
from bookkit.recording import read_verdicts


def disagreements(root: Path) -> list[str]:
    """Rules that the ledger breaks, and where it differs from what the notebooks compute.

    Parameters
    ----------
    root : Path
        The project's folder.
    """
    claims, recorded = read_ledger(root / LEDGER), read_verdicts(root)
    found = []
    for claim in claims:
        found += [f"{claim.id}: {error}" for error in claim.errors()]
        if claim.source and not (root / claim.source).is_file():
            found.append(f"{claim.id}: no source {claim.source}")
        entries = recorded.pop(claim.id, {})
        if set(entries) != {claim.notebook}:
            where = ", ".join(entries) or "no notebook"
            found.append(f"{claim.id}: ledger says {claim.notebook}, recorded by {where}")
        else:
            found += [f"{claim.id}: {text}" for text in _differences(claim, *entries.values())]
    return found + [f"{name}: recorded, but not in the ledger" for name in recorded]


def _differences(claim: Claim, entry: dict) -> Iterable[str]:
    if entry["verdict"] != claim.verdict:
        yield f"ledger says {claim.verdict}, {claim.notebook} finds {entry['verdict']}"
    if claim.verdict != "open" and not entry.get("wrong"):
        yield f"no planted fault: {claim.notebook} does not say what it would fail with"
    for fault in entry.get("missed", []):
        yield f"true as well with this fault: {fault}"
    if claim.verdict == "refuted" and not (entry.get("computed") or entry["note"]):
        yield "refuted wants our numbers, or what shows it"
