"""Design of optimal filters of a given memory on simulated paths: tables by regression."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.progress import followed
from seedslib.base.tables import AxesLike, Axis, as_axes, mesh
from seedslib.design.kernels import METHODS, histogram_table, likelihood_table
from seedslib.design.samples import MemoryPaths, Sample
from seedslib.designed.memory import Memory
from seedslib.designed.tables import Step, Table, TableFilter, prior, step_axes
from seedslib.filters.weights import most_probable
from seedslib.models.kinds import KINDS, AnySystem, as_system, switches

LARGEST_TABLE = 1 << 25
"""Entries of a table beyond which a design by tables is refused."""


def simulated_synthesis(
    system: AnySystem,
    memory: Memory,
    times: ArrayLike,
    *,
    paths: Count,
    seed: Seed,
    y: AxesLike,
    z: AxesLike | None = None,
    method: str = "likelihood",
    workers: int = 1,
) -> TableFilter:
    """Optimal filter of finite order by regression on simulated paths, measurement by measurement.

    Section 5 of the jump-diffusion paper: at each measurement the optimal function
    M[X | y, u] is estimated from paths that carry state and memory, tabulated, and applied to
    the paths. There are two sets of paths, and functions are fitted to them in turn: no
    function meets, at the next measurement, a memory that it has been fitted to.

    Parameters
    ----------
    system : JumpDiffusion or SwitchingSystem
    memory : Memory
        Of estimates, of measurements, or of both; for a switching system of one of the two, with
        the decided modes, and of as many indicators where they are to be remembered.
    times : array_like, shape (K+1,)
        Times of the measurements; the first is that of the initial distribution.
    paths : int
        Paths that each function is fitted to.
    seed : int, SeedSequence or Generator
    y, z : sequence of Axis or (low, high, count)
        Nodes for each component of a measurement and of an estimate; one alone where there is
        one component. A memory of measurements alone takes no `z`.
    method : {"likelihood", "histogram"}
        Smooth in the memory only and weight by the known likelihood of y (Rao-Blackwellised), or
        count simulated measurements too (the paper's method).
    workers : int
        Threads of the simulation.

    Returns
    -------
    TableFilter
        Its predicted errors are those on paths that the function at that time has not seen.

    Raises
    ------
    TypeError, ValueError
        An argument that does not fit; no likelihood where it is wanted; tables that would be too
        large.

    Warns
    -----
    UserWarning
        Paths that diverged and were left out.
    """
    if method not in METHODS:
        raise ValueError(f"method: wanted one of {', '.join(METHODS)}, got {method!r}")
    as_system("system", system, *KINDS)
    likelihood = method == "likelihood"
    if likelihood and not all(b is None or b.has_log_density for b in _readings(system)):
        raise ValueError("method: likelihood wants a sensor with a log-density; use histogram")
    samples = MemoryPaths(system, memory, times, paths, 2, seed, workers)
    axes_y, axes_z = _axes(system, memory, system.state_size, y, z)
    steps = []
    for k, t in enumerate(followed(samples.times, "design of tables")):
        axes, memory_axes = step_axes(system, memory, axes_y, axes_z, k)
        sample = samples.sample()
        if likelihood:
            update = _by_likelihood(samples, float(t), sample, axes)
        else:
            update = _by_histogram(samples, sample, axes)
        forecast = prior(system, system.state_size)
        if k or switches(system):
            forecast = _by_histogram(samples, sample, memory_axes, measured=False)
        steps.append(Step(update, forecast))
        samples.apply(update)
    return samples.designed(TableFilter, steps=tuple(steps), method=METHODS[method])


def _by_histogram(paths: MemoryPaths, sample: Sample, axes: Any, measured: bool = True) -> Table:
    """Smoothed histogram over indicator, measurement where it is used, and memory."""
    targets, points = _targets(paths, sample), _points(paths, sample, axes, measured)
    pooled = paths.system.indicators > 0
    return _table(paths, axes, histogram_table(targets, points, axes, pooled))


def _by_likelihood(paths: MemoryPaths, t: float, sample: Sample, axes: Any) -> Table:
    """Regression in the memory alone, weighted by the likelihoods of measurement and indicator."""
    targets, first = _targets(paths, sample), int(paths.system.indicators > 0)
    last = first + len(sample.measurements)
    log_density = _log_density(paths.system, t, sample, axes[first:last])
    points = _points(paths, sample, axes[last:], measured=False)
    values = likelihood_table(log_density, targets, points, axes[:last], axes[last:])
    return _table(paths, axes, values)


def _points(paths, sample, axes, measured) -> np.ndarray:
    """Arguments over the axes, the last ones of the function, (d, N)."""
    points = sample.arguments(paths.system, measured)
    points = np.array(points[len(points) - len(axes) :], dtype=float)
    return points.reshape(len(axes), sample.states.shape[1])


def _targets(paths, sample) -> np.ndarray:
    """What is regressed: which mode it is, where there are modes, and the state, (L + n, N)."""
    if sample.modes is None:
        return sample.states
    return np.concatenate([sample.modes == np.arange(paths.system.modes)[:, None], sample.states])


def _table(paths, axes, values) -> Table:
    """Table of the regression, of probabilities, where there are modes, and estimates."""
    if not switches(paths.system):
        return Table(axes, values)
    prob, means = np.split(values, [paths.system.modes])
    return Table(axes, means, most_probable(prob).astype(np.int8))


def _log_density(system, t, sample, axes) -> Callable[[slice], np.ndarray]:
    """Logarithm of the density of indicator and measurement on a grid, for a slice of the paths."""
    grid, x, p = mesh(axes)[:, None, :], sample.states, system.values()
    if not switches(system):
        return lambda part: system.sensor.log_density(t, grid, x[:, part, None], p)
    values = [*range(system.indicators), -1] if system.indicators else [0]

    def log_density(part):
        modes, states = sample.modes[part], x[:, part, None]
        logs = np.full((len(modes), len(values), grid.shape[2]), -np.inf)
        for i in range(system.modes):
            rows = np.flatnonzero(modes == i)
            in_mode = np.broadcast_to(states[:, rows], (len(x), len(rows), grid.shape[2]))
            for column, j in enumerate(values):
                reading = system.sensors[i] if j < 0 else system.readings[i][j]
                if reading is not None and rows.size:
                    logs[rows, column] = reading.log_density(t, grid, in_mode, p)
        return logs.reshape(len(modes), -1)

    return log_density


def _readings(system) -> list[Any]:
    """All that may be measured; None for a reading that never comes."""
    if not switches(system):
        return [system.sensor]
    return [reading for row in system.readings for reading in row]


def _axes(
    system: AnySystem, memory: Memory, components: int, y: AxesLike, z: AxesLike | None
) -> tuple[tuple[Axis, ...], tuple[Axis, ...]]:
    """Axes of measurements and of estimates.

    Raises
    ------
    TypeError, ValueError
        Axes that are none; tables with too many entries.
    """
    axes_y = as_axes("y", y, system.measurement_size)
    axes_z = as_axes("z", z, components) if memory.estimates or z is not None else ()
    axes = step_axes(system, memory, axes_y, axes_z, memory.depth)[0]
    entries = float(np.prod([float(axis.count) for axis in axes]))
    if entries > LARGEST_TABLE:
        raise ValueError(
            f"memory: tables over {len(axes)} arguments would have {entries:.3g} entries; wanted "
            f"at most {LARGEST_TABLE}: fewer nodes, a shorter memory, or seedslib.extra.learned"
        )
    return axes_y, axes_z
