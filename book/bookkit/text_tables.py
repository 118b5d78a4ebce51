"""Tables that a notebook printed as text, as tables of the page.

Columns are found where every line of a table has at least two blanks, so a cell never moves to
another column. What cannot be read so without doubt stays the text it was.
"""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from typing import NamedTuple

_PLAIN = r"[-+]?(?:\d[\d,]*(?: \d{3})*(?:\.\d+)?|\.\d+)(?:e[-+]?\d+)?"
_NUMBER = re.compile(
    rf"[<>±]? ?{_PLAIN}(?: ?[%x×])?(?: (?:±|\+-) {_PLAIN})?(?: ?%)?(?: \( ?{_PLAIN} ?%?\))?$"
)
_WORDS_FOR_NUMBERS = {"", "-", "--", "nan", "inf", "∞", "–", "—"}


LONGEST = 60
"""Signs in the longest cell of a table; longer ones are prose or formulas."""


class Piece(NamedTuple):
    """Lines of a printed text; `rows` holds the cells where they are a table."""

    lines: list[str]
    rows: list[list[str]]
    caption: str = ""


def pieces(text: str) -> list[Piece]:
    """Printed text as tables and what lies between them, in order."""
    lines = text.rstrip("\n").split("\n")
    found: list[Piece] = []
    at = 0
    while at < len(lines):
        end, rows = _longest(lines, at)
        before = found[-1].lines[-1] if found and not found[-1].rows else ""
        if rows and not _headed(rows) and "  " in before.strip():
            rows = []  # the head does not stand over the columns: text shows which is which
        if rows:
            titled = len(found) == 1 and len(found[0].lines) == 1 and "  " not in before.strip()
            caption = before.strip().rstrip(":") if titled else ""
            found = [] if titled else found
            found.append(Piece(lines[at:end], rows, caption))
        elif found and not found[-1].rows:
            found[-1].lines.extend(lines[at:end])
        else:
            found.append(Piece(lines[at:end], []))
        at = end
    return [piece for piece in found if piece.rows or any(map(str.strip, piece.lines))]


def to_html(rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """HTML of a table: a first line without numbers is its head, the first column names rows."""
    count = len(rows[0])
    headed = _headed(rows)
    body = rows[1:] if headed else rows
    left = [
        "" if all(_is_number(row[k]) for row in body) else ' class="text"' for k in range(count)
    ]
    parts = ['<table class="results">']
    if caption:
        parts.append(f"<caption>{html.escape(caption)}</caption>")
    if headed:
        cells = (f'<th scope="col"{left[k]}>{html.escape(c)}</th>' for k, c in enumerate(rows[0]))
        parts.append(f"<thead><tr>{''.join(cells)}</tr></thead>")
    parts.append("<tbody>")
    for row in body:
        first = f'<th scope="row"{left[0]}>{html.escape(row[0])}</th>'
        cells = (f"<td{left[k]}>{html.escape(row[k])}</td>" for k in range(1, count))
        parts.append(f"<tr>{first}{''.join(cells)}</tr>")
    return "\n".join([*parts, "</tbody></table>"])


def _longest(lines: Sequence[str], at: int) -> tuple[int, list[list[str]]]:
    """The end of the longest table that begins here with its cells, or of the line."""
    end = at
    while end < len(lines) and lines[end].strip():
        end += 1
    for stop in range(end, at + 2, -1):
        if rows := _cells(lines[at:stop]):
            return stop, rows
    return at + 1, []


def _cells(lines: Sequence[str]) -> list[list[str]]:
    """Cells of lines that are a table; nothing where they are not."""
    width = max(map(len, lines))
    padded = [line.ljust(width) for line in lines]
    blank = "".join(" " if all(line[k] == " " for line in padded) else "x" for k in range(width))
    spans = [match.span() for match in re.finditer(r"x+(?: x+)*", blank)]
    rows = [[line[a:b].strip() for a, b in spans] for line in padded]
    cells = [cell for row in rows for cell in row]
    if len(spans) < 2 or any("  " in cell or len(cell) > LONGEST for cell in cells):
        return []
    if any(re.search(r"\d[,;] [a-z]", cell) for cell in cells):
        return []  # sentences that happen to be alike
    told = [cell for row in rows[1:] for cell in row[1:] if cell]
    if 2 * sum(any(map(str.isdigit, cell)) for cell in told) < len(told):
        return []
    return rows


def _headed(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the first line names columns: by words over numbers, or by rounder numbers."""
    first, second = rows[0][1:], rows[1][1:]
    if all(_is_number(cell) for cell in first):
        return all(_decimals(a) < _decimals(b) for a, b in zip(first, second, strict=True))
    if any(re.search(r"\d\.\d\d", cell) for cell in first):
        return False
    over = zip(first, zip(*(row[1:] for row in rows[1:]), strict=True), strict=True)
    return any(not _is_number(top) and all(map(_is_number, below)) for top, below in over)


def _decimals(cell: str) -> int:
    return len(cell.partition(".")[2].partition(" ")[0])


def _is_number(cell: str) -> bool:
    return cell in _WORDS_FOR_NUMBERS or bool(_NUMBER.match(cell))
