"""Designed filters in files: ``.npz`` archives of plain arrays with a JSON header.

Nothing in a file is executed or taken for a formula. The model is not stored: it is given again
on loading and recognised by what its functions do at fixed points.
"""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
import zlib
from pathlib import Path

import numpy as np

import seedslib
from seedslib import linearization as linearizations
from seedslib.filters.between import KINDS
from seedslib.filters.finite_order import FiniteOrderFilter
from seedslib.filters.finite_order_rules import Design
from seedslib.filters.table import OutputFilter, TableFilter
from seedslib.linearization import Linearization
from seedslib.storage.finite_order import filter_arrays, filter_parts, shaped
from seedslib.storage.identity import difference, model_text, probe, probe_points
from seedslib.storage.tables import KIND as TABLE
from seedslib.storage.tables import probed, table_arrays, table_parts

FORMAT = "seedslib designed filter"
VERSION = 1
KIND = "finite order"
LARGEST = 2**31
"""Bytes of one array beyond which a file is not believed."""

_LINEARIZATIONS = ("Taylor", "ExactGaussian", "Unscented", "Cubature", "GaussHermite")


def save(filter: FiniteOrderFilter, path) -> None:
    """Write a designed filter to a file; equal filters give equal bytes.

    Parameters
    ----------
    filter : FiniteOrderFilter
    path : path-like

    Raises
    ------
    TypeError
        Something that is no designed filter, or a learned one, which is tabulated first.
    """
    table = isinstance(filter, TableFilter)
    unwritten = isinstance(filter, OutputFilter) and not table
    if not isinstance(filter, FiniteOrderFilter) or unwritten:
        raise TypeError(f"filter: wanted a FiniteOrderFilter, got {type(filter).__name__}")
    points = probe_points(filter.system, float(filter.times[0]), filter.horizon)
    known = _probe(filter.system, filter.linearization, points)
    design = filter.design
    header = {
        "format": FORMAT,
        "version": VERSION,
        "kind": TABLE if table else KIND,
        "memory": dataclasses.asdict(filter.memory),
        "predictor": _described(filter.predictor),
        "linearization": _described(filter.linearization),
        "components": filter.components,
        "measured_nodes": filter.measured_nodes,
        "between": filter.between,
        "model": model_text(filter.system),
        "design": {**design._asdict(), "spawn_key": list(design.spawn_key)},
        "in_sample": filter.predicted.in_sample,
        "tail": len(filter.node_times) > len(filter.fits),
        "versions": {"seedslib": seedslib.__version__, "numpy": np.__version__},
    }
    arrays = {"probe_x": points}
    arrays.update({f"probe_values/{name}": value for name, value in known.items()})
    arrays.update(table_arrays(filter) if table else filter_arrays(filter))
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        text = json.dumps(header, sort_keys=True, indent=1).encode()
        _write(archive, "header", np.frombuffer(text, dtype=np.uint8))
        for name, array in arrays.items():
            _write(archive, name, np.ascontiguousarray(array, dtype="<f8"))
    Path(path).write_bytes(whole.getvalue())


def load(path, system, *, linearization: Linearization | None = None) -> FiniteOrderFilter:
    """Read a designed filter for a model.

    Parameters
    ----------
    path : path-like
    system : JumpDiffusion
        The model that the filter was designed for, however it is written.
    linearization : Linearization, optional
        Only for a filter whose linearization is not one of the library's.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        A file that is damaged or cut short, that holds something else, that was written by a
        newer version, or that was designed for another model; the message says which.
    """
    path = Path(path)
    arrays, header = _read(path)
    table = header["kind"] == TABLE
    if table:
        linearization = None
    elif linearization is None:
        linearization = _linearization(path, header.get("linearization"))
    try:
        parts = table_parts(header, arrays, shaped) if table else filter_parts(header, arrays)
        parts.update(between=_between(header), design=_design(header))
        points = arrays["probe_x"]
        known = {
            name.removeprefix("probe_values/"): value
            for name, value in arrays.items()
            if name.startswith("probe_values/")
        }
        n = len(parts["start"].mean)
        if points.shape[:1] != (n + 1,) or points.ndim != 2:
            raise ValueError(f"probe_x of shape {points.shape}")
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise ValueError(f"{path.name}: the file contradicts itself ({error})") from None
    if n != system.state_size:
        raise ValueError(
            f"{path.name}: designed for another model: its state has {n} components, not "
            f"{system.state_size}"
        )
    reason = difference(known, _probe(system, linearization, points))
    if reason:
        raise ValueError(f"{path.name}: designed for another model: {reason}")
    kind = TableFilter if table else FiniteOrderFilter
    return kind(system=system, linearization=linearization, **parts)


def _probe(system, linearization, points):
    """What identifies a model; a table takes no linearization."""
    if linearization is None:
        return probed(system, points)
    return probe(system, linearization, points)


def _between(header) -> str:
    if header["between"] not in KINDS:
        raise ValueError(f"forecasts {header['between']!r}")
    return header["between"]


def _design(header) -> Design:
    design = dict(header["design"])
    return Design(**{**design, "spawn_key": tuple(design["spawn_key"])})


def _described(thing) -> dict:
    options = dataclasses.asdict(thing) if dataclasses.is_dataclass(thing) else {}
    return {"name": type(thing).__name__, **options}


def _write(archive, name, array):
    """One array, neither compressed nor dated: both would make the bytes depend on the machine."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, version=(1, 0), allow_pickle=False)
    entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
    entry.external_attr, entry.create_system = 0, 3
    archive.writestr(entry, buffer.getvalue())


def _read(path):
    """Arrays and header of a file, or what is wrong with it."""
    content = path.read_bytes()
    if content[:2] != b"PK":
        raise ValueError(f"{path.name}: not a designed filter (not an npz file)")
    try:
        arrays = {}
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for entry in archive.infolist():
                if entry.file_size > LARGEST:
                    raise ValueError(f"an array of {entry.file_size} bytes")
                buffer = io.BytesIO(archive.read(entry))
                name = entry.filename.removesuffix(".npy")
                arrays[name] = np.lib.format.read_array(buffer, allow_pickle=False)
    except (
        zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError,
        NotImplementedError, KeyError, MemoryError, UnicodeDecodeError,
    ) as error:  # fmt: skip
        raise ValueError(f"{path.name}: damaged or cut short ({error})") from None
    header = arrays.pop("header", None)
    try:
        header = json.loads(header.tobytes().decode())
        stated = header["format"]
    except (AttributeError, ValueError, TypeError, KeyError):
        raise ValueError(f"{path.name}: not a designed filter (no header of one)") from None
    if stated != FORMAT or header.get("kind") not in (KIND, TABLE):
        raise ValueError(
            f"{path.name}: not a finite-order filter (it says {stated!r}, {header.get('kind')!r})"
        )
    if header.get("version") != VERSION:
        raise ValueError(
            f"{path.name}: wanted version {VERSION} of the format, got {header.get('version')!r}"
        )
    return arrays, header


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
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path.name}: the file contradicts itself ({error})") from None
