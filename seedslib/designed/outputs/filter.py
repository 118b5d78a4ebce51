"""Filters of output functions: the optimal functions of theorems 1 and 2, in any form."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_real, as_times, unmasked
from seedslib.base.clock import Clock
from seedslib.designed.between import at, known_kind
from seedslib.designed.gaps import dropouts, unclaimed
from seedslib.designed.guards import freeze, positions, want_corrected, want_forecast
from seedslib.designed.memory import Memory
from seedslib.designed.outputs.lookup import Output, Step, summary
from seedslib.designed.outputs.steps import OutputState, arrived, corrected, found, interval
from seedslib.designed.prediction import Design, HeldOut, Prediction
from seedslib.designed.shapes import check_shapes
from seedslib.filters.estimates import Estimates, as_indicators, as_record
from seedslib.filters.verbs import Filter
from seedslib.models.kinds import switches


@dataclass(frozen=True, eq=False, repr=False)
class OutputFilter(Filter):
    """Filter whose estimate is any function of measurement and memory.

    Z_k = f_k(Y_k, U_{k-1}) and Z_k^i = g_k^i(U_k), theorem 1 of the jump-diffusion paper; with
    modes also the decided mode, iota_k(j, y, z) and g_k(j, y, z) of (3.1), (3.2) of the switching
    paper. There is no likelihood, and the covariance is the unconditional one that the design
    found, NaN from a missing measurement on.

    A missing measurement or indicator is left out, exactly for that step given the memory, by
    functions of its own. What was found is remembered like any other estimate.

    Attributes
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
    memory : Memory
        Of estimates, with their decided modes where there are modes, of measurements, or of
        both; of indicators too where it says so.
    times : ndarray, shape (K+1,)
    steps : tuple of Step, length K+1
        Output functions of each measurement.
    method : object
        How the functions were made.
    predicted : Prediction
        Accuracy; without standard errors where no random numbers were used.
    covariances : ndarray, shape (K+1, n', n')
        Error covariances that the design found.
    design : Design
    node_times : tuple of ndarray, length K or 0
        Nodes within each interval.
    node_fits : tuple of tuple of callable
        Forecasts Z_k^i, functions of the memory.
    changes : ndarray, shape (2, K+1), or None
        How far each function is from the one before: root mean square of the difference of the
        estimates, probability of another mode; NaN where the memory was still filling.
    between : str
        Kind of the forecasts between measurements, see `seedslib.designed.between.at`.
    lasting : bool
        Whether the last functions serve all later steps.
    held_out : HeldOut, optional
        Errors on paths that the design has not seen; none where it took no paths.
    """

    takes = ("indicators", "covariances")

    system: object
    memory: Memory
    times: np.ndarray
    steps: tuple[Step, ...]
    method: object
    predicted: Prediction
    covariances: np.ndarray
    design: Design
    node_times: tuple[np.ndarray, ...] = ()
    node_fits: tuple = ()
    changes: np.ndarray | None = None
    between: str = "interpolated"
    lasting: bool = False
    held_out: HeldOut | None = None

    def __post_init__(self):
        check_shapes(self)
        known_kind("between", self.between)
        object.__setattr__(self, "clock", Clock(self.times))
        freeze((
            self.times, self.steps, self.node_times, self.node_fits, self.changes,
            self.covariances, self.predicted, self.held_out,
        ))  # fmt: skip

    @property
    def components(self) -> int:
        """n': how many state components are estimated."""
        return self.covariances.shape[1]

    @property
    def order(self) -> int:
        """Numbers that are remembered, modes and indicators included: l (n' + 1) for FBP."""
        memory = self.memory
        numbers = memory.order(self.components, self.system.measurement_size)
        return numbers + memory.estimates * switches(self.system) + memory.indicators

    @property
    def horizon(self) -> float:
        """Last time the filter can forecast."""
        return np.inf if self.lasting else float(self.times[-1])

    @property
    def made(self) -> str:
        """How the functions were made."""
        return str(self.method)

    def forecasting(self, kind: str) -> OutputFilter:
        """The same filter with another kind of forecast between measurements."""
        return replace(self, between=kind)

    def output(self, k: int, y: ArrayLike, u: ArrayLike) -> Output:
        """What is found at measurement k, from arguments whose batch axes broadcast.

        Parameters
        ----------
        k : int
        y, u : array_like, shapes (m, *batch) and (d, *batch)
            The measurement, below the indicator where there is one; the memory, empty at k = 0.
        """
        return self.steps[k].shown([*y, *u])

    # Step by step

    def initial(self, batch=(), seed=None) -> OutputState:
        """State before any measurement; the filter draws nothing from `seed`."""
        return OutputState(-1, None, np.full((self.components, *batch), np.nan))

    def predict(self, state: OutputState, t: float) -> OutputState:
        """Forecast for the next measurement time.

        Raises
        ------
        ValueError
            Another time than the next, a state that was not corrected.
        """
        if state.index >= 0:
            want_corrected(state)
        given, t = arrived(self, state), float(t)
        if not self.clock.same(t, given.time):
            raise ValueError(f"t: wanted the next measurement time {given.time:g}, got {t:g}")
        mean, mode, prob = found(self, given, None, None)
        return given._replace(mean=mean, cov=None, mode=mode, mode_prob=prob)

    def correct(self, state: OutputState, y: ArrayLike, indicator=None) -> OutputState:
        """Correct the forecast by a measurement and the indicator.

        Parameters
        ----------
        state : OutputState
        y : array_like, shape (m, *batch)
            NaN where it is missing, in all components or none.
        indicator : array_like of int, shape (*batch), optional
            -1 where it is missing; wanted where the system has one.

        Raises
        ------
        TypeError, ValueError
            A state without a forecast, a wrong shape, an infinite measurement, an indicator out
            of range; a missing measurement or indicator that is to be remembered.
        """
        want_forecast(state)
        y, batch = as_real("y", y, nan=True), state.mean.shape[1:]
        wanted = (self.system.measurement_size, *batch)
        if y.shape != wanted:
            raise ValueError(f"y: wanted shape {wanted}, got {y.shape}")
        if indicator is not None:
            indicator = np.asarray(unmasked("indicator", indicator, missing=-1))[None]
        indicator = as_indicators(indicator, self.system, (1, *batch), "indicator")
        return corrected(self, state, y, None if indicator is None else indicator[0])

    def forecast(self, state: OutputState, t: float, kind: str | None = None) -> Estimates:
        """Estimate at a time up to the next measurement; with modes, at the next one.

        Parameters
        ----------
        state : OutputState
            After a correction.
        t : float
            From the time of the state to the next measurement time (before that measurement).
        kind : str, optional
            One of `FORECAST_KINDS`; the filter's own `between` by default.

        Raises
        ------
        ValueError
            A time outside the interval, an unknown kind, a state that was not corrected.
        """
        if switches(self.system):
            ahead = self.predict(state, t)
            return Estimates(ahead.mean, mode_prob=ahead.mode_prob, modes=ahead.mode)
        want_corrected(state)
        known, room = interval(self, state), self.clock.tolerance
        start, end = known.times[0], known.times[-1]
        if not start - room <= t <= end + room:
            raise ValueError(f"t: wanted a time from {start:g} to {end:g}, got {t:g}")
        return Estimates(at(known, t, self.between if kind is None else kind))

    # Whole records

    def run(
        self, times: ArrayLike, measurements: ArrayLike, *, indicators=None, covariances=False,
        workers=1,
    ) -> Estimates:  # fmt: skip
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (J+1,)
            The measurement times of the design up to some of them, evenly on beyond them where
            the last functions are lasting; without modes also any times between.
        measurements : array_like, shape (J+1, m, *batch)
            NaN marks a missing measurement, as a whole; between measurement times all must be NaN.
        indicators : array_like of int, shape (J+1, *batch), optional
            -1 marks a missing one; wanted where the system has an indicator.
        covariances : bool
            Whether `cov` is wanted, the unconditional one that the design found: (J+1, n', n'),
            or, with missing measurements or indicators, (J+1, n', n', *batch), NaN from the first
            missing one to the end of its record; NaN also between measurement times.
        workers : int
            Threads over blocks of paths.

        Returns
        -------
        Estimates
            ``mean`` (J+1, n', *batch), at measurement times after the correction and between
            them the forecasts; ``diverged`` (*batch), estimates that are not finite; with modes
            ``modes``, and ``mode_prob`` where the tables have them; without likelihoods.

        Raises
        ------
        TypeError, ValueError
            Times that do not increase or leave out a measurement time of the design; a
            measurement where the design has none; a measurement of which some components are
            NaN; a missing one that the memory wants; infinite measurements; wrong shapes.

        Warns
        -----
        UserWarning
            Records with missing measurements where `covariances` are wanted.
        """
        times, size = as_times("times", times), self.system.measurement_size
        y = as_record(measurements, len(times), size)
        batch = y.shape[2:]
        told = as_indicators(indicators, self.system, (len(times), *batch))
        clock = self.clock.prolonged(times[-1]) if self.lasting else self.clock
        index = positions(times, y, clock, self.horizon)
        if switches(self.system) and (index < 0).any():
            raise ValueError(
                "times: wanted those of measurements alone, for the system has modes, got "
                f"{times[index < 0][0]:g}"
            )
        lost = dropouts(y, index >= 0, told)
        flat = y.reshape(len(times), size, -1)
        told = None if told is None else told.reshape(len(times), -1)
        like, paths = found(self, arrived(self, self.initial()), None, None), flat.shape[2]
        mean, modes, prob = (
            None if part is None else np.empty((len(times), *part.shape, paths), kind)
            for part, kind in zip(like, (float, int, float), strict=True)
        )

        def work(a, b, _):
            state, known = self.initial((b - a,)), None
            for j, k in enumerate(index):
                if k < 0:
                    known = interval(self, state) if known is None else known
                    mean[j, :, a:b] = at(known, times[j], self.between)
                    continue
                shown = None if told is None else told[j, a:b]
                state, known = corrected(self, arrived(self, state), flat[j, :, a:b], shown), None
                mean[j, :, a:b] = state.mean
                if modes is not None:
                    modes[j, a:b] = state.mode
                if prob is not None:
                    prob[j, :, a:b] = state.mode_prob

        in_blocks(work, paths, 0, workers=workers)
        cov = self.covariances[np.minimum(index, len(self.covariances) - 1)]
        cov[index < 0] = np.nan
        mean, modes, prob = (
            None if part is None else part.reshape(*part.shape[:-1], *batch)
            for part in (mean, modes, prob)
        )
        diverged = ~np.isfinite(mean).all(axis=(0, 1))
        cov = cov if covariances else None
        return unclaimed(Estimates(mean, cov, prob, None, diverged, modes), lost, times)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of order {self.order}: {self.memory}; {self.made}>"

    def __str__(self) -> str:
        return summary(self)
