"""Joint law of a scalar state and a filter's memory, carried from measurement to measurement."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import outside
from seedslib.base.clock import when
from seedslib.base.progress import followed
from seedslib.base.tables import AxesLike, Axis, Labels, NodesLike, as_axes, as_grids, mesh
from seedslib.base.values import Course, Inputs
from seedslib.design.law.recursion import (
    GridRisk,
    Seen,
    conditional,
    default_axes,
    mode_masses,
    posterior_means,
    posterior_modes,
    push_forward,
    remember,
    seen,
)
from seedslib.designed.memory import Memory
from seedslib.designed.outputs.lookup import Output, Table, letter_labels, require_letters
from seedslib.designed.prediction import Design, Prediction
from seedslib.filters.weights import most_probable
from seedslib.models.chains import chain_of
from seedslib.models.kinds import AnySystem, as_grid, as_system, course_of, elapsed, switches

LOST = 1e-6
"""Probability of measurements beyond the axes that is worth a warning."""

LARGEST = 1 << 27
"""Numbers in the joint law, or in a table, beyond which a grid is refused."""

CLAMPED = 1e-4
"""Probability of estimates beyond the axis that is worth a warning."""

BY_GRID = Design(0, 0, 0, (), 0, True)

UNSEEN = 1e-15
"""Events of this probability or less are left out where a memory holds modes."""


class JointLaw:
    """Joint law of state and memory on a grid, and what was found on the way.

    Parameters
    ----------
    system, memory, times, x, z, y, inputs
        As `seedslib.design.grid_synthesis`.

    Attributes
    ----------
    joint : ndarray, shape (cells, S)
        Probabilities of the cells of the memory, newest block first, and the state's nodes.
    values : ndarray, shape (1, S)
        The nodes of the state.
    shown : ndarray, shape (m, Y)
        The grid of measurements, with the indicator as first row if there is one.
    modes : int
        Modes of the system; 1 for one that does not switch.
    measurement_axes, letter_axes : tuple of Axis
        Of a measurement, and of one block of the memory.
    """

    def __init__(
        self, system: AnySystem, memory: Memory, times: ArrayLike, x: NodesLike, z: AxesLike | None,
        y: AxesLike | None, inputs: Inputs | None = None,
    ) -> None:  # fmt: skip
        if not isinstance(memory, Memory):
            raise TypeError(f"memory: wanted a Memory, got {memory!r}")
        as_system("system", system, "JumpDiffusion", "DiscreteSystem", "SwitchingSystem")
        (x,) = as_grids("x", x, 1)
        self.chain: Any = chain_of(system, x)
        require_letters(memory, self.chain.indicators, " for a grid")
        self.system: AnySystem = system
        self.memory: Memory = memory
        self.times: np.ndarray = as_grid("times", times, system)
        self.held: Course = course_of(system, inputs, len(self.times))
        self.values: np.ndarray = self.chain.values
        self.modes: int = self.chain.modes
        self.switching: bool = switches(system)
        with self.held.at(0):
            reach = self.chain.reach(float(self.times[0]))
            axes = default_axes(*reach) if y is None else as_axes("y", y, len(reach[0]))
        labels = (Labels(self.chain.indicators),) if self.chain.indicators else ()
        self.measurement_axes: tuple[Any, ...] = labels + axes
        self.shown: np.ndarray = mesh(self.measurement_axes)
        self.weights: np.ndarray = np.ones(1)
        for axis in self.measurement_axes:
            self.weights = np.outer(self.weights, axis.weights).ravel()
        if memory.estimates:
            axes = Axis(x.low, x.high, 2 * x.count - 1) if z is None else Axis.of("z", z)
            axes = (axes,)
        decided, kept = letter_labels(system, memory)
        self.letter_axes: tuple[Any, ...] = decided + kept + axes
        self.letters: int = int(np.prod([axis.count for axis in self.letter_axes]))
        self.depth: int = memory.depth
        self.filled: int = 0
        size = max(self.values.shape[1], self.shown.shape[1])
        entries = float(self.letters) ** self.depth * size
        if entries > LARGEST:
            raise ValueError(
                f"memory: wanted at most {LARGEST} numbers on the grid, got {entries:.3g}: fewer "
                "nodes or a shorter memory"
            )
        self.joint: np.ndarray = self.chain.start()[None]
        self.found: list[Any] = []
        self.scores: list[Any] = []

    @property
    def memory_axes(self) -> tuple[Axis, ...]:
        """Axes of the memory as it is now."""
        return self.letter_axes * self.filled

    @property
    def memory_points(self) -> np.ndarray:
        """The memory at each cell, (d, cells)."""
        return mesh(self.memory_axes)

    def steps(self, nodes: int = 0) -> Iterator[tuple[int, float, Seen, tuple[Table, ...]]]:
        """Number, time and likelihoods of each measurement, and the forecasts at nodes before it.

        Between measurements the state moves; `take` is the caller's.
        """
        between: list[Table] = []
        for k, t in enumerate(followed(self.times, "design on a grid")):
            with self.held.at(k):
                sight = self.look(t)
            yield k, t, sight, tuple(between)
            if k + 1 < len(self.times):
                stops, between = np.linspace(t, self.times[k + 1], nodes + 2), []
                for a, b in pairwise(stops):
                    with self.held.at(k), elapsed(self.system, a, b):
                        self.move(a, b)
                    if b != stops[-1]:
                        between.append(self.forecast(b))
        self.look_at_memory()

    def look(self, t) -> Seen:
        """Likelihood of the measurements on the grid."""
        sight = seen(self.chain.log_likelihood(float(t), self.shown), self.weights)
        if self.chain.loses:  # given that it is on the axis still, whose ends are looked at
            self.renew()
        law = self.marginal()
        self.chain.look_at_ends(law)
        missed = float(law @ sight.defect)
        if missed > LOST:
            warnings.warn(
                f"y: the axes miss {missed:.2g} of the probability of a measurement at time "
                f"{when(t)}; they are too short or too coarse",
                stacklevel=outside(),
            )
        return sight

    def renew(self) -> None:
        """Give the law its mass again."""
        self.joint /= self.joint.sum()

    def marginal(self) -> Any:
        """Law of the state alone, (S,)."""
        return self.joint.sum(axis=0)

    def posterior(self, relative: np.ndarray, given: np.ndarray) -> Output:
        """Optimal estimates (1, Y, cells), decided modes (Y, cells) and probabilities.

        Parameters
        ----------
        relative : ndarray, shape (Y, S)
            Likelihood up to a factor that depends on the measurement.
        given : ndarray, shape (cells, S)
            Law of the chain in each cell.
        """
        masses = mode_masses(given, relative, self.modes)
        means = posterior_means(self.values, given, relative, masses.sum(axis=0))
        if not self.switching:
            return Output(means)
        prob = posterior_modes(given, masses)
        return Output(means, most_probable(prob).astype(np.int8), prob)

    def take(self, k: int, means: Any, sight: Any, modes: Any = None) -> Any:
        """Score estimates (1, Y, cells) and put them, or the measurements, in the memory.

        Parameters
        ----------
        k : int
        means : ndarray, shape (1, Y, cells)
        sight : Seen
        modes : ndarray of int, shape (Y, cells), optional
            Decided modes, for a switching system.

        Returns
        -------
        ndarray, shape (Y, cells)
            Probability of each measurement and memory.
        """
        score, mass = self.judged(self.joint, means, sight, modes)
        told = self.shown[0] if self.memory.indicators else None
        self.joint = self.remembered(self.joint, means, sight, modes, mass, told)
        self.noted(k, score)
        return mass

    def judged(self, joint: Any, means: Any, sight: Any, modes: Any = None) -> tuple[Any, Any]:
        """What estimates cost, as a row of `found`, and the mass of measurement and memory."""
        estimate, x = means[0], self.values[0]
        masses = mode_masses(joint, sight.mass, self.modes)
        mass = masses.sum(axis=0)
        first = sight.mass @ (joint * x).T
        law = joint.sum(axis=0)
        mse = law @ x**2 - 2.0 * np.vdot(estimate, first) + np.vdot(estimate**2, mass)
        bias = np.vdot(estimate, mass) - law @ x
        right = (part[modes == i].sum() for i, part in enumerate(masses))
        wrong = None if modes is None else 1.0 - sum(right)
        outside = 0.0
        if self.memory.estimates:
            axis = self.letter_axes[-1]
            outside = mass[(estimate < axis.low) | (estimate > axis.high)].sum()
        return (mse, bias, outside, wrong), mass

    def remembered(
        self, joint: Any, means: Any, sight: Any, modes: Any, mass: Any, told: Any = None
    ) -> Any:
        """Joint law with the new memory; `told` (Y,) are the indicators, where it has them."""
        tail = self.letters if self.filled == self.depth else 1
        if not self.memory.estimates:
            shown = sight.mass.reshape(-1, self.letters, sight.mass.shape[1]).sum(axis=0)
            return remember(joint, shown, tail)
        axis = self.letter_axes[-1]
        lower, share = axis.place(means[0])
        if modes is not None:
            label = modes.astype(np.intp)
            if told is not None:
                label = label * self.chain.indicators + told.astype(np.intp)[:, None]
            lower = lower + label * axis.count
        return push_forward(
            joint, sight.mass, lower, share, self.letters, tail,
            least=UNSEEN if self.switching else 0.0, mass=mass,
        )  # fmt: skip

    def noted(self, k: int, score: Any) -> None:
        """Keep what was found at measurement k, which the memory has now."""
        self.found.append(score)
        self.scores.append((self.times[k], score[0]))
        self.filled = min(self.filled + 1, self.depth)

    def move(self, start: float, stop: float) -> Any:
        """Let the state move while the memory stays: (4.8)."""
        self.joint = self.joint @ self.chain.transition(float(start), float(stop)).T

    def forecast(self, t: float) -> Table:
        """g(u) = M[X | u], (4.3), as a table; its error is noted."""
        means = conditional(self.joint) @ self.values[0]
        mass = self.joint.sum(axis=1)
        square = self.joint.sum(axis=0) @ self.values[0] ** 2
        self.scores.append((t, square - mass @ means**2))
        return Table.of(self.memory_axes, Output(means))

    def prediction(self) -> Prediction:
        """Root-mean-square errors at measurements and nodes, without sampling error."""
        times, squares = (np.array(part) for part in zip(*self.scores, strict=True))
        rms = np.sqrt(np.maximum(squares, 0.0))[:, None]
        if not self.switching:
            return Prediction(times, rms, np.zeros_like(rms))
        wrong = self.risk().mode_error
        return Prediction(
            times, rms, np.zeros_like(rms), mode_rate=wrong, mode_error=np.zeros(len(rms))
        )

    def errors(self) -> np.ndarray:
        """Error covariances (K+1, 1, 1) after each measurement."""
        return np.array([row[0] for row in self.found])[:, None, None]

    def risk(self) -> GridRisk:
        """What was found at the measurements."""
        mse, bias, clamped, wrong = (np.array(part) for part in zip(*self.found, strict=True))
        return GridRisk(self.times, mse, bias, clamped, wrong if self.switching else None)

    def look_at_memory(self) -> None:
        """Warn where the axis of the estimates is too short to remember them."""
        if (clamped := max(row[2] for row in self.found)) > CLAMPED:
            warnings.warn(
                f"z: probability {clamped:.2g} of an estimate outside of the axis, where it "
                "is remembered as the end",
                stacklevel=outside(),
            )
