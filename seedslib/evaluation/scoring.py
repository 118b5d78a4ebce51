"""One block of paths: what each filter says of them, held against the truth."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from seedslib.base.blocks import child
from seedslib.base.circle import Periods, as_periods, nearest, wrapped
from seedslib.base.values import Course
from seedslib.evaluation.consistency import innovation_squares, mahalanobis
from seedslib.evaluation.tally import Tally, tally
from seedslib.models.kinds import inputs_of

FILTERS = 0x46494C54
"""Key of the filters' own streams among the children of a block's: no block of paths has it."""


def circular(given: Mapping[int, float] | None, system: Any) -> Periods:
    """Circular components of the state of the truth."""
    if given is not None:
        return as_periods("period", given, system.state_size)
    maps = getattr(system, "dynamics", ())
    maps = maps if isinstance(maps, tuple) else (maps,)
    return tuple({pair for each in maps for pair in getattr(each, "period", ())})


def own_inputs(inputs: Mapping[Any, np.ndarray], system: Any) -> dict[str, Any]:
    """Those inputs that a system mentions, as an option where there are any."""
    own = {u: inputs[u] for u in inputs_of(system) if u in inputs}
    return {"inputs": own} if own else {}


def scored(
    filters: Mapping[str, Any], data: Any, measured: Any, components: int | None, window: Any,
    bound: float, consistency: bool, periods: Any, first: int, stream: np.random.SeedSequence,
    inputs: Mapping[Any, np.ndarray],
) -> Tally:  # fmt: skip
    """Run the filters on the paths of a block, and add up their errors; see `compare`.

    `first` is the number of the first time at which anything is measured.
    """
    errors, normalised, seconds, wrong, told = [], [], [], [], []
    truth = np.isfinite(data.states).all(axis=(0, 1))
    truth &= ~np.isinf(data.measurements).any(axis=(0, 1))
    if not truth.all():  # what is shown on a path that left the range of numbers is not scored
        mask = np.asarray(measured).reshape(len(measured), -1)[:, : data.measurements.shape[1]]
        data.measurements[..., ~truth] = np.where(mask, 0.0, np.nan)[..., None]
    rows = measured if measured.ndim == 1 else measured.any(axis=1)
    shown = rows & (np.arange(len(rows)) >= first)
    astray = []
    for number, each in enumerate(filters.values()):
        wants = _wanted(each, data, child(stream, FILTERS, number), consistency)
        own = own_inputs(inputs, getattr(each, "system", None))
        wants |= own
        begin = time.perf_counter()
        found = each.run(data.times, data.measurements, **wants)
        seconds.append(time.perf_counter() - begin)
        n = min(found.mean.shape[1], data.states.shape[1])
        if data.modes is not None:
            unknown = np.full(data.modes.shape, np.nan)
            wrong.append(unknown if found.modes is None else found.modes != data.modes)
        error = found.mean[:, :n] - data.states[:, :n]
        errors.append(error)
        with np.errstate(invalid="ignore"):
            wrapped(np.moveaxis(error, 1, 0), tuple(pair for pair in periods if pair[0] < n))
            lost = ~(np.abs(found.mean) <= min(bound, np.finfo(float).max)).all(axis=(0, 1))
        if found.diverged is not None:
            lost |= found.diverged
        astray.append(lost)
        normalised.append(None)
        if consistency:
            normalised[-1] = (
                None if found.cov is None else mahalanobis(error, found.cov[:, :n, :n]),
                _innovations(each, data, rows, Course(own.get("inputs", {}))),
                None if found.cov is None else (_covered(found, error), 1.0),
            )
            told.append(_log_density(found, shown, len(truth)))
    count = min(e.shape[1] for e in errors)
    if components is not None:
        if components > count:
            raise ValueError(f"components: wanted at most {count}, got {components}")
        count = components
    error = np.stack([e[:, :count] for e in errors])
    astray = np.array(astray)
    good = truth & ~astray.any(axis=0)
    steps = int(rows.sum()) * len(truth)
    more = {}
    if wrong:
        more["mode"] = np.array(wrong, dtype=float), window
    if consistency:
        more["log_score"] = np.array(told), window & shown
    return tally(
        error, good, truth, astray, normalised, np.array(seconds), steps, more=more, window=window
    )


def _log_density(found, rows, count):
    """Logarithms of the predicted densities (J, N) where there is something to predict."""
    if found.loglik is None:
        return np.full((len(rows), count), np.nan)
    told = np.broadcast_to(found.loglik.reshape(len(rows), -1), (len(rows), count))
    return np.where(rows[:, None] & np.isfinite(told), told, np.nan)


def _covered(found, error):
    """Whether the truth lies in the interval (J, n, N); NaN where there is none."""
    with np.errstate(invalid="ignore"):
        width = (found.interval()[1] - found.mean)[:, : error.shape[1]]
        return np.where(np.isnan(width), np.nan, np.abs(error) <= width)


def _wanted(filter, data, stream, consistency):
    """What the run of a filter takes beside times and measurements."""
    shown = getattr(getattr(filter, "system", None), "indicators", True)
    given = {
        "indicators": data.indicators if shown else None, "modes": data.modes, "seed": stream,
        "covariances": consistency or None,
    }  # fmt: skip
    takes = getattr(filter, "takes", ())
    return {name: part for name, part in given.items() if part is not None and name in takes}


def _innovations(filter, data, rows, held):
    """Normalised squared innovations (J, N) of a filter that says what it expects to measure, and
    how many components were measured.
    """
    if not hasattr(filter, "expect"):
        return None
    y, gaps = data.measurements, np.isnan(data.measurements)
    periods = getattr(getattr(getattr(filter, "system", None), "sensor", None), "period", ())
    squares = np.full((len(y), y.shape[2]), np.nan)
    state = filter.initial(y.shape[2:])
    stops = np.ones(len(y), dtype=bool)
    if getattr(filter, "times", None) is not None:  # it stands at its own times only
        stops = filter.placed(data.times, y) >= 0 if hasattr(filter, "placed") else rows
    last = 0
    for j, t in enumerate(data.times):
        if not stops[j]:
            continue
        with held.at(last):
            state = filter.predict(state, t)
        with held.at(j):
            if rows[j]:
                expected = filter.expect(state)
                error = nearest(y[j], expected.mean, periods) - expected.mean
                squares[j] = innovation_squares(error, gaps[j], expected.cov)
            state = filter.correct(state, y[j])
        last = j
    return squares, np.count_nonzero(~gaps, axis=1)
