"""From one measurement to the next with output functions: arrival, correction, forecasts between.

Functions of a filter, which holds what does not change, and of its state, which does.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.designed.arrivals import number_of
from seedslib.designed.guards import moment
from seedslib.designed.memory import Past
from seedslib.designed.outputs.lookup import Output, arguments
from seedslib.designed.outputs.patterns import ByPattern, by_pattern


class OutputState(NamedTuple):
    """What a filter of output functions remembers.

    Attributes
    ----------
    index : int
        Number k of the last measurement time reached; -1 before the first.
    time : float or None
    mean : ndarray, shape (n', *batch)
        Forecast after `predict`, estimate after `correct`, NaN before both.
    cov : ndarray, shape (n', n') or (n', n', *batch), or None
        Error covariance of the estimate that the design found, NaN from a gap on.
    mode : ndarray of int, shape (*batch), or None
        The mode that is likeliest in the forecast, or the decided one.
    mode_prob : ndarray, shape (L, *batch), or None
    past : Past
        The memory; after `predict` still the one before.
    before : OutputState or None
        The state after the measurement before the last, needed by linear forecasts.
    gap : ndarray of bool, shape (*batch), or False
        Whether something that the design does not know of has been missing so far.
    corrected : bool
    group : ndarray of int, shape (*batch), or 0
        Class of what has arrived so far, see `seedslib.designed.patterns`.
    """

    index: int
    time: float | None
    mean: np.ndarray
    cov: MaybeArray = None
    mode: MaybeArray = None
    mode_prob: MaybeArray = None
    past: Past = Past()
    before: OutputState | None = None
    gap: np.ndarray | bool = False
    corrected: bool = False
    group: np.ndarray | int = 0


def arrived(filter: Any, state: OutputState) -> OutputState:
    """The state at the next measurement time, with the estimate that it had."""
    before = state._replace(before=None) if state.corrected else None
    k, time = state.index + 1, next_time(filter, state)
    return OutputState(
        k, time, state.mean, past=state.past, before=before, gap=state.gap, group=state.group
    )


def next_time(filter: Any, state: OutputState) -> float:
    """The measurement time after that of a state.

    Raises
    ------
    ValueError
        There is none.
    """
    return moment(filter.clock, state.index + 1, filter.cycle)


def found(filter: Any, state: OutputState, y: Any, indicator: ArrayLike | None) -> Output:
    """What the functions of a measurement find; y is None where it is missing."""
    step = filter.steps[filter.served(state.index)]
    return _read(filter, state, indicator, step.blind if y is None else step.shown, y)


def _read(filter, state, indicator, function, y) -> Output:
    group = state.group if filter.arrivals else None
    points = arguments(filter.system, () if y is None else y, indicator, state.past, group)
    return function(points).filling(state.mean.shape[1:])


def after(
    filter: Any, state: OutputState, y: np.ndarray, indicator: Any, gap: Any = False
) -> OutputState:
    """The state after a measurement, (m, *batch), and an indicator, (*batch) or None.

    `gap` is where something is missing that the design does not know of, shape (*batch).

    Raises
    ------
    ValueError
        Only some components missing; a missing measurement or indicator that is to be remembered.
    """
    memory, lost = filter.memory, np.isnan(y)
    step = filter.steps[served := filter.served(state.index)]
    if isinstance(step.shown, ByPattern):
        output = by_pattern(step, y, partial(_read, filter, state, indicator))
    elif lost.any():
        output = _without(filter, state, y, indicator, lost)
    else:
        output = found(filter, state, y, indicator)
    if memory.indicators and indicator is not None and (indicator < 0).any():
        raise ValueError("indicator: wanted by the memory, got a missing one")
    mean, mode, prob = output
    past = memory.push(state.past, estimate=mean, measurement=y, mode=mode, indicator=indicator)
    cov, group, gap = filter.covariances[served], state.group, state.gap | gap
    if filter.arrivals:
        number = number_of(filter, y, indicator)
        cov = np.moveaxis(filter.arrivals[served].covs[group, number], (-2, -1), (0, 1))
        group = filter.ways[served][group, number]
    if np.any(gap):  # the design knows the error without other gaps only
        cov = cov[(..., *(None,) * (np.ndim(gap) + 2 - cov.ndim))]
        cov = np.where(gap, np.nan, cov)
    return OutputState(
        state.index, state.time, mean, cov, mode, prob, past, state.before, gap, True, group
    )


def _without(filter, state, y, indicator, lost) -> Output:
    """What is found where some measurements are missing."""
    missing = lost.all(axis=0)
    if not np.array_equal(lost.any(axis=0), missing):
        raise ValueError("y: wanted all components of a measurement or none, got some NaN")
    if filter.memory.measurements:
        raise ValueError("y: wanted a measurement, it is to be remembered; got NaN")
    unseen = found(filter, state, None, indicator)
    if missing.all():
        return unseen
    seen = found(filter, state, np.where(lost, 0.0, y), indicator)
    return Output(
        *(None if a is None else np.where(missing, b, a) for a, b in zip(seen, unseen, strict=True))
    )
