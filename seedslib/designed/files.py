"""Designed filters in files, bound to the models they were designed for.

The model is not stored: it is given again on loading and recognised by what its functions do at
fixed points.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

import seedslib
from seedslib import linearization as linearizations
from seedslib.designed import file_switching as switching
from seedslib.designed.archive import read, write
from seedslib.designed.between import FORECAST_KINDS
from seedslib.designed.file_arrays import held_out, held_out_arrays
from seedslib.designed.file_finite_order import filter_arrays, filter_parts
from seedslib.designed.file_tables import KIND as TABLE
from seedslib.designed.file_tables import UnknownModel, probed, table_arrays, table_parts
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import Design
from seedslib.designed.identity import (
    described,
    difference,
    probe,
    probe_arrays,
    probe_points,
    probe_values,
)
from seedslib.designed.table import OutputFilter, TableFilter
from seedslib.linearization.moments import Linearization
from seedslib.models.words import model_text

KIND = "finite order"
_LINEARIZATIONS = ("Taylor", "ExactGaussian", "Unscented", "Cubature", "GaussHermite")


def save(filter, path) -> None:
    """Write a designed filter to a file; equal filters give equal bytes.

    Parameters
    ----------
    filter : FiniteOrderFilter, TableFilter, SwitchingFilter or SwitchingTableFilter
    path : path-like

    Raises
    ------
    TypeError
        Something that is no designed filter, or a learned one, which is tabulated first.
    ValueError
        A filter that was itself loaded without its model.
    """
    if isinstance(filter, switching.FILTERS):
        return _store(path, *switching.switching_content(filter))
    table = isinstance(filter, TableFilter)
    unwritten = isinstance(filter, OutputFilter) and not table
    if not isinstance(filter, FiniteOrderFilter) or unwritten:
        raise TypeError(f"filter: wanted a FiniteOrderFilter, got {type(filter).__name__}")
    if isinstance(filter.system, UnknownModel):
        raise ValueError("filter: wanted one with its model, got one that was loaded without")
    points = probe_points(filter.system, float(filter.times[0]), filter.horizon)
    known = _probe(filter.system, filter.linearization, points)
    design = filter.design
    counts, beside = held_out_arrays(filter.held_out)
    header = {
        "kind": TABLE if table else KIND,
        "memory": dataclasses.asdict(filter.memory),
        "predictor": described(filter.predictor),
        "linearization": described(filter.linearization),
        "components": filter.components,
        "measured_nodes": filter.measured_nodes,
        "between": filter.between,
        "model": model_text(filter.system),
        "design": {**design._asdict(), "spawn_key": list(design.spawn_key)},
        "in_sample": filter.predicted.in_sample,
        "held_out": counts,
        "tail": len(filter.node_times) > len(filter.fits),
    }
    held = table_arrays(filter) if table else filter_arrays(filter)
    return _store(path, header, {**probe_arrays(points, known), **held, **beside})


def _store(path, header, arrays) -> None:
    """Write header and arrays."""
    versions = {"seedslib": seedslib.__version__, "numpy": np.__version__}
    write(path, {**header, "versions": versions}, arrays)


def load(path, system=None, *, linearization: Linearization | None = None):
    """Read a designed filter for a model.

    Parameters
    ----------
    path : path-like
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem, optional
        The model that the filter was designed for, however it is written. A filter of tables
        runs without it, then nothing is compared; any other evaluates the model's sensor.
    linearization : Linearization, optional
        Only for a filter whose linearization is not one of the library's.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        A file that is damaged or cut short, that holds something else, that was written by
        another version, or that was designed for another model; the message says which. No model
        for a filter that wants one.
    """
    path = Path(path)
    arrays, header = read(path, (KIND, TABLE, *switching.KINDS))
    if header["kind"] in switching.KINDS:
        if header["kind"] == switching.KIND and system is not None and linearization is None:
            linearization = _linearization(path, header.get("linearization"))
        return switching.switching_filter(path.name, header, arrays, system, linearization)
    if hasattr(system, "branches"):
        raise ValueError(f"{path.name}: designed for another model, one without modes")
    table = header["kind"] == TABLE
    if system is None and not table:
        raise ValueError(
            f"{path.name}: this filter evaluates the sensor of its model; wanted the model too, "
            "on the command line --model (only a filter of tables runs without)"
        )
    if table:
        linearization = None
    elif linearization is None:
        linearization = _linearization(path, header.get("linearization"))
    try:
        parts = table_parts(header, arrays) if table else filter_parts(header, arrays)
        parts.update(between=_between(header), design=_design(header))
        parts["held_out"] = held_out(header, arrays, parts["times"])
        n = len(parts["start"].mean)
        points, known = probe_values(arrays, n)
    except (KeyError, TypeError, IndexError, ValueError, OverflowError) as error:
        raise ValueError(f"{path.name}: the file contradicts itself ({error})") from None
    if system is None:
        system = UnknownModel(n, len(parts["predictor"].measurement))
    elif n != system.state_size:
        raise ValueError(
            f"{path.name}: designed for another model: its state has {n} components, not "
            f"{system.state_size}"
        )
    else:
        reason = difference(known, _probe(system, linearization, points), points)
        if reason:
            raise ValueError(f"{path.name}: designed for another model: {reason}")
    kind = TableFilter if table else FiniteOrderFilter
    return kind(system=system, linearization=linearization, **parts)


def _probe(system, linearization, points):
    """What identifies a model; a table takes no linearization."""
    with np.errstate(all="ignore"):  # a model may have no value at a point
        if linearization is None:
            return probed(system, points)
        return probe(system, linearization, points)


def _between(header) -> str:
    if header["between"] not in FORECAST_KINDS:
        raise ValueError(f"forecasts {header['between']!r}")
    return header["between"]


def _design(header) -> Design:
    design = dict(header["design"])
    return Design(**{**design, "spawn_key": tuple(design["spawn_key"])})


def _linearization(path, options):
    name = options.get("name") if isinstance(options, dict) else None
    if name not in _LINEARIZATIONS:
        raise ValueError(
            f"{path.name}: its linearization {name!r} is not the library's; "
            "wanted it as the argument `linearization`"
        )
    try:
        options = {key: value for key, value in options.items() if key != "name"}
        return getattr(linearizations, name)(**options)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path.name}: the file contradicts itself ({error})") from None
