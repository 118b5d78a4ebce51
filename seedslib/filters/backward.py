"""Steps back: what the measurements of later times say of a state before them."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.correction import correct
from seedslib.filters.estimates import Estimates
from seedslib.filters.kalman import settle


class Smoother:
    """What `smooth` asks of a filter beside its verbs: steps forward that can be gone back.

    What is known of one time is a *part*, of any type: `last` makes the first of them from the
    filter's last state, `back` each one from that of the next time, `report` says it.

    Parameters
    ----------
    filter : Filter
    """

    def __init__(self, filter: Any) -> None:
        self.filter: Any = filter

    def forecast(self, state: Any, t: float) -> tuple[Any, Any]:
        """The filter's forecast, as by `predict`, and what `back` has to know of the step."""
        return self.filter.predict(state, t), None

    def lost(self, state: Any) -> Any:
        """Where the filter has diverged in a state, (*batch) or a bool."""
        return False

    def last(self, state: Any) -> Any:
        """What is known of the time of a state without later measurements."""
        raise NotImplementedError

    def back(self, state: Any, part: Any, link: Any, indicator: MaybeArray = None) -> Any:
        """What is known of the time of a state from what is known of the next.

        With the link of the step between them, and the indicator shown at the next time.
        """
        raise NotImplementedError

    def report(self, part: Any) -> Estimates:
        """What is estimated, without the axis of times."""
        raise NotImplementedError


class Rauch(Smoother):
    """The smoother of Rauch, Tung and Striebel, of a filter that carries a covariance.

    A part is the mean, with what unknown numbers add to it as further columns, the covariance,
    and the last state, which says what the measurements tell of those numbers.

    Differences are taken between two laws of one time only. They are counted from the same turn
    of a circle, so circular components need no care.
    """

    def __init__(self, filter: Any) -> None:
        super().__init__(filter.apart())

    def forecast(self, state: Any, t: float) -> tuple[Any, Any]:
        """See `Smoother.forecast`; the link is the forecast and the gain of the step back."""
        if state.time is None:
            return super().forecast(state, t)
        later, cross = self.filter.moved_jointly(state, t)
        batch = state.mean.shape[1:]
        cov = wide(later.cov, batch)
        link = _columns(later), cov, gain_of(wide(cross, batch), cov)
        return later._replace(time=float(t)), link

    def lost(self, state: Any) -> Any:
        """Where the mean is beyond the bound of the filter."""
        bound = self.filter.bound
        return (np.abs(state.mean) > bound).any(axis=0) if np.isfinite(bound) else False

    def last(self, state: Any) -> Any:
        """See `Smoother.last`."""
        return _columns(state), wide(state.cov, state.mean.shape[1:]), state

    def back(self, state: Any, part: Any, link: Any, indicator: MaybeArray = None) -> Any:
        """See `Smoother.back`."""
        cov = wide(state.cov, state.mean.shape[1:])
        return *stepped_back(_columns(state), cov, *link, *part[:2]), part[2]

    def report(self, part: Any) -> Estimates:
        """Mean and covariance, unknown numbers taken from what the measurements say of them."""
        columns, cov, last = part
        if columns.shape[-1] == 1:
            return Estimates(columns[..., 0], cov)
        return Estimates(*settle(columns[..., 0], cov, columns[..., 1:], last, self.filter.leaning))


def stepped_back(
    columns: np.ndarray, cov: np.ndarray, forecast: np.ndarray, forecast_cov: np.ndarray,
    gain: np.ndarray, later: np.ndarray, later_cov: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """One step back: m + G (m' - E m'), P + G (P' - E P') Gᵀ.

    Parameters
    ----------
    columns, forecast, later : ndarray, shape (n, *batch, c)
        Means as columns: now, forecast for the next time, and smoothed there.
    cov, forecast_cov, later_cov : ndarray, shape (n, n, *batch)
    gain : ndarray, shape (n, n, *batch)
        From `gain_of`.
    """
    columns = columns + np.einsum("ij...,j...c->i...c", gain, later - forecast)
    change = np.einsum("ij...,jk...,lk...->il...", gain, later_cov - forecast_cov, gain)
    return columns, cov + 0.5 * (change + np.swapaxes(change, 0, 1))


def gain_of(cross: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """G = C P⁺, shape (n, n, *batch): what each unit of the later state moves."""
    n = len(cross)
    still = np.zeros((n, *(1,) * (cross.ndim - 1)))
    unit = np.eye(n).reshape(n, *(1,) * (cross.ndim - 2), n)
    gain, _, _ = correct(still, None, unit, (still, cross[..., None], cov[..., None]))
    return np.moveaxis(np.broadcast_to(gain, (*cross.shape[:1], *gain.shape[1:])), -1, 1)


def wide(cov: np.ndarray, batch: tuple[int, ...]) -> np.ndarray:
    """A matrix with axes of paths, of length one where it is common to them."""
    return cov if cov.ndim > 2 else cov.reshape(*cov.shape, *(1,) * len(batch))


def _columns(state: Any) -> np.ndarray:
    """The mean, and what unknown numbers add to it, as columns (n, *batch, 1 + q)."""
    mean = state.mean[..., None]
    effect = getattr(state, "effect", None)
    return mean if effect is None else np.concatenate([mean, effect], axis=-1)
