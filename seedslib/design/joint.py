"""The joint distribution of the state and the filter's memory on a grid, (4.5) and (4.10)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.base.progress import followed
from seedslib.base.tables import AxesLike, Axis, Labels, NodesLike, as_axes, as_grids, mesh
from seedslib.designed.accuracy import Accuracy, Design
from seedslib.designed.memory import Memory
from seedslib.designed.tables import Output, block_labels, require_like_blocks
from seedslib.filters.weights import most_probable
from seedslib.models.chains import GridChain, grid_chain, require_few
from seedslib.models.kinds import AnySystem, as_grid, as_system, switches

NEGLIGIBLE = 1e-290
"""Probabilities below this are set to zero: they cannot be divided by."""

SPREADS = 6.5
"""Default axes of measurements reach this many deviations of the sensor beyond its means."""

FINENESS = 0.25
"""Default step of these axes, in the smallest deviation of the sensor."""

CHUNK = 1 << 18
"""Numbers formed at a time in the push-forward: they stay in the processor's cache."""


class Likelihood(NamedTuple):
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


def likelihood_of(log_likelihood: np.ndarray, weights: np.ndarray) -> Likelihood:
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
    return Likelihood(relative / total, mass / total, np.abs(total - 1.0))


def default_axes(mean: np.ndarray, deviation: np.ndarray) -> tuple[Axis, ...]:
    """Axes for measurements, from their means and deviations at the states, both (m, S)."""
    low = (mean - SPREADS * deviation).min(axis=1)
    high = (mean + SPREADS * deviation).max(axis=1)
    count = (high - low) / (FINENESS * deviation.min(axis=1))
    return tuple(Axis(*part, int(n) + 2) for *part, n in zip(low, high, count, strict=True))


def conditional(joint: np.ndarray) -> np.ndarray:
    """Distribution of the state in each cell of the memory, (C, S), from joint ones (C, S).

    Where a cell has no probability the optimal function is arbitrary: the unconditional one is
    taken there, so that the estimate uses the measurement alone.
    """
    mass, total = joint.sum(axis=1, keepdims=True), joint.sum(axis=0)
    dist = np.divide(joint, mass, out=np.zeros_like(joint), where=mass > NEGLIGIBLE)
    dist[mass[:, 0] <= NEGLIGIBLE] = total / total.sum()
    return dist


def mode_masses(joint: np.ndarray, likelihood: np.ndarray, modes: int) -> np.ndarray:
    """Mass of each measurement, cell and mode, (L, Y, C), from (C, S) and (Y, S).

    The states of the chain are those of the first mode, then those of the next.
    """
    pairs = zip(np.split(likelihood, modes, axis=1), np.split(joint, modes, axis=1), strict=True)
    return np.stack([given @ block.T for given, block in pairs])


def posterior_modes(dist: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """P(i | y, u) of theorem 2 of the switching paper, (L, Y, C), from `mode_masses` of the
    distribution.
    """
    total, prob = masses.sum(axis=0), np.empty_like(masses)
    prob[:] = dist.reshape(len(dist), len(masses), -1).sum(axis=2).T[:, None]
    return np.divide(masses, total, out=prob, where=total > NEGLIGIBLE)


def posterior_means(
    values: np.ndarray, dist: np.ndarray, relative: np.ndarray, mass: np.ndarray | None = None
) -> np.ndarray:
    """f(y, u) = M[value | y, u] of theorem 1, (p, Y, C).

    Parameters
    ----------
    values : ndarray, shape (p, S)
    dist : ndarray, shape (C, S)
    relative : ndarray, shape (Y, S)
        Likelihood up to a factor that may depend on y.
    mass : ndarray, shape (Y, C), optional
        ``relative @ distribution.T``, where it is known.
    """
    mass = relative @ dist.T if mass is None else mass
    means = np.empty((len(values), *mass.shape))
    for mean, value in zip(means, values, strict=True):
        mean[:] = dist @ value
        np.divide(relative @ (dist * value).T, mass, out=mean, where=mass > NEGLIGIBLE)
    return means


def remember(joint: np.ndarray, likelihood: np.ndarray, dropped: int) -> np.ndarray:
    """Joint distribution of the state and the new memory where a measurement is remembered.

    Parameters
    ----------
    joint : ndarray, shape (C, S)
    likelihood : ndarray, shape (blocks, S)
        With the quadrature weights; columns sum to one.
    dropped : int
        As in `push_forward`.

    Returns
    -------
    ndarray, shape (blocks * C / dropped, S)
    """
    tails = joint.reshape(-1, dropped, joint.shape[1]).sum(axis=1)
    result = (likelihood[:, None, :] * tails).reshape(-1, joint.shape[1])
    result[result < NEGLIGIBLE] = 0.0
    return result


def push_forward(
    joint: np.ndarray,
    likelihood: np.ndarray,
    lower: np.ndarray,
    share: np.ndarray,
    blocks: int,
    dropped: int,
    *,
    least: float = 0.0,
    mass: np.ndarray | None = None,
) -> np.ndarray:
    """Joint distribution of the state and the new memory: (4.10).

    The probability of a measurement y in a cell of the old memory goes to the block `lower`
    and the next one, in the proportion that keeps the mean of the estimate. Cells are numbered
    with the newest block first.

    Parameters
    ----------
    joint : ndarray, shape (C, S)
        Old memory and state.
    likelihood : ndarray, shape (Y, S)
        With the quadrature weights; columns sum to one.
    lower : ndarray of int, shape (Y, C)
    share : ndarray, shape (Y, C)
        Part of the probability that goes to the block after `lower`.
    blocks : int
        Number of values that a block of the memory can take.
    dropped : int
        How many cells of the old memory become one when its oldest block drops out; 1 while
        the memory fills.
    least : float
        Events (y, cell) of this probability or less are left out; the distribution of the state
        is restored afterwards.
    mass : ndarray, shape (Y, C), optional
        ``likelihood @ joint.T``, where it is known.

    Returns
    -------
    ndarray, shape (blocks * C / dropped, S)
    """
    from scipy.sparse import csc_array

    cells, size = joint.shape
    tails = cells // dropped
    result = np.zeros((blocks, tails, size))
    happens = (likelihood @ joint.T if mass is None else mass) > least
    step = max(1, CHUNK // (size * dropped))
    for tail in range(tails):
        block = slice(tail * dropped, (tail + 1) * dropped)
        dist, total = joint[block], np.zeros((blocks, size))
        for a in range(0, len(likelihood), step):
            part = slice(a, a + step)
            used = happens[part, block].any(axis=0).nonzero()[0]
            if used.size == 0:
                continue
            events = (likelihood[part, None, :] * dist[used]).reshape(-1, size)
            below, up = lower[part, block][:, used].ravel(), share[part, block][:, used].ravel()
            targets = np.stack([below, np.minimum(below + 1, blocks - 1)], axis=1).ravel()
            weights = np.stack([1.0 - up, up], axis=1).ravel()
            starts = np.arange(0, targets.size + 1, 2)
            total += csc_array((weights, targets, starts), shape=(blocks, len(below))) @ events
        result[:, tail] = total
    result[result < NEGLIGIBLE] = 0.0
    result = result.reshape(blocks * tails, size)
    if least > 0:
        total = result.sum(axis=0)
        result *= np.divide(joint.sum(axis=0), total, out=np.zeros(size), where=total > 0)
    return result


ENDS = "x: probability {} in an outermost cell, or beyond it, at time {}; the axis is too short"
LOST = (
    "x: probability {} leaves the nodes in the step from time {}, or they are too coarse for the "
    "noise"
)
MISSED = (
    "y: the axes miss {} of the probability of a measurement at time {}; they are too short or "
    "too coarse"
)
CLAMPED = (
    "z: probability {} of an estimate outside of the axis at time {}, where it is remembered as "
    "the end"
)
NEGLECTED = {ENDS: 1e-6, LOST: 1e-6, MISSED: 1e-6, CLAMPED: 1e-4}
"""What a design warns of, and up to which probability it does not."""

LARGEST = 1 << 27
"""Numbers in the joint distribution, or in a table, beyond which a grid is refused."""

BY_GRID = Design(0, 0, 0, (), 0, True)

IMPROBABLE = 1e-15
"""Events of this probability or less are left out where a memory holds modes."""


class JointDistribution:
    """Joint distribution of state and memory on a grid, and the errors at each measurement.

    Parameters
    ----------
    system, memory, times, x, z, y
        As `seedslib.design.grid_synthesis`.

    Attributes
    ----------
    joint : ndarray, shape (cells, S)
        Probabilities of the cells of the memory, newest block first, and the state's nodes.
    values : ndarray, shape (1, S)
        The nodes of the state.
    y_grid : ndarray, shape (m, Y)
        The grid of measurements, with the indicator as first row if there is one.
    modes : int
        Modes of the system; 1 for one that does not switch.
    measurement_axes, block_axes : tuple of Axis
        Of a measurement, and of one block of the memory.
    """

    def __init__(
        self,
        system: AnySystem,
        memory: Memory,
        times: ArrayLike,
        x: NodesLike,
        z: AxesLike | None,
        y: AxesLike | None,
    ) -> None:
        if not isinstance(memory, Memory):
            raise TypeError(f"memory: wanted a Memory, got {memory!r}")
        as_system("system", system, "JumpDiffusion", "DiscreteSystem", "SwitchingSystem")
        (x,) = as_grids("x", x, 1)
        require_few(system, 1)
        self.chain: GridChain = grid_chain(system, x)
        require_like_blocks(memory, self.chain.indicators, " for a grid")
        self.system: AnySystem = system
        self.memory: Memory = memory
        self.times: np.ndarray = as_grid("times", times, system)
        self.values: np.ndarray = self.chain.values
        self.modes: int = self.chain.modes
        self.switching: bool = switches(system)
        reach = self.chain.measurement_moments(float(self.times[0]))
        axes = default_axes(*reach) if y is None else as_axes("y", y, len(reach[0]))
        labels = (Labels(self.chain.indicators),) if self.chain.indicators else ()
        self.measurement_axes: tuple[Any, ...] = labels + axes
        self.y_grid: np.ndarray = mesh(self.measurement_axes)
        self.weights: np.ndarray = np.ones(1)
        for axis in self.measurement_axes:
            self.weights = np.outer(self.weights, axis.weights).ravel()
        if memory.estimates:
            axes = Axis(x.low, x.high, 2 * x.count - 1) if z is None else Axis.of("z", z)
            axes = (axes,)
        modes, indicators = block_labels(system, memory)
        self.block_axes: tuple[Any, ...] = modes + indicators + axes
        self.blocks: int = int(np.prod([axis.count for axis in self.block_axes]))
        self.depth: int = memory.depth
        self.filled: int = 0
        size = max(self.values.shape[1], self.y_grid.shape[1])
        entries = float(self.blocks) ** self.depth * size
        if entries > LARGEST:
            raise ValueError(
                f"memory: wanted at most {LARGEST} numbers on the grid, got {entries:.3g}: fewer "
                "nodes or a shorter memory"
            )
        self.joint: np.ndarray = self.chain.initial[None]
        self.errors: list[tuple] = []  # mse, bias, clamped, wrong at each measurement
        self._worst: dict[str, tuple[float, float]] = {}  # by sentence: probability and time
        self._note(ENDS, self.chain.missed, self.times[0])

    @property
    def memory_axes(self) -> tuple[Axis, ...]:
        """Axes of the memory as it is now."""
        return self.block_axes * self.filled

    @property
    def memory_points(self) -> np.ndarray:
        """The memory at each cell, (d, cells)."""
        return mesh(self.memory_axes)

    def steps(self) -> Iterator[tuple[int, float, Likelihood]]:
        """Number, time and likelihoods of each measurement; `take` is the caller's."""
        for k, t in enumerate(followed(self.times, "design on a grid")):
            yield k, t, self.likelihood(t)
            if k + 1 < len(self.times):
                self.move(t, self.times[k + 1])
        self._warn()

    def likelihood(self, t: float) -> Likelihood:
        """Likelihood of the measurements on the grid."""
        likelihood = likelihood_of(self.chain.log_likelihood(float(t), self.y_grid), self.weights)
        if self.chain.loses:  # given that it is still on the axis, whose ends are looked at
            self.joint /= self.joint.sum()
        dist = self.joint.sum(axis=0)
        self._note(ENDS, self.chain.at_ends(dist), t)
        self._note(MISSED, float(dist @ likelihood.defect), t)
        return likelihood

    def posterior(self, relative: np.ndarray, given: np.ndarray) -> Output:
        """Optimal estimates (1, Y, cells) and decided modes (Y, cells).

        Parameters
        ----------
        relative : ndarray, shape (Y, S)
            Likelihood up to a factor that depends on the measurement.
        given : ndarray, shape (cells, S)
            Distribution of the chain in each cell.
        """
        masses = mode_masses(given, relative, self.modes)
        means = posterior_means(self.values, given, relative, masses.sum(axis=0))
        if not self.switching:
            return Output(means)
        prob = posterior_modes(given, masses)
        return Output(means, most_probable(prob).astype(np.int8))

    def take(
        self, k: int, means: np.ndarray, likelihood: Likelihood, modes: MaybeArray = None
    ) -> np.ndarray:
        """Score estimates (1, Y, cells) and put them, or the measurements, in the memory.

        Parameters
        ----------
        k : int
        means : ndarray, shape (1, Y, cells)
        likelihood : Likelihood
        modes : ndarray of int, shape (Y, cells), optional
            Decided modes, for a switching system.

        Returns
        -------
        ndarray, shape (Y, cells)
            Probability of each measurement and memory.
        """
        joint, estimate, x = self.joint, means[0], self.values[0]
        masses = mode_masses(joint, likelihood.mass, self.modes)
        mass, dist = masses.sum(axis=0), joint.sum(axis=0)
        first = likelihood.mass @ (joint * x).T
        mse = dist @ x**2 - 2.0 * np.vdot(estimate, first) + np.vdot(estimate**2, mass)
        bias = np.vdot(estimate, mass) - dist @ x
        wrong = None
        if modes is not None:
            wrong = 1.0 - sum(part[modes == i].sum() for i, part in enumerate(masses))
        clamped, dropped = 0.0, self.blocks if self.filled == self.depth else 1
        if self.memory.estimates:
            axis = self.block_axes[-1]
            clamped = mass[(estimate < axis.low) | (estimate > axis.high)].sum()
            lower, share = axis.place(estimate)
            if modes is not None:
                label = modes.astype(np.intp)
                if self.memory.indicators:
                    label = label * self.chain.indicators + self.y_grid[0].astype(np.intp)[:, None]
                lower = lower + label * axis.count
            self.joint = push_forward(
                joint,
                likelihood.mass,
                lower,
                share,
                self.blocks,
                dropped,
                least=IMPROBABLE if self.switching else 0.0,
                mass=mass,
            )
        else:
            of_blocks = likelihood.mass.reshape(-1, self.blocks, joint.shape[1]).sum(axis=0)
            self.joint = remember(joint, of_blocks, dropped)
        self._note(CLAMPED, float(clamped), self.times[k])
        self.errors.append((mse, bias, clamped, wrong))
        self.filled = min(self.filled + 1, self.depth)
        return mass

    def move(self, start: float, stop: float) -> None:
        """Let the state move while the memory stays: (4.8)."""
        dist = self.joint.sum(axis=0)
        loss = self.chain.loss(float(start), float(stop)) @ dist / dist.sum()
        self._note(LOST, float(loss), start)
        self.joint = self.joint @ self.chain.transition(float(start), float(stop)).T

    def prediction(self) -> Accuracy:
        """Root-mean-square errors at the measurements, without sampling error."""
        risk = self.risk()
        rms = np.sqrt(np.maximum(risk.mse, 0.0))[:, None]
        exact = None if risk.mode_error is None else np.zeros(len(rms))
        return Accuracy(self.times, rms, np.zeros_like(rms), False, risk.mode_error, exact)

    def covariances(self) -> np.ndarray:
        """Error covariances (K+1, 1, 1) after each measurement."""
        return np.array([row[0] for row in self.errors])[:, None, None]

    def risk(self) -> GridRisk:
        """Errors at the measurements."""
        mse, bias, clamped, wrong = (np.array(part) for part in zip(*self.errors, strict=True))
        return GridRisk(self.times, mse, bias, clamped, wrong if self.switching else None)

    def _note(self, sentence: str, probability: float, t: float) -> None:
        """Keep the worst of what a design warns of, once and at its end."""
        if probability > self._worst.get(sentence, (NEGLECTED[sentence], t))[0]:
            self._worst[sentence] = probability, float(t)

    def _warn(self) -> None:
        """Warn of axes that are too short or too coarse, each with its worst figure."""
        for sentence, (probability, t) in self._worst.items():
            text = sentence.format(f"{probability:.2g}", when(t))
            warnings.warn(text, stacklevel=outside())
