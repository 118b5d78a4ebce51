"""Numbers and verdicts that leave a notebook.

One call of `record` or `claim` is read by four readers: the tolerant re-run test, the sweep
tables, the text of the book, and the ledger of claims. What it writes is plain JSON inside the
notebook's outputs, so reading needs nothing but this module.
"""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

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
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{name}: wanted a finite number, got {value}")
    return value


def shown(value: object) -> str:
    """Value for the page: six significant digits."""
    if isinstance(value, list):
        return ", ".join(shown(item) for item in value)
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def _publish(data: dict, metadata: dict | None = None) -> None:
    from IPython.display import display

    display(data, raw=True, metadata=metadata or {})


def record(*, rtol: float = RTOL, atol: float = ATOL, **values: object) -> None:
    """Let numbers leave the notebook, under names that are unique in it.

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
    lines = "\n".join(f"{name} = {shown(value)}" for name, value in clean.items())
    _publish({MIME: {"values": clean, "rtol": rtol, "atol": atol}, "text/plain": lines})
    for name, value in clean.items():
        text = shown(value) if isinstance(value, list) else repr(value).strip("'")
        _publish({GLUE + "text/plain": text}, {"scrapbook": {"name": name, "mime_prefix": GLUE}})


def claim(
    name: str,
    *,
    holds: bool | None = None,
    computed: object = None,
    printed: object = None,
    tolerance: float | Sequence[float] | None = None,
    corrected: bool | None = None,
    note: str = "",
    rtol: float = RTOL,
    atol: float = ATOL,
) -> None:
    """Record the verdict on one claim of a paper, computed from numbers.

    Parameters
    ----------
    name : str
        The claim's id in ``book/claims.yml``.
    holds : bool, optional
        Whether the statement is true as printed, where it is not a matter of numbers.
    computed, printed : float or sequence of float, optional
        Our numbers and the paper's; the claim holds when each pair agrees.
    tolerance : float or sequence of float, optional
        Largest absolute difference allowed between them.
    corrected : bool, optional
        For a claim that does not hold: whether our corrected statement was found true.
    note : str
        One sentence for the page.
    rtol, atol : float
        How closely a re-run must agree with the stored `computed`.

    Raises
    ------
    ValueError
        Both or neither of `printed` and `tolerance`, different lengths, or numbers together
        with `holds`.
    """
    evidence: dict[str, object] = {}
    if printed is not None:
        if tolerance is None or computed is None or holds is not None:
            raise ValueError(
                f"claim {name}: printed numbers want computed numbers and a tolerance, "
                "and no holds beside them"
            )
        ours, theirs, widths = (
            value if isinstance(value, list) else [value]
            for value in (
                plain("computed", computed),
                plain("printed", printed),
                plain("tolerance", tolerance),
            )
        )
        widths = widths * len(theirs) if len(widths) == 1 else widths
        if not len(ours) == len(theirs) == len(widths):
            raise ValueError(
                f"claim {name}: wanted as many computed as printed numbers, "
                f"got {len(ours)} and {len(theirs)} (tolerances: {len(widths)})"
            )
        holds = all(abs(a - b) <= w for a, b, w in zip(ours, theirs, widths, strict=True))
        evidence = {"computed": ours, "printed": theirs, "tolerance": plain("tolerance", tolerance)}
    elif tolerance is not None:
        raise ValueError(f"claim {name}: a tolerance wants printed numbers beside it")
    elif computed is not None:
        ours = plain("computed", computed)
        evidence = {"computed": ours if isinstance(ours, list) else [ours]}
    verdict = _verdict(name, holds, corrected)
    entry = {"verdict": verdict, **evidence, "note": note}
    _publish(
        {
            MIME: {"claims": {name: entry}, "rtol": rtol, "atol": atol},
            "text/html": claim_html(name, entry),
            "text/plain": f"{name}: {verdict}",
        }
    )


def _verdict(name: str, holds: object, corrected: object) -> str:
    for label, value in (("holds", holds), ("corrected", corrected)):
        if value is not None and not isinstance(value, bool) and not hasattr(value, "dtype"):
            raise ValueError(f"claim {name}: {label}: wanted a boolean, got {value!r}")
    if holds is None:
        return "open"
    if holds:
        return "reproduced"
    return "corrected" if corrected else "refuted"


def claim_html(name: str, entry: Mapping) -> str:
    parts = []
    if "computed" in entry:
        parts.append("computed " + shown(entry["computed"]))
    if "printed" in entry:
        parts.append("printed " + shown(entry["printed"]))
        parts.append("tolerance " + shown(entry["tolerance"]))
    if entry["note"]:
        parts.append(entry["note"])
    label, detail = html.escape(name), html.escape("; ".join(parts))
    return (
        f'<div class="claim {entry["verdict"]}" id="{label}"><b>{label}</b> '
        f'<span class="verdict">{entry["verdict"]}</span> {detail}</div>'
    )


def payloads(outputs: Sequence[Mapping]) -> list[dict]:
    """The records among the outputs of one cell, in order."""
    return [out["data"][MIME] for out in outputs if MIME in out.get("data", {})]


def read_records(notebook: Mapping) -> Records:
    """All that a notebook (a dict as in its ``.ipynb``) has recorded.

    Raises
    ------
    ValueError
        A name was recorded twice, or an output of this kind that neither `record` nor `claim`
        made.
    """
    values: dict[str, object] = {}
    claims: dict[str, dict] = {}
    for cell in notebook["cells"]:
        for payload in payloads(cell.get("outputs", [])):
            _check_payload(payload)
            for kind, into in (("values", values), ("claims", claims)):
                for name, value in payload.get(kind, {}).items():
                    if name in into:
                        raise ValueError(f"{name} is recorded twice in one notebook")
                    into[name] = value
    return Records(values, claims)


def _check_payload(payload: object) -> None:
    """Refuse an output that says it is a record and has another shape."""
    if not isinstance(payload, Mapping):
        raise ValueError(f"a record of another shape: wanted a mapping, got {payload!r:.40}")
    for kind in ("values", "claims"):
        entries = payload.get(kind, {})
        if not isinstance(entries, Mapping):
            raise ValueError(f"a record of another shape: {kind}: wanted a mapping")
        for name, entry in entries.items():
            if kind == "claims" and not isinstance(entry, Mapping):
                raise ValueError(f"a record of another shape: claim {name}: wanted a mapping")
            if kind == "values":
                try:
                    plain(name, entry)
                except TypeError as error:
                    raise ValueError(f"a record of another shape: {error}") from None
