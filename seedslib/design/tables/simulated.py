"""Synthesis of optimal filters of finite order on simulated paths: tables by regression."""

from __future__ import annotations

import numpy as np

from seedslib.base.tables import Axis, as_axes
from seedslib.design.tables.carriers import Carriers
from seedslib.design.tables.regression import (
    METHODS,
    forecast_table,
    histogram_table,
    likelihood_table,
)
from seedslib.design.tables.switching_simulated import (
    SwitchingCarriers,
    switching_tables,
    want_densities,
)
from seedslib.designed.finite_order_rules import Start
from seedslib.designed.lookup import step_axes
from seedslib.designed.switching_table import SwitchingTableFilter
from seedslib.designed.table import OutputRules, Table, TableFilter, TableFit
from seedslib.models.kinds import KINDS, require_kind

LARGEST_TABLE = 1 << 25
"""Entries of a table beyond which a design by tables is refused."""

PILOT = 2000
"""Paths that the default axes are laid about."""


def simulated_synthesis(
    system, memory, times, *, paths, seed, z=None, y=None, method="likelihood", components=None,
    sets=2, kernel=0.5, nodes=4, workers=1, probabilities=False,
) -> TableFilter | SwitchingTableFilter:  # fmt: skip
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
    TableFilter, or SwitchingTableFilter for a switching system
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
    require_kind(system, *KINDS)
    switching = hasattr(system, "branches")
    if probabilities and not switching:
        raise ValueError("probabilities: wanted False, the system has no modes")
    if method == "likelihood" and switching:
        want_densities(system)
    elif method == "likelihood" and not system.sensor.has_log_density:
        raise ValueError("method: likelihood wants a sensor with a log-density; use histogram")
    if not 0 < kernel < np.inf:
        raise ValueError(f"kernel: wanted a positive number, got {kernel}")
    if switching:
        return _switching(
            system, memory, times, paths, seed, z, y, method, components, sets, kernel, workers,
            probabilities,
        )  # fmt: skip
    carriers = Carriers(system, memory, times, components, paths, sets, nodes, seed, workers)
    components = carriers.components
    axes_y, axes_z = _axes(system.sensor.size, carriers, y, z)
    refuse_large(axes_y, axes_z, memory)
    outputs, ends, between = [], [], []
    for k, t in enumerate(carriers.times):
        axes_u = held_axes(memory, axes_y, axes_z, k)
        lesson = carriers.lesson()
        if method == "likelihood":
            table = likelihood_table(
                system.sensor, float(t), lesson, components, axes_y, axes_u, kernel
            )
        else:
            table = histogram_table(lesson, components, axes_y, axes_u, kernel)
        outputs.append(TableFit(axes_y + axes_u, table))
        carriers.take(outputs[-1])
        if k + 1 == len(carriers.times):
            break
        axes_u, found = held_axes(memory, axes_y, axes_z, k + 1), []
        for stop in carriers.stops[k]:
            lesson = carriers.forecast_lesson(stop)
            found.append(TableFit(axes_u, forecast_table(lesson, components, axes_u, kernel)))
            if stop != carriers.stops[k][-1]:
                carriers.score(stop, found[-1])
        ends.append(found.pop())
        between.append(tuple(found))
    letters = axes_z if memory.estimates else axes_y
    return carriers.examined(TableFilter(
        system=system, memory=memory, predictor=Table(axes_y, letters, METHODS[method]),
        linearization=None, times=carriers.times,
        node_times=tuple(s[:-1] for s in carriers.stops), components=components,
        start=Start(system.mean0, system.cov0, None), fits=tuple(ends),
        node_fits=tuple(between), predicted=carriers.prediction(), design=carriers.design(),
        rules=OutputRules(
            memory, components, sensor=None, outputs=tuple(outputs),
            covariances=carriers.covariances,
        ),
    ))  # fmt: skip


def _switching(
    system, memory, times, paths, seed, z, y, method, components, sets, kernel, workers,
    probabilities,
):  # fmt: skip
    carriers = SwitchingCarriers(system, memory, times, components, paths, sets, seed, workers)
    axes_y, axes_z = _axes(system.measurement_size, carriers, y, z)
    letters = axes_z if memory.estimates else axes_y
    _refuse(step_axes(system, memory, axes_y, letters, memory.depth)[0])
    return switching_tables(system, carriers, axes_y, axes_z, method, kernel, probabilities)


def held_axes(memory, axes_y, axes_z, k) -> tuple[Axis, ...]:
    """Axes of the memory before measurement k."""
    return axes_z * min(k, memory.estimates) + axes_y * min(k, memory.measurements)


def refuse_large(axes_y, axes_z, memory) -> None:
    """Refuse tables that would not fit.

    Raises
    ------
    ValueError
        Too many entries.
    """
    _refuse(axes_y + held_axes(memory, axes_y, axes_z, memory.depth))


def _refuse(axes):
    entries = float(np.prod([float(axis.count) for axis in axes]))
    if entries > LARGEST_TABLE:
        raise ValueError(
            f"memory: tables over {len(axes)} arguments would have {entries:.3g} entries; wanted "
            f"at most {LARGEST_TABLE}: fewer nodes, a shorter memory, or seedslib.extra.learned"
        )


def _axes(m, carriers, y, z):
    """Axes of measurements and estimates, laid about the paths where none are given."""
    n = carriers.components
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
