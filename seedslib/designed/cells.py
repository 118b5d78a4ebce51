"""Cells of a memory with modes: the distributions in them, their numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.designed.lemmas import ModeDistribution
from seedslib.designed.memory import Memory, Past
from seedslib.models.switching import SwitchingSystem


class CellFit(NamedTuple):
    """Normal distribution of state and memory in each cell and mode.

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

    def forecast(self, cell: np.ndarray, z: np.ndarray) -> ModeDistribution:
        """Mode and state given the memory: (6.32) to (6.34).

        Parameters
        ----------
        cell : ndarray of int, shape (*batch)
        z : ndarray, shape (d, *batch)

        Returns
        -------
        ModeDistribution
            Xi (L, *batch), gamma (n, L, *batch), T (n, n, L, *batch).
        """
        with np.errstate(over="ignore", invalid="ignore"):  # diverged paths show as NaN
            weight, centre, white, gain, offset, cov = (self._of_cell(a, cell, z) for a in self)
            residual = z[:, None] - centre
            score = np.zeros(np.broadcast_shapes(weight.shape, (len(weight), *z.shape[1:])))
            score += weight
            for row in white:
                square = row[0] * residual[0]
                for factor, part in zip(row[1:], residual[1:], strict=True):
                    square = square + factor * part
                score -= 0.5 * square * square
            score -= score.max(axis=0)
            score -= np.log(np.exp(score).sum(axis=0))
            mean = np.empty((len(offset), *score.shape))
            for component, row, start in zip(mean, gain, offset, strict=True):
                component[...] = start
                for factor, part in zip(row, z, strict=True):
                    component += factor * part
        return ModeDistribution(score, mean, np.broadcast_to(cov, (*cov.shape[:2], *score.shape)))

    @staticmethod
    def _of_cell(array, cell, z):
        if array.shape[-1] == 1:
            return array.reshape(*array.shape[:-1], *(1,) * (z.ndim - 1))
        return array[..., cell]


def cell_number(past: Past, modes: int, indicators: int, batch: tuple[int, ...]) -> np.ndarray:
    """Number of the memory's cell, newest block first; zeros where no mode is remembered."""
    number = np.zeros(batch, dtype=np.intp)
    for block in past.modes:
        number = number * modes + block
    for block in past.indicators:
        number = number * indicators + block
    return number


def cell_count(memory: Memory, system: SwitchingSystem, k: int) -> int:
    """Number of cells of the memory after measurement k."""
    return system.modes ** min(k + 1, memory.estimates) * system.indicators ** min(
        k + 1, memory.indicators
    )


def require_memory(memory: Memory, system: SwitchingSystem) -> None:
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
