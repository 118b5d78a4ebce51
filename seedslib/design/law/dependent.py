"""Theorem 2 where the noises of sensor and dynamics are dependent, and with measurements kept."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from seedslib.base.checks import as_count
from seedslib.base.tables import Axis, AxisLike
from seedslib.design.law.recursion import mode_masses, posterior_means
from seedslib.filters.weights import most_probable

FAINT = 1e-13
"""Probability of a cell of the memory below which it is left out."""


class DependentStep(NamedTuple):
    """What is optimal at one measurement.

    Attributes
    ----------
    mean : ndarray, shape (Y, C)
        Optimal estimates for each measurement and cell of the memory.
    mode : ndarray of int, shape (Y, C)
    mass : ndarray, shape (Y, C)
        Probability of measurement and memory.
    mse, mode_error : float
        Mean-square error of the estimate, and probability of a wrong mode.
    """

    mean: np.ndarray
    mode: np.ndarray
    mass: np.ndarray
    mse: float
    mode_error: float


def dependent_steps(
    start: np.ndarray, kernels: Iterable[np.ndarray], values: np.ndarray, modes: int, *,
    z: AxisLike, measurements: bool = False,
) -> Iterator[DependentStep]:  # fmt: skip
    """Exact recursion for a scalar system whose next state depends on the noise of the sensor.

    Remark 1 of the switching paper. With gamma_k(x', y | x) for the joint law of the next mode
    and state and the present measurement, and p_k(x, u) for that of mode and state and the memory
    before measurement k, the optimal functions follow from beta_k = the sum of gamma_k over x' as
    in theorem 2, and

    p_{k+1}(x', z) = sum over y, x, u of gamma_k(x', y | x) delta[z - g_k(y, u)] p_k(x, u).

    The memory u is the last decided mode and estimate, and the last measurement as well where
    `measurements` is set: the small-order filter of three arguments of remark 2. An estimate is
    split between two nodes, so the errors are upper bounds that fall with the square of the step.

    Parameters
    ----------
    start : ndarray, shape (S,)
        Initial probabilities of the states: the nodes in mode 0, then those in mode 1, ...
    kernels : iterable of ndarray, shape (Y, S, S)
        gamma_k for k = 0, 1, ...: [y, next, now], with the quadrature weights of y; sums over the
        first two are one. It may be one of independent noises.
    values : ndarray, shape (S,)
    modes : int
    z : Axis or (low, high, count)
        Nodes of the remembered estimate.
    measurements : bool
        Whether the last measurement is remembered too.

    Yields
    ------
    DependentStep
    """
    from scipy.sparse import csr_array

    axis, modes = Axis.of("z", z), as_count("modes", modes)
    law = np.asarray(start, dtype=float)[None]
    for kernel in kernels:
        seen = kernel.sum(axis=1)
        masses = mode_masses(law, seen, modes)
        mass, mode = masses.sum(axis=0), most_probable(masses)
        mean = posterior_means(values[None], law, seen, mass)[0]
        mse = law.sum(axis=0) @ values**2 - np.vdot(mean**2, mass)
        wrong = law.sum() - masses.max(axis=0).sum()
        yield DependentStep(mean, mode, mass, float(mse), float(wrong))
        lower, share = axis.place(mean)
        lower = lower + mode * axis.count
        size = modes * axis.count
        found = np.zeros((len(kernel) if measurements else 1, size, law.shape[1]))
        columns = np.tile(np.arange(len(law)), 2)
        for j, gamma in enumerate(kernel):
            rows = np.concatenate([lower[j], lower[j] + 1])
            weights = np.concatenate([1.0 - share[j], share[j]])
            scatter = csr_array((weights, (rows, columns)), shape=(size, len(law)))
            found[j if measurements else 0] += (scatter @ law) @ gamma.T
        law = found.reshape(-1, law.shape[1])
        law = law[law.sum(axis=1) > FAINT]
