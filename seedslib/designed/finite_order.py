"""Finite-order filter: designed offline, it runs on a frozen table of forecasts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_real, as_times, unmasked
from seedslib.base.clock import Clock
from seedslib.base.objects import by_fields
from seedslib.designed.between import at, interval_after, known_kind, nodes_after
from seedslib.designed.finite_order_rules import FiniteOrderState, Rules, Start, initial_moments
from seedslib.designed.gaps import dropouts, step_unclaimed, unclaimed, unexpected
from seedslib.designed.guards import freeze, positions, want_corrected, want_forecast, want_next
from seedslib.designed.memory import Memory, Past
from seedslib.designed.prediction import (
    Design,
    HeldOut,
    Prediction,
    finite_order_page,
    headline,
)
from seedslib.designed.predictors import Fit
from seedslib.designed.shapes import check_shapes
from seedslib.filters.estimates import Estimates, as_record
from seedslib.filters.verbs import Filter
from seedslib.linearization.moments import Linearization, Moments


@dataclass(frozen=True, eq=False, repr=False)
class FiniteOrderFilter(Filter):
    """A designed filter of finite order; `seedslib.design.synthesize` makes it.

    At measurement k the state is forecast from the memory, Lambda_k = Gamma_k U_{k-1} + kappa_k
    with covariance T_k, and corrected by the lines that every filter uses; the first n'
    components are the estimate Z_k, which is pushed on the memory. Equations (6.2).

    Attributes
    ----------
    system : JumpDiffusion
    memory : Memory
    predictor : Affine, Polynomial or Continuous
    linearization : Linearization
    times : ndarray, shape (K+1,)
        Times of the measurements.
    node_times : tuple of ndarray
        Nodes within each interval, and after the last measurement where a horizon was given.
    components : int
        n': the first components of the state are estimated.
    start : Start
    fits : tuple of AffineFit or PolynomialFit, length K
    node_fits : tuple of tuple of AffineFit
        Forecasts Z_k^i; for `Continuous` the fits at the start of each integration step.
    predicted : Prediction
    design : Design
    measured_nodes : bool
        Whether Z_k^i also looks at Y_k directly (remark 1 of the paper).
    between : str
        Kind of the forecasts between measurements, see `seedslib.designed.between.at`.
    held_out : HeldOut, optional
    rules : Rules
        The compiled steps; made from the other fields.
    clock : Clock
        The measurement times, and what else is one of them.
    """

    takes = ("covariances",)

    takes = ("covariances",)

    system: object
    memory: Memory
    predictor: object
    linearization: Linearization
    times: np.ndarray
    node_times: tuple
    components: int
    start: Start
    fits: tuple[Fit, ...]
    node_fits: tuple
    predicted: Prediction
    design: Design
    measured_nodes: bool = False
    between: str = "interpolated"
    held_out: HeldOut | None = None
    rules: Rules | None = None

    def __post_init__(self):
        check_shapes(self)
        if self.rules is None:
            rules = Rules.of(
                self.system, self.memory, self.predictor, self.linearization, self.components,
                self.measured_nodes,
            )  # fmt: skip
            object.__setattr__(self, "rules", rules)
        known_kind("between", self.between)
        freeze((self.times, self.node_times, self.start, self.predicted, self.held_out))
        freeze((self.fits, self.node_fits))
        object.__setattr__(self, "clock", Clock(self.times, self.horizon))

    @property
    def order(self) -> int:
        """Dimension of the memory when it is full: l n' for the large-order filter."""
        return self.memory.order(self.components, self.system.sensor.size)

    @property
    def horizon(self) -> float:
        """Last time the filter can forecast."""
        tail = self.node_times[len(self.fits) :]
        return float(tail[0][-1] if tail else self.times[-1])

    def forecasting(self, kind: str) -> FiniteOrderFilter:
        """The same filter with another kind of forecast between measurements."""
        return replace(self, between=kind)

    def __reduce__(self) -> tuple:
        return by_fields(self, rules=None)  # what was compiled is compiled again elsewhere

    # Step by step

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> FiniteOrderState:
        """State before any measurement; the filter draws nothing from `seed`."""
        mean = self.start.mean.reshape(-1, *(1,) * len(batch))
        mean = np.broadcast_to(mean, (len(mean), *batch)).copy()
        return FiniteOrderState(-1, mean, self.start.cov, Past(), None, 0.0, None, False)

    def predict(self, state: FiniteOrderState, t: float) -> FiniteOrderState:
        """Forecast for the next measurement time, (n, *batch); the first has none to make.

        Raises
        ------
        ValueError
            Not the next measurement time of the design, or no more of them.
        """
        return self._predict(state, t)

    def _predict(self, state, t, interval=None):
        k = state.index + 1
        want_next(self.clock, k, t)
        if k == 0:
            return state._replace(index=0)
        want_corrected(state)
        if self.rules.velocity is None:
            u = state.past.vector
        else:  # the estimate has moved on
            u = interval.values[-1] if interval else nodes_after(self, k - 1, state)[1]
        mean, cov = self.fits[k - 1].forecast(u)
        before = FiniteOrderState(*state[:6], None, True)
        return FiniteOrderState(k, mean, cov, state.past, state.measurement, 0.0, before, False)

    def correct(self, state: FiniteOrderState, y: ArrayLike) -> FiniteOrderState:
        """Correct the forecast by y, (m, *batch); of NaN components see `run`.

        Raises
        ------
        TypeError, ValueError
            A state without a forecast, a wrong shape, an infinite measurement.
        """
        y, gap = np.asarray(unmasked("y", y, missing=np.nan)), False
        if y.dtype != np.float64 or not np.isfinite(y).all():
            y = as_real("y", y, nan=True)
            gap = np.isnan(y).any(axis=0)
        if y.shape != (self.system.sensor.size, *state.mean.shape[1:]):
            wanted = (self.system.sensor.size, *state.mean.shape[1:])
            raise ValueError(f"y: wanted shape {wanted}, got {y.shape}")
        return step_unclaimed(self._correct(state, y, True), state, gap)

    def _correct(self, state, y, spread):
        want_forecast(state)
        if state.index == 0:
            return self.rules.first(state, y, self.start.moments, spread)
        return self.rules.correct(state, self.clock.times[state.index], y, spread)

    def expect(self, state: FiniteOrderState) -> Moments:
        """Moments of the measurement that a forecast expects; after a gap the mean alone.

        Raises
        ------
        ValueError
            A state without a forecast.
        """
        want_forecast(state)
        if state.index == 0:
            return initial_moments(self.start.moments, state.mean.ndim - 1)
        moments = self.rules.sensor(self.clock.times[state.index], state.mean, state.cov)
        return unexpected(moments, state)

    def forecast(self, state: FiniteOrderState, t: float, kind: str | None = None) -> Estimates:
        """Estimate of the first n' components at a time up to the next measurement.

        Parameters
        ----------
        state : FiniteOrderState
            After a correction.
        t : float
            From the time of the state to the next measurement time (before that measurement),
            or to the horizon.
        kind : str, optional
            One of `FORECAST_KINDS`; the filter's own `between` by default.

        Raises
        ------
        ValueError
            A time outside the interval, an unknown kind, a state that was not corrected.
        """
        want_corrected(state)
        interval, k = interval_after(self, state), state.index
        end = self.times[k + 1] if k + 1 < len(self.times) else self.horizon
        room = self.clock.tolerance
        if not self.times[k] - room <= t <= end + room:
            raise ValueError(f"t: wanted a time from {self.times[k]:g} to {end:g}, got {t:g}")
        return Estimates(at(interval, t, self.between if kind is None else kind))

    # Whole records

    def run(
        self, times: ArrayLike, measurements: ArrayLike, *, covariances: bool = False,
        workers: int = 1,
    ) -> Estimates:  # fmt: skip
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (J+1,)
            The measurement times of the design up to some of them, and any times between.
        measurements : array_like, shape (J+1, m, *batch)
            NaN marks a missing component; between measurement times all must be NaN.
        covariances : bool
            Whether `cov` is wanted.
        workers : int
            Threads over blocks of paths.

        Returns
        -------
        Estimates
            ``mean`` (J+1, n', *batch), at measurement times after the correction and between
            them the forecasts; ``loglik`` (J+1, *batch), zero between; ``diverged`` (*batch),
            estimates that are not finite. ``cov`` (J+1, n', n', *batch), NaN where the filter
            claims none: between measurement times, and from a missing component to the end of
            its record; so is ``loglik`` after it.

        Raises
        ------
        TypeError, ValueError
            Times that do not increase or leave out a measurement time of the design; a
            measurement where the design has none; infinite measurements; wrong shapes.

        Warns
        -----
        UserWarning
            Records with missing components: how many, and from which time.
        """
        times = as_times("times", times)
        y = as_record(measurements, len(times), self.system.sensor.size)
        index = positions(times, y, self.clock, self.horizon)
        lost, batch, n = dropouts(y, index >= 0), y.shape[2:], self.components
        flat = y.reshape(*y.shape[:2], -1) if batch else y
        tail = flat.shape[2:]
        mean, loglik = np.empty((len(times), n, *tail)), np.zeros((len(times), *tail))
        cov = np.full((len(times), n, n, *tail), np.nan) if covariances else None

        def work(a, b, _):
            state, interval = self.initial((b - a,) if batch else ()), None
            for j, (t, k) in enumerate(zip(times, index, strict=True)):
                own = (j, ..., slice(a, b)) if batch else (j, ...)
                if k < 0:
                    interval = interval or interval_after(self, state)
                    mean[own] = at(interval, t, self.between)
                    continue
                state = self._correct(self._predict(state, t, interval), flat[own], covariances)
                mean[own], loglik[own], interval = state.mean, state.loglik, None
                if covariances:
                    cov[own] = state.cov.reshape(n, n, *(state.cov.shape[2:] or (1,) * len(tail)))

        if batch:
            in_blocks(work, tail[0], 0, workers=workers)
        else:
            work(0, 1, None)
        parts = (mean, cov, None, loglik, ~np.isfinite(mean).all(axis=(0, 1)))
        found = (p if p is None or not batch else p.reshape((*p.shape[:-1], *batch)) for p in parts)
        return unclaimed(Estimates(*found), lost, times)

    def __repr__(self) -> str:
        return f"<FiniteOrderFilter of {headline(self)}>"

    def __str__(self) -> str:
        return finite_order_page(self)
