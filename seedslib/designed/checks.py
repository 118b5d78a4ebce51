"""Whether the parts of a designed filter fit together: what its kinds ask of arrays and nodes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from seedslib.base.checks import require_shape
from seedslib.base.linalg import INDEFINITE


def check_array(name: str, array: Any, *shape: int | None, finite: bool = True) -> None:
    """Refuse what is no float64 array of finite numbers of a shape (None is any length).

    Raises
    ------
    TypeError, ValueError
        Something else; the message says what.
    """
    if not isinstance(array, np.ndarray) or array.dtype != np.float64:
        got = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise TypeError(f"{name}: wanted an array of float64, got {got}")
    require_shape(name, array, shape)
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name}: wanted finite numbers, got others")


def check_fields(name: str, thing: Any, **shapes: tuple[int | None, ...]) -> None:
    """`check_array` of the named fields of a description."""
    for part, shape in shapes.items():
        check_array(f"{name}.{part}", getattr(thing, part), *shape)


def check_start(name: str, start: Any) -> tuple[int, int]:
    """Sizes of the state and the first measurement of a `Start`, whose parts must fit them.

    Raises
    ------
    TypeError, ValueError
        Arrays of another shape or kind.
    """
    sizes = []
    for part, mean in ((name, start.mean), (f"{name}.moments", start.moments.mean)):
        check_array(f"{part}.mean", mean, None)
        sizes.append(len(mean))
    n, m = sizes
    check_fields(name, start, cov=(n, n))
    check_fields(f"{name}.moments", start.moments, cross=(n, m), cov=(m, m))
    return n, m


def check_verbs(parts: Iterable[tuple[str, Any]], verb: str) -> None:
    """Refuse parts, given with their names, that do not know a verb.

    Raises
    ------
    TypeError
        The first one that is something else.
    """
    for name, part in parts:
        if not callable(getattr(part, verb, None)):
            raise TypeError(f"{name}: wanted something with {verb}, got {type(part).__name__}")


def check_covariances(name: str, covariances: Iterable[np.ndarray]) -> None:
    """Refuse covariances (..., n, n) that are clearly indefinite.

    Held against their largest eigenvalue, as designs clip them: a variance in small units beside
    one in large units may be a rounding error. Those of one size are looked at once.

    Raises
    ------
    ValueError
        One that has a negative eigenvalue.
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


def check_times(times: Any) -> None:
    """Refuse times of measurements that are no increasing grid.

    Raises
    ------
    TypeError, ValueError
        No array of one axis, no times, or out of order.
    """
    check_array("times", times, None)
    if not (times.size and (np.diff(times) > 0).all()):
        raise ValueError(f"times: wanted an increasing grid, got {times}")


def check_nodes(filter: Any, intervals: int) -> None:
    """Refuse nodes outside of their intervals, or without a row of forecasts for each row of them.

    Raises
    ------
    TypeError, ValueError
        Rows other in number than the intervals or none; times out of order.
    """
    nodes, times = filter.node_times, filter.times
    if len(nodes) not in (intervals, 0) or len(nodes) != len(filter.node_fits):
        raise ValueError(
            f"node_times, node_fits: wanted {intervals} intervals, got {len(nodes)} and "
            f"{len(filter.node_fits)}"
        )
    for k, grid in enumerate(nodes):
        check_array(f"node_times[{k}]", grid, None)
        if not (np.diff([times[k], *grid, times[k + 1]]) > 0).all():
            raise ValueError(f"node_times[{k}]: outside of their interval or out of order")


def check_errors(predicted: Any, held: Any, times: np.ndarray, components: int | None) -> None:
    """Refuse a `Prediction` or `HeldOut` (or None) of other times or components.

    Raises
    ------
    TypeError, ValueError
        Arrays of another shape or kind, a prediction without one of the times.
    """
    if predicted is not None:
        check_array("predicted.times", predicted.times, None)
        if not np.isin(times, predicted.times).all():
            raise ValueError("predicted.times: wanted those of the measurements among them")
        steps = len(predicted.times)
        # a design whose paths diverge may know its errors no better than as no numbers
        check_array("predicted.rms", predicted.rms, steps, components, finite=False)
        check_array("predicted.error", predicted.error, *predicted.rms.shape, finite=False)
        for name in ("mode_rate", "mode_error"):
            if getattr(predicted, name) is not None:
                check_array(f"predicted.{name}", getattr(predicted, name), steps, finite=False)
    if held is not None:
        shape = (len(times), None if predicted is None else predicted.rms.shape[1])
        for name in ("rms", "error"):  # NaN where no path was left
            check_array(f"held_out.{name}", getattr(held, name), *shape, finite=False)
        for name in ("mode_rate", "mode_error"):
            part = getattr(held, name)
            if part is not None or getattr(predicted, name, None) is not None:
                check_array(f"held_out.{name}", part, len(times), finite=False)
