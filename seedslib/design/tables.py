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
from seedslib.designed.tables import OutputFilter, Step, Table, TableFilter, prior, step_axes
from seedslib.filters.weights import most_probable
from seedslib.models.kinds import KINDS, AnySystem, as_system, switches

LARGEST_TABLE = 1 << 25
"""Entries of a table beyond which a design by tables is refused."""

PILOT = 2000
"""Paths that the default axes are laid about."""

AT_ONCE = 1 << 16
"""Points at which a function is evaluated together."""


def simulated_synthesis(
    system: AnySystem,
    memory: Memory,
    times: ArrayLike,
    *,
    paths: Count,
    seed: Seed,
    z: AxesLike | None = None,
    y: AxesLike | None = None,
    method: str = "likelihood",
    components: int | None = None,
    nodes: Count = 4,
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
        Times of the measurements; the first is that of the initial law.
    paths : int
        Paths that each function is fitted to.
    seed : int, SeedSequence or Generator
    z, y : sequence of Axis or (low, high, count), optional
        Nodes for each component of an estimate and of a measurement; one alone where there is
        one component. By default laid about simulated paths.
    method : {"likelihood", "histogram"}
        Smooth in the memory only and weight by the known likelihood of y (Rao-Blackwellised), or
        count simulated measurements too (the paper's method).
    components : int, optional
        n': the first components of the state are estimated (default all).
    nodes : int
        Number of evenly spaced forecasts inside each interval; a switching system has none.
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
    samples = MemoryPaths(system, memory, times, components, paths, 2, nodes, seed, workers)
    axes_y, axes_z = _axes(samples, y, z)
    refuse_large(system, memory, axes_y, axes_z)
    steps, node_fits = [], []
    for k, t in enumerate(followed(samples.times, "design of tables")):
        axes, memory_axes = step_axes(system, memory, axes_y, axes_z, k)
        sample = samples.sample()
        if likelihood:
            update = _by_likelihood(samples, float(t), sample, axes)
        else:
            update = _by_histogram(samples, sample, axes)
        forecast = prior(system, samples.components)
        if k or switches(system):
            forecast = _by_histogram(samples, sample, memory_axes, measured=False)
        steps.append(Step(update, forecast))
        samples.apply(update)
        if k + 1 < len(samples.times):
            axes, fits = step_axes(system, memory, axes_y, axes_z, k + 1)[1], []
            for stop in samples.stops[k][:-1]:
                fits.append(_by_histogram(samples, samples.sample(stop), axes))
                samples.score(stop, fits[-1])
            node_fits.append(tuple(fits))
    return samples.designed(
        TableFilter,
        steps=tuple(steps),
        method=METHODS[method],
        node_times=tuple(stops[:-1] for stops in samples.stops),
        node_fits=tuple(node_fits),
    )


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
    """What is regressed: which mode it is, where there are modes, and the state, (L + n', N)."""
    states = sample.states[: paths.components]
    if sample.modes is None:
        return states
    return np.concatenate([sample.modes == np.arange(paths.system.modes)[:, None], states])


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


def refuse_large(system: AnySystem, memory: Memory, axes_y: Any, axes_z: Any) -> None:
    """Refuse tables that would not fit.

    Raises
    ------
    ValueError
        Too many entries.
    """
    axes = step_axes(system, memory, axes_y, axes_z, memory.depth)[0]
    entries = float(np.prod([float(axis.count) for axis in axes]))
    if entries > LARGEST_TABLE:
        raise ValueError(
            f"memory: tables over {len(axes)} arguments would have {entries:.3g} entries; wanted "
            f"at most {LARGEST_TABLE}: fewer nodes, a shorter memory, or seedslib.extra.learned"
        )


def _axes(paths, y, z):
    """Axes of measurements and estimates, laid about the paths where none are given."""
    n, m = paths.components, paths.system.measurement_size
    arguments = m + paths.memory.order(n, m)
    most = {2: 201, 3: 81}.get(arguments, max(7, int(LARGEST_TABLE ** (0.9 / arguments))))
    pilot = paths.sets[0]
    if y is None:
        measured = pilot.measurements[..., :PILOT].swapaxes(0, 1).reshape(m, -1)
        y = [_about(row, most) for row in measured]
    if z is None:
        states = np.concatenate([pilot.states[float(t)][:n, :PILOT] for t in paths.times], 1)
        z = [_about(row, most) for row in states]
    return as_axes("y", y, m), as_axes("z", z, n)


def _about(values, count):
    low, high = values.min(), values.max()
    # values that are all one leave no scale but their own size, or none at all
    reach = 0.1 * (high - low) or 1e-9 * max(abs(high), abs(low)) or 1.0
    return Axis(low - reach, high + reach, count)


def tabulated(filter: OutputFilter, *, y: Any, z: AxesLike | None = None) -> TableFilter:
    """The same filter with its functions as tables over the nodes of axes.

    The table runs without the model, so it may be handed on as a file alone.

    Parameters
    ----------
    filter : OutputFilter
        Learned, or of functions of one's own.
    y, z : sequence of Axis or (low, high, count)
        Nodes for each component of a measurement and of an estimate; one alone where there is
        one component. A memory of measurements alone takes no `z`.

    Raises
    ------
    TypeError, ValueError
        Another filter, axes that are none, tables that would be too large.
    """
    if not isinstance(filter, OutputFilter) or switches(filter.system):
        raise TypeError(f"filter: wanted output functions, got a {type(filter).__name__}")
    system, memory = filter.system, filter.memory
    axes_y = as_axes("y", y, system.measurement_size)
    axes_z = as_axes("z", z, filter.components) if memory.estimates or z is not None else ()
    refuse_large(system, memory, axes_y, axes_z)
    axes = [step_axes(system, memory, axes_y, axes_z, k) for k in range(len(filter.times))]
    steps = [Step(*map(_sampled, *pair)) for pair in zip(filter.steps, axes, strict=True)]
    node_fits = [
        tuple(_sampled(fit, memory_axes) for fit in fits)
        for fits, (_, memory_axes) in zip(filter.node_fits, axes[1:], strict=False)
    ]
    return TableFilter(
        system=system,
        memory=memory,
        times=filter.times,
        steps=tuple(steps),
        method=f"read off {filter.method}",
        predicted=filter.predicted,
        covariances=filter.covariances,
        design=filter.design,
        node_times=filter.node_times,
        node_fits=tuple(node_fits),
        between=filter.between,
    )


def _sampled(function, axes) -> Table:
    """Table of a function at the nodes of the axes."""
    points = mesh(axes)
    parts = [points[:, a : a + AT_ONCE] for a in range(0, points.shape[1], AT_ONCE)]
    values = [function([*part]).on(part.shape[1:]).mean for part in parts]
    return Table(axes, np.concatenate(values, axis=1).reshape(-1, *(a.count for a in axes)))
