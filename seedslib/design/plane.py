"""A state in the plane and one remembered estimate on a grid: theorems 1 and 2 for n = 2."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import as_times
from seedslib.base.progress import followed
from seedslib.base.tables import AxesLike, as_axes, locate, mesh
from seedslib.design.joint import NEGLIGIBLE, likelihood_of, posterior_means
from seedslib.filters.weights import most_probable

FAINT = 1e-7
"""Share of the probability of a state, a measurement or a cell that is left out."""


class PlaneStep(NamedTuple):
    """What is optimal at one measurement, on a grid of measurements and memories.

    Attributes
    ----------
    time : float
    cells : ndarray of int, shape (C,)
        Numbers of the cells of the memory that have probability: the decided mode, then the
        nodes of both axes, the last one fastest. One cell, 0, before the first measurement.
    dist : ndarray, shape (S, C)
        Joint distribution of the chain and the memory before the measurement.
    likelihood : ndarray, shape (Y, S)
        With quadrature weights; columns sum to one.
    mean : ndarray, shape (2, Y, C)
        f_k(y, u), the conditional mean of the state.
    mode : ndarray of int, shape (Y, C), or None
        The most probable mode, of a chain with modes.
    mass : ndarray, shape (Y, C)
        Probability of measurement and memory.
    mse : ndarray, shape (2,)
        M(X - Z_k)² of each component.
    mode_error : float
        Probability of a wrong mode.
    """

    time: float
    cells: np.ndarray
    dist: np.ndarray
    likelihood: np.ndarray
    mean: np.ndarray
    mode: MaybeArray
    mass: np.ndarray
    mse: np.ndarray
    mode_error: float


def plane_steps(chain: Any, times: ArrayLike, *, z: AxesLike, y: AxesLike) -> Iterator[PlaneStep]:
    """The density recursion (4.4)-(4.10) for a state of two components and a memory of order one.

    The memory is the last estimate of both components, and the decided mode where there are
    modes. An estimate is remembered on the four nodes about it, in shares that keep its mean; the
    errors are those of the filter with such rounding, an upper bound of the optimum that falls
    with the square of the steps of `z`.

    Parameters
    ----------
    chain : GridChain
    times : array_like, shape (K+1,)
    z : two of Axis or (low, high, count)
        Nodes of the remembered estimates.
    y : sequence of Axis or (low, high, count)
        Nodes for each component of a measurement; steps of about one deviation of the sensor's
        noise will do.

    Yields
    ------
    PlaneStep
    """
    times, z = as_times("times", times), as_axes("z", z, 2)
    y = as_axes("y", y, chain.system.measurement_size)
    points, weights = mesh(y), np.ones(1)
    for axis in y:
        weights = np.outer(weights, axis.weights).ravel()
    dist, cells = chain.initial[:, None], np.zeros(1, dtype=np.intp)
    for k, t in enumerate(followed(times, "density recursion")):
        if k:
            dist = chain.move(dist, float(times[k - 1]), float(t))
            dist /= dist.sum()
        likelihood = likelihood_of(chain.log_likelihood(float(t), points), weights).mass
        step = _optimal(chain, float(t), cells, dist, likelihood)
        yield step
        cells, dist = _remembered(chain, step, z)


def _optimal(chain, t, cells, dist, likelihood) -> PlaneStep:
    """Conditional means and modes, and what they cost."""
    used = dist.sum(axis=1) > FAINT * dist.sum()
    part, given, x = dist[used], likelihood[:, used], chain.values[:, used]
    mass, total = given @ part, part.sum(axis=1)
    mean = posterior_means(x, part.T, given, mass)
    mse = (x**2 @ total - (mean**2 * mass).sum(axis=(1, 2))) / total.sum()
    if chain.modes == 1:
        return PlaneStep(t, cells, dist, likelihood, mean, None, mass, mse, 0.0)
    modes = np.repeat(np.arange(chain.modes), len(used) // chain.modes)[used]
    masses = np.stack([given[:, modes == i] @ part[modes == i] for i in range(chain.modes)])
    wrong = float(1.0 - masses.max(axis=0).sum() / total.sum())
    mode = most_probable(masses)
    return PlaneStep(t, cells, dist, likelihood, mean, mode, mass, mse, wrong)


def _remembered(chain, step: PlaneStep, axes) -> tuple[np.ndarray, np.ndarray]:
    """Cells of the new memory that have probability, and the joint distribution with them,
    (4.10).
    """
    from scipy.sparse import csr_array

    size = axes[0].count * axes[1].count
    memory = np.zeros((chain.modes * size, len(step.dist)))
    for cell in np.flatnonzero(step.mass.sum(axis=0) > NEGLIGIBLE):
        mass, column = step.mass[:, cell], step.dist[:, cell]
        events = np.flatnonzero(mass > FAINT * mass.max())
        states = np.flatnonzero(column > FAINT * column.max())
        joint = step.likelihood[np.ix_(events, states)] * column[states]
        place = locate(axes, step.mean[:, events, cell])
        a, b = place.shares
        shares = np.stack([(1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b])
        lowest = place.index
        if step.mode is not None:
            lowest = lowest + size * step.mode[events, cell]
        targets = lowest + np.array(place.offsets)[:, None]
        into, rows = np.unique(targets, return_inverse=True)
        columns = np.tile(np.arange(len(events)), 4)
        scatter = csr_array(
            (shares.ravel(), (rows.ravel(), columns)), shape=(len(into), len(events))
        )
        memory[np.ix_(into, states)] += scatter @ joint
    probable = memory.sum(axis=1) > FAINT * 1e-2 * memory.sum()
    return np.flatnonzero(probable), np.ascontiguousarray(memory[probable].T)
