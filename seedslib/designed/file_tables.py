"""What a file of a table filter holds and how it is read back, for `seedslib.designed`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from seedslib.base.tables import Axis
from seedslib.designed.file_arrays import measurement_times, node_times, prediction, shaped
from seedslib.designed.finite_order_rules import Start
from seedslib.designed.identity import probe
from seedslib.designed.memory import Memory
from seedslib.designed.table import OutputRules, Table, TableFit
from seedslib.linearization.points import GaussHermite

KIND = "finite order, tables"

_POINTS = GaussHermite(3)
"""Any rule does to look at a sensor; this one takes every sensor there is."""


@dataclass(frozen=True)
class UnknownModel:
    """Stands for the model of a filter that was loaded without it: sizes, and no functions.

    Attributes
    ----------
    state_size, measurement_size : int
    """

    state_size: int
    measurement_size: int

    @property
    def sensor(self) -> SimpleNamespace:
        """What is known of the sensor: the size of a measurement."""
        return SimpleNamespace(size=self.measurement_size)


def probed(system, points: np.ndarray) -> dict[str, np.ndarray]:
    """What the model's functions give at the points: moments, and the likelihood if it has one."""
    found = probe(system, _POINTS, points)
    if system.sensor.has_log_density:
        values = []
        for t, *x in points.T:
            x = np.array(x)[:, None]
            mean, cov = system.sensor.conditional_moments(t, x)
            mean = np.reshape(mean, (-1, 1))
            spread = np.sqrt(np.diagonal(np.reshape(cov, (len(mean), len(mean)))))[:, None]
            y = mean + spread * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
            values.append(system.sensor.log_density(t, y, np.broadcast_to(x, (len(x), 5))))
        found["likelihood"] = np.stack(values)
    return found


def table_arrays(filter) -> dict[str, np.ndarray]:
    """Arrays of a table filter by name."""
    found = {
        "times": filter.times,
        "predicted/times": filter.predicted.times,
        "predicted/rms": filter.predicted.rms,
        "predicted/error": filter.predicted.error,
        "predicted/cov": filter.rules.covariances,
        "start/mean": filter.start.mean,
        "start/cov": filter.start.cov,
    }
    for k, table in enumerate(filter.rules.outputs):
        found[f"output/{k}"] = table.values
    for k, (nodes, fits) in enumerate(zip(filter.node_times, filter.node_fits, strict=True)):
        found[f"forecast/{k}"] = filter.fits[k].values
        found[f"nodes/{k}/times"] = nodes
        for i, table in enumerate(fits):
            found[f"nodes/{k}/{i}"] = table.values
    return found


def table_parts(header: dict, arrays: dict) -> dict:
    """Fields of the table filter in a file, each shape checked against the others.

    Parameters
    ----------
    header : dict
    arrays : dict of str to ndarray

    Raises
    ------
    KeyError, TypeError, ValueError
        Parts that are missing or do not fit together.
    """
    memory, components = Memory(**header["memory"]), int(header["components"])
    given = header["predictor"]
    axes_y = tuple(Axis(**axis) for axis in given["measurement"])
    axes_u = tuple(Axis(**axis) for axis in given["memory"])
    predictor = Table(axes_y, axes_u, str(given["method"]))
    # the letters of a memory of measurements are measurements
    axes_z = axes_u if memory.estimates else ()
    times = measurement_times(arrays)
    if memory.estimates and len(axes_u) != components:
        raise ValueError(f"{len(axes_u)} axes for {components} components")

    def table(name, axes):
        shape = (components, *(axis.count for axis in axes))
        if math.prod(shape) != arrays[name].size:
            raise ValueError(f"{name} of shape {arrays[name].shape}")
        return TableFit(axes, shaped(arrays, name, shape))

    def held(k):
        return axes_z * min(k, memory.estimates) + axes_y * min(k, memory.measurements)

    outputs = tuple(table(f"output/{k}", axes_y + held(k)) for k in range(len(times)))
    intervals = range(len(times) - 1)
    grid = node_times(arrays, times, len(intervals))
    n = len(shaped(arrays, "start/mean", (-1,)))
    covariances = shaped(arrays, "predicted/cov", (len(times), components, components))
    return {
        "memory": memory,
        "predictor": predictor,
        "times": times,
        "node_times": grid,
        "components": components,
        "start": Start(arrays["start/mean"], shaped(arrays, "start/cov", (n, n)), None),
        "fits": tuple(table(f"forecast/{k}", held(k + 1)) for k in intervals),
        "node_fits": tuple(
            tuple(table(f"nodes/{k}/{i}", held(k + 1)) for i in range(len(grid[k])))
            for k in intervals
        ),
        "predicted": prediction(header, arrays, times, components),
        "rules": OutputRules(
            memory, components, sensor=None, outputs=outputs, covariances=covariances
        ),
    }
