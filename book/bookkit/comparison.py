"""Compare what a notebook recorded with what a re-run records: numbers within tolerance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bookkit.recording import ATOL, GLUE, MIME, RTOL, claim_html, payloads, shown


def without_records(outputs: Sequence[Mapping]) -> list[Mapping]:
    """The outputs of a cell that are compared to the letter."""
    return [
        out
        for out in outputs
        if not any(mime == MIME or mime.startswith(GLUE) for mime in out.get("data", {}))
    ]


def differences(stored: Sequence[Mapping], computed: Sequence[Mapping]) -> list[str]:
    """How the records of a cell's re-run differ from the stored ones; empty when they agree.

    Parameters
    ----------
    stored, computed : sequence of mapping
        The outputs of one cell, as in the committed notebook and as just computed.
    """
    before, after = _flat(payloads(stored)), _flat(payloads(computed))
    found = _misprints(stored)
    found += [
        f"{name}: stored, but not recorded by the re-run" for name in before if name not in after
    ]
    found += [
        f"{name}: recorded by the re-run, but not stored" for name in after if name not in before
    ]
    for name, (value, rtol, atol) in before.items():
        if name not in after:
            continue
        if after[name][1:] != (rtol, atol):
            now = "rtol {:g}, atol {:g}".format(*after[name][1:])
            found.append(f"{name}: stored with rtol {rtol:g}, atol {atol:g}, now with {now}")
        if not _agree(value, after[name][0], rtol, atol):
            found.append(f"{name}: stored {value!r}, computed {after[name][0]!r} (rtol {rtol:g})")
    return found


def deviation(stored: Sequence[Mapping], computed: Sequence[Mapping]) -> tuple[float, str]:
    """Largest distance of a number from the stored one, in units of its tolerance, and its name.

    Above one the number fails; (0, "") where a cell records no numbers.
    """
    before, after = _flat(payloads(stored)), _flat(payloads(computed))
    far = [
        (_distance(value, after[name][0], rtol, atol), name)
        for name, (value, rtol, atol) in before.items()
        if name in after
    ]
    return max(far, default=(0.0, ""))


def _distance(a: object, b: object, rtol: float, atol: float) -> float:
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return max((_distance(x, y, rtol, atol) for x, y in zip(a, b, strict=True)), default=0.0)
    if _agree(a, b, 0.0, 0.0):
        return 0.0
    if _agree(a, b, rtol, atol) or all(isinstance(part, int | float) for part in (a, b)):
        return abs(a - b) / max(rtol * max(abs(a), abs(b)), atol, 5e-324)
    return math.inf


def _misprints(stored: Sequence[Mapping]) -> list[str]:
    """Where what a page shows of a record is not what is in the record."""
    found, glued = [], {}
    for data in (out["data"] for out in stored if MIME in out.get("data", {})):
        values, claims = (data[MIME].get(kind, {}) for kind in ("values", "claims"))
        right = {name: f"{name} = {shown(value)}" for name, value in values.items()}
        right |= {name: f"{name}: {entry['verdict']}" for name, entry in claims.items()}
        # The stored record has its names in alphabetical order, the page in that of the call.
        page = "".join(data.get("text/plain", "")).splitlines()
        lines = "\n".join(right.values()).splitlines()
        if page and sorted(page) != sorted(lines):
            strange = ", ".join(line for line in page if line not in lines) or "too little"
            found.append(f"{', '.join(right)}: the page shows what is not recorded: {strange}")
        for name, entry in claims.items():
            if "text/html" in data and "".join(data["text/html"]) != claim_html(name, entry):
                found.append(f"{name}: the box on the page is not what is recorded")
        for name, value in values.items():
            glued[name] = shown(value) if isinstance(value, list) else repr(value).strip("'")
    for out in stored:
        text = "".join(out.get("data", {}).get(GLUE + "text/plain", ""))
        name = out.get("metadata", {}).get("scrapbook", {}).get("name")
        if text and name and text != glued.get(name):
            found.append(f"{name}: glued as {text}, recorded as {glued.get(name)}")
    return found


def _flat(records: Sequence[Mapping]) -> dict[str, tuple[object, float, float]]:
    flat: dict[str, tuple[object, float, float]] = {}
    for payload in records:
        tolerances = payload.get("rtol", RTOL), payload.get("atol", ATOL)
        for name, value in payload.get("values", {}).items():
            flat[name] = (value, *tolerances)
        for name, entry in payload.get("claims", {}).items():
            for part, value in entry.items():
                flat[f"{name}.{part}"] = (value, *tolerances)
    return flat


def _agree(a: object, b: object, rtol: float, atol: float) -> bool:
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(_agree(x, y, rtol, atol) for x, y in zip(a, b, strict=True))
    if isinstance(a, bool) or isinstance(b, bool):
        return a is b
    if isinstance(a, int) and isinstance(b, int) and rtol == RTOL:
        return a == b  # counts are exact unless the record says otherwise
    if isinstance(a, int | float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=rtol, abs_tol=atol)
    return a == b
