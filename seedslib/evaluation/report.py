"""A comparison as a table: in a console, in a notebook, and as a data frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

SINGLE = {
    "nees_ratio": "NEES / n", "average_log_score": "log score", "average_mode_error": "wrong mode",
}  # fmt: skip
"""Numbers of an evaluation over the window that go into the table, and their headings."""

Columns = dict[str, list[tuple[Any, Any]]]


def columns(evaluations: Mapping[str, Any], names: Sequence[str] | None = None) -> Columns:
    """Values and standard errors of each filter, by the name of the column.

    Raises
    ------
    ValueError
        Another number of names than components are scored.
    """
    rows = list(evaluations.values())
    count = len(rows[0].average)
    names = [f"x{k + 1}" for k in range(count)] if names is None else list(names)
    if len(names) != count:
        raise ValueError(f"names: wanted {count}, got {len(names)}")
    found: Columns = {
        name: [(row.average[k], row.average_error[k]) for row in rows]
        for k, name in enumerate(names)
    }
    for name in SINGLE:
        pairs = [(getattr(row, name), getattr(row, f"{name}_error")) for row in rows]
        if any(value is not None for value, _ in pairs):
            found[name] = pairs
    found["seconds_per_step"] = [(row.seconds_per_step, None) for row in rows]
    found["diverged"] = [(row.diverged, None) for row in rows]
    return found


def data_frame(evaluations: Mapping[str, Any], names: Sequence[str] | None = None) -> Any:
    """A pandas table with a row for each filter; NaN for what it does not give."""
    import pandas

    table: dict[str, list[Any]] = {}
    for name, pairs in columns(evaluations, names).items():
        table[name] = [value for value, _ in pairs]
        if name not in ("seconds_per_step", "diverged"):
            table[f"{name}_error"] = [error for _, error in pairs]
    index = pandas.Index(list(evaluations), name="filter")
    return pandas.DataFrame(table, index=index).astype({"diverged": int})


def words_of(evaluations: Mapping[str, Any]) -> list[list[str]]:
    """Words of the table, the headings first."""
    rows = [[name] for name in evaluations]
    head = ["filter"]
    for name, pairs in columns(evaluations).items():
        if name == "seconds_per_step":
            head.append("µs a step")
            pairs = [(1e6 * value, None) for value, _ in pairs]
        else:
            head.append(SINGLE.get(name, name if name == "diverged" else f"RMS {name}"))
        for row, pair in zip(rows, pairs, strict=True):
            row.append(_words(*pair))
    return [head, *rows]


def text(evaluations: Mapping[str, Any]) -> str:
    """The table in characters of one width."""
    rows = words_of(evaluations)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(f"{word:<{width}}" for word, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def html(evaluations: Mapping[str, Any]) -> str:
    """The table for a notebook."""
    head, *rows = words_of(evaluations)

    def line(words, tag):
        return "<tr>" + "".join(f"<{tag}>{escape(word)}</{tag}>" for word in words) + "</tr>"

    return f"<table>{line(head, 'th')}{''.join(line(row, 'td') for row in rows)}</table>"


def _words(value, error):
    if value is None or value != value:
        return "-"
    if isinstance(value, int):
        return str(value)
    return f"{value:.3g}" if error is None else f"{value:.4g} ± {error:.2g}"
