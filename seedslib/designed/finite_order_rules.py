"""The steps of a finite-order filter that its design and its run share, and what they hold."""

from __future__ import annotations

from dataclasses import dataclass
from operator import mul
from typing import NamedTuple

import numpy as np

from seedslib.base.correction import correct
from seedslib.designed.memory import Memory, Past
from seedslib.designed.predictors import Continuous
from seedslib.designed.traced import TracedCorrection, mean_velocity, traced_correction
from seedslib.linearization.moments import Moments


class Start(NamedTuple):
    """Moments for the first estimate, which is the best affine one in Y_0.

    Attributes
    ----------
    mean, cov : ndarray, shapes (n,) and (n, n)
        Of X_0.
    moments : Moments
        Of Y_0, with cov(X_0, Y_0).
    """

    mean: np.ndarray
    cov: np.ndarray
    moments: Moments


class Prediction(NamedTuple):
    """What the design says about the filter's accuracy.

    Attributes
    ----------
    times : ndarray, shape (S,)
        Measurement times (after the correction) and nodes.
    rms : ndarray, shape (S, n')
        Root-mean-square errors.
    error : ndarray, shape (S, n')
        Standard errors of `rms`; zero where moments were exact.
    in_sample : bool
        Whether the errors are those of the paths that the filter was fitted to, which flatters
        it a little: by about (coefficients / paths) of the mean-square error.
    """

    times: np.ndarray
    rms: np.ndarray
    error: np.ndarray
    in_sample: bool


class Design(NamedTuple):
    """How a filter was designed: paths, paths per block, seed, how many paths were left out."""

    paths: int
    block: int
    entropy: object
    spawn_key: tuple
    diverged: int
    exact: bool


class FiniteOrderState(NamedTuple):
    """What the filter remembers.

    Attributes
    ----------
    index : int
        Number k of the last measurement time reached; -1 before the first.
    mean : ndarray
        After `predict` the forecast of the whole state, (n, *batch); after `correct` the
        estimate Z_k, (n', *batch).
    cov : ndarray or None
        Its covariance as the filter sees it, with or without batch axes.
    past : Past
        The memory U_k; after `predict` still U_{k-1}.
    measurement : ndarray or None
        Last measurement, missing components filled with their forecasts.
    loglik : ndarray
        Log-density of the last measurement as forecast by the filter.
    before : FiniteOrderState or None
        The state after the measurement before the last, needed by linear forecasts.
    corrected : bool
        Whether the measurement at `index` was taken in.
    """

    index: int
    mean: np.ndarray
    cov: np.ndarray | None
    past: Past
    measurement: np.ndarray | None
    loglik: np.ndarray | float
    before: object
    corrected: bool


class Course(NamedTuple):
    """One interval of a design: its start, nodes, end, and the forecasts that are known."""

    start: float
    nodes: np.ndarray
    end: float
    fits: tuple


def initial_moments(moments, depth) -> Moments:
    """Moments of the first measurement, shaped for `depth` batch axes."""
    return moments._replace(mean=moments.mean.reshape(-1, *(1,) * depth))


@dataclass(frozen=True)
class Rules:
    """The steps of a filter that its design and its run share."""

    memory: Memory
    components: int
    sensor: object
    traced: TracedCorrection | None = None
    velocity: object = None
    measured_nodes: bool = False

    @classmethod
    def of(cls, system, memory, predictor, linearization, components, measured_nodes):
        """Rules of a filter; the moment functions are compiled here."""
        velocity = None
        if isinstance(predictor, Continuous):
            velocity = mean_velocity(system, linearization)
        sensor = linearization.moments(system.sensor)
        traced = traced_correction(system.sensor, linearization, components)
        return cls(memory, components, sensor, traced, velocity, measured_nodes)

    def first(self, state, y, moments, spread=True) -> FiniteOrderState:
        """State after the first measurement, whose moments are fixed."""
        return self._corrected(state, y, initial_moments(moments, state.mean.ndim - 1), spread)

    def correct(self, state, t, y, spread=True) -> FiniteOrderState:
        """State after the measurement; its `mean` and `cov` hold the forecast before."""
        if self.traced is not None and state.mean.ndim == 1:
            found = self.traced(t, state.mean, state.cov, y, spread)
            if found is not None:
                return self._remembered(state, y, *found)
        return self._corrected(state, y, self.sensor(t, state.mean, state.cov), spread)

    def _corrected(self, state, y, moments, spread):
        cov = state.cov if spread else None
        found = correct(state.mean, cov, y, moments, rows=self.components)
        # a missing measurement is remembered as what was expected
        missing = np.isnan(y)
        shown = np.where(missing, moments.mean, y) if missing.any() else y
        return self._remembered(state, shown, *found)

    def _remembered(self, state, shown, mean, cov, loglik):
        past = self.memory.push(state.past, estimate=mean, measurement=shown)
        return FiniteOrderState(
            state.index, mean, cov, past, shown, loglik, state.before, corrected=True
        )

    def node_memory(self, state) -> np.ndarray:
        """What the node forecasts look at: U_k, and Y_k where remark 1 is used."""
        u = state.past.vector
        if self.measured_nodes and not self.memory.measurements:
            return np.concatenate([u, state.measurement])
        return u

    def nodes(self, course, state) -> tuple[list, object]:
        """Estimates at the nodes, and at the end of the interval where they lead there."""
        if self.velocity is None:
            u = self.node_memory(state)
            return [fit.mean(u) for fit in course.fits], None
        moved, z = [], state.mean
        stops = [course.start, *course.nodes, course.end]
        for fit, t, after in zip(course.fits, stops, stops[1:], strict=False):
            z = self.move(fit, t, after - t, z)
            moved.append(z)
        return moved[: len(course.nodes)], moved[-1]

    def move(self, fit, t, h, z) -> np.ndarray:
        """Euler step of the continuous forecast, dZ/dt = E b'(t, X) given Z."""
        n = self.components
        if z.ndim == 1:  # numbers: the interpreter's work on tiny arrays would be most of it
            values, moved = z.tolist(), z.copy()
            mean = [
                sum(map(mul, row, values), start)
                for row, start in zip(fit.gain.tolist(), fit.offset.tolist(), strict=True)
            ]
            for k, rate in enumerate(self.velocity(t, mean, fit.cov)[:n]):
                moved[k] += h * rate
            return moved
        with np.errstate(over="ignore", invalid="ignore"):
            mean, moved = fit.mean(z), np.empty_like(z)
            for k, rate in enumerate(self.velocity(t, list(mean), fit.cov)[:n]):
                np.multiply(rate, h, out=moved[k])
                moved[k] += z[k]
        return moved

    def arriving(self, course, state, interval=None) -> np.ndarray:
        """What the forecast for the next measurement looks at."""
        if self.velocity is None:
            return state.past.vector
        return self.nodes(course, state)[1] if interval is None else interval.values[-1]


def positions(times, y, clock, horizon) -> np.ndarray:
    """Number of the measurement time at each time of a grid, -1 between them.

    Parameters
    ----------
    times : ndarray, shape (J+1,)
    y : ndarray, shape (J+1, m, *batch)
        Must be NaN between the measurement times.
    clock : Clock
        Measurement times of the filter.
    horizon : float

    Raises
    ------
    ValueError
        A grid that starts elsewhere, goes too far, or leaves out a measurement time; a
        measurement at another time.
    """
    wanted = np.array(clock.times)
    wanted = wanted[wanted <= times[-1] + clock.tolerance]
    if not clock.same(times[0], clock.times[0]):
        raise ValueError(f"times: wanted to begin at {clock.times[0]:g}, got {times[0]:g}")
    if times[-1] > horizon + clock.tolerance:
        raise ValueError(f"times: wanted at most {horizon:g}, got {times[-1]:g}")
    place = clock.rows(times)[: len(wanted)]
    missed = place < 0
    if missed.any():
        raise ValueError(
            f"times: wanted all measurement times of the design, {wanted[missed][0]:g} is not "
            "among them"
        )
    index = np.full(len(times), -1)
    index[place] = np.arange(len(wanted))
    for j in np.flatnonzero(index < 0):
        if not np.isnan(y[j]).all():
            raise ValueError(
                f"measurements: wanted NaN at {times[j]:g}, which is no measurement time of the "
                "design"
            )
    return index


def freeze(part):
    """Make an array, or the arrays in a tuple, read-only: a designed filter does not change."""
    if isinstance(part, np.ndarray):
        part.flags.writeable = False
    elif isinstance(part, tuple):
        for piece in part:
            freeze(piece)
