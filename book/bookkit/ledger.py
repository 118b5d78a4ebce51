"""The ledger of claims: what the papers say, what was found, and where it is checked.

A verdict stands in the ledger and is computed by a notebook, which says as well with which
planted faults it would come out otherwise; `faults` says where the two do not fit.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from bookkit.claims import LEDGER, Claim, read_ledger
from bookkit.recording import Records, read_records


def faults(root: Path) -> list[str]:
    """Everything that does not fit between the ledger and the notebooks.

    Parameters
    ----------
    root : Path
        The project's folder.
    """
    claims = read_ledger(root / LEDGER)
    recorded = read_verdicts(root)
    found = []
    for claim in claims:
        found += [f"{claim.id}: {fault}" for fault in claim.faults()]
        if claim.source and not (root / claim.source).is_file():
            found.append(f"{claim.id}: no source {claim.source}")
        home = f"{claim.id}: ledger says {claim.notebook}"
        places = recorded.get(claim.id, {})
        if not places:
            found.append(f"{claim.id}: no notebook records it (ledger says {claim.notebook})")
        elif set(places) != {claim.notebook}:
            found.append(f"{home}, recorded by {', '.join(places)}")
        else:
            found += _disagreements(claim, places[claim.notebook])
    known = {claim.id for claim in claims}
    found += [
        f"{name}: recorded by {', '.join(places)}, but not in the ledger"
        for name, places in recorded.items()
        if name not in known
    ]
    return found


def read_notebooks(root: Path) -> dict[str, Records]:
    """What the executed notebooks recorded, by their names.

    Raises
    ------
    ValueError
        A file that is no executed notebook; it is named.
    """
    found = {}
    for path in sorted((root / "notebooks").glob("*.ipynb")):
        try:
            found[path.stem] = read_records(json.loads(path.read_text(encoding="utf-8")))
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path.name}: not an executed notebook: {error}") from None
    return found


def read_verdicts(root: Path) -> dict[str, dict[str, dict]]:
    """The verdicts of the executed notebooks: by claim, by notebook."""
    places: dict[str, dict[str, dict]] = {}
    for stem, records in read_notebooks(root).items():
        for name, entry in records.claims.items():
            places.setdefault(name, {})[f"notebooks/{stem}.md"] = entry
    return places


def _disagreements(claim: Claim, entry: dict) -> Iterable[str]:
    if entry["verdict"] != claim.verdict:
        yield f"{claim.id}: ledger says {claim.verdict}, {claim.notebook} finds {entry['verdict']}"
    if claim.verdict != "open" and not entry.get("wrong"):
        yield f"{claim.id}: no planted fault: {claim.notebook} does not say what it would fail with"
    for fault in entry.get("missed", []):
        yield f"{claim.id}: true as well with this fault: {fault}"
    if claim.verdict == "refuted" and not (entry.get("computed") or entry["note"]):
        yield f"{claim.id}: refuted wants our numbers, or what shows it"
