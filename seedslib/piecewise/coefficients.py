"""Coefficients of piecewise-linear maps: their shapes, and the maps themselves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.checks import as_real
from seedslib.base.correction import correct
from seedslib.models.maps import StochasticMap
from seedslib.models.noise import Noise
from seedslib.piecewise.cells import Intervals, Polygons


class Coefficients(NamedTuple):
    """Offset, matrix and noise of a map ``offset + matrix x + noise w``, one per cell.

    The last axis of each array is that of the data sets; its length is 1 unless the coefficients
    follow the estimates.
    """

    offset: np.ndarray  # (m, n, 1 or N)
    matrix: np.ndarray  # (m, k, n, 1 or N)
    noise: np.ndarray  # (m, p, n, 1 or N)


def as_coefficients(
    name: str, parts: tuple[Any, ...], cells: int, size: int, rows: int | None
) -> Coefficients:
    """Arrays with a cell axis and an axis of data sets, from arrays that may lack both."""
    if len(parts) != 3 or any(part is None for part in parts):
        raise ValueError(f"{name}: wanted an offset, a matrix and a noise, got None among them")
    labels = [f"{name} ({what})" for what in Coefficients._fields]
    arrays = [as_real(label, part) for label, part in zip(labels, parts, strict=True)]
    offset, _, noise = arrays
    rows = len(offset) if rows is None and offset.ndim else rows
    wanted = ((rows,), (rows, size), (rows, noise.shape[1] if noise.ndim > 1 else -1))
    full = []
    for label, part, core in zip(labels, arrays, wanted, strict=True):
        depth = part.ndim - len(core)
        if part.shape[: len(core)] != core or depth not in (0, 1, 2):
            raise ValueError(f"{label}: wanted shape {core} and the cells, got {part.shape}")
        if depth and part.shape[len(core)] != cells:
            raise ValueError(
                f"{label}: wanted {cells} cells along axis {len(core)}, got shape {part.shape}"
            )
        part = part.reshape(part.shape + (1,) * (2 - depth))
        full.append(np.broadcast_to(part, (*core, cells, part.shape[-1])))
    return Coefficients(*full)


def affine_map(
    cells: Intervals | Polygons, size: int, coefficients: Callable[..., Any], reference: float
) -> StochasticMap:
    """The piecewise-linear map with the coefficients ``coefficients(t)`` at time t.

    The shapes are looked up at the time `reference`.
    """
    rows, width = coefficients(reference).noise.shape[:2]

    def at(t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c, cell = coefficients(t), cells.locate(x[: cells.size])
        moved = np.einsum("ij...,j...->i...", c.matrix[:, :, cell, 0], x)
        return c.offset[:, cell, 0] + moved, c.noise[:, :, cell, 0]

    def value(t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        mean, gain = at(t, x)
        return mean + np.einsum("ij...,j...->i...", gain, v)

    def cov(t: float, x: np.ndarray) -> np.ndarray:
        gain = at(t, x)[1]
        return np.einsum("ip...,jp...->ij...", gain, gain)

    def log_density(t: float, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        known = np.zeros((1, *(1,) * (x.ndim - 1)))
        blind = np.zeros((1, rows, *(1,) * (x.ndim - 1)))
        return correct(known, None, y, (at(t, x)[0], blind, cov(t, x)))[2]

    return StochasticMap.from_functions(
        size, rows, value, Noise(width), mean=lambda t, x: at(t, x)[0], cov=cov,
        log_density=log_density,
    )  # fmt: skip
