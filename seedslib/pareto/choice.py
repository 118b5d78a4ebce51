"""Compromise within a list of choices: a table of criteria, or a bisection on the index."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from seedslib.base.checks import as_shape
from seedslib.pareto.result import Compromise, Criteria, Evaluated, as_losses, efficiency

SEPARABLE = 2.0  # standard errors


def choose(
    criteria: object, choices: Sequence[Any] | None = None, *, errors: object = None
) -> Compromise:
    """Choice whose largest relative loss is least, for instance the memory of a filter.

    Dominated choices are dropped first; with noise also choices that cost more than a
    kept one without an improvement beyond two standard errors, since an offered but useless
    choice stretches the scale of its cost and so moves the compromise. Ties go to the least sum of
    losses, then to the first.

    Parameters
    ----------
    criteria : array_like (n, p) or (draws, n, p), or two callables of a choice
        Losses of the n choices. Three axes: simulated criteria, one draw of common random numbers
        for all choices along the first axis; averaged, and compared in pairs. Two callables: both
        criteria are taken to be monotone in the order of `choices`, and about log2(n)
        choices are evaluated.
    choices : sequence of length n, optional
        What is chosen from; needed for callables, by default the positions.
    errors : array_like (n, p), optional
        Standard errors of a table, taken as independent; 0 for an exact criterion.

    Returns
    -------
    Compromise
        With `inseparable` and `sensitivity` (the latter for a table only).

    Raises
    ------
    TypeError, ValueError
        Fewer than two criteria or no choice, values not finite or not the same on a second call,
        negative `errors`, `errors` beside draws or callables, fewer than 8 draws.
    """
    if choices is not None and not (
        hasattr(choices, "__getitem__") and hasattr(choices, "__len__")
    ):
        raise TypeError(f"choices: wanted a sequence, got {type(choices).__name__}")
    listed = isinstance(criteria, (list, tuple))
    if callable(criteria) or (listed and any(callable(c) for c in criteria)):
        if choices is None or len(choices) == 0:
            raise ValueError("choices: wanted at least one choice for criteria that are callables")
        if errors is not None:
            raise ValueError("errors: wanted a table of criteria beside it, got callables")
        return _bisected(criteria, choices)
    table = as_losses(criteria)
    if table.ndim not in (2, 3):
        raise ValueError(
            f"criteria: wanted axes (choices, criteria) or (draws, choices, criteria), "
            f"got shape {table.shape}"
        )
    if table.shape[-1] < 2 or table.shape[-2] < 1:
        raise ValueError(
            f"criteria: wanted at least one choice and two criteria, got shape {table.shape}"
        )
    if choices is not None and len(choices) != table.shape[-2]:
        raise ValueError(f"choices: wanted {table.shape[-2]} choices, got {len(choices)}")
    noise = _noise(table, errors)
    return _tabled(table if table.ndim == 2 else table.mean(axis=0), choices, noise)


def _noise(table: np.ndarray, errors: object) -> Callable[[np.ndarray], np.ndarray] | None:
    """Standard error of a linear form: weights ``(..., n, p)`` to ``(...)``; None if exact."""
    if table.ndim == 2:
        if errors is None:
            return None
        errors = as_shape("errors", errors, table.shape)
        if errors.min() < 0:
            raise ValueError(f"errors: wanted nonnegative numbers, got {errors.min():g}")
        return lambda weights: np.sqrt(((weights * errors) ** 2).sum(axis=(-2, -1)))
    if errors is not None:
        raise ValueError("errors: wanted none beside draws, which carry their own errors")
    draws = len(table)
    if draws < 8:
        raise ValueError(f"criteria: wanted at least 8 draws, got {draws}")
    centred = (table - table.mean(axis=0)).reshape(draws, -1)

    def standard_error(weights: np.ndarray) -> np.ndarray:
        forms = centred @ weights.reshape(*weights.shape[:-2], -1, 1)
        return np.sqrt((forms[..., 0] ** 2).sum(axis=-1) / (draws * (draws - 1)))

    return standard_error


def _undominated(values: np.ndarray) -> np.ndarray:
    keep = [
        i
        for i, row in enumerate(values)
        if not ((values <= row).all(axis=1) & (values < row).any(axis=1)).any()
    ]
    return np.array(keep)


def _improving(values: np.ndarray, rows: np.ndarray, noise: Callable) -> np.ndarray:
    """Rows left when each must improve on the kept ones before it by more than the noise.

    The order is that of the criterion with the least noise, usually the cost.
    """
    count = values.shape[1]
    own = np.eye(values.size).reshape(values.size, *values.shape)
    relative = noise(own).reshape(values.shape) / np.maximum(np.ptp(values, axis=0), 1e-300)
    quiet = int(np.argmin(relative[rows].max(axis=0)))
    kept: list[int] = []
    # of equal values the smallest index first
    for i in rows[np.argsort(values[rows, quiet], kind="stable")]:
        for j in kept:
            pair = np.zeros((count, *values.shape))
            pair[range(count), i, range(count)] = 1.0
            pair[range(count), j, range(count)] = -1.0
            margin, worse = SEPARABLE * noise(pair), values[i] - values[j]
            if (worse >= -margin).all() and (worse > margin).any():
                break
        else:
            kept.append(int(i))
    return np.array(sorted(kept))


def _scaled(
    values: np.ndarray, noise: Callable | None, withdrawn: int = -1
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows kept, minimisers of the criteria, losses of all rows, and order of preference."""
    offered = np.delete(np.arange(len(values)), withdrawn) if withdrawn >= 0 else slice(None)
    rows = np.arange(len(values))[offered][_undominated(values[offered])]
    if noise is not None:
        rows = _improving(values, rows, noise)
    unit = np.ptp(values[rows], axis=0)
    shares = values / np.where(unit > 0, unit, np.inf)
    minimizers = np.array(
        [
            min(rows, key=lambda i, k=k: (values[i, k], shares[i].sum() - shares[i, k], i))
            for k in range(values.shape[1])
        ]
    )
    utopia = values[minimizers].diagonal()
    scale = values[minimizers].max(axis=0) - utopia
    losses = (values - utopia) / np.where(scale > 0, scale, np.inf)
    order = sorted(rows, key=lambda i: (losses[i].max(), losses[i].sum(), i))
    return rows, minimizers, losses, np.array(order)


def _tabled(values: np.ndarray, choices: Sequence | None, noise: Callable | None) -> Compromise:
    rows, minimizers, losses, order = _scaled(values, noise)
    best = int(order[0])
    ideal = bool((losses[best] == 0).all())
    withdrawn = {
        int(_scaled(values, noise, int(i))[3][0]) for i in set(minimizers) if len(values) > 1
    }
    return Compromise(
        x=best if choices is None else choices[best], index=best, values=values[best],
        losses=losses[best], utopia=values[minimizers].diagonal().copy(),
        nadir=values[minimizers].max(axis=0), minimizers=minimizers,
        status="ideal point" if ideal else _status(losses[best]),
        efficiency=efficiency(values[best], values[rows], exact=True), evaluations=len(values),
        inseparable=() if noise is None else _inseparable(values, minimizers, losses, best, noise),
        sensitivity=tuple(sorted(withdrawn - {best})),
    )  # fmt: skip


def _status(losses: np.ndarray) -> str:
    return "equal losses" if np.ptp(losses) <= 1e-12 else "minimax"


def _inseparable(
    values: np.ndarray, minimizers: np.ndarray, losses: np.ndarray, best: int, noise: Callable
) -> tuple[int, ...]:
    """Choices whose largest loss is within the noise of the least, by linear propagation.

    The loss of choice i in criterion k depends on three table entries: its own, and those
    that make the utopia and the nadir.
    """
    # of equal losses the first criterion; their propagated noise is compared, not their order
    worst = losses.argmax(axis=1)
    weights = np.zeros((len(values), *values.shape))
    for i, k in enumerate(worst):
        low = minimizers[k]
        high = minimizers[np.argmax(values[minimizers, k])]
        scale = values[high, k] - values[low, k]
        if scale > 0:
            weights[i, i, k] += 1.0 / scale
            weights[i, low, k] -= (1.0 - losses[i, k]) / scale
            weights[i, high, k] -= losses[i, k] / scale
    excess = losses.max(axis=1) - losses[best].max()
    near = excess <= SEPARABLE * noise(weights - weights[best])
    return tuple(int(i) for i in np.flatnonzero(near))


def _bisected(criteria: Criteria, choices: Sequence) -> Compromise:
    known: dict[int, np.ndarray] = {}
    several = [criteria] if callable(criteria) else criteria
    of_index = [(lambda i, c=c: c(choices[i])) if callable(c) else c for c in several]
    evaluate = Evaluated(of_index[0] if callable(criteria) else of_index, 0)

    def at(i: int) -> np.ndarray:
        if i not in known:
            known[i] = evaluate(i)
        return known[i]

    def last_equal(k: int, i: int, goal: int) -> int:
        """Farthest index from i towards the goal where criterion k is what it is at i."""
        step = 1 if goal > i else -1
        inside, outside = i, goal + step
        probe = i + step
        while abs(outside - inside) > 1:
            if at(probe)[k] == at(i)[k]:
                inside, probe = probe, (probe + outside) // 2
            else:
                outside, probe = probe, (inside + probe) // 2
        return inside

    ends = (0, len(choices) - 1)
    if at(ends[0]).size != 2:
        raise ValueError(f"criteria: wanted two for a bisection, got {at(0).size}")
    first, second = (min(ends, key=lambda i, k=k: (at(i)[k], at(i)[1 - k])) for k in (0, 1))
    if first != second:
        first, second = last_equal(0, first, second), last_equal(1, second, first)
    else:
        at(sum(ends) // 2)  # one look inside: `unimodal` says if it contradicts the ends
    utopia, nadir = np.array([at(first)[0], at(second)[1]]), np.array([at(second)[0], at(first)[1]])
    scale = np.where(nadir > utopia, nadir - utopia, np.inf)

    def losses(i: int) -> np.ndarray:
        return (at(i) - utopia) / scale

    low, high = first, second
    while abs(high - low) > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if losses(middle)[0] < losses(middle)[1] else (low, middle)
    # beyond an equal worst loss the other loss can still fall: that choice dominates
    pair = []
    for i in (low, high):
        worst = int(losses(i).argmax())
        goal = (second, first)[worst]
        pair.append(i if i == goal else last_equal(worst, i, goal))
    best = min(pair, key=lambda i: (losses(i).max(), losses(i).sum(), i))
    trace = np.array([at(i) for i in sorted(known)])
    slopes = np.diff(trace, axis=0)
    return Compromise(
        x=choices[best], index=best, values=at(best), losses=losses(best), utopia=utopia,
        nadir=nadir, minimizers=np.array([first, second]),
        status="ideal point" if first == second else _status(losses(best)),
        efficiency=efficiency(at(best), trace, exact=True),
        unimodal=bool(((slopes >= 0).all(axis=0) | (slopes <= 0).all(axis=0)).all()),
        evaluations=len(known),
    )  # fmt: skip
