"""Accuracy of filters on simulated paths: errors with standard errors, paired differences,
consistency, diverged paths, time per step.

All filters see the same paths. The streams of the paths lie at another depth of the seed than
those of a design, so they are other paths even where the seeds are equal: figures from here are
out of sample, those of `FiniteOrderFilter.predicted` are in-sample.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from seedslib._validate import as_times
from seedslib.evaluation.consistency import bounds, mahalanobis
from seedslib.evaluation.tally import merged, tally
from seedslib.systems.simulation import as_count, as_measured, in_blocks

BLOCK = 2048
"""Paths in a block of an evaluation, where whole trajectories of all filters are held."""


class Evaluation(NamedTuple):
    """Accuracy of one filter; J times, c components.

    Attributes
    ----------
    times : ndarray, shape (J,)
    rms, rms_error : ndarray, shape (J, c)
        Root-mean-square error and its standard error, without the paths that diverged.
    rms_all : ndarray, shape (J, c)
        With them: infinite or absurd where the filter was. Paths whose truth left the range of
        numbers are in neither.
    bias, bias_error : ndarray, shape (J, c)
        Mean of the estimate minus the state, and its standard error.
    average, average_error : ndarray, shape (c,)
        Root of the mean square over paths and times, and its standard error.
    paths, scored : int
        Simulated paths, and those that are scored: neither the path itself nor any filter in the
        comparison diverged.
    diverged : int
        Paths on which this filter diverged: not finite, or beyond the bound.
    nees, nis : ndarray, shape (J,), or None
        Mean normalised squares of the estimation error and of the innovation, NaN where the
        filter claims no covariance. For a consistent filter their means are the numbers of
        components.
    nees_bounds, nis_bounds : tuple of float, or None
        Where such means lie with probability 0.95 if errors are Gaussian and consistent.
    seconds_per_step : float
        Time of the filter for one measurement of one path, in the batch that was run.
    """

    times: np.ndarray
    rms: np.ndarray
    rms_error: np.ndarray
    rms_all: np.ndarray
    bias: np.ndarray
    bias_error: np.ndarray
    average: np.ndarray
    average_error: np.ndarray
    paths: int
    scored: int
    diverged: int
    nees: np.ndarray | None
    nis: np.ndarray | None
    nees_bounds: tuple | None
    nis_bounds: tuple | None
    seconds_per_step: float


class Difference(NamedTuple):
    """Root-mean-square error of one filter minus that of another on the same paths.

    Attributes
    ----------
    rms, error : ndarray, shape (J, c)
        Difference and its standard error.
    average, average_error : ndarray, shape (c,)
        The same of the averages over time.
    """

    rms: np.ndarray
    error: np.ndarray
    average: np.ndarray
    average_error: np.ndarray


class Comparison(Mapping):
    """Evaluations by name, and paired differences; read like a mapping."""

    def __init__(self, evaluations, squares, cov, scored):
        self._evaluations = evaluations
        self._squares, self._cov, self._scored = squares, cov, scored

    def __getitem__(self, name) -> Evaluation:
        return self._evaluations[name]

    def __iter__(self):
        return iter(self._evaluations)

    def __len__(self):
        return len(self._evaluations)

    def difference(self, first: str, second: str) -> Difference:
        """RMS error of `first` minus that of `second`, with the error of a paired comparison."""
        names = list(self)
        a, b = names.index(first), names.index(second)
        rms = np.sqrt(self._squares[[a, b]])
        slope = np.divide(0.5, rms, out=np.zeros_like(rms), where=rms > 0)
        variance = (
            slope[0] ** 2 * self._cov[a, a]
            + slope[1] ** 2 * self._cov[b, b]
            - 2 * slope[0] * slope[1] * self._cov[a, b]
        )
        error = np.sqrt(np.maximum(variance, 0.0) / self._scored)
        apart = rms[0] - rms[1]
        return Difference(apart[:-1], error[:-1], apart[-1], error[-1])

    def __str__(self) -> str:
        width = max(map(len, self))
        lines = [f"{'filter':{width}}  time-averaged RMS error by component"]
        for name, found in self.items():
            row = "  ".join(
                f"{a:.4f} ± {e:.4f}"
                for a, e in zip(found.average, found.average_error, strict=True)
            )
            lost = f"  {found.diverged} of {found.paths} paths diverged" if found.diverged else ""
            lines.append(f"{name:{width}}  {row}{lost}")
        return "\n".join(lines)


def evaluate(filter, system, times, paths, seed, **options) -> Evaluation:
    """Accuracy of one filter; arguments as `compare`."""
    return compare({"filter": filter}, system, times, paths, seed, **options)["filter"]


def compare(
    filters, system, times, paths, seed, *, measured=None, components=None, bound=np.inf,
    consistency=False, workers=1, **options,
) -> Comparison:  # fmt: skip
    """Accuracy of several filters on the same simulated paths.

    Parameters
    ----------
    filters : mapping of str to filter
        Anything with ``run(times, measurements) -> Estimates``.
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
    bound : float
        A path on which an estimate is beyond it in any component counts as diverged.
    consistency : bool
        Whether `nees` and `nis` are wanted.
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

    Notes
    -----
    Standard errors come from the squared errors of single paths, which are independent; that of
    a root-mean-square is the one of the mean square divided by twice the root.
    """
    if not isinstance(filters, Mapping) or not filters:
        raise TypeError("filters: wanted a mapping of names to filters with at least one entry")
    times, paths = as_times("times", times), as_count("paths", paths)
    measured = as_measured(_measured(filters, times) if measured is None else measured, len(times))
    if components is not None:
        components = as_count("components", components)

    def work(start, stop, stream):
        data = system.simulate(times, stop - start, stream, measured=measured, **options)
        return _block(filters, data, measured, components, bound, consistency)

    return _summed(
        filters, times, paths, in_blocks(work, paths, seed, workers=workers, block=BLOCK)
    )


def _measured(filters, times):
    """Mask of the measurement times of the designed filters; None where there are none."""
    wanted = [f.times for f in filters.values() if hasattr(f, "times")]
    if not wanted:
        return None
    mask = np.zeros(len(times), dtype=bool)
    for t in np.concatenate(wanted):
        mask |= np.abs(times - t) <= 1e-9 * max(1.0, abs(t))
    return mask


def _block(filters, data, measured, components, bound, consistency):
    errors, normalised, seconds = [], [], []
    truth = np.isfinite(data.states).all(axis=(0, 1))
    truth &= ~np.isinf(data.measurements).any(axis=(0, 1))
    if not truth.all():  # no filter is asked about a path that left the range of numbers
        data.measurements[..., ~truth] = np.nan
    astray = []
    for each in filters.values():
        wants = {"covariances": True} if consistency and _takes(each, "covariances") else {}
        begin = time.perf_counter()
        found = each.run(data.times, data.measurements, **wants)
        seconds.append(time.perf_counter() - begin)
        n = found.mean.shape[1]
        errors.append(found.mean - data.states[:, :n])
        with np.errstate(invalid="ignore"):
            lost = ~(np.abs(found.mean) <= min(bound, np.finfo(float).max)).all(axis=(0, 1))
        if found.diverged is not None:
            lost |= found.diverged
        astray.append(lost)
        normalised.append(None)
        if consistency:
            squares = mahalanobis(errors[-1], found.cov)
            normalised[-1] = squares, _innovations(each, data, measured)
    count = min(e.shape[1] for e in errors)
    if components is not None:
        if components > count:
            raise ValueError(f"components: wanted at most {count}, got {components}")
        count = components
    error = np.stack([e[:, :count] for e in errors])
    astray = np.array(astray)
    good = truth & ~astray.any(axis=0)
    steps = int(measured.sum()) * len(truth)
    return tally(error, good, truth, astray, normalised, np.array(seconds), steps)


def _takes(filter, name):
    return name in inspect.signature(filter.run).parameters


def _innovations(filter, data, measured):
    """Normalised squared innovations (J, N) of a filter that says what it expects to measure."""
    if not hasattr(filter, "expect"):
        return None
    y = data.measurements
    result = np.full((len(y), y.shape[2]), np.nan)
    state = filter.initial(y.shape[2:])
    for j in np.flatnonzero(measured):
        state = filter.predict(state, data.times[j])
        expected = filter.expect(state)
        error = (y[j] - expected.mean)[None]
        cov = expected.cov[None]
        result[j] = mahalanobis(error, cov)[0][0]
        state = filter.correct(state, y[j])
    return result, y.shape[1]


def _summed(filters, times, paths, tallies) -> Comparison:
    total = None
    for part in tallies:
        total = part if total is None else merged(total, part)
    if total.count < 2:
        raise ValueError(f"paths: wanted at least 2 without divergence, got {total.count}")
    count = total.count
    cov = total.products / count
    evaluations = {}
    for f, name in enumerate(filters):
        rms = np.sqrt(total.mean[f])
        slope = np.divide(0.5, rms, out=np.zeros_like(rms), where=rms > 0)
        error = slope * np.sqrt(cov[f, f] / count)
        bias = total.error[f] / count
        spread = np.sqrt(np.maximum(total.mean[f, :-1] - bias**2, 0.0) / count)
        nees, nees_bounds = _consistency(total.normalised[f], 0)
        nis, nis_bounds = _consistency(total.normalised[f], 1)
        evaluations[name] = Evaluation(
            times=times,
            rms=rms[:-1],
            rms_error=error[:-1],
            rms_all=np.sqrt(total.everything[f] / total.simulated),
            bias=bias,
            bias_error=spread,
            average=rms[-1],
            average_error=error[-1],
            paths=paths,
            scored=count,
            diverged=int(total.diverged[f]),
            nees=nees,
            nis=nis,
            nees_bounds=nees_bounds,
            nis_bounds=nis_bounds,
            seconds_per_step=float(total.seconds[f] / total.steps) if total.steps else np.nan,
        )
    return Comparison(evaluations, total.mean, cov, count)


def _consistency(pair, which):
    if pair is None or pair[which] is None:
        return None, None
    sums, count, freedom = pair[which]
    return sums / count, bounds(freedom, count)
