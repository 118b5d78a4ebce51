"""What a designed filter of a switching system knows of mode and state given its memory: lemma 5.

The memory is a cell (the remembered modes and indicators) and a vector (the remembered estimates
and measurements). In each cell and mode the state and the vector are taken for jointly normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.designed.memory import Memory, Past
from seedslib.designed.shapes import check_array, check_covariances, check_fields
from seedslib.designed.switching.lemmas import ModeLaw
from seedslib.models.kinds import AnySystem


class CellFit(NamedTuple):
    """Normal law of state and memory in each cell and mode.

    With C cells, L modes and a memory of d numbers:

    Attributes
    ----------
    log_weight : ndarray, shape (L, C)
        Logarithm of the probability of cell and mode, less that of the density's factor.
    centre : ndarray, shape (d, L, C)
    white : ndarray, shape (d, d, L, C)
        The density of the memory falls with half the square of ``white (z - centre)``; rows of
        zeros where the memory is singular.
    gain, offset : ndarray, shapes (n, d, L, C) and (n, L, C)
        Gamma and kappa of (6.34).
    cov : ndarray, shape (n, n, L, C)
        T of (6.34).
    """

    log_weight: np.ndarray
    centre: np.ndarray
    white: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    cov: np.ndarray

    def forecast(self, cell: np.ndarray, z: np.ndarray) -> ModeLaw:
        """Law of mode and state given the memory: (6.32) to (6.34).

        Parameters
        ----------
        cell : ndarray of int, shape (*batch)
        z : ndarray, shape (d, *batch)

        Returns
        -------
        ModeLaw
            Xi (L, *batch), gamma (n, L, *batch), T (n, n, L, *batch).
        """
        with np.errstate(over="ignore", invalid="ignore"):  # lost paths show as NaN
            return self._forecast(cell, z)

    def _forecast(self, cell, z):
        weight, centre, white, gain, offset, cov = (self._take(part, cell, z) for part in self)
        apart = z[:, None] - centre
        score = np.zeros(np.broadcast_shapes(weight.shape, (len(weight), *z.shape[1:])))
        score += weight
        for row in white:
            residual = row[0] * apart[0]
            for factor, part in zip(row[1:], apart[1:], strict=True):
                residual = residual + factor * part
            score -= 0.5 * residual * residual
        score -= score.max(axis=0)
        score -= np.log(np.exp(score).sum(axis=0))
        mean = np.empty((len(offset), *score.shape))
        for slot, row, start in zip(mean, gain, offset, strict=True):
            slot[...] = start
            for factor, part in zip(row, z, strict=True):
                slot += factor * part
        return ModeLaw(score, mean, np.broadcast_to(cov, (*cov.shape[:2], *score.shape)))

    def check(self, name: str, memory: Memory, system: AnySystem, k: int, classes: int = 1) -> None:
        """Refuse arrays that are not those of the memory after measurement k."""
        n, modes = system.state_size, system.modes
        d = memory.dimension(k, n, system.measurement_size, modes)
        tail = modes, classes * cell_count(memory, system, k)
        check_fields(
            name, self, gain=(n, d, *tail), offset=(n, *tail), cov=(n, n, *tail),
            centre=(d, *tail), white=(d, d, *tail),
        )  # fmt: skip
        # a mode that is never met in a cell has the weight zero
        check_array(f"{name}.log_weight", self.log_weight, *tail, finite=False)
        check_covariances(name, [np.moveaxis(self.cov, (0, 1), (-2, -1))])

    def _take(self, part, cell, z):
        if part.shape[-1] == 1:
            return part.reshape(*part.shape[:-1], *(1,) * (z.ndim - 1))
        return part[..., cell]


class ClassFit(NamedTuple):
    """Laws in the cells of the memory for each class of histories, one class after the other.

    Attributes
    ----------
    fit : CellFit
        With the cells of the first class, then those of the next.
    """

    fit: CellFit

    def forecast(self, cell: np.ndarray, z: np.ndarray) -> ModeLaw:
        """As `CellFit.forecast`; the cells of a class come after those of the one before it."""
        return self.fit.forecast(cell, z)


def cell_number(past: Past, modes: int, indicators: int, batch: tuple[int, ...]) -> np.ndarray:
    """Number of the memory's cell, newest block first; zeros where no mode is remembered."""
    number = np.zeros(batch, dtype=np.intp)
    for block in past.modes:
        number = number * modes + block
    for block in past.indicators:
        number = number * indicators + block
    return number


def cell_count(memory: Memory, system: AnySystem, k: int) -> int:
    """Number of cells of the memory after measurement k."""
    return system.modes ** min(k + 1, memory.estimates) * system.indicators ** min(
        k + 1, memory.indicators
    )


def require_memory(memory: Memory, system: AnySystem) -> None:
    """Refuse a memory of what a switching system does not have.

    Raises
    ------
    TypeError, ValueError
        No memory; one of indicators where there are none, or of log-odds of one mode.
    """
    if not isinstance(memory, Memory):
        raise TypeError(f"memory: wanted a Memory, got {memory!r}")
    if memory.indicators and not system.indicators:
        raise ValueError(f"memory: wanted no indicators, the system has none: {memory}")
    if memory.log_odds and system.modes == 1:
        raise ValueError("memory: wanted several modes for log-odds, got one")
