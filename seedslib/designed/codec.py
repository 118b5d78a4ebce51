"""A tree of descriptions as a JSON header and arrays: the one codec of files and checkpoints.

A designed filter is a tree: NamedTuples and frozen dataclasses that hold each other, tuples,
numbers, words and arrays. In the header a description is its class's name and its fields; an array
goes by its path in the tree, such as ``fits/3/gain``. Only classes of `KNOWN` are ever made.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping

import numpy as np

from seedslib import linearization as linearizations
from seedslib.base.tables import Axis, Labels
from seedslib.designed.arrivals import Arrivals
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import Start
from seedslib.designed.memory import Memory
from seedslib.designed.outputs.lookup import Step, Table
from seedslib.designed.outputs.minimax import (
    BoundedFit,
    BoundedPolynomial,
    Minimax,
    MinimaxFilter,
    MinimaxFit,
)
from seedslib.designed.outputs.patterns import ByPattern
from seedslib.designed.outputs.table import TableFilter
from seedslib.designed.patterns import PatternFit
from seedslib.designed.prediction import Design, HeldOut, Prediction
from seedslib.designed.predictors import Affine, AffineFit, Continuous, Polynomial, PolynomialFit
from seedslib.designed.switching.filter import SwitchingFilter
from seedslib.designed.switching.fits import CellFit, ClassFit
from seedslib.linearization.moments import Moments
from seedslib.models.kinds import UnknownModel

LINEARIZATIONS = ("Taylor", "ExactGaussian", "Unscented", "Cubature", "GaussHermite")
FILTERS = (FiniteOrderFilter, TableFilter, SwitchingFilter, MinimaxFilter)
KNOWN = {
    kind.__name__: kind
    for kind in (
        *FILTERS, Affine, Polynomial, Continuous, Axis, Labels, Memory, Start, Moments, AffineFit,
        PolynomialFit, PatternFit, CellFit, ClassFit, Step, Table, ByPattern, Arrivals,
        Prediction, HeldOut, Design, UnknownModel, Minimax, MinimaxFit, BoundedFit,
        BoundedPolynomial,
    )
}  # fmt: skip


def known_class(name: str, known: Mapping[str, type] = KNOWN) -> type | None:
    """Class of a description; linearizations are imported when they are met, some want SymPy."""
    return getattr(linearizations, name) if name in LINEARIZATIONS else known.get(name)


def packed(
    thing: object, leave: Collection[str] = (), known: Mapping[str, type] = KNOWN
) -> tuple[object, dict[str, np.ndarray]]:
    """Tree for a header, and arrays by their paths in it.

    Parameters
    ----------
    thing : object
    leave : collection of str
        Fields of the whole that are left out.
    known : mapping of str to type
        Classes of descriptions by their names.

    Raises
    ------
    TypeError
        Something in it that is neither a known description nor a number, a word or an array.
    """
    arrays: dict[str, np.ndarray] = {}
    return _packed(thing, "", leave, known, arrays), arrays


def _packed(thing, place, leave, known, arrays):
    if isinstance(thing, np.generic):
        thing = thing.item()
    if thing is None or isinstance(thing, bool | int | float | str):
        return thing
    if isinstance(thing, np.ndarray) and thing.dtype.kind in "biuf":
        arrays[place] = thing
        return {"class": "array"}
    kind, name = type(thing), type(thing).__name__
    if kind in (tuple, list):
        parts = dict(enumerate(thing))
    elif known_class(name, known) is kind:
        fields = getattr(kind, "_fields", None) or [
            f.name for f in dataclasses.fields(kind) if f.init
        ]
        parts = {field: getattr(thing, field) for field in fields if field not in leave}
    else:
        raise TypeError(f"{place or 'filter'}: wanted a description or numbers, got {name}")
    tree = {
        key: _packed(part, f"{place}/{key}" if place else str(key), (), known, arrays)
        for key, part in parts.items()
    }
    if kind is tuple:
        return list(tree.values())
    return {"class": name, **({"parts": list(tree.values())} if kind is list else tree)}


def unpacked(
    tree: object, arrays: Mapping[str, np.ndarray], place: str = "",
    known: Mapping[str, type] = KNOWN, **given: object,
) -> object:  # fmt: skip
    """What a tree and its arrays describe; fields that are given are not looked for in it.

    Raises
    ------
    KeyError, TypeError, ValueError
        An array that is missing, an unknown class, fields that a description does not take.
    """
    at = f"{place}/" if place else ""
    if isinstance(tree, list):
        parts = enumerate(tree)
        return tuple(unpacked(part, arrays, f"{at}{i}", known) for i, part in parts)
    if not isinstance(tree, dict):
        return tree
    name = tree.get("class")
    if name == "array":
        return arrays[place]
    if name == "list":
        return list(unpacked(tree["parts"], arrays, place, known))
    kind = known_class(name, known)
    if kind is None:
        raise ValueError(f"{place or 'filter'} is a {name!r}")
    fields = {
        key: unpacked(part, arrays, f"{at}{key}", known)
        for key, part in tree.items()
        if key != "class" and key not in given
    }
    return kind(**fields, **given)
