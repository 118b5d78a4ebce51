"""Classes of histories of what has arrived, about each measurement of a design.

The class of a path is a letter that its patterns alone decide, by a table at each step, as in
`seedslib.designed.patterns`; here it is one more letter of the memory, next to its modes.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from seedslib.designed.patterns import distances, loose
from seedslib.designed.shapes import check_array, check_covariances


class Arrivals(NamedTuple):
    """What a design knows of the classes of histories about one measurement.

    Attributes
    ----------
    table : ndarray of int, shape (classes before, patterns)
        Class after the measurement, by the one before it and the number of the pattern: the sum of
        2^i over the components that have arrived, counted among those that may be missing.
    covs : ndarray, shape (classes before, patterns, n', n')
        Error covariances of the estimates.
    before, after : ndarray, shape (classes, n', n')
        Those of the classes before it, from the measurement before; and of those after it.
    prob : ndarray, shape (classes after,)
    claimed : ndarray, shape (classes after, n')
        Variances that a filter of modes claims of them on the average.
    """

    table: np.ndarray
    covs: np.ndarray
    before: np.ndarray
    after: np.ndarray
    prob: np.ndarray
    claimed: np.ndarray

    def check(self, name: str, size: int, patterns: int) -> None:
        """Refuse arrays that do not fit together.

        Raises
        ------
        TypeError, ValueError
            Other shapes, classes that there are not, covariances that are none.
        """
        check_array(f"{name}.prob", self.prob, None)
        check_array(f"{name}.after", self.after, len(self.prob), size, size)
        check_array(f"{name}.claimed", self.claimed, len(self.prob), size)
        check_array(f"{name}.before", self.before, None, size, size)
        shape = len(self.before), patterns
        check_array(f"{name}.covs", self.covs, *shape, size, size)
        table = self.table
        if table.shape != shape or table.dtype.kind not in "iu":
            raise ValueError(f"{name}.table: wanted classes of shape {shape}, got {table.shape}")
        if table.size and not 0 <= table.min() <= table.max() < len(self.prob):
            raise ValueError(f"{name}.table: wanted classes below {len(self.prob)}")
        check_covariances(name, (self.covs, self.before, self.after))

    def scale(self, group: np.ndarray | int) -> np.ndarray:
        """What deviations claimed in the classes `group` are multiplied by, (n', *group).

        Normal laws of the modes make the filter more certain than it is, or less; its errors on
        the paths of the design are known.
        """
        actual = np.einsum("cjj->cj", self.after)
        ratio = np.divide(actual, self.claimed, out=np.ones_like(actual), where=self.claimed > 0)
        return np.sqrt(ratio).T[:, group]


def check_arrivals(filter: Any, size: int) -> None:
    """Refuse classes that do not fit the steps, the availability or the size of an estimate.

    Raises
    ------
    TypeError, ValueError
        What does not fit.
    """
    given, count = filter.availability, len(filter.times)
    patterns = 1 if given is None else 2 ** len(loose(given))
    if len(filter.arrivals) != (count if patterns > 1 else 0):
        raise ValueError(f"arrivals: wanted those of {count} steps for an availability")
    for k, part in enumerate(filter.arrivals):
        part.check(f"arrivals[{k}]", size, patterns)


def ways(arrivals: tuple[Arrivals, ...], cycle: int) -> tuple[np.ndarray, ...]:
    """Table of each step into the classes before the next one, of the last into its cycle.

    Steps that did not follow each other in the design are joined by the nearest covariances.
    """
    found = [_joined(one, other) for one, other in pairwise(arrivals)]
    if arrivals:
        last = arrivals[-1]
        found.append(_joined(last, arrivals[len(arrivals) - cycle]) if cycle else last.table)
    return tuple(found)


def _joined(one, other):
    if one.after.shape == other.before.shape and (one.after == other.before).all():
        return one.table
    return np.argmin(distances(one.after, other.before), axis=1)[one.table]


def number_of(filter: Any, y: np.ndarray, indicator: Any) -> np.ndarray:
    """Number of the pattern, among the components that may be missing, of y (m, *batch)."""
    there = ~np.isnan(y)
    if indicator is not None:
        there = np.concatenate([there, (np.asarray(indicator) >= 0)[None]])
    there = there[loose(filter.availability)]
    return np.tensordot(2 ** np.arange(len(there)), there, 1)
