"""What a design says of its filter, in numbers and words; errors on paths it has not seen.

And what it does not say. Covariances of a designed filter hold under the law that it was designed
for, of paths without gaps. A memory of estimates never forgets a gap, so from a missing
measurement to the end of a record they are NaN; means go on.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from seedslib.filters.estimates import Estimates

ROWS = 12

WIDTH = 100
"""Longest line of a summary."""


class HeldOut(NamedTuple):
    """Accuracy of a finished filter on paths that its design has not seen.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
        Times of the measurements; errors are those after the correction.
    rms, error : ndarray, shape (K+1, n')
        Root-mean-square errors and their standard errors; NaN where no path was left.
    deviation : ndarray, shape (K+1, n')
        Standard deviation of the state there: the error of the best constant.
    paths : int
    diverged : int
        Paths on which the filter left the range of numbers, which are left out from there on, or
        made an error that hardly one design would meet on as many paths as it was made on.
    mode_rate, mode_error : ndarray, shape (K+1,), or None
        Of a switching system: part of wrong modes and its standard error.
    """

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray
    deviation: np.ndarray
    paths: int
    diverged: int
    mode_rate: np.ndarray | None = None
    mode_error: np.ndarray | None = None


class SwitchingPrediction(NamedTuple):
    """What the design says about the filter's accuracy, on the paths it was fitted to.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    rms, error : ndarray, shape (K+1, n)
        Root-mean-square errors and their standard errors.
    mode_rate, mode_error : ndarray, shape (K+1,)
        Part of wrong modes, and its standard error.
    """

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray
    mode_rate: np.ndarray
    mode_error: np.ndarray


class SwitchingDesign(NamedTuple):
    """How a filter was designed: paths, paths per block, seed, and what had to be mended.

    ``thin`` of ``pairs`` pairs of cell and mode had too few paths of their own; the eigenvalues
    of ``floored`` covariances were raised; ``diverged`` paths were left out.
    """

    paths: int
    block: int
    entropy: object
    spawn_key: tuple
    thin: int
    pairs: int
    floored: int
    diverged: int = 0


def summary(filter) -> str:
    """Page of text: what the filter is, how it was designed, how accurate it says it is."""
    held = "carries the laws of all modes" if filter.memory is None else f"of {filter.memory}"
    lines = [
        f"Filter of {filter.system.modes} modes, {held}; {filter.linearization}",
        f"  order        {filter.order}",
    ]
    if filter.design is not None:
        design = filter.design
        lines.append(f"  designed on  {design.paths} paths, seed {design.entropy}")
        lines.append(
            f"  mended       {design.thin} of {design.pairs} thin pairs of cell and mode, "
            f"{design.floored} covariances"
            + (f", {design.diverged} diverged paths left out" if design.diverged else "")
        )
    if filter.lasting:
        lines.append("  used past its last design time, where its fits have converged")
    if filter.predicted is not None:
        lines.append("  predicted errors of state and part of wrong modes (in-sample)")
        count = len(filter.predicted.times)
        lines += held_out_words(filter.held_out)
        for k in np.unique(np.linspace(0, count - 1, min(ROWS, count)).astype(int)):
            t, rms, error, rate, doubt = (part[k] for part in filter.predicted)
            row = "  ".join(f"{a:.4f} ± {e:.4f}" for a, e in zip(rms, error, strict=True))
            row = f"    t = {t:<8g} {row}  modes {rate:.4f} ± {doubt:.4f}"
            lines += with_held_out(row, filter.held_out, k)
    return "\n".join(lines)


def held_out_words(held: HeldOut | None) -> list[str]:
    """Line that says what stands beside the predicted errors; none without held-out paths."""
    if held is None:
        return []
    lost = f", {held.diverged} of them diverged" if held.diverged else ""
    return [f"  after the bar: on {held.paths} paths that the design has not seen{lost}"]


def with_held_out(row: str, held: HeldOut | None, k: int) -> list[str]:
    """A row of a summary with the errors of measurement k on held-out paths, in a line or two."""
    if held is None:
        return [row]
    pairs = zip(held.rms[k], held.error[k], strict=True)
    other = "  ".join(f"{a:.4f} ± {e:.4f}" for a, e in pairs)
    if held.mode_rate is not None:
        other += f"  modes {held.mode_rate[k]:.4f} ± {held.mode_error[k]:.4f}"
    if len(row) + len(other) + 3 <= WIDTH:
        return [f"{row} | {other}"]
    return [row, f"{'|':>17} {other}"]


def dropouts(y, measured=None, indicators=None) -> np.ndarray | None:
    """Whether some of a measurement was missing at or before each time, shape (J+1, *batch).

    None where nothing was.

    Parameters
    ----------
    y : ndarray, shape (J+1, m, *batch)
    measured : ndarray of bool, shape (J+1,), optional
        Times at which the design has a measurement, all by default.
    indicators : ndarray of int, shape (J+1, *batch), optional
        -1 is a missing one.
    """
    if not np.isnan(y).any() and (indicators is None or not (indicators < 0).any()):
        return None
    lost = np.isnan(y).any(axis=1)
    if indicators is not None:
        lost |= indicators < 0
    if measured is not None:
        lost[~measured] = False
    return np.logical_or.accumulate(lost)


def step_unclaimed(found, state, gap):
    """A corrected state without what it cannot know; cheap where nothing was missing.

    Parameters
    ----------
    found, state : FiniteOrderState
        After the correction and before it.
    gap : ndarray of bool, shape (*batch), or False
        Whether some of the measurement was missing.
    """
    old = _gap_before(state)
    if gap is False and old is False:
        return found
    cov = _where(old | gap, found.cov)
    return found._replace(cov=cov, loglik=np.where(old, np.nan, found.loglik))


def law_unclaimed(found, state, y, indicator):
    """As `step_unclaimed`, for the law of a `SwitchingState`."""
    gap = np.isnan(y).any(axis=0) | state.gap
    if indicator is not None:
        gap = gap | (indicator < 0)
    if not np.any(gap):
        return found
    law = found.law._replace(cov=np.where(gap, np.nan, found.law.cov))
    return found._replace(law=law, loglik=np.where(state.gap, np.nan, found.loglik), gap=gap)


def unexpected(moments, state):
    """Moments of a measurement, only their mean where one before it was missing."""
    old = _gap_before(state)
    if old is False:
        return moments
    return moments._replace(cross=_where(old, moments.cross), cov=_where(old, moments.cov))


def _gap_before(state):
    """Paths on which a measurement before that of a forecast was missing, or False.

    The covariance of the last estimate is NaN there.
    """
    before = state.before
    if before is None or before.cov is None:
        return False
    first = before.cov[0, 0]
    gap = first != first  # a number that is none; of scalars the quickest way to ask
    return gap if (gap.any() if gap.ndim else gap) else False


def _where(gap, part):
    """NaN on the paths of a gap (*batch) in an array (a, b) or (a, b, *batch)."""
    return np.where(gap, np.nan, part.reshape(*part.shape, *(1,) * (np.ndim(gap) + 2 - part.ndim)))


def unclaimed(found: Estimates, lost, times, stacklevel=3) -> Estimates:
    """Estimates without the covariances and likelihoods that a filter cannot know.

    Parameters
    ----------
    found : Estimates
    lost : ndarray of bool, shape (J+1, *batch), or None
        See `dropouts`.
    times : ndarray, shape (J+1,)

    Warns
    -----
    UserWarning
        Once where there are any; how many records, and from which time.
    """
    if lost is None:
        return found
    # the measurement at the first gap was still forecast from a memory without one
    after = np.concatenate([np.zeros_like(lost[:1]), lost[:-1]])
    cov, loglik = found.cov, found.loglik
    if cov is not None and lost.any():
        cov = cov.reshape(*cov.shape, *(1,) * (lost.ndim + 2 - cov.ndim))
        cov = np.where(lost[:, None, None], np.nan, cov)
    if loglik is not None and (after & ~np.isnan(loglik)).any():
        loglik = np.where(after, np.nan, loglik)
    if cov is not found.cov or loglik is not found.loglik:
        records = lost[-1].size
        warnings.warn(
            f"measurements: {np.count_nonzero(lost[-1])} of {records} records have gaps, from "
            f"{times[lost.reshape(len(lost), -1).any(axis=1).argmax()]:g} on, which the design "
            "does not know of: covariances are NaN from a gap on, likelihoods after it",
            stacklevel=stacklevel,
        )
    return found._replace(cov=cov, loglik=loglik)
