"""What a designed filter of a switching system knows of mode and state given its memory: lemma 5.

The memory is a cell (the remembered modes and indicators) and a vector (the remembered estimates
and measurements). In each cell and mode the state and the vector are taken for jointly normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.designed.lemmas import FLOOR, Law
from seedslib.designed.memory import Memory
from seedslib.designed.regression import Scatter, inverse_root, merge

JITTER = 1e-8
"""Added to the covariance of the whitened memory before it is inverted."""

LEAST = 50
"""Fewer samples than this make a cell thin."""


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

    @classmethod
    def from_moments(cls, prob, mean, cov, size, *, jitter=JITTER) -> CellFit:
        """Fit from given moments of state and memory together, instead of simulated ones.

        Parameters
        ----------
        prob : ndarray, shape (L, C)
            Probabilities of mode and cell.
        mean : ndarray, shape (n + d, L, C)
            Of the state and, below it, the memory.
        cov : ndarray, shape (n + d, n + d, L, C)
        size : int
            n.
        jitter : float
            Added to the covariance of the whitened memory.
        """
        cells = []
        for c in range(prob.shape[1]):
            parts = [
                Scatter(p, mean[:, i, c], p * cov[:, :, i, c]) for i, p in enumerate(prob[:, c])
            ]
            pooled = merge([part for part in parts if part.count > 0])
            moments = [part if part.count > 0 else pooled for part in parts]
            cells.append(_cell(prob[:, c], moments, pooled, size, jitter)[0])
        return cls._stacked(cells)

    @classmethod
    def _stacked(cls, cells) -> CellFit:
        return cls(*(np.stack(parts, axis=-1) for parts in zip(*cells, strict=True)))

    def forecast(self, cell, z) -> Law:
        """Law of mode and state given the memory: (6.32) to (6.34).

        Parameters
        ----------
        cell : ndarray of int, shape (*batch)
        z : ndarray, shape (d, *batch)

        Returns
        -------
        Law
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
        return Law(score, mean, np.broadcast_to(cov, (*cov.shape[:2], *score.shape)))

    def _take(self, part, cell, z):
        if part.shape[-1] == 1:
            return part.reshape(*part.shape[:-1], *(1,) * (z.ndim - 1))
        return part[..., cell]


def cell_number(past, modes, indicators, batch) -> np.ndarray:
    """Number of the memory's cell, newest block first; zeros where no mode is remembered."""
    number = np.zeros(batch, dtype=np.intp)
    for block in past.modes:
        number = number * modes + block
    for block in past.indicators:
        number = number * indicators + block
    return number


def cell_count(memory, system, k) -> int:
    """Number of cells of the memory after measurement k."""
    return system.modes ** min(k + 1, memory.estimates) * system.indicators ** min(
        k + 1, memory.indicators
    )


def require_memory(memory, system) -> None:
    """Refuse a memory of what a switching system does not have.

    Raises
    ------
    TypeError, ValueError
        No memory; one of indicators where there are none, or of log-odds of one mode.
    """
    if not isinstance(memory, Memory):
        raise TypeError(f"memory: wanted a Memory, got {memory!r}")
    if memory.indicators and not system.has_indicator:
        raise ValueError(f"memory: wanted no indicators, the system has none: {memory}")
    if memory.log_odds and system.modes == 1:
        raise ValueError("memory: wanted several modes for log-odds, got one")


def require_fits(fits, memory, system) -> None:
    """Refuse fits that are not those of this memory and system.

    Raises
    ------
    ValueError
        A fit for a memory of another size, or for another number of modes.
    """
    n, m = system.state_size, system.measurement_size
    for k, fit in enumerate(fits):
        if not isinstance(fit, CellFit):
            continue
        d, cells = memory.dimension(k, n, m, system.modes), cell_count(memory, system, k)
        wanted = (n, d, system.modes, cells)
        if fit.gain.shape != wanted:
            raise ValueError(
                f"fits: wanted gains of shape {wanted} after measurement {k} for this memory, got "
                f"{fit.gain.shape}"
            )


def fits_apart(fits, memory) -> float:
    """How far the last two forecasts are apart, in deviations of the state given the memory.

    Root of the mean square over cells and modes, at the means of the memory, with the
    probabilities of the last fit.

    Raises
    ------
    ValueError
        No two fits of a whole memory, or fits of another kind.
    """
    if memory is None or len(fits) < memory.depth + 2:
        raise ValueError("times: wanted a design of more steps than the memory's depth")
    before, last = fits[-2:]
    if not (isinstance(before, CellFit) and isinstance(last, CellFit)):
        raise ValueError("fits: wanted two CellFits to compare, got others")
    weight = np.exp(last.log_weight - last.log_weight.max())
    weight /= weight.sum()
    size = np.sqrt(np.einsum("iilc,lc->i", last.cov, weight))
    shift = before.offset + (before.gain * last.centre).sum(axis=1)
    shift -= last.offset + (last.gain * last.centre).sum(axis=1)
    scaled = np.sqrt((weight * shift**2).sum(axis=(1, 2))) / size
    return float(np.sqrt((scaled**2).mean()))


def fit_cells(scatters, size, total) -> tuple[CellFit, int, int]:
    """Fit from samples, with the rules for thin cells.

    Moments of a mode in a cell with fewer than max(50, 3 (r + 1)) samples, r the rank of the
    memory there, are pooled over the modes of the cell; where that is thin too, over the cells of
    the mode; where even that is thin, over everything. No probability is zero: a cell never met
    in the design works online.

    Parameters
    ----------
    scatters : list of list of Scatter
        Moments of state and memory for each cell and mode.
    size : int
        n.
    total : int
        Number of samples.

    Returns
    -------
    fit : CellFit
    thin : int
        Pairs of cell and mode that borrowed their moments.
    floored : int
        Covariances T whose eigenvalues were raised.
    """
    modes = len(scatters[0])
    everything = merge([part for row in scatters for part in row])
    by_mode = [merge([row[i] for row in scatters]) for i in range(modes)]
    cells, thin, raised = [], 0, 0
    for row in scatters:
        pooled = merge(row)
        basis = pooled if pooled.count >= LEAST else everything
        rank = inverse_root(basis.cov[size:, size:], _sizes(basis, size)).shape[1]
        least = max(LEAST, 3 * (rank + 1))
        basis = pooled if pooled.count >= least else everything
        moments = []
        for i, part in enumerate(row):
            if part.count < least:
                thin += 1
                part = next(
                    (p for p in (pooled, by_mode[i], everything) if p.count >= least), everything
                )
            moments.append(part)
        weights = np.array([max(part.count, 0.5) for part in row]) / total
        cell, floors = _cell(weights, moments, basis, size, JITTER)
        cells.append(cell)
        raised += floors
    return CellFit._stacked(cells), thin, raised


def _sizes(part, n):
    return np.sqrt(np.diagonal(part.cov)[n:] + part.mean[n:] ** 2)


def _cell(weights, moments, basis, n, jitter):
    """Arrays of one cell, and how many covariances were floored."""
    d = len(basis.mean) - n
    root = inverse_root(basis.cov[n:, n:], _sizes(basis, n))
    rank, modes = root.shape[1], len(weights)
    log_weight, centre = np.empty(modes), np.empty((d, modes))
    white, gain = np.zeros((d, d, modes)), np.zeros((n, d, modes))
    offset, cov = np.empty((n, modes)), np.empty((n, n, modes))
    raised = 0
    for i, (weight, part) in enumerate(zip(weights, moments, strict=True)):
        inner = root.T @ part.cov[n:, n:] @ root + jitter * np.eye(rank)
        cross = part.cov[:n, n:] @ root
        lower = np.linalg.cholesky(inner)
        half = np.linalg.solve(lower, cross.T)
        scaled = np.linalg.solve(lower, root.T)
        gain[:, :, i] = half.T @ scaled
        white[:rank, :, i] = scaled
        centre[:, i] = part.mean[n:]
        offset[:, i] = part.mean[:n] - gain[:, :, i] @ part.mean[n:]
        rest = part.cov[:n, :n] - half.T @ half
        # a function of the matrix: the same for every basis of its eigenvectors
        values, vectors = np.linalg.eigh(0.5 * (rest + rest.T))
        least = FLOOR * max(np.trace(part.cov[:n, :n]), 0.0)
        negative = values < -least
        raised += int(negative.any())
        values = np.where(negative, least, np.maximum(values, 0.0))
        cov[:, :, i] = (vectors * values) @ vectors.T
        with np.errstate(divide="ignore"):
            log_weight[i] = np.log(weight) - np.log(np.diagonal(lower)).sum()
    return (log_weight, centre, white, gain, offset, cov), raised
