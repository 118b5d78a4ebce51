"""Forecasts of measurements: what a filter expects to be measured, and how far it may be off."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from numpy.typing import ArrayLike

from seedslib.base.values import Inputs
from seedslib.filters.base import Estimates, Filter, Record, stacked, walk


def forecast_measurements(
    filter: Filter,
    times: ArrayLike,
    measurements: ArrayLike,
    *,
    indicators: ArrayLike | None = None,
    modes: ArrayLike | None = None,
    inputs: Inputs | None = None,
) -> Estimates:
    """The distribution of each measurement given those before it, noise of the sensor included.

    Where nothing more is measured, in rows of NaN at the end, these are the forecasts of the
    future, of one step, two steps and so on; before, a measurement less its mean here is the
    innovation. ``.interval(level)`` of the result is an interval for the measurement itself.

    Parameters
    ----------
    filter : Filter
        One that carries means and covariances: `KalmanFilter`, `extended_kalman` and other
        covariance filters, also compiled; `SwitchingFilter`, `KnownModeFilter`.
    times : array_like, shape (K+1,)
    measurements : array_like, shape (K+1, m, *batch)
        NaN marks a missing component.
    indicators, modes, inputs
        As `run` of the filter.

    Returns
    -------
    Estimates
        ``mean`` (K+1, m, *batch) and ``cov`` (K+1, m, m, *batch), or (K+1, m, m) where it is
        common to all records; of modes those of the mixture. Infinite variances where the
        measurements before do not determine what is diffuse.

    Raises
    ------
    TypeError, ValueError
        Another filter; as `run` of the filter.
    """
    if not isinstance(filter, Filter):
        raise TypeError(f"filter: wanted a filter of this library, got {type(filter).__name__}")
    batch, record = filter.records_of(times, measurements, indicators, modes, inputs)

    def work(record: Record, stream: object) -> Estimates:
        predicted: list[Any] = []

        def predict(state: Any, t: float, *mode: Any, inputs: Any) -> Any:
            predicted.append(filter.predict(state, t, *mode, inputs=inputs))
            return predicted[-1]

        def reports() -> Iterator[Estimates]:
            for k, _ in enumerate(walk(filter, record, None, predict)):
                p = filter.values(record.inputs.at(k))
                yield Estimates(*filter.predictive(predicted.pop(), p))

        return stacked(reports(), len(record.times))

    return filter.in_blocks(work, record, batch)._replace(diverged=None)
