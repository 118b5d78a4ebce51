"""Coefficients of designed filters, held against each other measurement by measurement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.designed.predictors import Continuous, PolynomialFit
from seedslib.designed.table import OutputFilter, TableFit

NODES = "nodes: "


def relative_differences(first, k: int, second, q: int) -> dict[str, float]:
    """Relative differences between measurement k of one design and measurement q of another.

    Parameters
    ----------
    first, second : FiniteOrderFilter
    k, q : int

    Returns
    -------
    dict of str to float
        By the kind of coefficient: |A - B| / max(|A|, |B|) in the Frobenius norm, or NaN where
        the two are not alike.
    """
    here, there = _coefficients(first, k), _coefficients(second, q)
    # numbers of one shape may still weigh different things
    before = _held(first, k - 1) == _held(second, q - 1)
    after = _held(first, k) == _held(second, q)
    nodes = [d.node_times[j] for d, j in ((first, k), (second, q)) if j < len(d.node_times)]
    after &= len(nodes) < 2 or np.array_equal(*nodes)
    return {
        name: _relative(here.get(name, ()), there.get(name, ()))
        if (after if name.startswith(NODES) else before)
        else np.nan
        for name in {**here, **there}
    }


def _held(designed, k):
    """What forecasts after measurement k look at: so many estimates and measurements.

    A continuous forecast looks at the estimate it has moved, which is something else.
    """
    memory, moved = designed.memory, k >= 0 and isinstance(designed.predictor, Continuous)
    return min(k + 1, memory.estimates), min(k + 1, memory.measurements), moved


class _Function(NamedTuple):
    """A table, or a learned function, of so many arguments."""

    call: object
    size: int

    @property
    def axes(self):
        return self.call.axes if isinstance(self.call, TableFit) else None

    def at(self, axes):
        """Values at all nodes of the axes."""
        if self.axes == axes:
            return self.call.values
        points = np.array(np.meshgrid(*[axis.nodes for axis in axes], indexing="ij"))
        return self.call(points, points[:0])


def _coefficients(designed, k) -> dict[str, list]:
    """What measurement k and the nodes after it take, by name: lists of arrays or functions."""
    found: dict[str, list] = {}
    if isinstance(designed, OutputFilter):
        m, n = designed.system.sensor.size, designed.components
        size = m + (designed.memory.dimension(k - 1, n, m) if k else 0)
        found["output"] = [_Function(designed.rules.outputs[k], size)]
    elif k == 0:
        start = designed.start
        found["start"] = [start.mean, start.cov, *start.moments]
    if k > 0:
        _note(found, designed.fits[k - 1], "")
    if k < len(designed.node_fits):
        for fit in designed.node_fits[k]:
            _note(found, fit, NODES)
    return found


def _note(found, fit, place):
    """Add the arrays of a regression, or a table as a whole."""
    if isinstance(fit, TableFit):
        found.setdefault(f"{place}forecast", []).append(_Function(fit, len(fit.axes)))
        return
    if isinstance(fit, PolynomialFit):
        place += "powers' "
    for name, part in fit._asdict().items():
        if isinstance(part, np.ndarray):
            found.setdefault(f"{place}{name}", []).append(part)


def _relative(one, two) -> float:
    """Relative difference of two lists taken together; NaN where they are not alike."""
    if len(one) != len(two):
        return np.nan
    apart = size = other = 0.0
    for a, b in zip(one, two, strict=True):
        a, b = _values(a, b)
        if a is None or b is None or a.shape != b.shape:
            return np.nan
        apart += np.sum((a - b) ** 2)
        size += np.sum(a**2)
        other += np.sum(b**2)
    return float(np.sqrt(apart / max(size, other))) if apart > 0 else 0.0


def _values(one, two):
    """Two arrays as they are, two functions at the nodes of the first table among them."""
    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray):
        return one, two
    if not (isinstance(one, _Function) and isinstance(two, _Function)) or one.size != two.size:
        return None, None
    if one.call is two.call:
        return np.zeros(0), np.zeros(0)
    axes = one.axes or two.axes
    return (None, None) if axes is None else (one.at(axes), two.at(axes))
