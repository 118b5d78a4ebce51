"""C of what a filter knows of its sensor: a schedule, and classes of what arrived.

A step looks up which components there may be and which there must, numbers the pattern of those
that have arrived, and goes to the class of histories that a table of integers says. Each class has
a forecast of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.gaps import expected
from seedslib.designed.patterns import PatternFit, loose
from seedslib.extra.c.source import constants

_REGROUP = """\
/* Number of the pattern of what has arrived, among the components that may be missing. */
static inline int @name_pattern_(const double *y)
{
    int i, number = 0;
    for (i = 0; i < @NAME_LOOSE; i++) if (!isnan(y[@name_loose[i]])) number += 1 << i;
    return number;
}
"""

_LOST = "        if (isnan(y[i])) lost = 1;"

_SCHEDULED = """\
        if (!isnan(y[i]) && @name_read[s->k][i] == 0) return @NAME_STRAY;
        if (isnan(y[i]) && @name_read[s->k][i] == 2) lost = 1;"""

_CLASS = """\
    if (s->k < @NAME_WAYS) { /* class of what has arrived so far */
        s->group = @name_way[@name_way_start[s->k] + s->group * @NAME_PATTERNS + @name_pattern_(y)];
    }
"""


_TOLD = """\
    if (indicator >= 0 && @name_read[s->k][@NAME_MEASUREMENT] == 0) return @NAME_STRAY;
    if (indicator < 0 && @name_read[s->k][@NAME_MEASUREMENT] == 2) lost = 1;
"""


def knows(filter: Any) -> bool:
    """Whether a design knows of missing measurements."""
    return filter.measured is not None or filter.availability is not None


def by_class(fits: Sequence[Any]) -> list[tuple[int, Any]]:
    """The forecasts, class after class where there are such, each with the number of its fit."""
    return [
        (k, one)
        for k, fit in enumerate(fits)
        for one in (
            map(fit.one, range(len(fit.prob))) if isinstance(fit, PatternFit) else [fit]
        )
    ]  # fmt: skip


def measurements_by_pattern(filter: FiniteOrderFilter) -> list[np.ndarray]:
    """Measurements with each pattern of NaN that the first one may have, numbered as they are."""
    mask, arriving = filter.schedule
    free = loose(np.ones(len(mask[0])) if arriving is None else arriving)
    found = []
    for bits in product((False, True), repeat=len(free)):
        there = mask[0] & (True if arriving is None else arriving > 0.0)
        there[free] &= np.array(bits[::-1], dtype=bool)
        found.append(np.where(there, 0.0, np.nan))
    return found


def schedule(filter: Any) -> str:
    """C of which components there may be at each time, and which there must; 0, 1 and 2."""
    if not knows(filter):
        return ""
    rows = expected(filter, np.arange(len(filter.times)))
    return constants("@name_read", rows.sum(axis=0), "signed char")


def losing(filter: Any) -> tuple[str, str]:
    """C that sees a gap the design does not know of: in a component, and in the indicator."""
    if knows(filter):
        return _SCHEDULED, _TOLD
    return _LOST, "    if (indicator < 0) lost = 1;\n"


def arrivals(filter: FiniteOrderFilter) -> tuple[dict[Any, Any], str]:
    """Macros and C of the tables of schedule and classes; empty of a design without."""
    text = schedule(filter)
    if not text or filter.ways is None:
        return {}, text
    free = loose(filter.availability)
    macros = {"LOOSE": len(free), "PATTERNS": 2 ** len(free), "WAYS": len(filter.ways)}
    text += constants("@name_loose", free if len(free) else [0], "int")
    text += constants("@name_way_start", _starts([table.size for table in filter.ways]), "int")
    text += constants("@name_way", np.concatenate([t.ravel() for t in filter.ways]), "int")
    text += constants("@name_class", _starts([len(fit.prob) for fit in filter.fits]), "int")
    nodes = [len(fit.prob) for row in filter.node_fits for fit in row]
    text += constants("@name_node_class", _starts(nodes), "int")
    return macros, text + _REGROUP


def _starts(counts: Sequence[int]) -> np.ndarray:
    """Where each of several lists begins, when one follows the other."""
    return np.cumsum([0, *counts])[: max(1, len(counts))]


def knowing(filter: FiniteOrderFilter, text: str) -> str:
    """C of a filter with what it knows of its sensor put in at the marks."""
    classes = filter.ways is not None
    marks = {
        "@LOST": losing(filter)[0],
        "@GROUP": "    int group; /* class of what has arrived */\n" if classes else "",
        "@CLASS": _CLASS if classes else "",
        "@FIT": "@name_class[s->k - 1] + s->group" if classes else "s->k - 1",
        "@NODE": "f" if classes else "n",
        "@EACH": "\n        const int f = @name_node_class[n] + s->group;" if classes else "",
        "@SEEN": "[@name_pattern_(y)]" if classes else "",
    }
    for mark, part in marks.items():
        text = text.replace(mark, part)
    return text
