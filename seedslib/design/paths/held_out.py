"""A finished design on paths that it has not seen: its errors there, and what they warn of."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from seedslib.base.blocks import BLOCK, child
from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.base.values import Course
from seedslib.design.paths.walk import LARGEST, Crew, Walk
from seedslib.design.regression import combine, root_mean_squares, scatter
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.prediction import HeldOut
from seedslib.models.kinds import switches

SHARE = 8
"""There is one held-out path for so many design paths,"""

LEAST = 512
"""but at least so many."""

STREAM = 0x48454C44
"""Key of the held-out paths among the children of the seed: no block of a design has it."""

DOUBT = 4.0
"""Standard errors that a single difference must have to be one."""

SOME = 0.02
"""A smaller part of an error than this is not worth a warning."""

OFTEN = 0.25
"""Some corrections may be worse than their forecasts: filters of the papers have such. More than
this part of them is worth a warning."""

CHANCE = 1e-3
"""So many stray paths are taken for chance where that is at least so likely."""

NOTHING = 1e-9
"""An error that is a smaller part of its state than this is rounding."""

TINY = np.finfo(float).tiny


def examined(
    filter: Any, root: np.random.SeedSequence, paths: int, each: Crew, stops: np.ndarray, *,
    options: Mapping[Any, Any] | None = None, bound: float = np.inf,
    forecasts: np.ndarray | None = None, course: Course | None = None,
) -> Any:  # fmt: skip
    """The filter with its errors on held-out paths, by its own `run`.

    Parameters
    ----------
    filter : FiniteOrderFilter, SwitchingFilter or TableFilter
        As it was designed, with the errors that it predicts.
    root : SeedSequence
        Of the design; the design paths do not depend on what is done here.
    paths : int
        Design paths.
    each : Crew
        Map over blocks.
    stops : ndarray
        Measurement times and nodes: the simulation is that of the design.
    options : mapping, optional
        Of ``system.simulate``.
    bound : float
        As in the design.
    forecasts : ndarray, shape (K+1, n'), optional
        Root-mean-square errors of the forecasts that are corrected, NaN where there is none.
    course : Course, optional
        Inputs at the measurement times.

    Warns
    -----
    UserWarning
        Errors that differ from the predicted ones; an estimate that is worse than the mean of
        the state, or than the forecast that it corrects; paths on which the filter diverged.
    """
    reach, course = _reach(filter, paths), Course() if course is None else course
    held, size, lost, stray = _errors(
        filter, root, paths, each, stops, options or {}, min(bound, LARGEST), reach, course
    )
    astray = lost or not _by_chance(stray, held.paths / paths)
    share = math.sqrt(paths / held.paths)
    for text in _findings(filter.predicted, held, size, share, forecasts, astray):
        warnings.warn(text, stacklevel=outside())
    return dataclasses.replace(filter, held_out=held)


def _reach(filter, paths):
    """Errors (K+1, n') that hardly one design would meet on as many paths as it was made on.

    With m the mean fourth power of an error on N design paths, an error beyond r has at most the
    probability m / r⁴ (Markov); r⁴ = N m C makes that 1 / (N C) for each of C errors of a path,
    and 1 / N for the path.
    """
    predicted = filter.predicted
    at = np.searchsorted(predicted.times, filter.times)
    square = predicted.rms[at] ** 2
    # the standard error of a root-mean-square is that of the mean square by twice the root
    fourth = square**2 + 4.0 * paths * square * predicted.error[at] ** 2
    return (paths * square.size * fourth) ** 0.25


def _by_chance(stray, expected):
    """Whether errors beyond the reach, in units of it, may be those of a design that holds.

    Markov's bound lets it meet at most `expected` of them beyond 1, and so beyond any other.
    """
    ratios = np.sort(stray)[::-1]
    return all(_tail(m, expected / r**4) >= CHANCE for m, r in enumerate(ratios, start=1))


def _tail(count, mean):
    """Probability that a Poisson number reaches a count."""
    below, term = 0.0, math.exp(-mean)
    for j in range(count):
        below += term
        term *= mean / (j + 1)
    return 1.0 - below


def _errors(filter, root, paths, each, stops, options, bound, reach, course):
    """What was found, root mean squares of the state (K+1, n'), lost paths, stray ones."""
    count = max(LEAST, -(-paths // SHARE))
    sizes = [min(BLOCK, count - a) for a in range(0, count, BLOCK)]
    jobs = list(zip(child(root, STREAM).spawn(len(sizes)), sizes, strict=True))
    at = np.searchsorted(stops, filter.times)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of the run: the design has said its own
        found = each(
            lambda one, job: _block(one, *job, stops, at, options, bound, reach, course),
            each.share(filter), jobs,
        )  # fmt: skip
        blocks, lost, stray = zip(*found, strict=True)
    switching = switches(filter.system)
    rows = [_moments(combine(parts), switching) for parts in zip(*blocks, strict=True)]
    rms, error, deviation, size, *mode = (np.array(part) for part in zip(*rows, strict=True))
    lost, stray = sum(lost), np.concatenate(stray)
    held = HeldOut(filter.times, rms, error, deviation, count, lost + len(stray), *mode)
    return held, size, lost, stray


def _paths(system, stream, count, stops, at, options, bound, course):
    """States, measurements, and which paths are still there, at the measurement times.

    A lost path goes on harmlessly: it is not scored, and must not show what is not finite.
    """
    walk = Walk(system, count, stream, len(stops), Crew(), options, bound)
    taken = []
    for j, t in enumerate(stops):
        if j == 0:
            walk.begin(t)
        else:
            with course.at(len(taken) - 1):
                walk.advance(stops[j - 1], t)
        if j in at:
            with course.at(len(taken)):
                (y,) = walk.measure(t)
            taken.append((*walk.states, y, *walk.alive))
    return [np.stack(part) for part in zip(*taken, strict=True)]


def _block(filter, stream, count, stops, at, options, bound, reach, course):
    """Moments of squared errors and states at each measurement; lost paths, stray ones.

    Of a stray path it is the largest error in units of the reach, where that is beyond 1.
    """
    with np.errstate(all="ignore"):
        system, schedule = filter.system, filter.schedule
        mixed = getattr(system, "hybrid", system)
        states, y, good = _paths(mixed, stream, count, stops, at, options, bound, course)
        for k, shown in enumerate(y):
            schedule.leave_out(k, shown, stream)
        told, modes = {"inputs": course.values or None}, None
        if mixed is not system:
            modes = states[:, -1].astype(int)
            if system.indicators:
                y, told["indicators"] = y[:, :-1], np.nan_to_num(y[:, -1], nan=-1.0).astype(int)
        found = filter.run(filter.times, y, **told)
        fine = (np.abs(found.mean) <= LARGEST).all(axis=1)
        kept = good & np.logical_and.accumulate(fine)
        n, parts = found.mean.shape[1], []
        lost, stray = (good & ~kept).any(axis=0), np.zeros(count)
        for k, here in enumerate(kept):
            x = states[k][:n, here]
            error = x - found.mean[k][:, here]
            rounding = NOTHING * np.sqrt(np.mean(x**2, axis=1, keepdims=True))
            ratio = np.abs(error) / np.maximum(np.maximum(reach[k][:, None], rounding), TINY)
            stray[here] = np.maximum(stray[here], ratio.max(axis=0))
            rows = [error**2, x]
            if modes is not None:
                rows.append((found.modes[k] != modes[k])[None, here])
            parts.append(scatter(np.concatenate(rows)))
    return parts, int(np.count_nonzero(lost)), stray[~lost & (stray > 1.0)]


def _moments(found, switching):
    """Root-mean-square errors and their standard errors, deviation and size of the state."""
    n = (len(found.mean) - switching) // 2
    if found.count < 2:
        none = np.full(n, np.nan)
        return (none,) * 4 + (np.nan,) * (2 * switching)
    rms, error, spread = root_mean_squares(found, n)
    deviation = spread[n : 2 * n]
    size = np.hypot(found.mean[n : 2 * n], deviation)
    mode = (found.mean[-1], spread[-1] / math.sqrt(found.count)) if switching else ()
    return rms, error, deviation, size, *mode


def _findings(predicted, held, size, share, forecasts, astray):
    """Sentences on what the held-out paths say against a design.

    `share` is the root of the number of design paths by that of held-out paths.
    """
    times, count = held.times, held.paths
    at = np.searchsorted(predicted.times, times)
    rms, error = predicted.rms[at], predicted.error[at]
    # the same chance of a false alarm whatever the number of comparisons
    doubt = math.sqrt(DOUBT**2 + 2.0 * math.log(rms.size))

    def worse(a, b, standard):
        with np.errstate(invalid="ignore"):
            apart = a - b
            return (apart > doubt * standard) & (apart > SOME * b) & (a > NOTHING * size)

    def said(bad, a, a_error, b):
        which = bad.any(axis=1)
        ratio = np.where(bad, a / np.where(b > 0, b, np.nan), -1.0)
        k, i = np.unravel_index(np.nanargmax(ratio), ratio.shape)
        which_ones = np.flatnonzero(bad.any(axis=0))
        components = "s" * (len(which_ones) > 1) + " " + ", ".join(map(str, which_ones))
        return (
            f"at {np.count_nonzero(which)} of {len(times)} times from {when(times[which][0])} to "
            f"{when(times[which][-1])} (component{components}), most of component {i} at time "
            f"{when(times[k])}: {a[k, i]:.4g} ± {a_error[k, i]:.2g} for {b[k, i]:.4g}"
        )

    # few paths that miss the large errors believe themselves too much
    both = np.hypot(error, np.maximum(held.error, share * error))
    bad = worse(held.rms, rms, both) | worse(rms, held.rms, both)
    if bad.any():
        yield (
            f"held out: root-mean-square errors on {count} other paths are not the predicted "
            f"ones {said(bad, held.rms, held.error, rms)}; take more design paths, or forecasts "
            "of a lower degree or a shorter memory"
        )
    constant = held.deviation
    bad = worse(held.rms, constant, np.hypot(held.error, constant / math.sqrt(2.0 * count)))
    if bad.any():
        yield (
            f"held out: the estimate is worse than the mean of the state, a constant, "
            f"{said(bad, held.rms, held.error, constant)}; take another linearization, or more "
            "design paths"
        )
    if forecasts is not None:
        bad = worse(rms, forecasts, np.hypot(error, forecasts / math.sqrt(2.0 * count)))
        if bad.any(axis=1).sum() > OFTEN * (len(times) - 1):
            yield (
                "correction: the estimate is worse than the forecast that it corrects, on the "
                f"design paths, {said(bad, rms, error, forecasts)}; take another linearization"
            )
    if held.mode_rate is not None:
        yield from _mode_findings(predicted, held, doubt, share)
    if astray:
        yield (
            f"held out: the filter diverged on {held.diverged} of {count} other paths; take more "
            "design paths, or forecasts of a lower degree"
        )


def _mode_findings(predicted, held, doubt, share):
    apart = np.abs(held.mode_rate - predicted.mode_rate)
    standard = predicted.mode_error
    standard = np.hypot(standard, np.maximum(held.mode_error, share * standard))
    with np.errstate(invalid="ignore"):
        bad = (apart > doubt * standard) & (apart > SOME * predicted.mode_rate)
    if bad.any():
        k = int(np.argmax(np.where(bad, apart, -1.0)))
        yield (
            f"held out: the part of wrong modes on {held.paths} other paths is not the predicted "
            f"one at {np.count_nonzero(bad)} of {len(bad)} times, most at time "
            f"{when(held.times[k])}: {held.mode_rate[k]:.4g} ± {held.mode_error[k]:.2g} for "
            f"{predicted.mode_rate[k]:.4g}; take more design paths or a shorter memory"
        )


def forecast_errors(filter: FiniteOrderFilter) -> np.ndarray:
    """Root-mean-square errors of the forecasts for the measurements, (K+1, n'), by their fits."""
    n = filter.components
    found = np.full((len(filter.times), n), np.nan)
    for k, fit in enumerate(filter.fits, start=1):
        found[k] = np.sqrt(np.diagonal(fit.cov)[:n])
    return found
