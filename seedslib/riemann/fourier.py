"""Fourier series, projections and the winding number on the nodes of the unit circle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ZERO = 1e-12  # |G| below this part of its largest value counts as a zero on the circle
PHASE = 0.9 * np.pi  # largest step of the phase between nodes that still gives a certain index


class UnresolvedError(ValueError):
    """The nodes are too few to count the turns of a phase."""


def circle(nodes: int | np.integer) -> NDArray[np.complex128]:
    """Nodes ``exp(2 pi i j / M)`` of the unit circle, shape ``(M,)``."""
    return np.exp(2j * np.pi * np.arange(nodes) / nodes)


def fourier(values: np.ndarray) -> np.ndarray:
    return np.fft.fft(values, axis=0) / len(values)


def series(coefficients: np.ndarray) -> np.ndarray:
    return np.fft.ifft(coefficients, axis=0) * len(coefficients)


def split(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cauchy projections: ``h = h+ - h-``, the Nyquist mode counted as negative."""
    half = (len(coefficients) + 1) // 2
    plus, minus = coefficients.copy(), -coefficients
    plus[half:], minus[:half] = 0.0, 0.0
    return series(plus), series(minus)


def tail(coefficients: np.ndarray, scale: float = 0.0) -> float:
    """Size of the highest frequencies (the last sixteenth), relative to the largest or `scale`."""
    nodes = len(coefficients)
    width, middle = max(1, nodes // 32), nodes // 2
    sizes = np.abs(coefficients)
    largest = max(sizes.max(), scale)
    return float(sizes[middle - width : middle + width + 1].max() / largest) if largest else 0.0


def winding(values: np.ndarray) -> int:
    """Index: turns of the phase of ``(M,)`` values around the closed circle.

    Raises
    ------
    ValueError
        A zero on the circle, or a phase step between nodes of 0.9 pi or more, where the
        number of turns is uncertain.
    """
    sizes = np.abs(values)
    if not sizes.min() > ZERO * sizes.max():
        raise ValueError(
            f"coefficient: wanted no zero on the circle, got values from {sizes.min():.3g} "
            f"to {sizes.max():.3g}"
        )
    steps = np.angle(np.roll(values, -1) / values)
    if np.abs(steps).max() >= PHASE:
        raise UnresolvedError(
            f"coefficient: wanted phase steps below 0.9 pi, got {np.abs(steps).max():.3g} with "
            f"{len(values)} nodes; the index is uncertain, take more nodes"
        )
    return round(steps.sum() / (2 * np.pi))
