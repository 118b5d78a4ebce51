"""What a file of a switching filter holds and how it is read back, for `seedslib.designed`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from seedslib.base.tables import Axis, Labels
from seedslib.designed.file_arrays import held_out, held_out_arrays, measurement_times, shaped
from seedslib.designed.finite_order_rules import Design
from seedslib.designed.identity import (
    described,
    difference,
    probe_arrays,
    probe_points,
    probe_values,
)
from seedslib.designed.lookup import ModeTable, StepTables, step_axes
from seedslib.designed.memory import Memory
from seedslib.designed.prediction import SwitchingDesign, SwitchingPrediction
from seedslib.designed.switching import SwitchingFilter
from seedslib.designed.switching_fits import CellFit, cell_count
from seedslib.designed.switching_table import SwitchingTableFilter
from seedslib.models.noise import hermite_nodes

KIND = "switching"
TABLES = "switching, tables"
KINDS = (KIND, TABLES)
FILTERS = (SwitchingFilter, SwitchingTableFilter)

MOST = 128
"""Modes, values of an indicator and components of a model that is known from a file only."""

NODES = 5
"""Gauss-Hermite nodes of the noise at which a branch is looked at."""


@dataclass(frozen=True)
class UnknownModes:
    """Stands for the model of a table filter that was loaded without it: sizes, no functions."""

    state_size: int
    measurement_size: int
    modes: int
    indicators: int
    has_indicator: bool

    @classmethod
    def of(cls, header) -> UnknownModes:
        """From the header of a file, or ValueError."""
        n, m = map(int, header["shape"])
        told, modes = int(header["indicators"]), int(header["modes"])
        # tables hold the decided mode in a byte, and no table has as many arguments
        for name, value, least in (("shape", n, 1), ("shape", m, 1), ("modes", modes, 1),
                                   ("indicators", told, 0)):  # fmt: skip
            if not least <= value <= MOST:
                raise ValueError(f"{name}: wanted {least} to {MOST}, got {value}")
        return cls(n, m, modes, max(told, 1), told > 0)


@np.errstate(all="ignore")  # a model may have no value at a point
def probe_switching(system, points: np.ndarray) -> dict[str, np.ndarray]:
    """What the branches of a system do at points (1 + n, P), by name; see `identity.probe`.

    Of each branch its probability, and mean and covariance of its value weighed by it, over nodes
    of the noise, so that equal laws are equal models however they are written.
    """
    found = {}
    for name, table, noise in (
        ("switching", system.branches, system.noise),
        ("readings", system.readings, system.sensor_noise),
    ):
        nodes, weights = hermite_nodes(noise.size, NODES)
        v = noise.mean[:, None] + noise.root @ nodes
        branches, count = [b for row in table for b in row], points.shape[1]
        size = next(b.map.size for b in branches if b is not None)
        shape = (count, len(branches))
        prob, mean = np.zeros(shape), np.zeros((*shape, size))
        cov = np.zeros((*shape, size, size))
        for place in np.ndindex(*shape):
            branch, (t, *x) = branches[place[1]], points[:, place[0]]
            if branch is None:
                continue
            x = np.repeat(np.array(x)[:, None], len(weights), axis=1)
            y, share = branch.map.value(t, x, v), branch.map.weight(t, x, v) * weights
            prob[place], mean[place] = share.sum(), y @ share
            # about the mean: beside a large mean a small variance would not be seen
            apart = y - (mean[place] / prob[place])[:, None] if prob[place] else y
            cov[place] = (apart * share) @ apart.T
        found |= {f"{name} (probability)": prob, f"{name} (mean)": mean, f"{name} (cov)": cov}
    for name in ("probability", "mean", "cov"):
        parts = np.array([[getattr(part, name) for part in system.initial]])
        found[f"initial ({name})"] = parts
    return found


def _header(filter) -> dict:
    """What a filter adds to the header."""
    design = filter.design
    header = {
        "kind": TABLES if isinstance(filter, SwitchingTableFilter) else KIND,
        "memory": dataclasses.asdict(filter.memory),
        "lasting": filter.lasting,
        "held_out": held_out_arrays(filter.held_out)[0],
        "shape": [filter.system.state_size, filter.system.measurement_size],
        "modes": filter.system.modes,
        "indicators": filter.system.indicators if filter.system.has_indicator else 0,
        "design": None if design is None else {
            **design._asdict(), "spawn_key": list(design.spawn_key)
        },
        "model": switching_text(filter.system),
    }  # fmt: skip
    if header["kind"] == TABLES:
        return {
            **header,
            "method": filter.method,
            "axes": [[_axes(step.shown), _axes(step.blind)] for step in filter.tables],
        }
    return {
        **header,
        "linearization": described(filter.linearization),
        "normalisation": filter.normalisation,
        "split": filter.split,
    }


def _axes(table):
    return [
        ["labels", axis.count] if isinstance(axis, Labels) else [axis.low, axis.high, axis.count]
        for axis in table.axes
    ]


def switching_text(system) -> dict[str, str]:
    """The model in words, a label for people."""
    if not system.symbolic:
        return {"model": "array functions"}
    return {
        name: str([[b and [str(b.map.weight_expression), *map(str, b.map.expressions)] for b in row]
                   for row in table])
        for name, table in (("switching", system.branches), ("readings", system.readings))
    }  # fmt: skip


def _arrays(filter) -> dict[str, np.ndarray]:
    """Arrays of a switching filter by their names in the file."""
    found = {"times": filter.times}
    found.update(
        {f"predicted/{name}": part for name, part in filter.predicted._asdict().items()}
        if filter.predicted is not None else {}
    )  # fmt: skip
    found.update(held_out_arrays(filter.held_out)[1])
    if isinstance(filter, SwitchingTableFilter):
        found.update(changes=filter.changes, covariances=filter.covariances)
        for k, step in enumerate(filter.tables):
            for place, table in step._asdict().items():
                found[f"{place}/{k}/estimate"] = table.estimate
                found[f"{place}/{k}/mode"] = table.mode
                if table.prob is not None:
                    found[f"{place}/{k}/prob"] = table.prob
        return found
    for k, fit in enumerate(filter.fits):
        found.update({f"fit/{k}/{name}": part for name, part in fit._asdict().items()})
    return found


def switching_content(filter) -> tuple[dict, dict]:
    """Header and arrays of a switching filter.

    Raises
    ------
    TypeError, ValueError
        A filter without a design, or one that was itself loaded without its model.
    """
    if filter.memory is None:
        raise TypeError("filter: wanted a designed filter, got one without a memory")
    if isinstance(filter.system, UnknownModes):
        raise ValueError("filter: wanted one with its model, got one that was loaded without")
    points = probe_points(filter.system, float(filter.times[0]), float(filter.times[-1]))
    known = probe_switching(filter.system, points)
    return _header(filter), {**probe_arrays(points, known), **_arrays(filter)}


def switching_filter(name, header, arrays, system, linearization):
    """The filter in a file called `name`; see `seedslib.designed.load`.

    Raises
    ------
    ValueError
        A file that contradicts itself or was designed for another model; no model for a filter
        that wants one.
    """
    tables = header["kind"] == TABLES
    if system is None and not tables:
        raise ValueError(
            f"{name}: this filter evaluates its model; wanted the model too, on the command line "
            "--model (only a filter of tables runs without)"
        )
    if system is not None and not hasattr(system, "branches"):
        raise ValueError(f"{name}: designed for another model, one that has modes")
    try:
        if system is None:
            system = UnknownModes.of(header)
        else:
            reason = _other_model(header, arrays, system)
            if reason:
                raise _OtherModel(f"{name}: designed for another model: {reason}")
        return _filter(header, arrays, system, linearization)
    except _OtherModel:
        raise
    except (KeyError, TypeError, IndexError, ValueError, OverflowError) as error:
        raise ValueError(f"{name}: the file contradicts itself ({error})") from None


class _OtherModel(ValueError):
    """The model is not the one of the file."""


def _other_model(header, arrays, system) -> str:
    """What differs between the model of a file and another, in words; empty where nothing does."""
    n, m = header["shape"]
    told = system.indicators if system.has_indicator else 0
    found = (system.modes, system.state_size, system.measurement_size, told)
    for what, wanted, got in zip(
        ("modes", "state components", "measured components", "values of an indicator"),
        (header["modes"], n, m, header["indicators"]),
        found,
        strict=True,
    ):
        if wanted != got:
            return f"it has {wanted} {what}, not {got}"
    points, known = probe_values(arrays, n)
    return difference(known, probe_switching(system, points), points)


def _filter(header, arrays, system, linearization):
    """The filter, each shape checked against the others."""
    memory, times = Memory(**header["memory"]), measurement_times(arrays)
    n = system.state_size
    predicted = None
    if "predicted/times" in arrays:
        steps = len(times)
        components = arrays["predicted/rms"].shape[1]
        predicted = SwitchingPrediction(
            shaped(arrays, "predicted/times", (steps,)),
            shaped(arrays, "predicted/rms", (steps, components)),
            shaped(arrays, "predicted/error", (steps, components)),
            shaped(arrays, "predicted/mode_rate", (steps,)),
            shaped(arrays, "predicted/mode_error", (steps,)),
        )
    design = header["design"]
    if design is not None:
        design = {**design, "spawn_key": tuple(design["spawn_key"])}
    lasting, held = bool(header["lasting"]), held_out(header, arrays, times)
    if header["kind"] == TABLES:
        tables = tuple(
            StepTables(
                _table(arrays, f"shown/{k}", axes[0], system.modes),
                _table(arrays, f"blind/{k}", axes[1], system.modes),
            )
            for k, axes in enumerate(header["axes"])
        )
        if len(tables) != len(times):
            raise ValueError(f"{len(tables)} tables for {len(times)} times")
        components = len(tables[0].blind.estimate)
        _check_axes(tables, memory, system, components)
        changes = arrays["changes"]
        if changes.shape != (2, len(times)):
            raise ValueError(f"changes of shape {changes.shape}")
        return SwitchingTableFilter(
            system, memory, times, tables, str(header["method"]), predicted, changes,
            shaped(arrays, "covariances", (len(times), components, components)),
            Design(**design), lasting, held,
        )  # fmt: skip
    fits = []
    for k in range(len(times) - 1):
        d = memory.dimension(k, n, system.measurement_size, system.modes)
        tail = (system.modes, cell_count(memory, system, k))
        fits.append(
            CellFit(
                shaped(arrays, f"fit/{k}/log_weight", tail),
                shaped(arrays, f"fit/{k}/centre", (d, *tail)),
                shaped(arrays, f"fit/{k}/white", (d, d, *tail)),
                shaped(arrays, f"fit/{k}/gain", (n, d, *tail)),
                shaped(arrays, f"fit/{k}/offset", (n, *tail)),
                shaped(arrays, f"fit/{k}/cov", (n, n, *tail)),
            )
        )
    return SwitchingFilter(
        system, linearization, memory, times, tuple(fits), header["normalisation"],
        bool(header["split"]), predicted, design and SwitchingDesign(**design), lasting, held,
    )  # fmt: skip


def _check_axes(tables, memory, system, components):
    """Refuse tables whose arguments are not those of the memory."""
    m = system.measurement_size
    numbers = m if memory.measurements else components
    for k, step in enumerate(tables):
        held = min(k, memory.depth)
        wanted = step_axes(system, memory, (None,) * m, (None,) * numbers, held)
        for place, table, axes in zip(StepTables._fields, step, wanted, strict=True):
            if _kinds(table.axes) != _kinds(axes):
                raise ValueError(f"{place}/{k} has other axes than the memory {memory}")


def _kinds(axes):
    """Number of labels of each axis, None for numbers."""
    return [axis.count if isinstance(axis, Labels) else None for axis in axes]


def _table(arrays, place, axes, modes):
    axes = tuple(
        Labels(int(axis[1])) if axis[0] == "labels" else Axis(*axis[:2], int(axis[2]))
        for axis in axes
    )
    shape = tuple(axis.count for axis in axes)
    decided = shaped(arrays, f"{place}/mode", shape)
    if not ((decided >= 0) & (decided < modes) & (decided == np.floor(decided))).all():
        raise ValueError(f"{place}/mode with a number that is no mode")
    prob = f"{place}/prob"
    return ModeTable(
        axes,
        shaped(arrays, f"{place}/estimate", (-1, *shape)),
        decided.astype(np.int8),
        shaped(arrays, prob, (modes, *shape)) if prob in arrays else None,
    )
