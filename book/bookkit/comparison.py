"""Compare what a notebook recorded with what a re-run records: numbers within tolerance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bookkit.recording import ATOL, GLUE, MIME, RTOL, payloads


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
    result = [f"{name}: only in the stored outputs" for name in before if name not in after]
    result += [f"{name}: only in the outputs of the re-run" for name in after if name not in before]
    for name in before.keys() & after.keys():
        (old, *tolerances), (new, *changed) = before[name], after[name]
        if tolerances != changed:
            result.append(f"{name}: stored with tolerances {tolerances}, now with {changed}")
        elif not _agree(old, new, *tolerances):
            result.append(f"{name}: stored {old!r}, computed {new!r} (rtol {tolerances[0]:g})")
    return result


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
