"""Accuracy of filters on simulated paths: errors with standard errors, paired differences,
consistency, diverged paths, time per step.

All filters see the same paths. The streams of the paths lie at another depth of the seed than
those of a design, so they are other paths even where the seeds are equal: figures from here are
out of sample, those of `FiniteOrderFilter.predicted` are in-sample.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import FILTERS, child, in_blocks
from seedslib.base.checks import as_count, as_times
from seedslib.base.circle import Periods, nearest, wrapped
from seedslib.base.clock import Clock
from seedslib.base.values import Inputs, InputTrajectory, input_values
from seedslib.evaluation.consistency import error_squares, innovation_squares
from seedslib.evaluation.results import Comparison, Evaluation, named, roots
from seedslib.models.kinds import KINDS, AnySystem, as_system, inputs_of
from seedslib.models.simulation import as_measured

RATIOS = "nees_ratio", "nis_ratio", "average_coverage"
"""Sums over paths and times that are divided by what they are expected to be."""

BLOCK = 2048
"""Paths in a block of an evaluation: the trajectories of all filters on them are in memory."""


def evaluate(
    filter: Any, system: AnySystem, times: ArrayLike, paths: Count, seed: Seed, **options: Any
) -> Evaluation:
    """Accuracy of one filter; arguments as `compare`."""
    return compare({"filter": filter}, system, times, paths, seed, **options)["filter"]


def compare(
    filters: Mapping[str, Any],
    system: AnySystem,
    times: ArrayLike,
    paths: Count,
    seed: Seed,
    *,
    measured: ArrayLike | None = None,
    components: int | None = None,
    window: Any = None,
    bound: Any = np.inf,
    consistency: bool = False,
    inputs: Inputs | None = None,
    workers: int = 1,
    **options: Any,
) -> Comparison:
    """Accuracy of several filters on the same simulated paths.

    Parameters
    ----------
    filters : mapping of str to filter
        Anything with ``run(times, measurements) -> Estimates``. What a run is given beside is in
        its `takes`: names of ``"indicators"``, ``"modes"``, ``"seed"`` and ``"covariances"``.
    system : object
        With ``simulate``; the truth. Each filter has a model of its own, which need not be this
        one: a state of another size is compared on the components that both have. Errors of
        components whose dynamics have a period are differences on the circle.
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
        Whether `nees_ratio`, `nis_ratio` and coverage are wanted. They are over the paths and times
        at which there is something to compare: not, for a designed filter, after a missing
        measurement.
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
    as_system("system", system, *KINDS, "PiecewiseLinearSystem")
    times, paths = as_times("times", times), as_count("paths", paths)
    measured = _measured(filters, times) if measured is None else measured
    mask = np.asarray(measured) if np.ndim(measured) == 2 else as_measured(measured, len(times))
    if components is not None:
        components = as_count("components", components)
    observed = mask if mask.ndim == 1 else mask.any(axis=1)
    window = _window(window, len(times))
    scoring = _Scoring(filters, mask, observed, window, components, bound, consistency, system)
    models = [system, *(getattr(f, "system", None) for f in filters.values())]
    known = frozenset().union(*map(inputs_of, models))
    bound = set().union(*(getattr(m, "numbers", ()) for m in models))
    trajectory = InputTrajectory(input_values(inputs, known, bound, len(times), (paths,)))

    def work(start, stop, stream):
        own = trajectory.of(slice(start, stop)).values
        given = _inputs_for(system, own)
        data = system.simulate(times, stop - start, stream, measured=mask, **given, **options)
        return scoring.sums(data, own, stream)

    blocks = in_blocks(work, paths, seed, workers=workers, block=BLOCK, what="compare")
    return _comparison(filters, times, paths, int(observed.sum()), reduce(_merged, blocks))


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


def _periods(system) -> Periods:
    """Circular components of the state of the truth."""
    maps = getattr(system, "dynamics", ())
    maps = maps if isinstance(maps, tuple) else (maps,)
    return tuple({pair for each in maps for pair in getattr(each, "period", ())})


def _inputs_for(system, inputs):
    """Those inputs that a system mentions, as an option where there are any."""
    own = {u: inputs[u] for u in inputs_of(system) if u in inputs}
    return {"inputs": own} if own else {}


class _Sums(NamedTuple):
    """Sums over the paths of a block; F filters, J times and their average, C numbers of a path:
    squared errors of the components, their sum, and whether a mode was wrong.
    """

    count: int  # paths on which neither the truth nor any filter diverged
    mean: np.ndarray  # (F, J + 1, C)
    products: np.ndarray  # (F, F, J + 1, C), centred
    plain: dict[Any, np.ndarray]  # what is added up as it is, by name


def _merged(a: _Sums, b: _Sums) -> _Sums:
    """Sums of two sets of blocks (Chan's update of means and products)."""
    share = b.count / max(a.count + b.count, 1)
    shift = b.mean - a.mean
    products = a.products + b.products + a.count * share * shift[:, None] * shift[None, :]
    plain = {name: a.plain[name] + b.plain[name] for name in a.plain}
    return _Sums(a.count + b.count, a.mean + share * shift, products, plain)


@dataclass(frozen=True)
class _Scoring:
    """Filters compared with the truth on one block of paths after the other; see `compare`."""

    filters: Mapping[str, Any]
    mask: np.ndarray
    observed: np.ndarray  # times (J,) of measurements
    window: np.ndarray
    components: int | None
    bound: float
    consistency: bool
    system: Any

    def sums(self, data, inputs, stream) -> _Sums:
        truth = np.isfinite(data.states).all(axis=(0, 1))
        truth &= ~np.isinf(data.measurements).any(axis=(0, 1))
        if not truth.all():  # measurements of a path that left the range of numbers are replaced
            mask = self.mask.reshape(len(self.mask), -1)[:, : data.measurements.shape[1]]
            data.measurements[..., ~truth] = np.where(mask, 0.0, np.nan)[..., None]
        runs = [
            self._run(each, data, inputs, child(stream, FILTERS, number))
            for number, each in enumerate(self.filters.values())
        ]
        size = min(run["error"].shape[1] for run in runs)
        if self.components is not None:
            if self.components > size:
                raise ValueError(f"components: wanted at most {size}, got {self.components}")
            size = self.components
        diverged = np.array([run["diverged"] for run in runs])
        good = truth & ~diverged.any(axis=0)
        error = np.stack([run["error"][:, :size, good] for run in runs])
        switches = data.modes is not None
        squares = np.empty((len(runs), len(self.window) + 1, size + 1 + switches, good.sum()))
        np.square(error, out=squares[:, :-1, :size])
        squares[:, :-1, size] = squares[:, :-1, :size].sum(axis=2)
        if switches:
            squares[:, :-1, -1] = [run["wrong"][:, good] for run in runs]
        squares[:, -1] = squares[:, :-1][:, self.window].mean(axis=1)
        count = int(good.sum())
        mean = squares.sum(axis=-1) / max(count, 1)
        squares -= mean[..., None]
        products = np.empty((len(mean), *mean.shape))
        for a, b in zip(*np.tril_indices(len(mean)), strict=True):
            products[a, b] = products[b, a] = np.einsum("jcN,jcN->jc", squares[a], squares[b])
        plain = {
            "bias": error.sum(axis=-1),
            "diverged": (diverged & truth).sum(axis=1),
            "seconds": np.array([run["seconds"] for run in runs]),
        }
        for f, run in enumerate(runs):
            for name in RATIOS:
                if run.get(name) is not None:
                    plain[f, name] = self._ratio_sums(*run[name], good, size)
        return _Sums(count, mean, products, plain)

    def _run(self, filter, data, inputs, stream) -> dict[str, Any]:
        """Errors of a filter on the paths (J, n, N), and what else is known of them by name."""
        given = _inputs_for(getattr(filter, "system", None), inputs)
        options = self._options(filter, data, stream) | given
        begin = time.perf_counter()
        estimates = filter.run(data.times, data.measurements, **options)
        run: dict[str, Any] = {"seconds": time.perf_counter() - begin}
        n = min(estimates.mean.shape[1], data.states.shape[1])
        run["error"] = error = estimates.mean[:, :n] - data.states[:, :n]
        with np.errstate(invalid="ignore"):
            periods = tuple(pair for pair in _periods(self.system) if pair[0] < n)
            wrapped(np.moveaxis(error, 1, 0), periods)
            inside = np.abs(estimates.mean) <= min(self.bound, np.finfo(float).max)
        run["diverged"] = ~inside.all(axis=(0, 1))
        if estimates.diverged is not None:
            run["diverged"] = run["diverged"] | estimates.diverged
        if data.modes is not None:
            unknown = np.full(data.modes.shape, np.nan)
            run["wrong"] = unknown if estimates.modes is None else estimates.modes != data.modes
        if self.consistency:
            run["nis_ratio"] = self._innovations(filter, data, given.get("inputs", {}))
            if estimates.cov is not None:
                run["nees_ratio"] = error_squares(error, estimates.cov[:, :n, :n]), n
                with np.errstate(invalid="ignore"):
                    width = (estimates.interval()[1] - estimates.mean)[:, :n]
                    covered = np.where(np.isnan(width), np.nan, np.abs(error) <= width)
                run["average_coverage"] = covered, 1.0
        return run

    def _options(self, filter, data, stream):
        """What the run of a filter takes beside times and measurements."""
        indicators = getattr(getattr(filter, "system", None), "indicators", True)
        options = {
            "indicators": data.indicators if indicators else None,
            "modes": data.modes,
            "seed": stream,
            "covariances": self.consistency or None,
        }
        takes = getattr(filter, "takes", ())
        return {k: value for k, value in options.items() if value is not None and k in takes}

    def _innovations(self, filter, data, inputs):
        """Normalised squared innovations (J, N) of a filter that says what it expects to measure,
        and how many components were measured.
        """
        if not hasattr(filter, "expect"):
            return None
        y, gaps = data.measurements, np.isnan(data.measurements)
        trajectory = InputTrajectory(inputs)
        periods = getattr(getattr(getattr(filter, "system", None), "sensor", None), "period", ())
        squares = np.full((len(y), y.shape[2]), np.nan)
        state = filter.initial(y.shape[2:])
        # a designed filter stands at its own times only, measured or not
        rows = np.arange(len(y))
        if hasattr(filter, "numbered"):
            rows = np.flatnonzero(filter.numbered(data.times, y) >= 0)
        last = 0
        for j in rows:
            state = filter.predict(state, data.times[j], inputs=trajectory.at(last))
            now = trajectory.at(j)
            if self.observed[j]:
                expected = filter.expect(state, now)
                error = nearest(y[j], expected.mean, periods) - expected.mean
                squares[j] = innovation_squares(error, gaps[j], expected.cov)
            state = filter.correct(state, y[j], inputs=now)
            last = j
        return squares, np.count_nonzero(~gaps, axis=1)

    def _ratio_sums(self, values, expected, good, size):
        """Sums over the good paths of A, B, A^2, A B and B^2 (5, ...): A is the sum of a path's
        values (J, ..., N) over the window, without those that are NaN, B what it is expected to be.
        """
        values = values[:, :size] if values.ndim == 3 else values
        known = ~np.isnan(values)
        a, b = np.where(known, values, 0.0), np.where(known, expected, 0.0)
        A, B = (part[self.window].sum(axis=0)[..., good] for part in (a, b))
        return np.stack([A, B, A * A, A * B, B * B]).sum(axis=-1)


def _comparison(filters, times, paths, rows, sums) -> Comparison:
    """Means, standard errors and paired covariances from the sums of all blocks."""
    count, plain = sums.count, sums.plain
    if count < 2:
        raise ValueError(f"paths: wanted at least 2 without divergence, got {count}")
    cov = sums.products / count / count
    size = plain["bias"].shape[2]
    evaluations = {}
    for f, name in enumerate(filters):
        mean, error = sums.mean[f], np.sqrt(cov[f, f])
        rms, slope = roots(mean[:, : size + 1])
        rms_error = slope * error[:, : size + 1]
        bias = plain["bias"][f] / count
        scores = named("total", rms[:, size], rms_error[:, size])
        if mean.shape[1] > size + 1:
            scores |= named("mode_error", mean[:, -1], error[:, -1])
        for ratio in RATIOS:
            if (f, ratio) in plain:
                scores[ratio], scores[f"{ratio}_error"] = _ratio(*plain[f, ratio])
        evaluations[name] = Evaluation(
            times=times,
            paths=paths,
            scored=count,
            diverged=int(plain["diverged"][f]),
            seconds_per_step=float(plain["seconds"][f] / (rows * paths)) if rows else np.nan,
            rms=rms[:-1, :size],
            rms_error=rms_error[:-1, :size],
            average=rms[-1, :size],
            average_error=rms_error[-1, :size],
            bias=bias,
            bias_error=np.sqrt(np.maximum(mean[:-1, :size] - bias**2, 0.0) / count),
            **scores,
        )
    return Comparison(evaluations, sums.mean, cov, size)


def _ratio(a, b, aa, ab, bb):
    """Ratio of sums over paths, and its standard error, that of a ratio of means (to first order):
    errors at different times of a path depend on each other, those of different paths do not.
    """
    b = np.where(b > 0, b, np.nan)
    ratio = a / b
    return ratio, np.sqrt(np.maximum(aa - 2 * ratio * ab + ratio**2 * bb, 0.0)) / b
