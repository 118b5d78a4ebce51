"""Kernel regression on tables: sums over paths, smoothed, and their ratio."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import product

import numpy as np

from seedslib.base.tables import Axis, Labels, locate

Axes = tuple[Axis | Labels, ...]

LogDensity = Callable[[slice], np.ndarray]
"""Log-density of measurements for a slice of the paths: (paths, nodes of the measured axes)."""

METHODS = {"likelihood": "likelihood-weighted regression", "histogram": "smoothed histogram"}

KERNEL = 0.5
"""Width in units of the normal reference rule, which is too wide for several peaks."""

ENOUGH = 8.0
"""Paths that a kernel must weigh together before its mean is believed."""

WIDER = (1.0, 2.0, 4.0, 8.0)
"""Factors of the kernel's width, tried in turn."""

CHUNK = 2048
"""Paths whose likelihoods are formed at a time."""

NEGLIGIBLE = 1e-290
"""A sum of weights that is no more than this cannot be divided by."""


def likelihood_table(
    log_density: LogDensity,
    targets: np.ndarray,
    points: np.ndarray,
    measured: Axes,
    axes: Axes,
) -> np.ndarray:
    """M[X | y, u] with the known likelihood of y: the Rao-Blackwellised estimate of section 5.

    f(y, u) = sum_j w_j(u) X_j beta(y | X_j) / sum_j w_j(u) beta(y | X_j), with a kernel w in the
    memory alone.

    Parameters
    ----------
    log_density : callable
    targets : ndarray, shape (p, N)
        X.
    points : ndarray, shape (d, N)
        Memory of the paths.
    measured, axes : tuple of Axis or Labels
        Of what is measured, and of the memory.

    Returns
    -------
    ndarray, shape (p, count of each measured axis and of each axis of the memory...)
    """
    rows = np.concatenate([np.ones((1, targets.shape[1])), targets])
    size = math.prod(axis.count for axis in measured)
    sums = likelihood_sums(log_density, size, rows, points, axes)
    shape = [axis.count for axis in measured + axes]
    counts = path_sums(targets[:0], points, axes)[0]
    sums = sums.reshape(-1, *shape)
    return smoothed_ratio(sums, counts, widths(points, axes), len(measured))


def histogram_table(
    targets: np.ndarray, points: np.ndarray, axes: Axes, pooled: bool = False
) -> np.ndarray:
    """M[X | arguments] from simulated arguments: the smoothed histogram of section 5.

    Parameters
    ----------
    targets : ndarray, shape (p, N)
        X.
    points : ndarray, shape (d, N)
        Measurement and memory of the paths; for a forecast the memory alone.
    axes : tuple of Axis or Labels
    pooled : bool
        Whether the last label of the first axis stands for all paths together.

    Returns
    -------
    ndarray, shape (p, count of each axis...)
    """
    sums = path_sums(targets, points, axes)
    if pooled:
        sums[:, -1] = sums[:, :-1].sum(axis=1)
    return smoothed_ratio(sums, sums[0], widths(points, axes), 0)


def likelihood_sums(
    log_density: LogDensity, size: int, rows: np.ndarray, u: np.ndarray, axes: Axes
) -> np.ndarray:
    """Sums over paths of each row times the likelihood, (rows, points, cells), paths split.

    Parameters
    ----------
    log_density : callable
    size : int
        Number of points of the grid of measurements.
    rows : ndarray, shape (R, N)
    u : ndarray, shape (d, N)
        Memory of the paths.
    axes : tuple of Axis or Labels
    """
    from scipy.sparse import csr_array

    cells = math.prod(axis.count for axis in axes)
    sums = np.zeros((len(rows), cells, size))
    corners = list(_corners(u, axes))
    # relative to the likeliest of some paths, so that far measurements do not vanish
    peak = log_density(slice(0, CHUNK)).max(axis=0)
    peak[np.isneginf(peak)] = 0.0
    for a in range(0, u.shape[1], CHUNK):
        part = slice(a, a + CHUNK)
        likelihood = log_density(part) - peak
        np.exp(np.minimum(likelihood, 600.0, out=likelihood), out=likelihood)
        columns = np.tile(np.arange(len(likelihood)), len(corners))
        numbers = np.concatenate([number[part] for number, _ in corners])
        weights = np.concatenate([weight[part] for _, weight in corners])
        for total, row in zip(sums, rows[:, part], strict=True):
            spread = (weights * row[columns], (numbers, columns))
            total += csr_array(spread, shape=(cells, len(likelihood))) @ likelihood
    return np.moveaxis(sums, 1, 2)


def path_sums(targets: np.ndarray, points: np.ndarray, axes: Axes) -> np.ndarray:
    """Sums (1 + p, nodes...) of one and of the targets, each path split between its nodes."""
    shape = tuple(axis.count for axis in axes)
    rows = np.concatenate([np.ones((1, points.shape[1])), targets])
    sums = np.zeros((len(rows), math.prod(shape)))
    for number, weight in _corners(points, axes):
        for total, row in zip(sums, rows, strict=True):
            total += np.bincount(number, weight * row, minlength=len(total))
    return sums.reshape(len(rows), *shape)


def widths(points: np.ndarray, axes: Axes) -> list[float]:
    """Widths of the kernel, in nodes of each axis: the normal reference rule; labels have none."""
    labels = [isinstance(axis, Labels) for axis in axes]
    size, count = len(axes) - sum(labels), points.shape[1]
    for axis, label in zip(axes, labels, strict=True):
        count /= axis.count if label else 1
    factor = KERNEL * (4.0 / ((size + 2.0) * count)) ** (1.0 / (size + 4.0))
    deviation = points.std(axis=1)
    return [
        0.0 if label else factor * s / axis.step
        for s, axis, label in zip(deviation, axes, labels, strict=True)
    ]


def _corners(points: np.ndarray, axes: Axes) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Number and weight of each of the nodes around the points."""
    place = locate(axes, points)
    index = np.broadcast_to(place.index, points.shape[1:])
    for ups in product((0, 1), repeat=len(place.shares)):
        number, weight = index, np.ones(index.shape)
        for up, stride, share in zip(ups, place.strides, place.shares, strict=True):
            number = number + up * stride
            weight = weight * (share if up else 1.0 - share)
        yield number, weight


def smoothed_ratio(
    sums: np.ndarray, counts: np.ndarray, widths: list[float], lead: int
) -> np.ndarray:
    """Smoothed sums over smoothed weights, with a wider kernel where few paths are.

    Parameters
    ----------
    sums : ndarray, shape (1 + p, lead nodes..., nodes...)
        Of weights and of weighted targets; the `lead` axes are not smoothed.
    counts : ndarray, shape (nodes...)
        Paths at the nodes.
    widths : list of float
        Of the kernel, in nodes.
    lead : int
    """
    total = sums.reshape(*sums.shape[: 1 + lead], -1).sum(axis=-1)
    mean = _quotient(total, np.zeros_like(total[1:]))
    result = np.empty((len(sums) - 1, *sums.shape[1:]))
    result[...] = mean.reshape(*mean.shape, *(1,) * len(widths))
    if not widths:
        return result
    sparse = np.ones(counts.shape, dtype=bool)
    for factor in WIDER:
        wider = [factor * width for width in widths]
        # paths together under the kernel: a Gaussian of width s weighs like a box of 2 s sqrt(pi)
        box = math.prod(max(1.0, 2.0 * math.sqrt(math.pi) * width) for width in wider)
        enough = sparse & (_smoothed(counts, wider, 0) * box >= ENOUGH)
        if enough.any():
            ratio = _quotient(_smoothed(sums, wider, 1 + lead), result)
            result = np.where(enough, ratio, result)
            sparse &= ~enough
        if not sparse.any():
            break
    return result


def _quotient(sums, otherwise):
    """Sums over weights, `otherwise` where there is no weight."""
    return np.divide(sums[1:], sums[:1], out=otherwise.copy(), where=sums[:1] > NEGLIGIBLE)


def _smoothed(array, widths, lead):
    from scipy.ndimage import gaussian_filter1d

    for axis, width in enumerate(widths):
        if width > 0:
            array = gaussian_filter1d(array, width, axis=lead + axis, mode="constant")
    return array
