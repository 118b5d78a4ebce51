"""Simulation of a system and its measurements, in blocks of paths with their own streams.

Each block of paths has its own random stream and each interval between two times its own child
of it, so the numbers do not depend on the number of threads, on the order of the blocks, or on
how many paths follow: path i of a small run is path i of a large one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, MaybeArray, Seed
from seedslib.base.blocks import child as descendant
from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_count, as_real, brief
from seedslib.base.values import Inputs, as_trajectory
from seedslib.models.kinds import AnySystem, as_grid

ARRIVALS = 0x41525256
"""Key of the stream that decides what arrives, among the children of a block's."""


class Simulation(NamedTuple):
    """Simulated paths.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    states : ndarray, shape (K+1, n, paths)
    measurements : ndarray, shape (K+1, m, paths)
        NaN for what is not measured.
    modes, indicators : ndarray of int, shape (K+1, paths), or None
        Of a switching system; -1 for an indicator that was not measured.
    """

    times: np.ndarray
    states: np.ndarray
    measurements: np.ndarray
    modes: MaybeArray = None
    indicators: MaybeArray = None


def as_measured(measured: object, count: int, name: str = "measured") -> np.ndarray:
    """Mask of the measured times, shape (K+1,), from None (all), a mask, or a list of indices.

    Raises
    ------
    ValueError
        A mask of another length or an index out of range.
    """
    if measured is None:
        return np.ones(count, dtype=bool)
    given = np.asarray(measured)
    if given.dtype == bool:
        if given.shape != (count,):
            raise ValueError(f"{name}: wanted a mask of shape ({count},), got {given.shape}")
        return given
    if given.ndim != 1 or given.dtype.kind not in "iu" or (np.abs(given) >= count).any():
        raise ValueError(f"{name}: wanted indices from 0 to {count - 1}, got {brief(measured)}")
    mask = np.zeros(count, dtype=bool)
    mask[given] = True
    return mask


class Schedule(NamedTuple):
    """When each component of a measurement is read.

    Attributes
    ----------
    mask : ndarray of bool, shape (K+1, m)
    availability : ndarray, shape (m,), or None
        Probability that a component that is read arrives; None where all do.
    """

    mask: np.ndarray
    availability: MaybeArray = None

    @classmethod
    def of(cls, measured: Any, availability: Any, count: int, size: int) -> Schedule:
        """The schedule of `count` times and `size` components; arguments as `simulate`.

        Raises
        ------
        TypeError, ValueError
            A mask of another shape, an index out of range, no probabilities.
        """
        if np.ndim(measured) == 2:
            mask = np.asarray(measured)
            if mask.dtype != bool or mask.shape != (count, size):
                raise ValueError(
                    f"measured: wanted a mask of shape ({count},) or ({count}, {size}), got "
                    f"{mask.dtype} of shape {mask.shape}"
                )
        else:
            mask = np.repeat(as_measured(measured, count)[:, None], size, axis=1)
        if availability is None:
            return cls(mask)
        chance = as_real("availability", availability)
        if chance.shape not in ((), (size,)) or not ((chance >= 0) & (chance <= 1)).all():
            raise ValueError(
                f"availability: wanted a probability, or {size} of them, got {brief(availability)}"
            )
        return cls(mask, np.broadcast_to(chance, (size,)))

    def leave_out(self, k: int, y: np.ndarray, stream: np.random.SeedSequence) -> None:
        """Put NaN for what is not read or does not arrive in measurements (m, paths) of time k.

        What arrives is drawn from a descendant of the stream that nothing else uses.
        """
        y[~self.mask[k]] = np.nan
        if self.availability is not None:
            rng = np.random.default_rng(descendant(stream, ARRIVALS, k))
            y[self.availability[:, None] <= rng.random(y.shape[::-1]).T] = np.nan


def simulate(
    system: AnySystem,
    times: ArrayLike,
    paths: Count,
    seed: Seed,
    *,
    measured: ArrayLike | None = None,
    availability: ArrayLike | None = None,
    inputs: Inputs | None = None,
    modes: MaybeArray = None,
    workers: int = 1,
    **options: Any,
) -> Simulation:
    """Simulate paths of any system that can be sampled, and what its sensor shows.

    Parameters
    ----------
    system : object
        With ``initial_sample(rng, count)``, ``advance(x, start, stop, rng, p, **options)``,
        ``sensor.sample(t, x, rng, p)`` and ``values(inputs, dt)``, which gives the numbers p.
    times : array_like, shape (K+1,)
        Output times; the first is the time of the initial distribution.
    paths : int
    seed : int, SeedSequence or Generator
    measured : array_like, optional
        Mask (K+1,) or indices of the times with a measurement (default all), or a mask (K+1, m)
        of the components that are read at each time; NaN at the others. An indicator of a
        switching system counts as a component of its own, the last one.
    availability : float or array_like, shape (m,), optional
        Probability that a component that is read arrives, independently at each time and on
        each path; NaN where it does not. States and the numbers that arrive do not depend on it.
    inputs : mapping of Input to array_like, shape (K+1,) or (K+1, paths), optional
        Values of the inputs that the system mentions: those of a time act in the dynamics from
        there until the next time, and in the sensor at that time.
    modes : ndarray of int, shape (K+1, paths), optional
        Modes, which ``initial_sample`` and ``advance`` are given as a last argument.
    workers : int
        Threads over blocks of paths.

    Raises
    ------
    TypeError, ValueError
        Times that do not increase, unequal steps of a system in discrete time, a count below
        one, a wrong mask or seed, no probabilities; inputs that are missing or do not fit.
    """
    times = as_grid("times", times, system)
    paths = as_count("paths", paths)
    schedule = Schedule.of(measured, availability, len(times), system.sensor.size)
    trajectory = as_trajectory(system, inputs, len(times), (paths,))
    states = np.empty((len(times), system.state_size, paths))
    measurements = np.full((len(times), system.sensor.size, paths), np.nan)

    def work(start: int, stop: int, stream: np.random.SeedSequence) -> None:
        own, x = slice(start, stop), None
        own_inputs = trajectory.of(own)
        # a path that leaves the range of numbers shows as inf or NaN in the result
        with np.errstate(over="ignore", invalid="ignore"):
            for k, child in enumerate(stream.spawn(len(times))):
                moving, sensing = (np.random.default_rng(s) for s in child.spawn(2))
                mode = () if modes is None else (modes[k, own],)
                if k == 0:
                    x = system.initial_sample(moving, stop - start, *mode)
                else:
                    before = times[k - 1]
                    p = system.values(own_inputs.at(k - 1), times[k] - before)
                    x = system.advance(x, before, times[k], moving, p, *mode, **options)
                states[k, :, own] = x
                if schedule.mask[k].any():
                    p = system.values(own_inputs.at(k))
                    measurements[k, :, own] = system.sensor.sample(times[k], x, sensing, p)
                    schedule.leave_out(k, measurements[k, :, own], stream)

    in_blocks(work, paths, seed, workers=workers)
    return Simulation(times, states, measurements)
