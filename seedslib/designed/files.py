"""Designed filters in files, bound to the models they were designed for.

A file is an ``.npz`` archive of one vector of numbers for each type, and a JSON header. A filter
is a tree: NamedTuples and frozen dataclasses that contain each other, tuples, numbers, words and
arrays. The header has of each of these its class's name and its fields, of an array its type, its
shape and where it begins in the vector. Nothing is executed, and only classes of `KNOWN` are ever
made.

The model is not stored: it is given again on loading and recognised by the values of its
functions at fixed points.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

import seedslib
from seedslib import linearization as linearizations
from seedslib.base.atomic import write_whole
from seedslib.designed import (
    arrivals,
    cells,
    finite_order,
    minimax,
    predictors,
    switching,
    tables,
)
from seedslib.designed.base import DesignedFilter
from seedslib.designed.identity import difference, probe, probe_points
from seedslib.designed.tables import TableFilter
from seedslib.models.kinds import KINDS, AnySystem, as_system

FORMAT, VERSION = "seedslib designed filter", 7
FILTERS = (
    finite_order.FiniteOrderFilter,
    TableFilter,
    switching.SwitchingFilter,
    minimax.MinimaxFilter,
)
KNOWN = {
    name: kind
    for module in (arrivals, cells, finite_order, minimax, predictors, switching, tables)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and (hasattr(kind, "_fields") or dataclasses.is_dataclass(kind))
}
"""NamedTuples and dataclasses that filters consist of; linearizations come beside them."""

LINEARIZATIONS = ("Taylor", "ExactGaussian", "Unscented", "Cubature", "GaussHermite")
FAULTS = KeyError, TypeError, IndexError, ValueError, OverflowError, AttributeError, RecursionError
"""What the parts of a file raise that do not fit together."""


def save(filter: DesignedFilter, path: str | PathLike[str]) -> None:
    """Write a designed filter to a file; equal filters give equal bytes.

    Parameters
    ----------
    filter : FiniteOrderFilter, SwitchingFilter, TableFilter or MinimaxFilter
    path : path-like

    Raises
    ------
    TypeError
        Something that is no designed filter, or one with functions or a linearization of one's
        own, which are programs.
    """
    if type(filter) not in FILTERS:
        raise TypeError(f"filter: wanted a FiniteOrderFilter, got {type(filter).__name__}")
    if filter.memory is None:
        raise TypeError("filter: wanted a designed filter, got one without a memory")
    numbers, points = _Numbers(), probe_points(filter.system, *filter.reach)
    values = probe(filter.system, points)
    header = {
        "format": FORMAT,
        "version": VERSION,
        "versions": {"seedslib": seedslib.__version__, "numpy": np.__version__},
        "filter": numbers.packed(filter, "", leave=("system",)),
        "points": numbers.packed(points, "points"),
        "values": {name: numbers.packed(value, name) for name, value in values.items()},
    }
    text = json.dumps(header, sort_keys=True).encode()
    file = io.BytesIO()  # NumPy dates no member: equal contents give equal bytes
    np.savez(file, header=np.frombuffer(text, dtype=np.uint8), **numbers.vectors())
    write_whole(path, file.getvalue())


def load(path: str | PathLike[str], system: AnySystem) -> Any:
    """Read a designed filter for a model.

    Parameters
    ----------
    path : path-like
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
        The model that the filter was designed for, however it is written.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    TypeError, ValueError
        No model; a file that is damaged or cut short, that contains something else, that was
        written by another version, or that was designed for another model; the message says which.
    """
    as_system("system", system, *KINDS)
    path = Path(path)
    header, vectors = _read(path)
    with _consistent(path):
        points = _unpacked(header["points"], vectors)
        values = {name: _unpacked(part, vectors) for name, part in header["values"].items()}
        size = len(points) - 1
        if size != system.state_size:
            reason = f"it has {size} state components, not {system.state_size}"
        else:
            reason = difference(values, probe(system, points))
    if reason:
        raise ValueError(f"{path.name}: designed for another model: {reason}")
    with _consistent(path):
        filter = _unpacked(header["filter"], vectors, system=system)
        if type(filter) not in FILTERS:
            raise TypeError(f"a {type(filter).__name__} is no filter")
    return filter


@contextmanager
def _consistent(path: Path) -> Iterator[None]:
    """Say of a file whose parts do not fit together that they do not."""
    try:
        yield
    except FAULTS as error:
        raise ValueError(f"{path.name}: the file contradicts itself ({error})") from None


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and vectors of a file; ValueError says what is wrong with it."""
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                vectors = {name: archive[name] for name in archive.files}
        except Exception as error:  # of zipfile, zlib and NumPy there are many kinds
            raise ValueError(f"{path.name}: damaged or cut short ({error})") from None
    try:
        header = json.loads(vectors.pop("header").tobytes())
        stated = header["format"], header["version"]
    except (ValueError, TypeError, KeyError, RecursionError):
        raise ValueError(f"{path.name}: not a designed filter (no header of one)") from None
    if stated != (FORMAT, VERSION):
        raise ValueError(f"{path.name}: wanted {FORMAT!r}, version {VERSION}, got {stated}")
    return header, vectors


def _class_of(name: str) -> type | None:
    """Class of a description; linearizations are imported when they occur, some need SymPy."""
    return getattr(linearizations, name) if name in LINEARIZATIONS else KNOWN.get(name)


class _Numbers:
    """Arrays of a file, side by side in one vector for each type."""

    def __init__(self) -> None:
        self._arrays: dict[str, list[np.ndarray]] = {}
        self._sizes: dict[str, int] = {}

    def vectors(self) -> dict[str, np.ndarray]:
        """The vectors, by the names of their types."""
        return {kind: np.concatenate(arrays) for kind, arrays in self._arrays.items()}

    def packed(self, part: Any, place: str, leave: Collection[str] = ()) -> Any:
        """Tree of a part for the header; its arrays are added to the vectors.

        Parameters
        ----------
        part : object
        place : str
            Its path, for messages.
        leave : collection of str
            Fields that are left out.

        Raises
        ------
        TypeError
            Something in it that is neither a known description nor a number, a word or an array.
        """
        if isinstance(part, np.generic):
            part = part.item()
        if part is None or isinstance(part, bool | int | float | str):
            return part
        if isinstance(part, tuple):
            if type(part) is tuple:
                return [self.packed(one, f"{place}[{i}]") for i, one in enumerate(part)]
        elif isinstance(part, np.ndarray) and part.dtype.kind in "biuf":
            kind = part.dtype.name
            start = self._sizes.get(kind, 0)
            self._arrays.setdefault(kind, []).append(part.ravel())
            self._sizes[kind] = start + part.size
            return {"array": kind, "start": start, "shape": part.shape}
        name, fields = type(part).__name__, getattr(part, "_fields", None)
        if _class_of(name) is not type(part):
            raise TypeError(f"{place or 'filter'}: wanted a description or numbers, got {name}")
        if fields is None:
            fields = [field.name for field in dataclasses.fields(part) if field.init]
        tree = {
            field: self.packed(getattr(part, field), f"{place}.{field}".lstrip("."))
            for field in fields
            if field not in leave
        }
        return {"class": name, **tree}


def _unpacked(tree: Any, vectors: Mapping[str, np.ndarray], **given: Any) -> Any:
    """What a tree and its vectors describe; fields that are given are not looked for in it.

    Raises
    ------
    KeyError, TypeError, ValueError
        A vector that is missing or too short, an unknown class, fields that it does not take.
    """
    if isinstance(tree, list):
        return tuple(_unpacked(part, vectors) for part in tree)
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        start, shape = tree["start"], tree["shape"]
        return vectors[tree["array"]][start : start + math.prod(shape)].reshape(shape)
    fields = {
        name: _unpacked(part, vectors)
        for name, part in tree.items()
        if name != "class" and name not in given
    }
    kind = _class_of(tree["class"])
    if kind is None:
        raise ValueError(f"a {tree['class']!r} is no part of a filter")
    return kind(**fields, **given)
