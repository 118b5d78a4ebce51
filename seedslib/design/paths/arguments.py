"""What a design on paths asks of its arguments, and where its nodes are."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from seedslib.base.checks import as_count, as_times, is_whole, outside
from seedslib.base.clock import step_count, when
from seedslib.design.fitting import coefficients_of
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import Affine, Continuous, Polynomial

PATHS_PER_COEFFICIENT = 50
"""Fewer design paths than this for each dimension of the memory are worth a warning."""


def check_kinds(memory: Memory, predictor: Any, measured_nodes: bool, exact_moments: bool) -> None:
    """Refuse a memory, a predictor and options that do not go together.

    Raises
    ------
    TypeError, ValueError
        Which, and why.
    """
    if memory.indicators or memory.log_odds:
        raise ValueError(
            f"memory: wanted estimates and measurements, there are no modes here, got {memory}"
        )
    if not isinstance(predictor, Affine | Polynomial | Continuous):
        raise TypeError(f"predictor: wanted Affine, Polynomial or Continuous, got {predictor!r}")
    if isinstance(predictor, Continuous) and (memory != Memory(1) or measured_nodes):
        raise ValueError(f"predictor: Continuous wants the memory of one estimate, got {memory}")
    if exact_moments and not isinstance(predictor, Affine):
        raise ValueError(f"exact_moments: wanted with Affine forecasts, got {predictor}")


def check_available(
    predictor: Any, exact_moments: bool, checkpoint: object, horizon: float | None
) -> None:
    """Refuse what a design for what arrives cannot take.

    Raises
    ------
    ValueError
        Which.
    """
    if isinstance(predictor, Continuous) or exact_moments or checkpoint is not None:
        raise ValueError(
            "availability: wanted Affine or Polynomial forecasts on simulated paths, and no "
            "checkpoint"
        )
    if horizon is not None:
        # the forecasts after the last measurement would have to know which ones had come
        raise ValueError(f"horizon: wanted none beside availability, got {horizon}")


def check_paths(
    paths: int, memory: Memory, predictor: Any, components: int, measured: int,
    measured_nodes: bool,
) -> None:  # fmt: skip
    """Refuse fewer paths than coefficients, and warn of few.

    Raises
    ------
    ValueError
        Too few.
    """
    order = memory.order(components, measured)
    coefficients = max(coefficients_of(predictor, order), order + measured * measured_nodes)
    if paths <= coefficients + 1:
        raise ValueError(
            f"paths: wanted more than {coefficients + 1} for {coefficients} coefficients, "
            f"got {paths}"
        )
    if paths < PATHS_PER_COEFFICIENT * coefficients:
        warnings.warn(
            f"paths: {paths} are few for {coefficients} coefficients; "
            f"{PATHS_PER_COEFFICIENT * coefficients} or more are advised",
            stacklevel=outside(),
        )


def node_times(times: np.ndarray, nodes: Any, horizon: float | None, step: float | None) -> tuple:
    """Node times within each interval; with a horizon also after the last measurement.

    Raises
    ------
    TypeError, ValueError
        Nodes outside of their intervals, or an early horizon.
    """
    ends = list(times[1:])
    if horizon is not None:
        if not times[-1] < horizon < np.inf:
            raise ValueError(
                f"horizon: wanted a time after the last measurement at {when(times[-1])}, "
                f"got {horizon}"
            )
        ends.append(float(horizon))
    whole = is_whole(nodes)
    if whole:
        as_count("nodes", nodes, 0)
    if not whole and step is None:
        nodes = list(nodes)
        if len(nodes) != len(ends):
            raise ValueError(f"nodes: wanted {len(ends)} lists of times, got {len(nodes)}")
    found = []
    for k, (start, end) in enumerate(zip(times, ends, strict=False)):
        inside = k < len(times) - 1
        if step is not None or whole:
            parts = nodes + 1 if step is None else step_count(start, end, step)
            grid = start + (end - start) * np.arange(1, parts) / parts
        else:
            grid = as_times(f"nodes[{k}]", nodes[k]) if len(nodes[k]) else np.empty(0)
            if len(grid) and not (start < grid[0] and grid[-1] < end):
                raise ValueError(
                    f"nodes: wanted times between {when(start)} and {when(end)}, "
                    f"got {grid[0]:g} to {grid[-1]:g}"
                )
        found.append(grid if inside else np.append(grid, end))
    return tuple(found)
