"""What a filter is: four verbs of its own, and those that every filter has from them."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import BLOCK, in_blocks
from seedslib.base.objects import Shown
from seedslib.base.values import Inputs, on_paths
from seedslib.filters.estimates import (
    Estimates,
    as_indicators,
    as_modes,
    as_record,
    first_step,
    stays,
)
from seedslib.filters.weights import most_probable
from seedslib.models.kinds import as_grid, course_of, elapsed

State = TypeVar("State", bound=Any)


class Filter(Shown):
    """Estimates of a state from measurements, one after the other.

    A filter writes ``initial(batch=(), seed=None)``, ``moved(state, t)``, or the whole of
    ``predict(state, t)``, and ``correct(state, y)``, with an indicator as third argument where its
    system has modes, and `report` where its states do not say by themselves what is estimated.
    States are frozen, so every verb gives a new one. Whole records are run here, many at once.

    Attributes
    ----------
    system : System
    takes : tuple of str
        What `run` looks at beside times and measurements: of ``"indicators"``, ``"modes"`` (the
        true ones), ``"seed"`` and ``"covariances"`` (whether they are wanted).
    records : int
        How many are worked on together: so many as stay in the processor's cache.
    alone : bool
        Whether a single record is run without an axis of records.
    """

    system: Any
    takes: ClassVar[tuple[str, ...]] = ()
    records: int = BLOCK
    alone: bool = False

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> Any:
        """State before any measurement, for batch axes such as (paths,).

        A filter that draws nothing does not look at the seed; one that does takes None for 0.
        """
        raise NotImplementedError

    def predict(self, state: State, t: float, *told: ArrayLike) -> State:
        """Forecast to time t; a state without a time is only given one.

        Parameters
        ----------
        state : NamedTuple
            Left as it is.
        t : float
        *told : array_like of int, shape (*batch)
            The mode at that time, of a filter that is told it.

        Raises
        ------
        ValueError
            A time before that of the state; of a system in discrete time that does not mention
            the elapsed time, a step of another length than the first.
        """
        if stays(state, t):
            return state._replace(time=float(t))
        interval = first_step(state, t, self.system)
        with elapsed(self.system, state.time, t):
            moved = self.moved(state, float(t), *told)
        return moved._replace(time=float(t), interval=interval)

    def moved(self, state: State, t: float) -> State:
        """What `predict` makes of a state, but for its time."""
        raise NotImplementedError

    def correct(self, state: Any, y: ArrayLike) -> Any:
        """Correct by the measurement y, shape (m, *batch), at the time of the state.

        Raises
        ------
        ValueError
            A state without a time: `predict` gives it one.
        """
        raise NotImplementedError

    def report(self, state: Any) -> Estimates:
        """What the filter says in a state, without the axis of times."""
        said = {name: getattr(state, name, None) for name in Estimates._fields if name != "modes"}
        modes = getattr(state, "mode", None)
        if modes is None and said["mode_prob"] is not None:
            modes = most_probable(said["mode_prob"])
        return Estimates(**said, modes=modes)

    def kept(self, state: Any) -> Estimates:
        """What `run` keeps of a state at every time: of `report` what `completed` does not add."""
        return self.report(state)

    def completed(self, found: Estimates) -> Estimates:
        """Estimates of a run, with what is formed for all times at once."""
        return found

    def step(
        self, state: Any, t: float, y: ArrayLike, indicator: ArrayLike | None = None, *,
        mode: ArrayLike | None = None,
    ) -> Any:  # fmt: skip
        """Forecast to time t and correct there.

        A model with inputs is told those that act from the time of the state on for the forecast,
        and those of time t for the correction::

            with assigned({u: 0.3}):
                state = filter.predict(state, t)
            with assigned({u: 0.5}):
                state = filter.correct(state, y)

        and likewise `forecast`; where they are the same, one block around `step` will do.

        Parameters
        ----------
        state : NamedTuple
            Left as it is.
        t : float
        y : array_like, shape (m, *batch)
            NaN marks a missing component.
        indicator : array_like of int, shape (*batch), optional
            Of a system that has one; -1 where it is missing.
        mode : array_like of int, shape (*batch), optional
            The true mode at time t, for a filter that is told it.

        Raises
        ------
        TypeError, ValueError
            As `predict` and `correct`.
        """
        told = () if mode is None else (mode,)
        shown = () if indicator is None else (indicator,)
        return self.correct(self.predict(state, t, *told), y, *shown)

    def forecast(self, state: Any, t: float, *, mode: ArrayLike | None = None) -> Estimates:
        """What the filter expects at a later time, without a measurement; arguments as `step`."""
        told = () if mode is None else (mode,)
        later = self.report(self.predict(state, t, *told))
        return later._replace(loglik=None, diverged=None)

    def smoother(self) -> Any:
        """How `seedslib.filters.smooth` goes back through the states, see `Smoother`.

        Raises
        ------
        TypeError
            The filter has none.
        """
        raise TypeError(
            "filter: wanted one that can be smoothed (extended_kalman and other covariance "
            "filters, GridBayesFilter, SwitchingFilter without a memory), got "
            f"{type(self).__name__}"
        )

    def record(self, times: ArrayLike, measurements: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Times (K+1,) and measurements (K+1, m, *batch) of a run, checked."""
        times = as_grid("times", times, self.system)
        return times, as_record(measurements, len(times), self.system.measurement_size)

    def block(self, times: np.ndarray, paths: int, workers: int) -> int:
        """Number of records that are worked on together."""
        return self.records

    def run(
        self, times: ArrayLike, measurements: ArrayLike, *, indicators: ArrayLike | None = None,
        modes: ArrayLike | None = None, inputs: Inputs | None = None, seed: object = 0,
        workers: int = 1,
    ) -> Estimates:  # fmt: skip
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (K+1,)
            Times of the measurements; the first is that of the initial law and has no forecast.
        measurements : array_like, shape (K+1, m, *batch)
            NaN marks a missing component; a time without any measurement gives a forecast.
        indicators : array_like of int, shape (K+1, *batch), optional
            -1 marks a missing one; wanted where the system has an indicator.
        modes : array_like of int, shape (K+1, *batch), optional
            The true modes, wanted by a filter that is told them.
        inputs : mapping of Input to array_like, shape (K+1,) or (K+1, *batch), optional
            Values of the inputs that the model mentions: those of a time act in the dynamics from
            there until the next time, and in the sensor at that time.
        seed : int, SeedSequence or Generator
            Of a filter that draws.
        workers : int
            Threads over blocks of records; the numbers do not depend on it.

        Returns
        -------
        Estimates
            ``mean`` (K+1, n, *batch), ``cov`` (K+1, n, n, *batch), or (K+1, n, n) where it is
            common to all records, ``loglik`` (K+1, *batch), ``diverged`` (*batch) and, of modes,
            ``mode_prob`` (K+1, L, *batch) and ``modes`` (K+1, *batch).

        Raises
        ------
        TypeError, ValueError
            Times that do not increase, infinite measurements, shapes that do not fit, inputs
            that are missing or that the model does not mention, and what `predict` and `correct`
            refuse.
        """
        times, y = self.record(times, measurements)
        batch = y.shape[2:]
        course = course_of(self.system, inputs, len(times), batch)
        shape = (len(times), *batch)
        indicators = as_indicators(indicators, self.system, shape)
        if "modes" in self.takes:
            modes = as_modes("modes", modes, shape, self.system.modes)
        elif modes is not None:
            raise ValueError("modes: wanted none, the filter finds them by itself")
        flat = y.reshape(*y.shape[:2], -1)
        paths = flat.shape[2]
        seen, true = (None if p is None else p.reshape(len(times), -1) for p in (indicators, modes))
        wide, kept, cov = bool(batch) or not self.alone, [], None
        for place, part in enumerate(self.kept(self.initial((1,)))):
            name = Estimates._fields[place]
            if name == "cov":
                cov = np.empty((len(times), *part.shape[:2], paths))
            elif name != "diverged" and part is not None:
                part = np.asarray(part)
                kept.append((place, np.empty((len(times), *part.shape[:-1], paths), part.dtype)))
        diverged = np.zeros(paths, dtype=bool)

        def work(start, stop, stream):
            own = slice(start, stop)
            with on_paths(batch, own) if batch else nullcontext():
                return fill(own, stream, course.of(own))

        def fill(own, stream, held):
            common = []
            rows = [(place, whole[..., own]) for place, whole in kept]
            first = {} if true is None else {"mode": true[0, own]}
            state = self.initial((own.stop - own.start,) if wide else (), stream, **first)
            for k, t in enumerate(times):
                shown = () if seen is None else (seen[k, own],)
                told = {} if true is None else {"mode": true[k, own]}
                row = flat[k, :, own] if wide else y[k]
                if not held.values:
                    state = self.step(state, t, row, *shown, **told)
                else:
                    with held.at(max(k - 1, 0)):
                        state = self.predict(state, t, *told.values())
                    with held.at(k):
                        state = self.correct(state, row, *shown)
                said = self.kept(state)
                for place, whole in rows:
                    whole[k].T[...] = np.asarray(said[place]).T
                shared = said.cov.ndim == 2
                common.append(said.cov if shared else None)
                if not shared:
                    cov[k, :, :, own] = said.cov
                if said.diverged is not None:
                    diverged[own] |= said.diverged
            # what is no number once is no number at the end
            finite = np.isfinite(said.mean).all(axis=0) & np.isfinite(said.cov).all(axis=(0, 1))
            diverged[own] |= ~finite
            return own, common

        blocks = in_blocks(
            work, paths, seed, workers=workers, block=self.block(times, paths, workers)
        )
        shared = _shared(blocks)
        if shared is None:
            for own, common in blocks:
                for k, part in enumerate(common):
                    if part is not None:
                        cov[k, :, :, own] = part[..., None]
            shared = cov.reshape(*cov.shape[:3], *batch)
        found = {Estimates._fields[p]: w.reshape(*w.shape[:-1], *batch) for p, w in kept}
        impossible = found.get("loglik", np.zeros(1)) == -np.inf
        diverged = diverged.reshape(batch) | impossible.any(axis=0)
        return self.completed(Estimates(**found, cov=shared, diverged=diverged))


def _shared(blocks: list) -> np.ndarray | None:
    """Covariances (K+1, n, n) common to all records, or None where they are not."""
    first = blocks[0][1]
    for _, common in blocks:
        for part, wanted in zip(common, first, strict=True):
            if part is None or wanted is None or not np.array_equal(part, wanted, equal_nan=True):
                return None
    return np.stack(first)
