"""Any designed filter of finite order as a function of measurement and memory, and as a table."""

from __future__ import annotations

import numpy as np

from seedslib.base.tables import as_axes
from seedslib.design.tables.simulated import held_axes, refuse_large
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import Course, FiniteOrderState, Start
from seedslib.designed.memory import Past
from seedslib.designed.table import OutputFilter, OutputRules, Table, TableFilter, TableFit

BLOCK = 1 << 16
"""Points at which a function is read off together."""


def output(filter, k: int, y: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Estimate f_k(y, u) of a designed filter from measurement k and the memory before it.

    Parameters
    ----------
    filter : FiniteOrderFilter
    k : int
        Number of the measurement, from 0.
    y : array_like, shape (m, *batch)
        Nothing missing.
    u : array_like, shape (d, *batch)
        Estimates, newest first, then measurements, newest first; at k = 0 there are none.

    Returns
    -------
    ndarray, shape (n', *batch)

    Raises
    ------
    ValueError
        No such measurement, or a memory of another size.
    """
    if not 0 <= k < len(filter.times):
        raise ValueError(f"k: wanted 0 to {len(filter.times) - 1}, got {k}")
    m = filter.system.sensor.size
    size = filter.memory.dimension(k - 1, filter.components, m) if k else 0
    y, u = np.asarray(y, dtype=float), np.asarray(u, dtype=float)
    if len(u) != size or len(y) != m:
        raise ValueError(f"y, u: wanted {m} and {size} components, got {len(y)} and {len(u)}")
    batch = np.broadcast_shapes(y.shape[1:], u.shape[1:])
    y, u = np.broadcast_to(y, (m, *batch)), np.broadcast_to(u, (size, *batch))
    if isinstance(filter, OutputFilter):
        return filter.output(k, y, u)
    state = _after(filter, k - 1, u) if k else filter.initial(batch)
    return filter.correct(filter.predict(state, filter.times[k]), y).mean


def tabulated(filter, *, y, z=None) -> TableFilter:
    """The same filter with its functions read off at the nodes of axes.

    The table runs without the model, so it may be handed on as a file alone.

    Parameters
    ----------
    filter : FiniteOrderFilter
        Learned, or with one estimated component: of several, a regression design does not know
        the error covariances that a table holds. Its forecasts end at the last measurement.
    y, z : sequence of Axis or (low, high, count)
        Nodes for each component of a measurement and of an estimate; one alone where there is
        one component. A memory of measurements alone takes no `z`.

    Raises
    ------
    TypeError, ValueError
        Another filter, axes that are none, tables that would be too large, a filter whose
        forecasts look at a measurement that is not remembered, more than one estimated component.
    """
    if not isinstance(filter, FiniteOrderFilter):
        raise TypeError(
            f"filter: wanted a FiniteOrderFilter, got a {type(filter).__name__}; tables of a "
            "switching system come from simulated_synthesis or grid_synthesis"
        )
    memory, n, times = filter.memory, filter.components, filter.times
    m = filter.system.sensor.size
    axes_y = as_axes("y", y, m)
    axes_z = as_axes("z", z, n) if memory.estimates or z is not None else ()
    refuse_large(axes_y, axes_z, memory)
    if filter.measured_nodes and not memory.measurements:
        raise ValueError(
            "filter: wanted forecasts from the memory alone, got measured_nodes, which look at "
            "a measurement that is not remembered"
        )
    outputs, fits, node_fits = [], [], []
    for k in range(len(times)):
        held = held_axes(memory, axes_y, axes_z, k)
        outputs.append(_read(lambda p, k=k: output(filter, k, p[:m], p[m:]), axes_y + held))
        if k + 1 == len(times):
            break
        held, nodes = held_axes(memory, axes_y, axes_z, k + 1), filter.node_times[k]
        table = _read(lambda p, k=k: _forecasts(filter, k, p), held).values
        rows = [TableFit(held, part) for part in table.reshape(-1, n, *table.shape[1:])]
        node_fits.append(tuple(rows[: len(nodes)]))
        fits.append(rows[-1])
    rules = OutputRules(
        memory, n, sensor=None, outputs=tuple(outputs), covariances=_covariances(filter)
    )
    start = Start(filter.start.mean, filter.start.cov, None)
    return TableFilter(
        system=filter.system, memory=memory,
        predictor=Table(
            axes_y, axes_z if memory.estimates else axes_y, f"read off {filter.predictor}"
        ),
        linearization=None, times=times, node_times=filter.node_times[: len(fits)],
        components=n, start=start, fits=tuple(fits), node_fits=tuple(node_fits),
        predicted=filter.predicted, design=filter.design, between=filter.between, rules=rules,
    )  # fmt: skip


def _read(function, axes):
    points = np.array([g.ravel() for g in np.meshgrid(*[a.nodes for a in axes], indexing="ij")])
    parts = [function(points[:, a : a + BLOCK]) for a in range(0, points.shape[1], BLOCK)]
    values = np.concatenate(parts, axis=1)
    return TableFit(axes, values.reshape(len(values), *(a.count for a in axes)))


def _forecasts(filter, k, u):
    """Forecasts at the nodes after measurement k and for the next one, below each other."""
    state, n = _after(filter, k, u), filter.components
    start, end = (float(t) for t in filter.times[k : k + 2])
    course = Course(start, filter.node_times[k], end, filter.node_fits[k])
    nodes, _ = filter.rules.nodes(course, state)
    return np.concatenate([*nodes, filter.predict(state, end).mean[:n]])


def _after(filter, k, u) -> FiniteOrderState:
    """State after measurement k of which only the memory is known."""
    n, m, memory = filter.components, filter.system.sensor.size, filter.memory
    held, shown = min(k + 1, memory.estimates), min(k + 1, memory.measurements)
    estimates = tuple(u[i * n : (i + 1) * n] for i in range(held))
    rest = u[held * n :]
    measurements = tuple(rest[i * m : (i + 1) * m] for i in range(shown))
    mean = estimates[0] if held else np.full((n, *u.shape[1:]), np.nan)
    past = Past(estimates, measurements)
    return FiniteOrderState(k, mean, None, past, None, 0.0, None, True)


def _covariances(filter) -> np.ndarray:
    """Error covariances at the measurements, shape (K+1, n', n')."""
    if isinstance(filter, OutputFilter):
        return filter.rules.covariances
    if filter.components > 1:
        raise ValueError(
            f"filter: wanted one estimated component, got {filter.components}; of several the "
            "design knows no error covariance (design with components=1)"
        )
    predicted = filter.predicted
    at = np.abs(predicted.times - filter.times[:, None]).argmin(axis=1)
    return predicted.rms[at][:, :, None] ** 2
