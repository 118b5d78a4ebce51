"""Numbers and verdicts that a notebook publishes, and how they are read.

One call of `record` or `claim` has four readers: the tolerant re-run test, the sweep tables, the
text of the book, and the ledger of claims. What it writes is plain JSON inside the notebook's
outputs, so reading needs nothing but this module.
"""

from __future__ import annotations

import html
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bookkit.claims import Claim, look_up

MIME = "application/vnd.seedslib.record+json"
GLUE = "application/papermill.record/"
RTOL = 1e-7
ATOL = 1e-12

_WANTED = "a number, a string, a boolean, or a flat list of them"


class Records(NamedTuple):
    """Everything a notebook recorded: named values and claims, each with its tolerances."""

    values: dict[str, object]
    claims: dict[str, dict]


def plain(name: str, value: object) -> object:
    """Value as plain JSON: NumPy scalars and arrays become numbers and lists.

    Raises
    ------
    TypeError
        Anything but a scalar or a flat list.
    ValueError
        A number that is not finite.
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        if any(isinstance(item, list | tuple | Mapping) for item in value):
            raise TypeError(f"{name}: wanted {_WANTED}, got a nested list")
        return [plain(f"{name}[{index}]", item) for index, item in enumerate(value)]
    if not isinstance(value, bool | int | float | str):
        raise TypeError(f"{name}: wanted {_WANTED}, got {type(value).__name__}")
    if isinstance(value, int | float) and not abs(value) <= sys.float_info.max:
        raise ValueError(f"{name}: wanted a finite number, got {str(value)[:40]}")
    return value


def formatted(value: object) -> str:
    """Value as text: six significant digits."""
    if isinstance(value, list):
        return ", ".join(formatted(item) for item in value)
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def _publish(data: dict, metadata: dict | None = None) -> None:
    from IPython.display import display

    display(data, raw=True, metadata=metadata or {})


def record(*, rtol: float = RTOL, atol: float = ATOL, **values: object) -> None:
    """Publish numbers of the notebook, under names that are unique in it.

    Parameters
    ----------
    rtol, atol : float
        How closely a re-run must agree with the stored value.
    **values
        Scalars, strings, booleans, or flat lists of them.

    Raises
    ------
    TypeError, ValueError
        Nothing to record, a nested or unknown type, or a number that is not finite.
    """
    if not values:
        raise ValueError("record: wanted at least one named value")
    clean = {name: plain(name, value) for name, value in values.items()}
    lines = "\n".join(f"{name} = {formatted(value)}" for name, value in clean.items())
    _publish({MIME: {"values": clean, "rtol": rtol, "atol": atol}, "text/plain": lines})
    for name, value in clean.items():
        text = formatted(value) if isinstance(value, list) else repr(value).strip("'")
        _publish({GLUE + "text/plain": text}, {"scrapbook": {"name": name, "mime_prefix": GLUE}})


def claim(
    name: str,
    *,
    holds: bool | None = None,
    computed: object = None,
    corrected: bool | None = None,
    identities: Mapping[str, object] | None = None,
    wrong: Mapping[str, object] | None = None,
    undecided: bool = False,
    note: str = "",
    rtol: float = RTOL,
    atol: float = ATOL,
) -> None:
    """Record the verdict on one claim, computed from numbers.

    What is claimed, the numbers it is compared with and their tolerance are in the ledger,
    ``book/claims.yml``.

    Parameters
    ----------
    name : str
        The claim's id in the ledger.
    holds : bool, optional
        Whether the statement is true as it stands; beside numbers, what must hold besides.
    computed : float or sequence of float, optional
        Our numbers; where the ledger has numbers the claim holds when each pair agrees.
    corrected : bool, optional
        For a claim that does not hold: whether our corrected statement is true.
    identities : mapping of str to bool, optional
        Equalities in symbols or fractions, or what intervals enclose, by a few words each. They
        prove the statement or, where that does not hold, the corrected one.
    wrong : mapping of str to bool or numbers, optional
        What `holds` (`corrected`, `computed`) comes to with a fault planted, by a few words that
        name the fault. A condition that is true then is no condition: the box says so, and the
        ledger does not take it. (With other parameters a difference may be too small to see.)
    undecided : bool
        The numbers are shown, and the claim is open whether they agree or not.
    note : str
        One sentence for the page.
    rtol, atol : float
        How closely a re-run must agree with the stored `computed`.

    Raises
    ------
    ValueError
        An id that is not in the ledger, or numbers that do not fit the ledger's in number.
    """
    entry = look_up(name)
    evidence: dict[str, object] = {"paper": entry.origin != "ours", "place": entry.place}
    evidence["says"] = _statement(entry)
    holds, corrected = _boolean(name, "holds", holds), _boolean(name, "corrected", corrected)
    if computed is not None:
        evidence["computed"] = _numbers(name, computed)
    if entry.expected is not None:
        if computed is None:
            raise ValueError(f"claim {name}: the ledger has numbers; wanted computed ones")
        agrees = _agrees(entry, evidence["computed"])
        holds = agrees if holds is None else agrees and holds
        kind = "reference" if entry.printed is None else "printed"
        evidence |= {kind: entry.expected, "tolerance": entry.widths}
    if identities:
        exact = all(_boolean(name, label, value) for label, value in identities.items())
        if holds is False:
            corrected = exact and corrected is not False
        else:
            holds = exact
        evidence["identities"] = list(identities)
    if entry.source:
        evidence["source"] = entry.source
    missed = [
        fault
        for fault, value in (wrong or {}).items()
        if (_boolean(name, fault, value) if _is_truth(value) else _agrees(entry, value))
    ]
    if missed:
        evidence["missed"] = missed
    verdict = "open" if undecided else _verdict(holds, corrected, bool(evidence["paper"]))
    verdict = entry.decided(verdict)
    result = {"verdict": verdict, **evidence, "wrong": list(wrong or ()), "note": note}
    _publish(
        {
            MIME: {"claims": {name: result}, "rtol": rtol, "atol": atol},
            "text/html": claim_html(name, result),
            "text/plain": f"{name}: {verdict}",
        }
    )


def _statement(entry: Claim) -> str:
    """What is claimed, as one paragraph of text."""
    parts = [entry.statement.strip()]
    if entry.reading:
        label = {None: "Reading", "one": "Under one reading", "all": "Under every reading tried"}
        parts.append(f"({label[entry.readings]}: {entry.reading.strip()})")
    if entry.printed_formula and entry.corrected_formula:
        parts += [f"Printed: {entry.printed_formula}.", f"Right: {entry.corrected_formula}."]
    if entry.because:
        parts.append(f"({entry.because.strip()})")
    return " ".join(" ".join(parts).split())


def _is_truth(value: object) -> bool:
    return isinstance(value, bool) or str(getattr(value, "dtype", "")) == "bool"


def _boolean(name: str, label: str, value: object) -> bool | None:
    if value is not None and not _is_truth(value):
        raise ValueError(f"claim {name}: {label}: wanted a boolean, got {value!r}")
    return None if value is None else bool(value)


def _numbers(name: str, value: object) -> list:
    numbers = plain(f"claim {name}", value)
    return numbers if isinstance(numbers, list) else [numbers]


def _agrees(entry: Claim, computed: object) -> bool:
    ours, theirs = _numbers(entry.id, computed), entry.expected
    if theirs is None:
        raise ValueError(f"claim {entry.id}: the ledger has no numbers to compare these with")
    if len(ours) != len(theirs):
        raise ValueError(
            f"claim {entry.id}: wanted {len(theirs)} numbers as in the ledger, got {len(ours)}"
        )
    return all(abs(a - b) <= w for a, b, w in zip(ours, theirs, entry.widths, strict=True))


def _verdict(holds: bool | None, corrected: bool | None, paper: bool) -> str:
    if holds is None:
        return "open"
    if holds:
        return "reproduced" if paper else "checked"
    return "corrected" if corrected else "refuted"


FEW = 6
"""Numbers that a box lists; of more it only says how many they are."""


def evidence(entry: Mapping) -> list[str]:
    """What was found on a claim, from its record, as a few sentences."""
    parts, ours = [], entry.get("computed", [])
    if ours and len(ours) <= FEW:
        parts.append("computed " + formatted(ours))
    for kind in ("printed", "reference"):
        if kind in entry:
            theirs, widths = entry[kind], entry["tolerance"]
            if len(theirs) <= FEW:
                same = widths[:1] if len(set(widths)) == 1 else widths
                parts.append(f"{kind} {formatted(theirs)} (± {formatted(same)})")
            else:
                parts.append(f"{len(theirs)} numbers compared with {kind} ones")
    if "source" in entry:
        parts.append("from " + entry["source"])
    if entry["note"]:
        parts.append(entry["note"])
    if "identities" in entry:
        parts.append("Exact: " + ", ".join(entry["identities"]))
    missed = entry.get("missed", [])
    if caught := [fault for fault in entry["wrong"] if fault not in missed]:
        parts.append("Would fail with: " + ", ".join(caught))
    if missed:
        parts.append("Would not fail with: " + ", ".join(missed))
    return parts


def claim_html(name: str, entry: Mapping) -> str:
    """The badge of a claim on a page: verdict and place in one line, the rest folded."""
    label = typeset(name)
    detail = typeset("; ".join(evidence(entry)))
    return (
        f'<details class="claim {entry["verdict"]}" id="{label}"><summary><span class="verdict">'
        f"{entry['verdict']}</span> · <b>{label}</b> · {typeset(entry['place'])}</summary>"
        f"<p>{typeset(entry['says'])}</p><p>{detail}</p></details>"
    )


def typeset(text: str) -> str:
    """A text as HTML; MathJax sets what is between dollars, on a page and in JupyterLab."""
    return re.sub(r"\$([^$]+)\$", r'<span class="math">\\(\1\\)</span>', html.escape(text))


def columns(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values with the entries of a list ``x`` under ``x_0``, ``x_1``, ..."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        items = enumerate(value) if isinstance(value, list) else ()
        result |= {f"{name}_{index}": item for index, item in items} or {name: value}
    return result


def payloads(outputs: Sequence[Mapping]) -> list[dict]:
    """The records among the outputs of one cell, in order."""
    return [out["data"][MIME] for out in outputs if MIME in out.get("data", {})]


def read_records(notebook: Mapping) -> Records:
    """All that a notebook (a dict as in its ``.ipynb``) has recorded.

    Raises
    ------
    ValueError
        A name was recorded twice.
    """
    values: dict[str, object] = {}
    claims: dict[str, dict] = {}
    for cell in notebook["cells"]:
        for payload in payloads(cell.get("outputs", [])):
            for kind, into in (("values", values), ("claims", claims)):
                for name, value in payload.get(kind, {}).items():
                    if name in into:
                        raise ValueError(f"{name} is recorded twice in one notebook")
                    into[name] = value
    return Records(values, claims)


def read_notebooks(root: Path) -> dict[str, Records]:
    """What each executed notebook of a project recorded, by its name."""
    paths = sorted((root / "notebooks").glob("*.ipynb"))
    return {path.stem: read_records(json.loads(path.read_text())) for path in paths}


def read_verdicts(root: Path) -> dict[str, dict[str, dict]]:
    """The verdicts of the executed notebooks: by claim, by notebook."""
    by_claim: dict[str, dict[str, dict]] = {}
    for stem, records in read_notebooks(root).items():
        for name, entry in records.claims.items():
            by_claim.setdefault(name, {})[f"notebooks/{stem}.md"] = entry
    return by_claim
