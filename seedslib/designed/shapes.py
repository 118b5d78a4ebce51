"""Whether the parts of a designed filter fit together, asked when it is made or read."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from seedslib.base.semidefinite import INDEFINITE
from seedslib.base.tables import Labels
from seedslib.designed.outputs.lookup import Step, Table, step_axes
from seedslib.designed.predictors import AffineFit, Continuous, PolynomialFit
from seedslib.designed.switching_fits import CellFit, cell_count


def check_shapes(filter: Any) -> None:
    """Refuse a filter whose parts do not fit together.

    Regressions and tables are held against the memory, the times and the model's sizes; functions
    of one's own are taken as they are.

    Raises
    ------
    TypeError, ValueError
        Arrays of another shape or kind, numbers that are not finite, covariances that are not
        semidefinite, times out of order, axes other than those of the memory.
    """
    if filter.times is None:  # a bank of all modes was not designed
        return
    times = filter.times
    _check("times", times, None)
    if not (times.size and (np.diff(times) > 0).all()):
        raise ValueError(f"times: wanted an increasing grid, got {times}")
    if hasattr(filter, "steps"):
        _check_outputs(filter)
    elif hasattr(filter, "node_fits"):
        _check_finite_order(filter)
    else:
        _check_cells(filter)
    _check_errors(filter)


def _check(name, array, *shape, finite=True):
    """Refuse what is no float64 array of finite numbers of a shape (None is any length)."""
    if not isinstance(array, np.ndarray) or array.dtype != np.float64:
        got = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise TypeError(f"{name}: wanted an array of float64, got {got}")
    if array.ndim != len(shape) or any(
        want not in (None, got) for want, got in zip(shape, array.shape, strict=True)
    ):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise ValueError(f"{name}: wanted shape ({wanted}), got {array.shape}")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name}: wanted finite numbers, got others")


def _check_parts(name, thing, **shapes):
    """`_check` of the named parts of a description."""
    for part, shape in shapes.items():
        _check(f"{name}.{part}", getattr(thing, part), *shape)


def _check_covariances(name: str, covariances: Iterable[np.ndarray]) -> None:
    """Refuse covariances (..., n, n) that are clearly indefinite.

    Held against their largest eigenvalue, as designs clip them: a variance in small units beside
    one in large units may be a rounding error. Those of one size are looked at once.
    """
    sizes: dict[tuple, list] = {}
    for cov in covariances:
        sizes.setdefault(cov.shape, []).append(cov)
    for shape, several in sizes.items():
        if all(shape):
            values = np.linalg.eigvalsh(np.stack(several))
            if (values[..., 0] < -INDEFINITE * np.maximum(values[..., -1], 0.0)).any():
                raise ValueError(
                    f"{name}: wanted positive semidefinite covariances, got eigenvalue "
                    f"{values.min():.3g}"
                )


def _check_finite_order(filter):
    start, times, memory, components = filter.start, filter.times, filter.memory, filter.components
    _check("start.mean", start.mean, None)
    n = len(start.mean)
    _check_parts("start", start, cov=(n, n))
    if not 1 <= components <= n:
        raise ValueError(f"components: wanted 1 to {n}, got {components}")
    _check("start.moments.mean", start.moments.mean, None)
    m = len(start.moments.mean)
    _check_parts("start.moments", start.moments, cross=(n, m), cov=(m, m))
    _check_covariances("start", (start.cov, start.moments.cov))
    intervals = len(times) - 1
    if len(filter.fits) != intervals:
        raise ValueError(f"fits: wanted {intervals}, got {len(filter.fits)}")
    _check_nodes(filter, [intervals, intervals + 1])
    sizes = [memory.dimension(k, components, m) for k in range(len(times))]
    extra = m if filter.measured_nodes and not memory.measurements else 0
    continuous = isinstance(filter.predictor, Continuous)
    regressions = []
    for k, (grid, fits) in enumerate(zip(filter.node_times, filter.node_fits, strict=True)):
        count = len(grid) + (continuous and k < intervals)
        if len(fits) != count:
            raise ValueError(f"node_fits[{k}]: wanted {count}, got {len(fits)}")
        targets = n if continuous else components
        regressions += [
            (f"node_fits[{k}][{i}]", fit, targets, sizes[k] + extra) for i, fit in enumerate(fits)
        ]
    regressions += [(f"fits[{k}]", fit, n, sizes[k]) for k, fit in enumerate(filter.fits)]
    for name, fit, targets, dimension in regressions:
        _check_fit(name, fit, targets, dimension)
    _check_covariances(
        "fits",
        [fit.cov for _, fit, *_ in regressions if isinstance(fit, AffineFit)]
        + [fit.residual for _, fit, *_ in regressions if isinstance(fit, PolynomialFit)],
    )


def _check_fit(name, fit, targets, dimension):
    if isinstance(fit, AffineFit):
        square = targets, targets
        _check_parts(name, fit, gain=(targets, dimension), offset=(targets,), cov=square)
    elif isinstance(fit, PolynomialFit):
        degrees = fit.mean_degree, fit.cov_degree
        # counted, not listed, and only where the gain may have as many: they may be anything
        if not all(type(d) is int and 0 <= d <= fit.gain.size + fit.cov_gain.size for d in degrees):
            raise ValueError(f"{name}: gains that are not those of the degrees {degrees}")
        powers, others = (math.comb(dimension + degree, degree) - 1 for degree in degrees)
        entries = targets * (targets + 1) // 2
        _check_parts(
            name, fit, centre=(dimension,), scale=(dimension,), gain=(targets, powers),
            offset=(targets,), residual=(targets, targets), cov_gain=(entries, others),
            cov_offset=(entries,),
        )  # fmt: skip


def _check_outputs(filter):
    """Tables; functions of one's own are taken as they are, and learned ones have no axes."""
    system, memory, times = filter.system, filter.memory, filter.times
    steps, components, m = len(times), filter.components, system.measurement_size
    if len(filter.steps) != steps:
        raise ValueError(f"steps: wanted {steps}, got {len(filter.steps)}")
    _check("covariances", filter.covariances, steps, components, components)
    if filter.changes is not None:
        _check("changes", filter.changes, 2, steps, finite=False)
    _check_nodes(filter, [steps - 1])
    numbers = (None,) * m, (None,) * components
    for k, step in enumerate(filter.steps):
        for place, table, axes in zip(
            Step._fields, step, step_axes(system, memory, *numbers, k), strict=True
        ):
            _check_table(f"steps[{k}].{place}", table, axes, filter)
        for fit in filter.node_fits[k] if k < len(filter.node_fits) else ():
            _check_table(
                f"node_fits[{k}]", fit, step_axes(system, memory, *numbers, k + 1)[1], filter
            )


def _check_table(name, table, axes, filter):
    if not isinstance(table, Table):
        return
    if _labels(table.axes) != _labels(axes):
        raise ValueError(f"{name} has other axes than the memory {filter.memory}")
    shape, modes = tuple(axis.count for axis in table.axes), getattr(filter.system, "modes", 0)
    _check(f"{name}.estimate", table.estimate, filter.components, *shape)
    if table.prob is not None:
        _check(f"{name}.prob", table.prob, modes, *shape)
    if table.mode is None:
        return
    if table.mode.shape != shape or table.mode.dtype != np.int8:
        raise ValueError(f"{name}.mode: wanted bytes of shape {shape}")
    if table.mode.size and not 0 <= table.mode.min() <= table.mode.max() < modes:
        raise ValueError(f"{name}.mode: a number that is no mode")


def _check_nodes(filter, allowed):
    """Nodes inside of their intervals, with a row of forecasts for each row of them."""
    nodes, times = filter.node_times, filter.times
    if len(nodes) not in (*allowed, 0) or len(nodes) != len(filter.node_fits):
        raise ValueError(
            f"node_times, node_fits: wanted {allowed[0]} intervals, or one more for a horizon, got "
            f"{len(nodes)} and {len(filter.node_fits)}"
        )
    for k, grid in enumerate(nodes):
        _check(f"node_times[{k}]", grid, None)
        end = times[k + 1] if k < len(times) - 1 else np.inf
        if not (np.diff([times[k], *grid, end]) > 0).all():
            raise ValueError(f"node_times[{k}]: outside of their interval or out of order")


def _check_cells(filter):
    system, memory = filter.system, filter.memory
    if memory is None:
        return
    n, m, modes = system.state_size, system.measurement_size, system.modes
    for k, fit in enumerate(filter.fits):
        if not isinstance(fit, CellFit):
            continue
        d, tail = memory.dimension(k, n, m, modes), (modes, cell_count(memory, system, k))
        _check_parts(
            f"fits[{k}]", fit, gain=(n, d, *tail), offset=(n, *tail), cov=(n, n, *tail),
            centre=(d, *tail), white=(d, d, *tail),
        )  # fmt: skip
        # a mode that is never met in a cell has the weight zero
        _check(f"fits[{k}].log_weight", fit.log_weight, *tail, finite=False)
        _check_covariances(f"fits[{k}]", [np.moveaxis(fit.cov, (0, 1), (-2, -1))])


def _labels(axes):
    """Number of labels of each axis, None for numbers."""
    return [axis.count if isinstance(axis, Labels) else None for axis in axes]


def _check_errors(filter):
    """What the design says of the filter's accuracy."""
    predicted, held, times = filter.predicted, filter.held_out, filter.times
    if predicted is not None:
        _check("predicted.times", predicted.times, None)
        if not np.isin(times, predicted.times).all():
            raise ValueError("predicted.times: wanted those of the measurements among them")
        steps, components = len(predicted.times), getattr(filter, "components", None)
        # a design whose paths diverge may know its errors no better than as no numbers
        _check("predicted.rms", predicted.rms, steps, components, finite=False)
        _check("predicted.error", predicted.error, *predicted.rms.shape, finite=False)
        for name in ("mode_rate", "mode_error"):
            if getattr(predicted, name) is not None:
                _check(f"predicted.{name}", getattr(predicted, name), steps, finite=False)
    if held is not None:
        shape = (len(times), None if predicted is None else predicted.rms.shape[1])
        for name in ("rms", "error", "deviation"):  # NaN where no path was left
            _check(f"held_out.{name}", getattr(held, name), *shape, finite=False)
        for name in ("mode_rate", "mode_error"):
            part = getattr(held, name)
            if part is not None or getattr(predicted, name, None) is not None:
                _check(f"held_out.{name}", part, len(times), finite=False)
