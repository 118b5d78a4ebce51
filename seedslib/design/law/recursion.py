"""One step of the joint law of the state and the filter's memory, (4.5) and (4.10)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.tables import Axis

NEGLIGIBLE = 1e-290
"""Probabilities below this are set to zero: they cannot be divided by."""

SPREADS = 6.5
"""Default axes of measurements reach this many deviations of the sensor beyond its means."""

FINENESS = 0.25
"""Default step of these axes, in the smallest deviation of the sensor."""

CHUNK = 1 << 18
"""Numbers formed at a time in the push-forward: they stay in the processor's cache."""


class Seen(NamedTuple):
    """Likelihood of a grid of measurements.

    Attributes
    ----------
    relative : ndarray, shape (Y, S)
        Likelihood up to a factor that depends on the measurement.
    mass : ndarray, shape (Y, S)
        Likelihood times quadrature weight; columns sum to one.
    defect : ndarray, shape (S,)
        By how much the quadrature had missed one.
    """

    relative: np.ndarray
    mass: np.ndarray
    defect: np.ndarray


class GridRisk(NamedTuple):
    """Accuracy of a filter without random numbers.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    mse : ndarray, shape (K+1,)
        M(X - Z_k)² of the filter whose memory is rounded to the grid at random.
    bias : ndarray, shape (K+1,)
        M(Z_k - X).
    clamped : ndarray, shape (K+1,)
        Probability that the estimate falls outside of the axis of the memory.
    mode_error : ndarray, shape (K+1,), or None
        Probability of a wrong mode, for a switching system.
    """

    times: np.ndarray
    mse: np.ndarray
    bias: np.ndarray
    clamped: np.ndarray
    mode_error: MaybeArray = None


def seen(log_likelihood: np.ndarray, weights: np.ndarray) -> Seen:
    """Likelihoods from their logarithms (Y, S) and the quadrature weights (Y,).

    Raises
    ------
    ValueError
        A state of which no measurement on the grid is likely.
    """
    peak = log_likelihood.max(axis=1, keepdims=True)
    peak[np.isneginf(peak)] = 0.0  # a value of the indicator that never comes
    relative = np.exp(log_likelihood - peak)
    mass = relative * (np.exp(peak) * weights[:, None])
    total = mass.sum(axis=0)
    if not (total > NEGLIGIBLE).all():
        raise ValueError("y: wanted axes that hold the measurements of every state on the grid")
    return Seen(relative / total, mass / total, np.abs(total - 1.0))


def default_axes(mean: np.ndarray, deviation: np.ndarray) -> tuple[Axis, ...]:
    """Axes for measurements, from their means and deviations at the states, both (m, S)."""
    low = (mean - SPREADS * deviation).min(axis=1)
    high = (mean + SPREADS * deviation).max(axis=1)
    count = (high - low) / (FINENESS * deviation.min(axis=1))
    return tuple(Axis(*part, int(n) + 2) for *part, n in zip(low, high, count, strict=True))


def conditional(joint: np.ndarray) -> np.ndarray:
    """Law of the state in each cell of the memory, (C, S), from joint probabilities (C, S).

    Where a cell has no probability the optimal function is arbitrary: the unconditional law is
    taken there, so that the estimate uses the measurement alone.
    """
    mass = joint.sum(axis=1, keepdims=True)
    everywhere = joint.sum(axis=0)
    law = np.divide(joint, mass, out=np.zeros_like(joint), where=mass > NEGLIGIBLE)
    law[mass[:, 0] <= NEGLIGIBLE] = everywhere / everywhere.sum()
    return law


def mode_masses(joint: np.ndarray, likelihood: np.ndarray, modes: int) -> np.ndarray:
    """Mass of each measurement, cell and mode, (L, Y, C), from (C, S) and (Y, S).

    The states of the chain are those of the first mode, then those of the next.
    """
    size = joint.shape[1] // modes
    found = np.empty((modes, len(likelihood), len(joint)))
    for i, mass in enumerate(found):
        block = slice(i * size, (i + 1) * size)
        np.matmul(likelihood[:, block], joint[:, block].T, out=mass)
    return found


def posterior_modes(law: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """P(i | y, u) of theorem 2 of the switching paper, (L, Y, C), from `mode_masses` of the law."""
    modes, total = len(masses), masses.sum(axis=0)
    known = total > NEGLIGIBLE
    found = np.empty_like(masses)
    prior = law.reshape(len(law), modes, -1).sum(axis=2)
    for row, mass, before in zip(found, masses, prior.T, strict=True):
        row[:] = before
        np.divide(mass, total, out=row, where=known)
    return found


def posterior_means(
    values: np.ndarray, law: np.ndarray, relative: np.ndarray, mass: np.ndarray | None = None
) -> np.ndarray:
    """f(y, u) = M[value | y, u] of theorem 1, (p, Y, C).

    Parameters
    ----------
    values : ndarray, shape (p, S)
    law : ndarray, shape (C, S)
    relative : ndarray, shape (Y, S)
        Likelihood up to a factor that may depend on y.
    mass : ndarray, shape (Y, C), optional
        ``relative @ law.T``, where it is known.
    """
    mass = relative @ law.T if mass is None else mass
    known = mass > NEGLIGIBLE
    found = np.empty((len(values), *mass.shape))
    for row, value in zip(found, values, strict=True):
        row[:] = law @ value
        np.divide(relative @ (law * value).T, mass, out=row, where=known)
    return found


def remember(joint: np.ndarray, likelihood: np.ndarray, dropped: int) -> np.ndarray:
    """Joint law of the state and the new memory where a measurement is remembered itself.

    Parameters
    ----------
    joint : ndarray, shape (C, S)
    likelihood : ndarray, shape (letters, S)
        With the quadrature weights; columns sum to one.
    dropped : int
        As in `push_forward`.

    Returns
    -------
    ndarray, shape (letters * C / dropped, S)
    """
    tails = joint.reshape(-1, dropped, joint.shape[1]).sum(axis=1)
    result = (likelihood[:, None, :] * tails).reshape(-1, joint.shape[1])
    result[result < NEGLIGIBLE] = 0.0
    return result


def push_forward(
    joint: np.ndarray, likelihood: np.ndarray, lower: np.ndarray, share: np.ndarray,
    letters: int, dropped: int, *, least: float = 0.0, mass: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Joint law of the state and the new memory: (4.10).

    The probability of a measurement y in a cell of the old memory goes to the letter `lower`
    and the next one, in the proportion that keeps the mean of the estimate. Cells are numbered
    with the newest letter first.

    Parameters
    ----------
    joint : ndarray, shape (C, S)
        Old memory and state.
    likelihood : ndarray, shape (Y, S)
        With the quadrature weights; columns sum to one.
    lower : ndarray of int, shape (Y, C)
    share : ndarray, shape (Y, C)
        Part of the probability that goes to the letter after `lower`.
    letters : int
        Number of values that a block of the memory can take.
    dropped : int
        How many cells of the old memory become one when its oldest block drops out; 1 while
        the memory fills.
    least : float
        Events (y, cell) of this probability or less are left out; the law of the state is mended
        afterwards.
    mass : ndarray, shape (Y, C), optional
        ``likelihood @ joint.T``, where it is known.

    Returns
    -------
    ndarray, shape (letters * C / dropped, S)
    """
    from scipy.sparse import csc_array

    cells, size = joint.shape
    tails = cells // dropped
    result = np.zeros((letters, tails, size))
    happens = (likelihood @ joint.T if mass is None else mass) > least
    step = max(1, CHUNK // (size * dropped))
    for tail in range(tails):
        block = slice(tail * dropped, (tail + 1) * dropped)
        law, into = joint[block], np.zeros((letters, size))
        for a in range(0, len(likelihood), step):
            part = slice(a, a + step)
            used = happens[part, block].any(axis=0).nonzero()[0]
            if used.size == 0:
                continue
            events = (likelihood[part, None, :] * law[used]).reshape(-1, size)
            below, up = lower[part, block][:, used].ravel(), share[part, block][:, used].ravel()
            targets = np.stack([below, np.minimum(below + 1, letters - 1)], axis=1).ravel()
            weights = np.stack([1.0 - up, up], axis=1).ravel()
            starts = np.arange(0, targets.size + 1, 2)
            into += csc_array((weights, targets, starts), shape=(letters, len(below))) @ events
        result[:, tail] = into
    result[result < NEGLIGIBLE] = 0.0
    result = result.reshape(letters * tails, size)
    if least > 0:
        found = result.sum(axis=0)
        result *= np.divide(joint.sum(axis=0), found, out=np.zeros(size), where=found > 0)
    return result
