"""What a design does not say of its filter: covariances after a missing measurement.

Covariances of a designed filter hold under the law that it was designed for: of paths without
gaps, or with those of the schedule or the availability that the design was given. A memory of
estimates never forgets another gap, so from such a one to the end of a record they are NaN; means
go on.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.designed.patterns import PatternFit, loose
from seedslib.filters.base import Estimates

if TYPE_CHECKING:
    from seedslib.designed.finite_order_rules import FiniteOrderState
    from seedslib.designed.switching.rules import SwitchingState
    from seedslib.linearization.moments import Moments


def check_schedule(filter: Any) -> None:
    """Refuse a schedule, probabilities or classes of another shape than the measurements.

    Raises
    ------
    TypeError, ValueError
        What does not fit.
    """
    mask, arriving = filter.schedule  # which refuses most
    if filter.measured is not None and filter.measured.shape != mask.shape:
        raise ValueError(f"measured: wanted a mask of shape {mask.shape}")
    if arriving is None:
        return
    patterns = 2 ** len(loose(arriving))
    fits = () if hasattr(filter, "arrivals") else filter.fits  # where the classes are then
    for fit in fits:
        if not isinstance(fit, PatternFit) or fit.table.shape[1:] != (patterns,):
            raise ValueError(f"fits: wanted classes of {patterns} patterns for the availability")


def expected(filter: Any, index: np.ndarray) -> MaybeArray:
    """Components that may be, and that must be, in measurements, by their numbers (J,).

    Shape (2, J, m'); None where the design expects all of them.
    """
    if filter.measured is filter.availability is None:
        return None
    mask, arriving = filter.schedule
    rate = 1.0 if arriving is None else arriving
    rows = [filter.served(int(k)) for k in index]
    return np.stack([mask & (rate > 0.0), mask & (rate == 1.0)])[:, rows]


def dropouts(
    y: np.ndarray, measured: np.ndarray, indicators: np.ndarray | None,
    expected: np.ndarray | None = None,
) -> np.ndarray | None:  # fmt: skip
    """Whether some of a measurement was missing at or before each time, shape (J+1, *batch).

    None where nothing was.

    Parameters
    ----------
    y : ndarray, shape (J+1, m, *batch)
    measured : ndarray of bool, shape (J+1,)
        Times at which the design has a measurement.
    indicators : ndarray of int, shape (J+1, *batch), or None
        -1 is a missing one.
    expected : ndarray of bool, shape (2, J+1, m'), or None
        Components that may be there, and those that must, where the design says so.
    """
    none = not np.isnan(y).any() and (indicators is None or not (indicators < 0).any())
    if none and expected is None:
        return None
    indicators = None if indicators is None else indicators[measured]
    expected = None if expected is None else expected[:, measured]
    lost = missing("measurements", y[measured], indicators, expected)
    whole = np.zeros((len(y), *y.shape[2:]), dtype=bool)
    whole[measured] = lost
    return np.logical_or.accumulate(whole)


def missing(
    name: str, y: np.ndarray, indicators: np.ndarray | None, expected: np.ndarray | None
) -> np.ndarray:
    """Whether something is missing in each measurement that the design expects, (J, *batch).

    Parameters
    ----------
    name : str
        Of the argument.
    y, indicators, expected : ndarray or None
        See `dropouts`.

    Raises
    ------
    ValueError
        A component that the schedule of the design leaves out.
    """
    absent = np.isnan(y)
    if indicators is not None:
        absent = np.concatenate([absent, (indicators < 0)[:, None]], axis=1)
    if expected is None:
        return absent.any(axis=1)
    may, must = expected.reshape(*expected.shape, *(1,) * (absent.ndim - 2))
    stray = ~(absent | may)
    if stray.any():
        row, component = np.argwhere(stray.any(axis=tuple(range(2, stray.ndim))))[0]
        raise ValueError(
            f"{name}: wanted what the schedule of the design has, got component {component} of a "
            f"measurement without it{f' in row {row}' if len(y) > 1 else ''}"
        )
    return (absent & must).any(axis=1)


def step_unclaimed(
    found: FiniteOrderState, state: FiniteOrderState, gap: np.ndarray | bool
) -> FiniteOrderState:
    """A corrected state without what it cannot know; cheap where nothing was missing.

    Parameters
    ----------
    found, state : FiniteOrderState
        After the correction and before it.
    gap : ndarray of bool, shape (*batch), or False
        Whether some of the measurement was missing.
    """
    gap = state.gap | gap
    if gap is False or not gap.any():
        return found
    loglik = np.where(state.gap, np.nan, found.loglik)
    return found._replace(cov=_where(gap, found.cov), loglik=loglik, gap=gap)


def law_unclaimed(
    found: SwitchingState, state: SwitchingState, gap: np.ndarray | bool
) -> SwitchingState:
    """As `step_unclaimed`, for the law of a `SwitchingState`; an indicator may be missing too."""
    gap = state.gap | gap
    if not np.any(gap):
        return found
    law = found.law._replace(cov=np.where(gap, np.nan, found.law.cov))
    return found._replace(law=law, loglik=np.where(state.gap, np.nan, found.loglik), gap=gap)


def unexpected(moments: Moments, state: FiniteOrderState) -> Moments:
    """Moments of a measurement, only their mean where one before it was missing."""
    gap = state.gap
    if gap is False:
        return moments
    return moments._replace(cross=_where(gap, moments.cross), cov=_where(gap, moments.cov))


def _where(gap, part):
    """NaN on the paths of a gap (*batch) in an array (a, b) or (a, b, *batch)."""
    return np.where(gap, np.nan, part.reshape(*part.shape, *(1,) * (np.ndim(gap) + 2 - part.ndim)))


def unclaimed(found: Estimates, lost: np.ndarray | None, times: np.ndarray) -> Estimates:
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
            f"{when(times[lost.reshape(len(lost), -1).any(axis=1).argmax()])} on, which the design "
            "does not know of: covariances are NaN from a gap on, likelihoods after it; a design "
            "knows of them by `measured` or `availability`",
            stacklevel=outside(),
        )
    return found._replace(cov=cov, loglik=loglik)
