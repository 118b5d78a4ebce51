"""Accuracy of filters on simulated paths: errors with standard errors, paired differences,
consistency, diverged paths, time per step.

All filters see the same paths. The streams of the paths lie at another depth of the seed than
those of a design, so they are other paths even where the seeds are equal: figures from here are
out of sample, those of `FiniteOrderFilter.predicted` are in-sample.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import child, in_blocks
from seedslib.base.checks import as_count, as_times
from seedslib.base.clock import Clock
from seedslib.base.values import Course, Inputs, as_course
from seedslib.evaluation.consistency import bounds, mahalanobis
from seedslib.evaluation.results import Comparison, Evaluation, roots
from seedslib.evaluation.tally import merged, tally
from seedslib.models.kinds import KINDS, AnySystem, as_system, inputs_of
from seedslib.models.simulation import as_measured

FILTERS = 0x46494C54
"""Key of the filters' own streams among the children of a block's: no block of paths has it."""

BLOCK = 2048
"""Paths in a block of an evaluation, where whole trajectories of all filters are held."""


def evaluate(
    filter: Any, system: AnySystem, times: ArrayLike, paths: Count, seed: Seed, **options: Any
) -> Evaluation:
    """Accuracy of one filter; arguments as `compare`."""
    return compare({"filter": filter}, system, times, paths, seed, **options)["filter"]


def compare(
    filters: Mapping[str, Any], system: AnySystem, times: ArrayLike, paths: Count, seed: Seed, *,
    measured: ArrayLike | None = None, components: int | None = None, window: Any = None,
    bound: Any = np.inf, consistency: bool = False, inputs: Inputs | None = None,
    workers: int = 1, **options: Any,
) -> Comparison:  # fmt: skip
    """Accuracy of several filters on the same simulated paths.

    Parameters
    ----------
    filters : mapping of str to filter
        Anything with ``run(times, measurements) -> Estimates``. What a run is given beside is in
        its `takes`: names of ``"indicators"``, ``"modes"``, ``"seed"`` and ``"covariances"``.
    system : object
        With ``simulate``; the truth.
    times : array_like, shape (J,)
        Times at which errors are scored; at a measurement time after the correction.
    paths : int
    seed : int, SeedSequence or Generator
    measured : array_like, optional
        Mask or indices of the measurement times. By default those of the designed filters among
        `filters`, and all times where there are none.
    components : int, optional
        Score the first components only; by default those that all filters estimate.
    window : slice, mask of shape (J,), or (first, last), optional
        Times over which averages are taken, all by default; of a pair of numbers of times the
        last is included, None standing for the end.
    bound : float
        A path on which an estimate is beyond it in any component counts as diverged.
    consistency : bool
        Whether `nees` and `nis` are wanted. At each time they are means over the paths on which
        there is something to compare: not, for a designed filter, after a missing measurement.
    inputs : mapping of Input to array_like, shape (J,) or (J, paths), optional
        Values of the inputs that the truth and the filters' models mention.
    workers : int
        Threads over blocks of paths; errors do not depend on it, the time per step does.
    **options
        For ``system.simulate``, such as `step` and `scheme`.

    Returns
    -------
    Comparison

    Raises
    ------
    TypeError, ValueError
        No filters, arguments that do not fit, or fewer than two paths without divergence.

    Warns
    -----
    UserWarning
        Consistency was wanted and is known at a time on some of the paths only.

    Notes
    -----
    Standard errors come from the squared errors of single paths, which are independent; that of
    a root-mean-square is the one of the mean square divided by twice the root. A filter that
    takes a seed has a stream of its own in every block of 2048 paths, by its place among
    the filters: the paths are common, the random numbers of two filters are not.
    """
    if not isinstance(filters, Mapping) or not filters:
        raise TypeError("filters: wanted a mapping of names to filters with at least one entry")
    for name, each in filters.items():
        if not hasattr(each, "run"):
            raise TypeError(
                f"{name}: wanted a filter with run(times, measurements), got a "
                f"{type(each).__name__}; filters come before the system"
            )
    as_system("system", system, *KINDS, "DelaySystem", "PiecewiseLinearSystem")
    times, paths = as_times("times", times), as_count("paths", paths)
    measured = as_measured(_measured(filters, times) if measured is None else measured, len(times))
    if components is not None:
        components = as_count("components", components)
    window = _window(window, len(times))
    mentioned = [inputs_of(getattr(f, "system", None)) for f in filters.values()]
    known = inputs_of(system).union(*mentioned)
    course = as_course(inputs, known, len(times), (paths,))

    def work(start, stop, stream):
        told = course.of(slice(start, stop)).values
        own = {"inputs": _told(told, system)} if told else {}
        data = system.simulate(times, stop - start, stream, measured=measured, **own, **options)
        return _block(filters, data, measured, components, window, bound, consistency, stream, told)

    return _summed(
        filters, times, paths, in_blocks(work, paths, seed, workers=workers, block=BLOCK)
    )


def _measured(filters, times):
    """Mask of the measurement times of the designed filters; None where there are none."""
    wanted = [f.times for f in filters.values() if getattr(f, "times", None) is not None]
    if not wanted:
        return None
    mask = np.zeros(len(times), dtype=bool)
    for known in wanted:
        rows = Clock(known).rows(times)
        mask[rows[rows >= 0]] = True
    return mask


def _window(given, count):
    """Mask (J,) of the times that averages are taken over."""
    if isinstance(given, tuple) and len(given) == 2:
        last = given[1]
        given = slice(given[0], None if last is None or last == -1 else last + 1)
    if isinstance(given, slice):
        given = np.arange(count)[given]
    mask = as_measured(given, count, "window")
    if not mask.any():
        raise ValueError(f"window: wanted at least one of {count} times, got none")
    return mask


def _told(inputs, system):
    """Those inputs that a system mentions."""
    return {u: inputs[u] for u in inputs_of(system) if u in inputs}


def _block(filters, data, measured, components, window, bound, consistency, stream, told):
    errors, normalised, seconds, wrong = [], [], [], []
    truth = np.isfinite(data.states).all(axis=(0, 1))
    truth &= ~np.isinf(data.measurements).any(axis=(0, 1))
    if not truth.all():  # what is shown on a path that left the range of numbers is not scored
        data.measurements[np.ix_(measured, np.ones(data.measurements.shape[1], bool), ~truth)] = 0.0
    astray = []
    for number, each in enumerate(filters.values()):
        wants = _wanted(each, data, child(stream, FILTERS, number), consistency)
        own = _told(told, getattr(each, "system", None)) if told else {}
        wants |= {"inputs": own} if own else {}
        begin = time.perf_counter()
        found = each.run(data.times, data.measurements, **wants)
        seconds.append(time.perf_counter() - begin)
        n = found.mean.shape[1]
        if data.modes is not None:
            unknown = np.full(data.modes.shape, np.nan)
            wrong.append(unknown if found.modes is None else found.modes != data.modes)
        errors.append(found.mean - data.states[:, :n])
        with np.errstate(invalid="ignore"):
            lost = ~(np.abs(found.mean) <= min(bound, np.finfo(float).max)).all(axis=(0, 1))
        if found.diverged is not None:
            lost |= found.diverged
        astray.append(lost)
        normalised.append(None)
        if consistency:
            squares = mahalanobis(errors[-1], found.cov)
            normalised[-1] = squares, _innovations(each, data, measured, own)
    count = min(e.shape[1] for e in errors)
    if components is not None:
        if components > count:
            raise ValueError(f"components: wanted at most {count}, got {components}")
        count = components
    error = np.stack([e[:, :count] for e in errors])
    astray = np.array(astray)
    good = truth & ~astray.any(axis=0)
    steps = int(measured.sum()) * len(truth)
    extra = np.array(wrong, dtype=float) if wrong else None
    return tally(
        error, good, truth, astray, normalised, np.array(seconds), steps, wrong=extra, window=window
    )


def _wanted(filter, data, stream, consistency):
    """What the run of a filter takes beside times and measurements."""
    shown = getattr(getattr(filter, "system", None), "indicators", True)
    given = {
        "indicators": data.indicators if shown else None, "modes": data.modes, "seed": stream,
        "covariances": consistency or None,
    }  # fmt: skip
    takes = getattr(filter, "takes", ())
    return {name: part for name, part in given.items() if part is not None and name in takes}


def _innovations(filter, data, measured, inputs):
    """Normalised squared innovations (J, N) of a filter that says what it expects to measure."""
    if not hasattr(filter, "expect"):
        return None
    y = data.measurements
    result = np.full((len(y), y.shape[2]), np.nan)
    state, held, last = filter.initial(y.shape[2:]), Course(inputs), 0
    for j in np.flatnonzero(measured):
        with held.at(last):
            state = filter.predict(state, data.times[j])
        with held.at(j):
            expected = filter.expect(state)
            result[j] = mahalanobis((y[j] - expected.mean)[None], expected.cov[None])[0][0]
            state = filter.correct(state, y[j])
        last = j
    return result, y.shape[1]


def _summed(filters, times, paths, tallies) -> Comparison:
    total = reduce(merged, tallies)
    if total.count < 2:
        raise ValueError(f"paths: wanted at least 2 without divergence, got {total.count}")
    count = total.count
    cov = total.products / count
    evaluations = {}
    components = total.error.shape[2]
    for f, name in enumerate(filters):
        rms, slope = roots(total.mean[f, :, : components + 1])
        spread = np.sqrt(cov[f, f] / count)
        error = slope * spread[:, : components + 1]
        bias = total.error[f] / count
        variance = total.mean[f, :-1, :components] - bias**2
        decides = ()
        if total.mean.shape[2] > components + 1 and np.isfinite(total.mean[f, -1, -1]):
            share, width = total.mean[f, :, -1], spread[:, -1]
            decides = share[:-1], width[:-1], float(share[-1]), float(width[-1])
        nees, nees_bounds = _consistency(total.normalised[f], 0, name, "nees", count)
        nis, nis_bounds = _consistency(total.normalised[f], 1, name, "nis", count)
        evaluations[name] = Evaluation(
            times, rms[:-1, :-1], error[:-1, :-1],
            np.sqrt(total.everything[f] / total.simulated),
            bias, np.sqrt(np.maximum(variance, 0.0) / count),
            rms[-1, :-1], error[-1, :-1],
            paths, count, int(total.diverged[f]),
            nees, nis, nees_bounds, nis_bounds,
            float(total.seconds[f] / total.steps) if total.steps else np.nan,
            rms[:-1, -1], error[:-1, -1], float(rms[-1, -1]), float(error[-1, -1]), *decides,
        )  # fmt: skip
    return Comparison(evaluations, total.mean, cov, count)


def _consistency(pair, which, name, what, paths):
    """Means over the paths with a covariance, and bounds for the least number of them."""
    if pair is None or pair[which] is None:
        return None, None
    sums, count, freedom = pair[which]
    known = count > 0
    least = int(count[known].min()) if known.any() else paths
    if least < paths:
        warnings.warn(
            f"consistency: {what} of {name!r} is known on {least} of {paths} paths only at some "
            "times, since measurements are missing; it is the mean over those",
            stacklevel=4,
        )
    mean = np.divide(sums, count, out=np.full(len(sums), np.nan), where=known)
    return mean, bounds(freedom, least)
