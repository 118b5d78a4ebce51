"""One notion of the same time.

Times come from sums, products and files, so that what is meant as one time differs in its last
digits. Two times are the same when they are nearer than a billionth of the shortest interval, or
than a few roundings of numbers of their size, whatever the unit and wherever zero is.
"""

from __future__ import annotations

import math

import numpy as np

SAME = 1e-9
"""Part of the shortest interval within which times are one."""

ROUNDING = 2.0**-50
"""Part of a time within which times are one: two to four units in its last place on each side."""

MOST_STEPS = 10_000_000
"""Steps that one span of time may be divided into: minutes of work, where more has no end."""


def when(t: float) -> str:
    """A time in words: six digits, and three behind the point however many stand before it.

    Times that count the seconds since some day are told apart by their last digits.
    """
    return f"{t:.{max(6, len(f'{abs(t):.0f}') + 3)}g}"


def slack(interval: float, size: float) -> float:
    """How far two times of a given size may be apart and be the same, in a grid of intervals.

    Never more than a quarter of the interval: neighbours in a grid are two times.
    """
    return min(max(SAME * interval, ROUNDING * size), 0.25 * interval)


class Clock:
    """Times of a grid, and which other times are the same.

    Parameters
    ----------
    times : ndarray, shape (K,)
        Increasing.
    end : float, optional
        The last time that will be asked about, where it is later.

    Attributes
    ----------
    times : list of float
    interval : float
        The shortest between two of them.
    tolerance : float
        How far apart two times are the same.
    """

    def __init__(self, times: np.ndarray, end: float | None = None) -> None:
        self.times: list[float] = np.asarray(times, dtype=float).tolist()
        last = self.times[-1] if end is None else max(float(end), self.times[-1])
        steps = np.diff([*self.times, last] if len(self.times) == 1 else self.times)
        # one time alone has no interval: what is left is the rounding of its size
        self.interval = float(steps.min()) if steps.any() else 4.0 * ROUNDING * abs(last)
        self.tolerance: float = slack(self.interval, max(abs(self.times[0]), abs(last)))

    def same(self, t: float, other: float) -> bool:
        """Whether two times are one, also where they lie beyond the grid."""
        return abs(t - other) <= max(self.tolerance, slack(self.interval, abs(other)))

    def prolonged(self, end: float, cycle: int) -> Clock:
        """The same clock, which goes on to a later time with its last `cycle` intervals in turn.

        Raises
        ------
        ValueError
            More times than `step_count` allows.
        """
        count, last = len(self.times), self.times[-1]
        span = last - self.times[-1 - cycle]
        step_count(last, end, span / cycle)
        most = count + cycle * max(0, math.ceil((end - last) / span) + 1)
        later = [self.moment(k, cycle) for k in range(count, most)]
        later = [t for t in later if t <= end + slack(self.interval, abs(end))]
        return Clock(np.array(self.times + later)) if later else self

    def moment(self, k: int, cycle: int) -> float:
        """Time number k; beyond the last one the last `cycle` intervals go on in turn."""
        last = len(self.times) - 1
        if k <= last:
            return self.times[k]
        laps, rest = divmod(k - last, cycle)
        first = self.times[last - cycle]
        return self.times[last - cycle + rest] + (laps + 1) * (self.times[last] - first)

    def rows(self, other: np.ndarray) -> np.ndarray:
        """Where the times of this clock lie in another grid, shape (K,).

        Parameters
        ----------
        other : ndarray, shape (J,)
            Increasing; may be empty.

        Returns
        -------
        ndarray of int
            The row of the nearest time; -1 where none is the same.
        """
        times, other = np.array(self.times), np.asarray(other, dtype=float)
        if not len(other):
            return np.full(len(times), -1)
        after = np.searchsorted(other, times).clip(max=len(other) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(other[after] - times < times - other[before], after, before)
        return np.where(np.abs(other[nearest] - times) <= self.tolerance, nearest, -1)


def step_count(start: float, stop: float, step: float) -> int:
    """Number of equal steps of at most `step`, but for a billionth, between two times.

    Raises
    ------
    ValueError
        More than `MOST_STEPS` of them.
    """
    wanted = (stop - start) / step - SAME
    if not wanted <= MOST_STEPS:
        raise ValueError(
            f"times: wanted at most {MOST_STEPS} steps in one interval, got {wanted:.3g} of "
            f"{step:g} between {when(start)} and {when(stop)}"
        )
    return max(1, math.ceil(wanted))


def lengths_alike(steps: np.ndarray) -> np.ndarray:
    """Lengths of intervals without the last digits, in which the steps of an even grid differ."""
    mantissa, exponent = np.frexp(steps)
    return np.ldexp(np.round(mantissa * 2.0**39), exponent - 39)
