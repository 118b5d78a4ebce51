"""Kernel regression on tables: sums over paths, smoothed, and their ratio."""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from seedslib.base.tables import Labels

METHODS = {
    "likelihood": "likelihood-weighted regression",
    "histogram": "smoothed histogram",
}

ENOUGH = 8.0
"""Paths that a kernel must weigh together before its mean is believed."""

WIDER = (1.0, 2.0, 4.0, 8.0)
"""Factors of the kernel's width, tried in turn."""

CHUNK = 2048
"""Paths whose likelihoods are formed at a time."""

NOTHING = 1e-290


def likelihood_table(sensor, t, lesson, components, axes_y, axes_u, kernel) -> np.ndarray:
    """M[X | y, u] with the known likelihood of y: the Rao-Blackwellised estimate of section 5.

    f(y, u) = sum_j w_j(u) X_j beta(y | X_j) / sum_j w_j(u) beta(y | X_j), with a kernel w in the
    memory alone.

    Parameters
    ----------
    sensor : StochasticMap
        With a log-density.
    t : float
    lesson : Lesson
        Its measurements are not used.
    components : int
        n'.
    axes_y, axes_u : tuple of Axis
    kernel : float
        Width in units of the normal reference rule.

    Returns
    -------
    ndarray, shape (n', count of each axis of y and u...)
    """
    grid = mesh(axes_y)[:, None, :]
    x, u = lesson.states, lesson.memory
    rows = np.concatenate([np.ones((1, x.shape[1])), x[:components]])

    def log_density(part):
        return sensor.log_density(t, grid, x[:, part, None])

    sums = likelihood_sums(log_density, grid.shape[2], rows, u, axes_u)
    shape = [axis.count for axis in axes_y + axes_u]
    counts = path_sums(x[:0], u, axes_u)[0]
    return smoothed_ratio(sums.reshape(-1, *shape), counts, widths(u, axes_u, kernel), len(axes_y))


def mesh(axes) -> np.ndarray:
    """Points of a product of axes, (size, points)."""
    grid = np.meshgrid(*[axis.nodes for axis in axes], indexing="ij")
    return np.array([part.ravel() for part in grid])


def likelihood_sums(log_density, size, rows, u, axes_u) -> np.ndarray:
    """Sums over paths of each row times the likelihood, (rows, points, cells), paths split.

    Parameters
    ----------
    log_density : callable
        ``log_density(part)`` for a slice of the paths: (paths, points).
    size : int
        Number of points of the grid of measurements.
    rows : ndarray, shape (R, N)
    u : ndarray, shape (d, N)
        Memory of the paths.
    axes_u : tuple of Axis or Labels
    """
    from scipy.sparse import csr_array

    cells = math.prod(axis.count for axis in axes_u)
    sums = np.zeros((len(rows), cells, size))
    corners = list(_corners(u, axes_u))
    # relative to the likeliest of some paths, so that far measurements do not vanish
    peak = log_density(slice(0, CHUNK)).max(axis=0)
    peak[np.isneginf(peak)] = 0.0
    for a in range(0, u.shape[1], CHUNK):
        part = slice(a, a + CHUNK)
        likely = log_density(part) - peak
        likely = np.exp(np.minimum(likely, 600.0, out=likely), out=likely)
        columns = np.tile(np.arange(len(likely)), len(corners))
        numbers = np.concatenate([number[part] for number, _ in corners])
        weights = np.concatenate([weight[part] for _, weight in corners])
        for total, row in zip(sums, rows[:, part], strict=True):
            spread = (weights * row[columns], (numbers, columns))
            total += csr_array(spread, shape=(cells, len(likely))) @ likely
    return np.moveaxis(sums, 1, 2)


def histogram_table(lesson, components, axes_y, axes_u, kernel) -> np.ndarray:
    """M[X | y, u] from simulated measurements: the smoothed histogram of section 5.

    Parameters and result as `likelihood_table`.
    """
    points, axes = np.concatenate([lesson.measurements, lesson.memory]), axes_y + axes_u
    sums = path_sums(lesson.states[:components], points, axes)
    return smoothed_ratio(sums, sums[0], widths(points, axes, kernel), 0)


def forecast_table(lesson, components, axes_u, kernel) -> np.ndarray:
    """M[X | u], shape (n', count of each axis of u...)."""
    sums = path_sums(lesson.states[:components], lesson.memory, axes_u)
    return smoothed_ratio(sums, sums[0], widths(lesson.memory, axes_u, kernel), 0)


def path_sums(targets, points, axes):
    """Sums (1 + p, nodes...) of one and of the targets, each path split between its nodes."""
    shape = tuple(axis.count for axis in axes)
    rows = np.concatenate([np.ones((1, points.shape[1])), targets])
    sums = np.zeros((len(rows), math.prod(shape)))
    for number, weight in _corners(points, axes):
        for total, row in zip(sums, rows, strict=True):
            total += np.bincount(number, weight * row, minlength=len(total))
    return sums.reshape(len(rows), *shape)


def widths(points, axes, kernel):
    """Widths of the kernel, in nodes of each axis: the normal reference rule; labels have none."""
    labels = [isinstance(axis, Labels) for axis in axes]
    size, count = len(axes) - sum(labels), points.shape[1]
    for axis, label in zip(axes, labels, strict=True):
        count /= axis.count if label else 1
    factor = kernel * (4.0 / ((size + 2.0) * count)) ** (1.0 / (size + 4.0))
    deviation = points.std(axis=1)
    return [
        0.0 if label else factor * s / axis.step
        for s, axis, label in zip(deviation, axes, labels, strict=True)
    ]


def _corners(points, axes):
    """Number and weight of each of the nodes around the points."""
    if not axes:
        yield np.zeros(points.shape[1], dtype=np.intp), np.ones(points.shape[1])
        return
    places = [axis.place(row) for axis, row in zip(axes, points, strict=True)]
    for ups in product(*((0,) if share is None else (0, 1) for _, share in places)):
        number, weight = 0, 1.0
        for up, axis, (index, share) in zip(ups, axes, places, strict=True):
            number = number * axis.count + index + up
            if share is not None:
                weight = weight * (share if up else 1.0 - share)
        yield number, np.broadcast_to(weight, number.shape)


def smoothed_ratio(sums, counts, widths, lead):
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
    everywhere = sums.reshape(*sums.shape[: 1 + lead], -1).sum(axis=-1)
    everywhere = _quotient(everywhere, np.zeros_like(everywhere[1:]))
    result = np.empty((len(sums) - 1, *sums.shape[1:]))
    result[...] = everywhere.reshape(*everywhere.shape, *(1,) * len(widths))
    if not widths:
        return result
    unsettled = np.ones(counts.shape, dtype=bool)
    for factor in WIDER:
        wide = [factor * width for width in widths]
        # paths together under the kernel: a Gaussian of width s weighs like a box of 2 s sqrt(pi)
        box = math.prod(max(1.0, 2.0 * math.sqrt(math.pi) * width) for width in wide)
        good = unsettled & (_smoothed(counts, wide, 0) * box >= ENOUGH)
        if good.any():
            found = _quotient(_smoothed(sums, wide, 1 + lead), result)
            result = np.where(good, found, result)
            unsettled &= ~good
        if not unsettled.any():
            break
    return result


def _quotient(sums, otherwise):
    """Sums over weights, `otherwise` where there is no weight."""
    return np.divide(sums[1:], sums[:1], out=otherwise.copy(), where=sums[:1] > NOTHING)


def _smoothed(array, widths, lead):
    from scipy.ndimage import gaussian_filter1d

    for axis, width in enumerate(widths):
        if width > 0:
            array = gaussian_filter1d(array, width, axis=lead + axis, mode="constant")
    return array
