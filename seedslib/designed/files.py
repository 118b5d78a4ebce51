"""Designed filters in files, bound to the models they were designed for.

A file is an ``.npz`` archive of plain arrays with a JSON header. A filter is a tree: NamedTuples
and frozen dataclasses that hold each other, tuples, numbers, words and arrays. In the header a
description is its class's name and its fields; an array goes by its path in the tree, such as
``fits/3/gain``. Nothing is executed, and only classes of `KNOWN` are ever made.

The model is not stored: it is given again on loading and recognised by what its functions do at
fixed points.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Collection, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

import seedslib
from seedslib import linearization as linearizations
from seedslib.base.atomic import replacing
from seedslib.base.tables import Axis, Labels
from seedslib.designed.finite_order import FiniteOrderFilter, Start
from seedslib.designed.identity import (
    difference,
    model_text,
    probe,
    probe_arrays,
    probe_points,
    probe_values,
)
from seedslib.designed.memory import Memory
from seedslib.designed.minimax import (
    BoundedFit,
    BoundedPolynomial,
    Minimax,
    MinimaxFilter,
    MinimaxFit,
)
from seedslib.designed.output_filter import TableFilter
from seedslib.designed.patterns import PatternFit
from seedslib.designed.prediction import Design, HeldOut, Prediction
from seedslib.designed.predictors import Affine, AffineFit, Continuous, Polynomial, PolynomialFit
from seedslib.designed.switching.filter import CellFit, SwitchingFilter
from seedslib.designed.tables import Step, Table
from seedslib.linearization.moments import Linearization, Moments
from seedslib.models.kinds import UnknownModel, switches

FORMAT, VERSION = "seedslib designed filter", 4
LINEARIZATIONS = ("Taylor", "ExactGaussian", "Unscented", "Cubature", "GaussHermite")
FILTERS = (FiniteOrderFilter, TableFilter, SwitchingFilter, MinimaxFilter)
KNOWN = {
    kind.__name__: kind
    for kind in (
        *FILTERS,
        Affine,
        Polynomial,
        Continuous,
        Axis,
        Labels,
        Memory,
        Start,
        Moments,
        AffineFit,
        PolynomialFit,
        PatternFit,
        CellFit,
        Step,
        Table,
        Prediction,
        HeldOut,
        Design,
        UnknownModel,
        Minimax,
        MinimaxFit,
        BoundedFit,
        BoundedPolynomial,
    )
}

FAULTS = KeyError, TypeError, IndexError, ValueError, OverflowError, AttributeError, RecursionError
"""What the parts of a file raise that do not fit together."""


def save(filter: Any, path: str | PathLike[str]) -> None:
    """Write a designed filter to a file; equal filters give equal bytes.

    Parameters
    ----------
    filter : FiniteOrderFilter, SwitchingFilter, TableFilter or MinimaxFilter
    path : path-like

    Raises
    ------
    TypeError
        Something that is no designed filter, or one of learned functions or of functions of
        one's own, which is tabulated first.
    ValueError
        A filter that was itself loaded without its model.
    """
    if type(filter) not in FILTERS:
        raise TypeError(f"filter: wanted a FiniteOrderFilter, got {type(filter).__name__}")
    if filter.memory is None:
        raise TypeError("filter: wanted a designed filter, got one without a memory")
    if isinstance(filter.system, UnknownModel):
        raise ValueError("filter: wanted one with its model, got one that was loaded without")
    rule, arrays = getattr(filter, "linearization", None), {}
    own = rule is not None and _class_of(type(rule).__name__) is not type(rule)
    # a linearization of the user's own is given again on loading
    tree = _packed(filter, "", arrays, ("system", *("linearization",) * own))
    if own:
        tree["linearization"] = {"class": type(rule).__name__}
    points = probe_points(filter.system, *filter.reach)
    arrays = {**probe_arrays(points, probe(filter.system, points, rule)), **arrays}
    header = {
        "format": FORMAT,
        "version": VERSION,
        "versions": {"seedslib": seedslib.__version__, "numpy": np.__version__},
        "filter": tree,
        "model": model_text(filter.system),
        "sizes": _packed(UnknownModel.of(filter.system), "", {}),
    }
    text = json.dumps(header, sort_keys=True).encode()
    with replacing(path) as file:  # NumPy dates no member: equal contents give equal bytes
        np.savez(file, header=np.frombuffer(text, dtype=np.uint8), **arrays)


def load(
    path: str | PathLike[str], system: Any = None, *, linearization: Linearization | None = None
) -> Any:
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
    header, arrays = _read(path)
    try:
        tree, given = header["filter"], {}
        kind, sizes = KNOWN[tree["class"]], _unpacked(header["sizes"], arrays)
        points, known = probe_values(arrays, sizes.state_size)
        rule = tree.get("linearization")
        if rule is not None:
            own = rule["class"] not in LINEARIZATIONS
            given["linearization"] = linearization or (None if own else _unpacked(rule, {}))
        reason = ""
        if system is not None and given.get("linearization", True):
            reason = _difference(system, sizes, known, points, given.get("linearization"))
    except FAULTS as error:
        raise ValueError(f"{path.name}: the file contradicts itself ({error})") from None
    if not given.get("linearization", True):
        raise ValueError(f"{path.name}: wanted the argument `linearization`, {rule['class']!r}")
    if reason:
        raise ValueError(f"{path.name}: designed for another model{reason}")
    if system is None and kind is not TableFilter:
        raise ValueError(
            f"{path.name}: this filter evaluates its model; wanted the model too, on the command "
            "line --system (only a filter of tables runs without)"
        )
    try:
        given["system"] = sizes.bounded() if system is None else system
        return _unpacked(tree, arrays, **given)
    except FAULTS as error:
        raise ValueError(f"{path.name}: the file contradicts itself ({error})") from None


def _read(path):
    """Header and arrays of a file; ValueError says what is wrong with it."""
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except Exception as error:  # of zipfile, zlib and NumPy there are many kinds
            raise ValueError(f"{path.name}: damaged or cut short ({error})") from None
    try:
        header = json.loads(arrays.pop("header").tobytes())
        stated = header["format"], header["version"]
    except (ValueError, TypeError, KeyError, RecursionError):
        raise ValueError(f"{path.name}: not a designed filter (no header of one)") from None
    if stated != (FORMAT, VERSION):
        raise ValueError(f"{path.name}: wanted {FORMAT!r}, version {VERSION}, got {stated}")
    return header, arrays


def _difference(system, sizes, known, points, linearization) -> str:
    """What differs between the model of a file and another, in words; empty where nothing does."""
    if switches(system) != switches(sizes):
        return ", one that has modes" if sizes.modes else ", one without modes"
    if apart := sizes.apart(UnknownModel.of(system)):
        word, one, two = apart
        return f": it has {one} {word}, not {two}"
    reason = difference(known, probe(system, points, linearization), points)
    return reason and f": {reason}"


def _class_of(name):
    """Class of a description; linearizations are imported when they are met, some want SymPy."""
    return getattr(linearizations, name) if name in LINEARIZATIONS else KNOWN.get(name)


def _packed(
    thing: Any, place: str, arrays: dict[str, np.ndarray], leave: Collection[str] = ()
) -> Any:
    """Tree for the header; arrays are added by their paths in it.

    Parameters
    ----------
    thing : object
    place : str
        Its path.
    arrays : dict of str to ndarray
    leave : collection of str
        Fields that are left out.

    Raises
    ------
    TypeError
        Something in it that is neither a known description nor a number, a word or an array.
    """
    if isinstance(thing, np.generic):
        thing = thing.item()
    if thing is None or isinstance(thing, bool | int | float | str):
        return thing
    if isinstance(thing, np.ndarray) and thing.dtype.kind in "biuf":
        arrays[place] = np.asarray(thing, order="C")
        return {"class": "array"}
    kind, name, at = type(thing), type(thing).__name__, f"{place}/" if place else ""
    if kind is tuple:
        return [_packed(part, f"{at}{i}", arrays) for i, part in enumerate(thing)]
    if _class_of(name) is not kind:
        raise TypeError(f"{place or 'filter'}: wanted a description or numbers, got {name}")
    fields = getattr(kind, "_fields", None) or [f.name for f in dataclasses.fields(kind) if f.init]
    parts = {
        field: _packed(getattr(thing, field), f"{at}{field}", arrays)
        for field in fields
        if field not in leave
    }
    return {"class": name, **parts}


def _unpacked(tree: Any, arrays: Mapping[str, np.ndarray], place: str = "", **given: Any) -> Any:
    """What a tree and its arrays describe; fields that are given are not looked for in it.

    Raises
    ------
    KeyError, TypeError, ValueError
        An array that is missing, an unknown class, fields that a description does not take.
    """
    at = f"{place}/" if place else ""
    if isinstance(tree, list):
        return tuple(_unpacked(part, arrays, f"{at}{i}") for i, part in enumerate(tree))
    if not isinstance(tree, dict):
        return tree
    if tree["class"] == "array":
        return arrays[place]
    fields = {
        key: _unpacked(part, arrays, f"{at}{key}")
        for key, part in tree.items()
        if key != "class" and key not in given
    }
    kind = _class_of(tree["class"])
    if kind is None:
        raise ValueError(f"{place or 'filter'} is a {tree['class']!r}")
    return kind(**fields, **given)
