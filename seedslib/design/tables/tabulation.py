"""Any designed filter of finite order as a function of measurement and memory, and as a table."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from seedslib.base.tables import AxesLike, as_axes, mesh
from seedslib.design.tables.simulated import refuse_large
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import FiniteOrderState
from seedslib.designed.outputs.filter import OutputFilter
from seedslib.designed.outputs.lookup import Output, Step, Table, recalled, step_axes
from seedslib.designed.outputs.table import TableFilter
from seedslib.models.kinds import switches

BLOCK = 1 << 16
"""Points at which a function is read off together."""


def output(filter: Any, k: int, y: np.ndarray, u: np.ndarray) -> np.ndarray:
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
    m = filter.system.measurement_size
    size = filter.memory.dimension(k - 1, filter.components, m) if k else 0
    y, u = np.asarray(y, dtype=float), np.asarray(u, dtype=float)
    if len(u) != size or len(y) != m:
        raise ValueError(f"y, u: wanted {m} and {size} components, got {len(y)} and {len(u)}")
    batch = np.broadcast_shapes(y.shape[1:], u.shape[1:])
    y, u = np.broadcast_to(y, (m, *batch)), np.broadcast_to(u, (size, *batch))
    state = _after(filter, k - 1, u) if k else filter.initial(batch)
    return filter.correct(filter.predict(state, filter.times[k]), y).mean


def tabulated(filter: Any, *, y: Any, z: AxesLike | None = None) -> TableFilter:
    """The same filter with its functions read off at the nodes of axes.

    The table runs without the model, so it may be handed on as a file alone.

    Parameters
    ----------
    filter : FiniteOrderFilter or OutputFilter
        Learned, or with one estimated component: of several, a regression design does not know
        the error covariances that a table holds. Its forecasts end at the last measurement.
    y, z : sequence of Axis or (low, high, count)
        Nodes for each component of a measurement and of an estimate; one alone where there is
        one component. A memory of measurements alone takes no `z`.

    Raises
    ------
    TypeError, ValueError
        Another filter, axes that are none, tables that would be too large, a filter whose
        forecasts look at a measurement that is not remembered, more than one estimated component,
        a design with a schedule or an availability.
    """
    if not isinstance(filter, FiniteOrderFilter | OutputFilter) or switches(filter.system):
        raise TypeError(
            f"filter: wanted a FiniteOrderFilter, got a {type(filter).__name__}; tables of a "
            "switching system come from simulated_synthesis or grid_synthesis"
        )
    if filter.measured is not None or filter.availability is not None:
        raise ValueError(
            "filter: wanted one whose sensor is always there; tables for a schedule or an "
            "availability come from grid_synthesis"
        )
    system, memory, times = filter.system, filter.memory, filter.times
    axes_y = as_axes("y", y, system.measurement_size)
    axes_z = as_axes("z", z, filter.components) if memory.estimates or z is not None else ()
    refuse_large(system, memory, axes_y, axes_z)
    if getattr(filter, "measured_nodes", False) and not memory.measurements:
        raise ValueError(
            "filter: wanted forecasts from the memory alone, got measured_nodes, which look at "
            "a measurement that is not remembered"
        )
    known, covariances = isinstance(filter, OutputFilter), _covariances(filter)
    steps, node_fits = (filter.steps, filter.node_fits) if known else _functions(filter)
    axes = [step_axes(system, memory, axes_y, axes_z, k) for k in range(len(times))]
    return TableFilter(
        system=system, memory=memory, times=times,
        steps=tuple(Step(*map(_read, *pair)) for pair in zip(steps, axes, strict=True)),
        method=f"read off {filter.method if known else filter.predictor}",
        predicted=filter.predicted, covariances=covariances, design=filter.design,
        node_times=filter.node_times[: len(times) - 1],
        node_fits=tuple(
            tuple(_read(fit, blind) for fit in fits)
            for fits, (_, blind) in zip(node_fits, axes[1:], strict=False)
        ),
        between=filter.between,
    )  # fmt: skip


def _read(function, axes) -> Table:
    """A function at the nodes of the axes."""
    points = mesh(axes)
    parts = [points[:, a : a + BLOCK] for a in range(0, points.shape[1], BLOCK)]
    values = [function([*part]).filling(part.shape[1:]).mean for part in parts]
    return Table(axes, np.concatenate(values, axis=1).reshape(-1, *(a.count for a in axes)))


def _functions(filter) -> tuple[list, list]:
    """The functions of a filter with affine or polynomial forecasts: outputs, and at nodes."""
    m, n, times = filter.system.measurement_size, filter.components, filter.times

    def shown(k, points):
        points = np.array(points)
        return Output(output(filter, k, points[:m], points[m:]))

    def blind(k, points):
        state = _after(filter, k - 1, points) if k else filter.initial()
        return Output(filter.predict(state, times[k]).mean[:n])

    def node(k, i, points):
        return Output(filter.nodes_after(k, _after(filter, k, points))[0][i])

    steps = [Step(partial(shown, k), partial(blind, k)) for k in range(len(times))]
    return steps, [
        [partial(node, k, i) for i in range(len(stops))]
        for k, stops in enumerate(filter.node_times[: len(times) - 1])
    ]


def _after(filter, k, points) -> FiniteOrderState:
    """State after measurement k of which only the memory is known."""
    past = recalled(filter.system, filter.memory, filter.components, k, points)
    unknown = np.full((filter.components, *np.shape(points[0])), np.nan)
    mean = past.estimates[0] if past.estimates else unknown
    return FiniteOrderState(k, mean, None, past, None, 0.0, None, True)


def _covariances(filter) -> np.ndarray:
    """Error covariances at the measurements, shape (K+1, n', n')."""
    if isinstance(filter, OutputFilter):
        return filter.covariances
    if filter.components > 1:
        raise ValueError(
            f"filter: wanted one estimated component, got {filter.components}; of several the "
            "design knows no error covariance (design with components=1)"
        )
    predicted = filter.predicted
    at = np.abs(predicted.times - filter.times[:, None]).argmin(axis=1)
    return predicted.rms[at][:, :, None] ** 2
