"""How cells of a switching filter's memory are fitted, from simulated moments or given ones."""

from __future__ import annotations

import numpy as np

from seedslib.base.semidefinite import NEGATIVE
from seedslib.design.regression import Scatter, combine, inverse_root
from seedslib.designed.switching.fits import CellFit

JITTER = 1e-8
"""Added to the covariance of the whitened memory before it is inverted."""

FEWEST = 50
"""Fewer samples than this make a cell thin."""


def cells_from_moments(
    prob: np.ndarray, mean: np.ndarray, cov: np.ndarray, size: int, *, jitter: float = JITTER
) -> CellFit:
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

    Returns
    -------
    CellFit
    """
    cells = []
    for c in range(prob.shape[1]):
        parts = [Scatter(p, mean[:, i, c], p * cov[:, :, i, c]) for i, p in enumerate(prob[:, c])]
        pooled = combine([part for part in parts if part.count > 0])
        moments = [part if part.count > 0 else pooled for part in parts]
        cells.append(_cell(prob[:, c], moments, pooled, size, jitter)[0])
    return _stacked(cells)


def fit_cells(scatters: list[list[Scatter]], size: int, total: int) -> tuple[CellFit, int, int]:
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
    mended : int
        Covariances T whose eigenvalues were raised.
    """
    modes = len(scatters[0])
    everything = combine([part for row in scatters for part in row])
    by_mode = [combine([row[i] for row in scatters]) for i in range(modes)]
    cells, thin, raised = [], 0, 0
    for row in scatters:
        pooled = combine(row)
        basis = pooled if pooled.count >= FEWEST else everything
        rank = inverse_root(basis.cov[size:, size:], _sizes(basis, size)).shape[1]
        least = max(FEWEST, 3 * (rank + 1))
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
    return _stacked(cells), thin, raised


def _stacked(cells):
    return CellFit(*(np.stack(parts, axis=-1) for parts in zip(*cells, strict=True)))


def _sizes(part, n):
    return np.sqrt(np.diagonal(part.cov)[n:] + part.mean[n:] ** 2)


def _cell(weights, moments, basis, n, jitter):
    """Arrays of one cell, and how many covariances were mended."""
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
        least = NEGATIVE * max(np.trace(part.cov[:n, :n]), 0.0)
        negative = values < -least
        raised += int(negative.any())
        values = np.where(negative, least, np.maximum(values, 0.0))
        cov[:, :, i] = (vectors * values) @ vectors.T
        with np.errstate(divide="ignore"):
            log_weight[i] = np.log(weight) - np.log(np.diagonal(lower)).sum()
    return (log_weight, centre, white, gain, offset, cov), raised
