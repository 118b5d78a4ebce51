"""Synthesis of optimal filters of a given memory on simulated paths: tables by regression."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.checks import as_positive
from seedslib.base.progress import followed
from seedslib.base.tables import AxesLike, Axis, as_axes, mesh
from seedslib.design.carriers import Carriers, counted, likely, sensors_of
from seedslib.design.kernels import METHODS
from seedslib.designed.memory import Memory
from seedslib.designed.tables import OutputFilter, Step, Table, TableFilter, prior, step_axes
from seedslib.models.kinds import KINDS, AnySystem, as_system, switches

LARGEST_TABLE = 1 << 25
"""Entries of a table beyond which a design by tables is refused."""

PILOT = 2000
"""Paths that the default axes are laid about."""


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
    sets: int = 2,
    kernel: float = 0.5,
    nodes: Count = 4,
    workers: int = 1,
    probabilities: bool = False,
) -> TableFilter:
    """Optimal filter of finite order by regression on simulated paths, measurement by measurement.

    Section 5 of the jump-diffusion paper: at each measurement the optimal function
    M[X | y, u] is estimated from paths that carry state and memory, tabulated, and applied to
    the paths. There are several sets of paths, and functions are fitted to them in turn: no
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
    sets : int
        Sets of paths, at least 2.
    kernel : float
        Width of the smoothing kernel in units of the normal reference rule, which is too wide
        for densities of several peaks.
    nodes : int
        Number of evenly spaced forecasts inside each interval; a switching system has none.
    workers : int
        Threads of the simulation.
    probabilities : bool
        Whether tables of the probabilities of the modes are wanted too.

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
    if probabilities and not switches(system):
        raise ValueError("probabilities: wanted False, the system has no modes")
    if method == "likelihood" and not all(
        b is None or b.has_log_density for b in sensors_of(system)
    ):
        raise ValueError("method: likelihood wants a sensor with a log-density; use histogram")
    kernel = as_positive("kernel", kernel)
    carriers = Carriers(system, memory, times, components, paths, sets, nodes, seed, workers)
    axes_y, axes_z = _axes(carriers, y, z)
    refuse_large(system, memory, axes_y, axes_z)
    steps, between = [], []
    for k, t in enumerate(followed(carriers.times, "design of tables")):
        shown, blind = step_axes(system, memory, axes_y, axes_z, k)
        lesson = carriers.lesson()
        if method == "likelihood":
            output = likely(carriers, float(t), lesson, shown, kernel)
        else:
            output = counted(carriers, lesson, shown, kernel)
        forecast = prior(system, carriers.components)
        if k or switches(system):
            forecast = counted(carriers, lesson, blind, kernel, blind=True)
        steps.append(Step(output, forecast))
        carriers.take(output)
        if k + 1 < len(carriers.times):
            axes, fits = step_axes(system, memory, axes_y, axes_z, k + 1)[1], []
            for stop in carriers.stops[k][:-1]:
                fits.append(counted(carriers, carriers.forecast_lesson(stop), axes, kernel))
                carriers.score(stop, fits[-1])
            between.append(tuple(fits))
    if not probabilities:
        steps = [Step(*(table._replace(prob=None) for table in step)) for step in steps]
    return carriers.examined(
        TableFilter(
            system=system,
            memory=memory,
            times=carriers.times,
            steps=tuple(steps),
            method=METHODS[method],
            predicted=carriers.prediction(),
            covariances=carriers.covariances,
            design=carriers.design(),
            node_times=tuple(stops[:-1] for stops in carriers.stops),
            node_fits=tuple(between),
        )
    )


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


def _axes(carriers, y, z):
    """Axes of measurements and estimates, laid about the paths where none are given."""
    n, m = carriers.components, carriers.system.measurement_size
    arguments = m + carriers.memory.order(n, m)
    most = {2: 201, 3: 81}.get(arguments, max(7, int(LARGEST_TABLE ** (0.9 / arguments))))
    pilot = carriers.sets[0]
    if y is None:
        shown = pilot.measurements[..., :PILOT].swapaxes(0, 1).reshape(m, -1)
        y = [_about(row, most) for row in shown]
    if z is None:
        states = np.concatenate([pilot.states[float(t)][:n, :PILOT] for t in carriers.times], 1)
        z = [_about(row, most) for row in states]
    return as_axes("y", y, m), as_axes("z", z, n)


def _about(values, count):
    low, high = values.min(), values.max()
    # values that are all one leave no scale but their own size, or none at all
    reach = 0.1 * (high - low) or 1e-9 * max(abs(high), abs(low)) or 1.0
    return Axis(low - reach, high + reach, count)


BLOCK = 1 << 16
"""Points at which a function is read off together."""


def tabulated(filter: OutputFilter, *, y: Any, z: AxesLike | None = None) -> TableFilter:
    """The same filter with its functions read off at the nodes of axes.

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
    steps = [Step(*map(_read, *pair)) for pair in zip(filter.steps, axes, strict=True)]
    between = [
        tuple(_read(fit, blind) for fit in fits)
        for fits, (_, blind) in zip(filter.node_fits, axes[1:], strict=False)
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
        node_fits=tuple(between),
        between=filter.between,
    )


def _read(function, axes) -> Table:
    """A function at the nodes of the axes."""
    points = mesh(axes)
    parts = [points[:, a : a + BLOCK] for a in range(0, points.shape[1], BLOCK)]
    values = [function([*part]).on(part.shape[1:]).mean for part in parts]
    return Table(axes, np.concatenate(values, axis=1).reshape(-1, *(a.count for a in axes)))
