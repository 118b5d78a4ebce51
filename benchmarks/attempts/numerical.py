"""Numerical abuse: each argument of each target spoiled in all ways that fit its kind."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from attempts.functions import designs, functions
from attempts.judge import Attempt, equal, sane
from attempts.spoiled import (
    no_counts,
    no_covariance,
    no_numbers,
    no_positives,
    no_times,
    same,
    spoiled,
)
from attempts.targets import FILTERS, TIMES, Target, Y, filtered, targets

EXTREME = (0.0, 5e-324, 1e-310, 1e-60, 1e60, -1e60, 1e15)
SHAPED = ("array", "cov", "times", "missing", "missing array", "formulas")
FREE = ("elementwise", "variance", "bound", "correlation")
"""Kinds of arguments of which many may be given at once: any shape is legal."""


def attempts() -> list[Attempt]:
    """All of them, in an order of their own."""
    found = []
    for target in (*targets(), *functions(), *designs()):
        for argument, kind in target.kinds.items():
            for what, value, legal in changes(target, argument, kind):
                call = partial(target.call, **target.good | {argument: value})
                name = f"{target.name}, {argument}: {what}"
                if legal == "same":
                    found.append(Attempt(name, call, partial(as_before, target), legal=True))
                else:
                    found.append(Attempt(name, call, sane if legal == "sane" else None))
        found += [
            Attempt(
                f"{target.name} without {argument}",
                partial(target.call, **target.good | {argument: None}),
            )
            for argument, kind in target.kinds.items()
            if (target.name, argument) not in OPTIONAL
        ]
    return found + extremes()


OPTIONAL = {
    ("correct", "cov"),
    ("simulate a diffusion", "step"),
    ("smooth", "lag"),
    ("step of a filter", "step"),
    ("Noise", "cov"),
    ("indicator", "indicator"),
}
"""Arguments that may be None."""


def as_before(target: Target, value: object) -> bool:
    return equal(value, target.call(**target.good))


def changes(target: Target, argument: str, kinds: str) -> Iterator[tuple[str, object, str]]:
    """What it is, the value, and what is legal: nothing, anything sane, the same numbers."""
    good = target.good[argument]
    kind, *more = kinds.split() if kinds != "missing array" else [kinds]
    if kind in ("count", "seed"):
        for what, value in no_counts(int(more[0]) if more else 0):
            # NumPy takes lists and arrays of whole numbers as seeds
            if kind == "count" or what not in ("list", "array"):
                yield what, value, ""
        yield "of numpy", np.int64(good), "same"
        return
    for what, value in no_numbers():
        # matrices may be functions of time there
        if target.name in ("LinearSystem", "DelaySystem") and what in ("type", "function"):
            continue
        if what not in LEGAL.get(kind, ()) and not ("inf" in more and what == "inf"):
            yield what, value, ""
    if kind in ("positive", "nonnegative", "number", "probability"):
        if kind != "number":
            for what, value in no_positives():
                if not (
                    (what == "inf" and "inf" in more) or (what == "zero" and kind == "nonnegative")
                ):
                    yield what, value, ""
        yield "scalar of numpy", np.float64(good), "same"
        return
    if kind == "primitive":
        return
    for what, value in spoiled(good, missing=kind.startswith("missing")):
        if what in SHAPES and kind in (*FREE, "broadcast", "rows", "vertices", "complex"):
            continue
        free = kind in ("bound", "cells") and ("inf" in what or what in ("one more", "doubled"))
        if free or what in LEGAL.get(kind, ()):
            continue
        # another shape may be another number of paths, or of axes that are batches
        yield what, value, "sane" if what in BATCHES else ""
    if kind != "formulas":
        yield from ((what, value, "same") for what, value in same(good))
    if kind == "cov":
        yield from ((what, value, "") for what, value in no_covariance(good))
    if kind == "variance":
        yield from ((f"{v:g}", v, "") for v in (-1.0, -1e-7, -1e60))
    if kind == "correlation":
        yield from ((f"{v:g}", v, "") for v in (-1.5, 1.0000001, 2.0, 1e60))
    if kind == "times":
        yield from ((what, value, "") for what, value in no_times(good))


EMPTY = ("empty", "empty matrix", "nested", "range of none")
EXACT = ("decimal", "fraction")
LEGAL = {
    **dict.fromkeys(FREE, EMPTY),
    "bound": (*EMPTY, "inf", "-inf"),
    "positive": EXACT,
    "nonnegative": EXACT,
    "number": EXACT,
    "formulas": ("symbol", "objects", "fraction", "complex"),
    "complex": ("complex", "complexes"),
    "lone": ("nested", "one axis more", "many axes"),
    "missing array": (*EMPTY, "masked", "fraction", "objects"),
    "primitive": ("NaN", "inf", "-inf", "complexes", "decimal", "fraction", "nested", "empty"),
}
"""What is legal of each kind. A primitive of arithmetic passes on what is no number as NaN."""
SHAPES = (
    "one axis more",
    "many axes",
    "one more",
    "doubled",
    "none",
    "flat and doubled",
    "cut",
    "turned",
)
BATCHES = ("one axis more", "many axes")


def extremes() -> list[Attempt]:
    """Extreme but legal measurements: the answer is sane, or flagged, or refused."""
    found = []
    for name, make in FILTERS.items():
        for value in EXTREME:
            for row in range(len(Y)):
                y = Y.copy()
                y[row] = value
                found.append(
                    Attempt(
                        f"{name}: measurement {value:g}", partial(filtered(make), TIMES, y), sane
                    )
                )
        for rows in range(1, 2 ** len(Y)):
            gaps = np.where([[rows >> k & 1] for k in range(len(Y))], np.nan, Y)
            masked = np.ma.masked_invalid(np.where(np.isnan(gaps), -9999.0, Y))
            masked.mask = np.isnan(gaps)
            right = partial(
                lambda wanted, found: equal(found, wanted()), partial(filtered(make), TIMES, gaps)
            )
            found.append(
                Attempt(
                    f"{name}: mask {rows}",
                    partial(filtered(make), TIMES, masked),
                    right,
                    legal=True,
                )
            )
    return found
