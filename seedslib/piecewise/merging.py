"""Merging of branches of a scalar state, with a guarantee that does not grow afterwards.

Two branches are replaced by one Gaussian piece when the logarithm of the ratio between the sum of
the two densities and the new one varies by at most a given amount over the union of their
regions. Bayes' rule and the dynamics never increase that variation (it is Hilbert's projective
distance), and the total variation between two normalised laws at projective distance d is at most
``tanh(d / 4)``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from seedslib.gaussian.intervals import interval
from seedslib.piecewise.branches import Branches
from seedslib.piecewise.geometry import IntervalRegions

_SAME = 1e-12  # relative difference of ends that only rounding can have made


class _Pieces(NamedTuple):
    """Gaussian pieces; arrays whose last axis is that of the data sets."""

    lower: np.ndarray
    upper: np.ndarray
    mean: np.ndarray
    var: np.ndarray
    log_weight: np.ndarray
    log_unit: np.ndarray
    least: np.ndarray  # bounds of the log-ratio between what was replaced and this piece
    largest: np.ndarray

    def at(self, *index) -> _Pieces:
        return _Pieces(*(part[index] for part in self))


def merge(
    branches: Branches, log_weight: np.ndarray, tolerance: float
) -> tuple[Branches, np.ndarray, np.ndarray]:
    """Merge branches that lie in one cell, on the same interval or on adjoining ones.

    Parameters
    ----------
    branches : Branches
        Of a scalar state.
    log_weight : ndarray, shape (B, N)
        Normalised log-weights.
    tolerance : float
        Largest variation of the log-ratio that a merged piece may have.

    Returns
    -------
    branches : Branches
    log_weight : ndarray
    distance : ndarray, shape (N,)
        Projective distance between the law before and after.
    """
    shape, regions = log_weight.shape, branches.regions
    nothing, var = np.zeros(shape), np.broadcast_to(branches.cov[0, 0], shape)
    ends = (np.repeat(end[:, None], shape[1], axis=1) for end in (regions.lower, regions.upper))
    laws = branches.mean[0], var, log_weight, branches.log_unit
    pieces = _Pieces(*ends, *laws, nothing, nothing)
    pieces = _merge_stacks(branches, pieces, tolerance)
    pieces, origin = _merge_rows(branches, pieces, tolerance)
    if not (pieces.largest > pieces.least).any():
        return branches, log_weight, np.zeros(shape[1])

    alive = np.flatnonzero((pieces.log_weight > -np.inf).any(axis=1))
    pieces = pieces.at(alive)
    held = pieces.log_weight > -np.inf
    # a piece has one interval, the same for every data set that holds it
    # any that holds it will do: it is the same interval
    first = np.argmax(held, axis=1)[:, None]
    ends = (np.take_along_axis(e, first, axis=1)[:, 0] for e in (pieces.lower, pieces.upper))
    merged = branches.take(origin[alive])._replace(
        regions=IntervalRegions(*ends),
        mean=pieces.mean[None],
        cov=pieces.var[None, None],
        log_unit=np.where(held, pieces.log_unit, -np.inf),
    )
    least, largest = (np.where(held, part, 0.0) for part in (pieces.least, pieces.largest))
    return merged, pieces.log_weight, largest.max(axis=0) - least.min(axis=0)


def _merge_stacks(branches: Branches, pieces: _Pieces, tolerance: float) -> _Pieces:
    """Merge branches on the same interval, neighbours in their means first.

    The slots of a stack are interchangeable, and so no new ones are needed.
    """
    pieces = _Pieces(*(part.copy() for part in pieces))
    for chain in _stacks(branches):
        stack = pieces.at(chain)
        placed = np.where(stack.log_weight > -np.inf, stack.mean, np.inf)
        order = np.argsort(placed, axis=0, kind="stable")
        stack = _Pieces(*(np.take_along_axis(part, order, axis=0) for part in stack))
        if not _promising(stack, tolerance, True):
            continue
        pieces.log_weight[chain] = pieces.log_unit[chain] = -np.inf
        for _, start, done, piece in _chained(stack, tolerance, True):
            here = np.flatnonzero(done)
            for part, value in zip(pieces[2:], piece[2:], strict=True):
                part[chain[start[here]], here] = value[here]
    return pieces


def _merge_rows(
    branches: Branches, pieces: _Pieces, tolerance: float
) -> tuple[_Pieces, np.ndarray]:
    """Merge branches on adjoining intervals; a merged piece is a new one.

    Returns the pieces and the branch that each of them takes its cell and coordinates from.
    """
    added, parents, origin = [], [], np.arange(len(pieces.mean))
    weight = pieces.log_weight.copy()
    for chain in _rows(branches):
        row = pieces.at(chain)
        if not _promising(row, tolerance, False):
            continue
        for end, start, done, piece in _chained(row, tolerance, False):
            merged = done & (start < end)
            for first in np.unique(start[merged]):
                here = merged & (start == first)
                weight[np.ix_(chain[first : end + 1], here)] = -np.inf
                added.append(piece._replace(log_weight=np.where(here, piece.log_weight, -np.inf)))
                parents.append(chain[first])
    if not added:
        return pieces, origin
    new = (np.stack(part) for part in zip(*added, strict=True))
    old = pieces._replace(log_weight=weight)
    grown = _Pieces(*(np.concatenate(pair) for pair in zip(old, new, strict=True)))
    return grown, np.append(origin, parents)


def _promising(chain: _Pieces, tolerance: float, stacked: bool) -> bool:
    """Whether any two neighbours of a chain can be merged."""
    joined = _join(chain.at(slice(None, -1)), chain.at(slice(1, None)), stacked)
    return bool((joined.largest - joined.least <= tolerance).any())


def _chained(
    chain: _Pieces, tolerance: float, stacked: bool
) -> Iterator[tuple[int, np.ndarray, np.ndarray, _Pieces]]:
    """Merge along a chain from its first position on, for each data set by itself.

    Yields the position at which pieces end, where they start, for which data sets, and the pieces.
    """
    count, datasets = chain.mean.shape
    current, start = chain.at(0), np.zeros(datasets, dtype=int)
    for p in range(1, count):
        following = chain.at(p)
        joined = _join(current, following, stacked)
        accept = joined.largest - joined.least <= tolerance
        yield p - 1, start, ~accept, current
        current = _Pieces(*(np.where(accept, a, b) for a, b in zip(joined, following, strict=True)))
        start = np.where(accept, start, p)
    yield count - 1, start, np.ones(datasets, dtype=bool), current


def _join(a: _Pieces, b: _Pieces, stacked: bool) -> _Pieces:
    """One Gaussian piece for two, and the bounds of the log-ratio; infinite where hopeless."""
    both = (a.log_weight > -np.inf) & (b.log_weight > -np.inf)
    top = np.where(both, np.maximum(a.log_weight, b.log_weight), 0.0)
    parts = [np.exp(np.where(both, item.log_weight, top) - top) for item in (a, b)]
    total = parts[0] + parts[1]
    share = [part / total for part in parts]
    var = 1.0 / (share[0] / a.var + share[1] / b.var)
    mean = var * (share[0] * a.mean / a.var + share[1] * b.mean / b.var)
    ends = np.minimum(a.lower, b.lower), np.maximum(a.upper, b.upper)
    log_weight = np.where(both, top + np.log(total), -np.inf)
    new = _Pieces(*ends, mean, var, log_weight, a.log_unit, a.least, a.largest)
    peak, log_unit = _height(new)
    lows, highs = [], []
    with np.errstate(divide="ignore", invalid="ignore"):
        for item, part in ((a, share[0]), (b, share[1])):
            # pieces that lie on each other are compared with their share of the new one
            own = _height(item)[0] - (np.log(part) if stacked else 0.0)
            low, high = _range(own - peak, item, new)
            lows.append(low + item.least)
            highs.append(high + item.largest)
        low, high = np.minimum(*lows), np.maximum(*highs)
        usable = both & np.isfinite(low) & np.isfinite(high)
    low, high = np.where(usable, low, -np.inf), np.where(usable, high, np.inf)
    return new._replace(log_unit=log_unit, least=low, largest=high)


def _height(item: _Pieces) -> tuple[np.ndarray, np.ndarray]:
    """Log-density at the mean of the unrestricted law, up to a common constant, and ln U."""
    inside = interval(item.mean, item.var, item.lower, item.upper).log_mass
    with np.errstate(invalid="ignore"):
        log_unit = item.log_weight - inside
        return log_unit - 0.5 * np.log(item.var), log_unit


def _range(constant: np.ndarray, item: _Pieces, new: _Pieces) -> tuple[np.ndarray, np.ndarray]:
    """Extremes over the interval of `item` of the difference of the two log-densities."""
    curve = 1.0 / new.var - 1.0 / item.var

    def value(x: np.ndarray) -> np.ndarray:
        out, own = (x - new.mean) ** 2 / new.var, (x - item.mean) ** 2 / item.var
        return constant + 0.5 * (out - own)

    still = (new.mean / new.var - item.mean / item.var) / curve
    inner = np.clip(np.where(np.isfinite(still), still, item.lower), item.lower, item.upper)
    values = np.stack([value(item.lower), value(item.upper), value(inner)])
    values = np.where((item.mean == new.mean) & (item.var == new.var), constant, values)
    bounded = np.isfinite(values).all(axis=0)
    low, high = values.min(axis=0), values.max(axis=0)
    return np.where(bounded, low, -np.inf), np.where(bounded, high, np.inf)


def _key(branches: Branches) -> np.ndarray:
    """What two branches must share to have a common future: cell and coordinates."""
    return np.stack([branches.cell, branches.slope[0, 0], branches.shift[0]])


def _close(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return (a == b) | (np.abs(a - b) <= _SAME * (1.0 + np.abs(a)))


def _stacks(branches: Branches) -> list[np.ndarray]:
    """Groups of branches on the same interval."""
    key = np.vstack([_key(branches), branches.regions.lower, branches.regions.upper])
    order = np.lexsort(key[::-1])
    same = _close(key[:, order[1:]], key[:, order[:-1]]).all(axis=0)
    groups = np.split(order, np.flatnonzero(~same) + 1)
    return [group for group in groups if group.size > 1]


def _rows(branches: Branches) -> list[np.ndarray]:
    """Chains of branches on adjoining intervals, each branch in one chain at most."""
    key, lower, upper = _key(branches), branches.regions.lower, branches.regions.upper
    free = np.ones(lower.size, dtype=bool)
    chains = []
    for first in np.argsort(lower, kind="stable"):
        if not free[first]:
            continue
        chain, free[first] = [first], False
        while True:
            last = chain[-1]
            joins = free & _close(lower, upper[last]) & _close(key.T, key[:, last]).all(axis=1)
            if not joins.any():
                break
            chain.append(int(np.flatnonzero(joins)[0]))
            free[chain[-1]] = False
        if len(chain) > 1:
            chains.append(np.array(chain))
    return chains
