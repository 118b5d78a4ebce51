"""Coefficients of designed filters, held against each other measurement by measurement."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.tables import Labels, mesh
from seedslib.designed.outputs.filter import OutputFilter
from seedslib.designed.outputs.lookup import Table
from seedslib.designed.outputs.patterns import ByPattern
from seedslib.designed.predictors import Continuous, PolynomialFit
from seedslib.designed.switching.filter import SwitchingFilter
from seedslib.designed.switching.fits import CellFit

NODES = "nodes: "


def relative_differences(first: Any, k: int, second: Any, q: int) -> dict[str, float]:
    """Relative differences between measurement k of one design and measurement q of another.

    Of regressions without modes the forecast that leads to the measurement and those at the nodes
    after it; of a `SwitchingFilter` the forecast that starts after it; of output functions those
    of the measurement, of its being missing, and at the nodes after it.

    Parameters
    ----------
    first, second : FiniteOrderFilter, SwitchingFilter or OutputFilter
    k, q : int

    Returns
    -------
    dict of str to float
        By the kind of coefficient: |A - B| / max(|A|, |B|) in the Frobenius norm, of decided modes
        the part of nodes at which they differ, or NaN where the two are not alike.
    """
    here, there = _coefficients(first, k), _coefficients(second, q)
    none = _Part(None, [])
    return {
        name: _relative(here.get(name, none), there.get(name, none), name.endswith("mode"))
        for name in {**here, **there}
    }


class _Part(NamedTuple):
    """Arrays or functions, and what they weigh: numbers of one shape may be of other things."""

    weighs: object
    values: list[Any]


class _Function(NamedTuple):
    """The estimate, or the decided mode, of an output function; of a table so many arguments."""

    call: Callable[..., Any]
    size: int | None
    mode: bool = False

    @property
    def axes(self) -> tuple | None:
        return self.call.axes if isinstance(self.call, Table) else None

    def at(self, axes: Sequence) -> np.ndarray:
        """Values (..., points) at all nodes of the axes."""
        if self.axes == axes:
            found = self.call.mode if self.mode else self.call.estimate
        else:
            output = self.call([*mesh(axes)])
            found = output.mode if self.mode else output.mean
        return found.reshape(-1, math.prod(axis.count for axis in axes))


def _coefficients(designed, k) -> dict[str, _Part]:
    """What measurement k and the forecasts after it take, by name."""
    found: dict[str, _Part] = {}
    before, after = _held(designed, k - 1), _held(designed, k)
    if isinstance(designed, SwitchingFilter):
        if k < len(designed.fits):
            _note(found, designed.fits[k], "", after)
        return found
    if isinstance(designed, OutputFilter):
        shown = designed.steps[k].shown
        for table in shown.tables if isinstance(shown, ByPattern) else (shown,):
            if table is not None:
                _note(found, table, "", before, "output")
        _note(found, designed.steps[k].blind, "", before)
    elif k == 0:
        start = designed.start
        found["start"] = _Part(before, [start.mean, start.cov, *start.moments])
    else:
        _note(found, designed.fits[k - 1], "", before)
    if k < len(designed.node_fits):
        nodes = designed.node_times[k].tolist()
        for fit in designed.node_fits[k]:
            _note(found, fit, NODES, (after, nodes))
    return found


def _held(designed, k):
    """What a forecast after measurement k looks at: so many estimates, measurements, indicators.

    A continuous forecast looks at the estimate it has moved, which is something else.
    """
    memory = designed.memory
    moved = k >= 0 and isinstance(getattr(designed, "predictor", None), Continuous)
    blocks = (memory.estimates, memory.measurements, memory.indicators)
    return [min(k + 1, count) for count in blocks], memory.log_odds, moved


def _note(found, fit, place, weighs, word="forecast"):
    """Add the arrays of a regression, or an output function as a whole."""
    fit = getattr(fit, "fit", fit)  # a learned forecast is a regression
    if isinstance(fit, CellFit):
        parts = _law(fit)
    elif isinstance(fit, Table) or not hasattr(fit, "_asdict"):
        size = len(fit.axes) if isinstance(fit, Table) else None
        parts = {word: _Function(fit, size)}
        if getattr(fit, "mode", None) is not None:
            parts[f"{word} mode"] = _Function(fit, size, True)
    else:
        place += "powers' " * isinstance(fit, PolynomialFit)
        parts = {name: v for name, v in fit._asdict().items() if isinstance(v, np.ndarray)}
    for name, part in parts.items():
        found.setdefault(f"{place}{name}", _Part(weighs, [])).values.append(part)


def _law(fit):
    """What a fit of cells weighs, in forms that do not depend on how its density is factored."""
    return {
        "probability": np.exp(fit.log_weight - fit.log_weight.max()),
        "centre": fit.centre,
        "precision": np.einsum("kalc,kblc->ablc", fit.white, fit.white),
        "gain": fit.gain,
        "offset": fit.offset,
        "cov": fit.cov,
    }


def _relative(one, two, decided) -> float:
    """Relative difference of two lists taken together; NaN where they are not alike."""
    if one.weighs != two.weighs or len(one.values) != len(two.values):
        return np.nan
    apart = size = other = 0.0
    for a, b in zip(one.values, two.values, strict=True):
        a, b = _values(a, b)
        if a is None or b is None or a.shape != b.shape:
            return np.nan
        if decided and a.size:
            return float((a != b).mean())
        apart += np.sum((a - b) ** 2)
        size += np.sum(a**2)
        other += np.sum(b**2)
    return float(np.sqrt(apart / max(size, other))) if apart > 0 else 0.0


def _values(one, two):
    """Two arrays as they are, two functions at the nodes of the first table among them."""
    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray):
        return one, two
    if not (isinstance(one, _Function) and isinstance(two, _Function)):
        return None, None
    if one.call is two.call:
        return np.zeros(0), np.zeros(0)
    axes = two.axes if one.axes is None else one.axes
    if axes is None or (one.size != two.size and None not in (one.size, two.size)):
        return None, None
    if two.axes is not None and any(
        a != b for a, b in zip(axes, two.axes, strict=True) if Labels in (type(a), type(b))
    ):
        return None, None
    return one.at(axes), two.at(axes)
