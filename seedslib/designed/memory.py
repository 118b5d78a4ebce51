"""What a finite-order filter remembers between measurements: U_k, newest block first.

One description covers the filters of the papers: small order (the last estimate), large order
(the last l estimates), finite memory (the last l measurements), mixtures of them, and for
switching systems the decided modes, the indicators and soft decisions (log-odds). The memory
grows at the start: after step k it holds min(k + 1, l) blocks and is never padded with zeros.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_count

COUNTS = ("estimates", "measurements", "indicators")
"""Fields of a memory that count remembered steps."""


class Past(NamedTuple):
    """The remembered blocks, newest first; each block is (size, *batch).

    Attributes
    ----------
    estimates : tuple of ndarray
        Past estimates, with the log-odds of the modes below them where the memory keeps those.
    measurements : tuple of ndarray
        Past measurements.
    modes, indicators : tuple of ndarray of int
        Decided modes (one with each estimate) and past indicators, shape (*batch) each.
    """

    estimates: tuple[Any, ...] = ()
    measurements: tuple[Any, ...] = ()
    modes: tuple[Any, ...] = ()
    indicators: tuple[Any, ...] = ()

    @property
    def vector(self) -> np.ndarray:
        """U_k: estimates newest first, then measurements newest first, shape (dim, *batch)."""
        blocks = self.estimates + self.measurements
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)


@dataclass(frozen=True)
class Memory:
    """Memory of a finite-order filter: how many past values are carried.

    Parameters
    ----------
    estimates : int
        How many past estimates are remembered: the order l of the large-order filter.
    measurements : int
        How many past measurements are remembered.
    indicators : int
        How many past indicators are remembered (switching systems).
    log_odds : bool
        Whether the log-odds of the modes are remembered with each estimate (switching systems).

    Raises
    ------
    TypeError
        Counts that are not whole numbers, or a flag that is not a bool.
    ValueError
        Negative counts, a memory of nothing, or log-odds without estimates.

    Notes
    -----
    State equations (3.1), (3.2) of the jump-diffusion paper and (2.1)-(2.4) of the switching
    paper: U_0 = Z_0, U_k = [Z_k; U_{k-1}] while the memory fills, then the oldest block drops
    out. The matrix C that cuts it off is a slice here.
    """

    estimates: int = 0
    measurements: int = 0
    indicators: int = 0
    log_odds: bool = False

    def __post_init__(self) -> None:
        for name in COUNTS:
            object.__setattr__(self, name, as_count(name, getattr(self, name), 0))
        if not isinstance(self.log_odds, bool | np.bool_):
            raise TypeError(f"log_odds: wanted True or False, got {self.log_odds!r}")
        if not self.estimates + self.measurements:
            raise ValueError("memory: wanted at least one estimate or measurement, got none")
        if self.log_odds and not self.estimates:
            raise ValueError("log_odds: wanted with at least one remembered estimate, got none")

    @property
    def depth(self) -> int:
        """Number of steps after which the memory is full."""
        return max(self.estimates, self.measurements, self.indicators)

    def dimension(self, step: int, estimate: int, measurement: int = 0, modes: int = 1) -> int:
        """Dimension of U_k for k = `step`, from the sizes of an estimate and a measurement.

        The lemma of the jump-diffusion paper: n' min(k + 1, l) for a memory of estimates.
        """
        block = estimate + (modes - 1 if self.log_odds else 0)
        estimates, measurements = min(step + 1, self.estimates), min(step + 1, self.measurements)
        return block * estimates + measurement * measurements

    def order(self, estimate: int, measurement: int = 0, modes: int = 1) -> int:
        """Dimension of the full memory: the order of the filter, l n' for the large-order one."""
        return self.dimension(self.depth, estimate, measurement, modes)

    def push(
        self,
        past: Past,
        *,
        estimate: ArrayLike | None = None,
        measurement: ArrayLike | None = None,
        mode: ArrayLike | None = None,
        indicator: ArrayLike | None = None,
        log_odds: ArrayLike | None = None,
    ) -> Past:
        """Memory after one more step; blocks beyond the memory's length drop out.

        Parameters
        ----------
        past : Past
        estimate : ndarray, shape (n', *batch)
        measurement : ndarray, shape (m, *batch)
        mode, indicator : ndarray of int, shape (*batch), optional
        log_odds : ndarray, shape (modes - 1, *batch), optional

        Raises
        ------
        ValueError
            A block that the memory keeps was not given.
        """
        if self.log_odds and estimate is not None:
            if log_odds is None:
                raise ValueError("log_odds: wanted by this memory, got none")
            estimate = np.concatenate([estimate, log_odds])
        decided = past.modes if mode is None else (mode, *past.modes)[: self.estimates]
        return Past(
            _pushed("estimate", past.estimates, estimate, self.estimates),
            _pushed("measurement", past.measurements, measurement, self.measurements),
            decided,
            _pushed("indicator", past.indicators, indicator, self.indicators),
        )

    def __str__(self) -> str:
        counts = [(getattr(self, name), name) for name in COUNTS]
        parts = [f"{count} {name if count > 1 else name[:-1]}" for count, name in counts if count]
        return ", ".join(parts + ["log-odds of the modes"] * self.log_odds)


def _pushed(name, blocks, new, length):
    if length == 0:
        return ()
    if new is None:
        raise ValueError(f"{name}: wanted by this memory, got none")
    return (new, *blocks)[:length]


def places(memory: Memory, estimate: int, measurement: int, count: int) -> np.ndarray:
    """Which numbers of the full memory are in use after so many measurements.

    An estimate takes up `estimate` of them, a measurement `measurement`.
    """
    estimates = estimate * min(count, memory.estimates)
    measurements = measurement * min(count, memory.measurements)
    start = estimate * memory.estimates
    return np.concatenate([np.arange(estimates), np.arange(start, start + measurements)])


def small_order() -> Memory:
    """Memory of the last estimate: the filter of small order (FMP), of the state's dimension."""
    return Memory(1)


def large_order(l: int) -> Memory:
    """Memory of the last `l` estimates: the large-order filter (FBP), of order l n'.

    Raises
    ------
    TypeError, ValueError
        `l` not a whole number of at least 1.
    """
    return Memory(as_count("l", l))


def finite_memory(l: int) -> Memory:
    """Memory of the last `l` measurements: the finite-memory filter (FKP), of order l m.

    Raises
    ------
    TypeError, ValueError
        `l` not a whole number of at least 1.
    """
    return Memory(measurements=as_count("l", l))
