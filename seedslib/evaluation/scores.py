"""Accuracy of filters on simulated paths: errors with standard errors, paired differences,
consistency, diverged paths, time per step.

All filters see the same paths. The streams of the paths lie at another depth of the seed than
those of a design, so they are other paths even where the seeds are equal: figures from here are
out of sample, those of `FiniteOrderFilter.predicted` are in-sample.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_count, as_times
from seedslib.base.clock import Clock
from seedslib.base.values import Inputs, as_course
from seedslib.evaluation.consistency import bounds, ratio_of_sums
from seedslib.evaluation.results import NOTHING, Comparison, Evaluation, quadruple, roots
from seedslib.evaluation.scoring import circular, own_inputs, scored
from seedslib.evaluation.tally import merged
from seedslib.models.kinds import KINDS, AnySystem, as_system, inputs_of, kind_of
from seedslib.models.simulation import as_measured

LATER = "DelaySystem", "PiecewiseLinearSystem"
"""Systems that measure nothing at the first time."""

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
    bound: Any = np.inf, consistency: bool = False, period: Mapping[int, float] | None = None,
    inputs: Inputs | None = None,
    workers: int = 1, **options: Any,
) -> Comparison:  # fmt: skip
    """Accuracy of several filters on the same simulated paths.

    Parameters
    ----------
    filters : mapping of str to filter
        Anything with ``run(times, measurements) -> Estimates``. What a run is given beside is in
        its `takes`: names of ``"indicators"``, ``"modes"``, ``"seed"`` and ``"covariances"``.
    system : object
        With ``simulate``; the truth. Each filter has a model of its own, which need not be this
        one: a state of another size is compared on the components that both have.
    times : array_like, shape (J,)
        Times at which errors are scored; at a measurement time after the correction.
    paths : int
    seed : int, SeedSequence or Generator
    measured : array_like, optional
        Mask (J,) or indices of the measurement times, or a mask (J, m) where sensors have
        schedules of their own; an indicator is the last component. By default the times of the
        designed filters among `filters`, and all times where there are none.
    components : int, optional
        Score the first components only; by default those that all filters estimate.
    window : slice, mask of shape (J,), or (first, last), optional
        Times over which averages are taken, all by default; of a pair of numbers of times the
        last is included, None standing for the end.
    bound : float
        A path on which an estimate is beyond it in any component counts as diverged.
    consistency : bool
        Whether `nees`, `nis`, coverage and log scores are wanted. At each time they are means
        over the paths on which there is something to compare: not, for a designed filter, after
        a missing measurement.
    period : mapping of int to float, optional
        State components that lie on a circle, and their periods: their errors are differences
        on the circle. Those of the dynamics of a `DiscreteSystem` are known.
    inputs : mapping of Input to array_like, shape (J,) or (J, paths), optional
        Values of the inputs that the truth and the filters' models mention.
    workers : int
        Threads over blocks of paths; errors do not depend on it, the time per step does.
    **options
        For ``system.simulate``, such as `step`, `scheme` and `availability`.

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
    measured = _measured(filters, times) if measured is None else measured
    if np.ndim(measured) == 2:
        measured = np.asarray(measured)
    else:
        measured = as_measured(measured, len(times))
    periods, first = circular(period, system), int(kind_of(system) in LATER)
    if components is not None:
        components = as_count("components", components)
    window = _window(window, len(times))
    known = inputs_of(system).union(
        *(inputs_of(getattr(f, "system", None)) for f in filters.values())
    )
    course = as_course(inputs, known, len(times), (paths,))

    def work(start, stop, stream):
        told = course.of(slice(start, stop)).values
        own = own_inputs(told, system)
        data = system.simulate(times, stop - start, stream, measured=measured, **own, **options)
        return scored(
            filters, data, measured, components, window, bound, consistency, periods, first, stream,
            told,
        )  # fmt: skip

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
        found = {
            name: quadruple(total.mean[f, :, k], spread[:, k])
            for k, name in enumerate(total.more, components + 1)
        }
        nees, nis, covers = total.normalised[f] or (None, None, None)
        nees = _consistency(nees, name, count)
        nis = _consistency(nis)
        evaluations[name] = Evaluation(
            times, rms[:-1, :-1], error[:-1, :-1],
            np.sqrt(total.everything[f] / total.simulated),
            bias, np.sqrt(np.maximum(variance, 0.0) / count),
            rms[-1, :-1], error[-1, :-1],
            paths, count, int(total.diverged[f]),
            nees[0], nis[0], nees[1], nis[1],
            float(total.seconds[f] / total.steps) if total.steps else np.nan,
            rms[:-1, -1], error[:-1, -1], float(rms[-1, -1]), float(error[-1, -1]),
            *found.get("mode", NOTHING), *nees[2:], *nis[2:], *_coverage(covers, components),
            *found.get("log_score", NOTHING),
        )  # fmt: skip
    return Comparison(evaluations, total.mean, cov, count, total.more)


def _consistency(known, name="", paths=0):
    """Means over the paths with a covariance, their bounds, and the ratio over the window.

    Where paths are named, it is told that there are fewer.
    """
    if known is None:
        return NOTHING
    least = known.counts[known.counts > 0].min(initial=paths)
    if least < paths:
        warnings.warn(
            f"consistency: nees of {name!r} is known on {least} of {paths} paths only at some "
            "times, since measurements are missing; it is the mean over those",
            stacklevel=4,
        )
    count = np.where(known.counts > 0, known.counts, np.nan)
    return (
        known.sums / count,
        bounds(known.expected / count, count),
        *map(float, ratio_of_sums(known)),
    )


def _coverage(known, components):
    """Shares of paths by time and over the window, with their errors."""
    if known is None:
        return NOTHING
    count = np.where(known.counts > 0, known.counts, np.nan)
    share = known.sums / count
    error = np.sqrt(share * (1.0 - share) / count)
    average = (part[:components] for part in ratio_of_sums(known))
    return share[:, :components], error[:, :components], *average
