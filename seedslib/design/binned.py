"""Design by plain histograms, as the papers have it: cells, majorities, means, step by step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, MaybeArray, Seed
from seedslib.base.checks import as_count
from seedslib.base.progress import followed
from seedslib.base.tables import Labels
from seedslib.design.samples import MemoryPaths, Sample
from seedslib.designed.memory import Memory
from seedslib.designed.tables import Output, OutputFilter, Step, step_axes
from seedslib.filters.weights import most_probable
from seedslib.models.kinds import KINDS, AnySystem, as_system

FEWEST = 5
"""Paths that a cell must have to be believed."""

METHOD = "histogram of cells of equal probability"


class BinnedOutput(NamedTuple):
    """Output function that is constant in each cell of its arguments.

    Attributes
    ----------
    labels : tuple of int
        Number of values of each discrete argument, 0 for a continuous one.
    edges : tuple of ndarray, shape (groups, bins - 1)
        Of each continuous argument, for each group of the discrete ones.
    mean : ndarray, shape (n, cells)
    mode : ndarray of int, shape (cells,), or None
    """

    labels: tuple[int, ...]
    edges: tuple[np.ndarray, ...]
    mean: np.ndarray
    mode: MaybeArray

    def __call__(self, points: Sequence[np.ndarray]) -> Output:
        """Values at arguments whose shapes broadcast; without batch axes where there are none."""
        if not self.labels:
            return Output(self.mean[:, 0], None if self.mode is None else self.mode[0])
        cell = cells(self.labels, self.edges, points)
        return Output(self.mean[:, cell], None if self.mode is None else self.mode[cell])


def cells(
    labels: tuple[int, ...], edges: tuple[np.ndarray, ...], points: Sequence[np.ndarray]
) -> np.ndarray:
    """Number of the cell of each point; the first continuous argument runs fastest."""
    points = np.broadcast_arrays(*points)
    group = _group(labels, points)
    cell = np.zeros(group.shape, dtype=np.intp)
    continuous = [point for count, point in zip(labels, points, strict=True) if not count]
    for rows, point in zip(reversed(edges), reversed(continuous), strict=True):
        bin = np.zeros(group.shape, dtype=np.intp)
        for number, row in enumerate(rows):
            members = group == number
            bin[members] = np.searchsorted(row, point[members])
        cell = cell * (rows.shape[1] + 1) + bin
    for rows in edges:
        group = group * (rows.shape[1] + 1)
    return group + cell


def _group(labels, points) -> np.ndarray:
    """Number of the combination of the discrete arguments."""
    group = np.zeros(np.shape(points[0]), dtype=np.intp)
    for count, point in zip(labels, points, strict=True):
        if count:
            group = group * count + point.astype(np.intp)
    return group


def binned_synthesis(
    system: AnySystem,
    memory: Memory,
    times: ArrayLike,
    *,
    paths: Count,
    seed: Seed,
    bins: Count = 40,
    workers: int = 1,
) -> OutputFilter:
    """Finite-order filter by the histograms of section 5, as the papers describe it.

    State, measurement and memory are simulated. At each step the arguments of the output function
    are sorted into cells: the estimate of a cell is the mean state of its paths, its mode that of
    the majority. The function is applied to the same paths, and so on. Nothing is smoothed:
    `simulated_synthesis` wants far fewer paths.

    Each continuous argument has cells of equal probability for each value of the discrete ones; a
    cell with few paths takes the mean over all memories with its measurement.

    Parameters
    ----------
    system : SwitchingSystem, JumpDiffusion or DiscreteSystem
        Of one measured component.
    memory : Memory
    times : array_like, shape (K+1,)
    paths : int
    seed : int, SeedSequence or Generator
    bins : int
        Cells of each continuous argument.
    workers : int
        Threads of the simulation.

    Returns
    -------
    OutputFilter
        Its predicted errors are those on its own paths, which flatter it; those in `held_out` do
        not.

    Raises
    ------
    TypeError, ValueError
        An argument that does not fit.

    Warns
    -----
    UserWarning
        Errors on other paths that are not the predicted ones: too many cells for the paths.
    """
    as_system("system", system, *KINDS)
    if system.measurement_size != 1:
        raise ValueError("system: wanted one measured component for a histogram")
    bins = as_count("bins", bins, 2)
    samples, steps = MemoryPaths(system, memory, times, paths, 1, seed, workers), []
    for k in followed(range(len(samples.times)), "design of tables"):
        sample = samples.sample()
        axes = step_axes(system, memory, (None,), (None,) * system.state_size, k)
        functions = [
            _fitted(system, sample, _label_counts(part), measured, bins)
            for part, measured in zip(axes, (True, False), strict=True)
        ]
        steps.append(Step(*functions))
        samples.apply(steps[-1].update)
    return samples.designed(OutputFilter, steps=tuple(steps), method=METHOD)


def _label_counts(axes) -> tuple[int, ...]:
    return tuple(axis.count if isinstance(axis, Labels) else 0 for axis in axes)


def _fitted(
    system: AnySystem, sample: Sample, labels: tuple[int, ...], measured: bool, bins: int
) -> BinnedOutput:
    """The function of one step: means and majorities in cells of its arguments."""
    points, states, modes = sample.arguments(system, measured), sample.states, sample.modes
    count = states.shape[1]
    group = _group(labels, points) if points else np.zeros(count, dtype=np.intp)
    groups, levels = math.prod(c for c in labels if c), np.arange(1, bins) / bins
    edges = tuple(
        np.stack([_levels(point[group == g], point, levels) for g in range(groups)])
        for c, point in zip(labels, points, strict=True)
        if not c
    )
    cell = cells(labels, edges, points) if points else group
    rows = [np.ones(count), *states]
    if modes is not None:
        rows += [modes == i for i in range(system.modes)]
    sums = np.stack([np.bincount(cell, row, groups * bins ** len(edges)) for row in rows])
    # the measurement runs fastest: few paths in a cell take all memories with its measurement
    by_bin = sums.reshape(len(sums), groups, -1, bins if edges else 1)
    pooled = np.broadcast_to(by_bin.sum(axis=2, keepdims=True), by_bin.shape).reshape(sums.shape)
    sums = np.where(sums[0] < FEWEST, pooled, sums)
    sums = np.where(sums[0] < FEWEST, sums.sum(axis=1, keepdims=True), sums)
    values = sums[1:] / np.maximum(sums[0], 1.0)
    if modes is None:
        return BinnedOutput(labels, edges, values, None)
    mode = most_probable(values[len(states) :])
    return BinnedOutput(labels, edges, values[: len(states)], mode)


def _levels(inside, everywhere, levels) -> np.ndarray:
    """Quantiles of the values in a group, of all values where it is empty."""
    return np.quantile(inside if inside.size else everywhere, levels)
