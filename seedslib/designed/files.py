"""Designed filters in files, bound to the models they were designed for.

The model is not stored: it is given again on loading and recognised by what its functions do at
fixed points. The filter is: a tree of descriptions in the header, see `seedslib.designed.codec`.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from seedslib.designed.archive import read, write
from seedslib.designed.codec import FILTERS, KNOWN, LINEARIZATIONS, known_class, packed, unpacked
from seedslib.designed.identity import (
    difference,
    model_text,
    probe,
    probe_arrays,
    probe_points,
    probe_values,
)
from seedslib.designed.outputs.filter import OutputFilter
from seedslib.designed.outputs.table import TableFilter
from seedslib.linearization.moments import Linearization
from seedslib.linearization.points import GaussHermite
from seedslib.models.kinds import UnknownModel, switches

MOST_NODES, MOST_POINTS = 256, 2**22
"""Nodes in a direction, and points, of a linearization that a file may ask for."""


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
    rule = getattr(filter, "linearization", None)
    # one of the user's own is given again on loading
    own = rule is not None and known_class(type(rule).__name__) is not type(rule)
    # rules are compiled again
    leave = ("system", "rules", *("linearization",) * own)
    tree, arrays = packed(filter, leave)
    if own:
        tree["linearization"] = {"class": type(rule).__name__}
    points = probe_points(filter.system, *filter.reach)
    known = probe_arrays(points, probe(filter.system, points, rule))
    sizes, _ = packed(UnknownModel.of(filter.system))
    header = {"filter": tree, "model": model_text(filter.system), "sizes": sizes}
    write(path, header, {k: np.asarray(a, order="C") for k, a in {**known, **arrays}.items()})


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
    header, arrays = read(path)
    try:
        kind = header["filter"]["class"]
        given = {"linearization": header["filter"].get("linearization")}
        sizes = unpacked(header["sizes"], arrays)
        points, known = probe_values(arrays, sizes.state_size)
        tables = KNOWN[kind] is TableFilter
    except _FAULTS as error:
        raise _contradiction(path, error) from None
    if system is None and not tables:
        raise ValueError(
            f"{path.name}: this filter evaluates its model; wanted the model too, on the command "
            "line --system (only a filter of tables runs without)"
        )
    # a table has no linearization, or none that matters
    if tables or given["linearization"] is None:
        given = {}
    elif linearization is not None:
        given["linearization"] = linearization
    else:
        given["linearization"] = _linearization(path, given["linearization"], sizes.state_size)
    if system is not None and (reason := _other(path, system, sizes, known, points, **given)):
        raise ValueError(f"{path.name}: designed for another model{reason}")
    if not issubclass(KNOWN[kind], OutputFilter):
        given["rules"] = None
    try:
        given["system"] = sizes.bounded() if system is None else system
        return unpacked(header["filter"], arrays, **given)
    except _FAULTS as error:
        raise _contradiction(path, error) from None


_FAULTS = (
    KeyError, TypeError, IndexError, ValueError, OverflowError, AttributeError, RecursionError
)  # fmt: skip
"""What the parts of a file raise that do not fit together."""


def _contradiction(path, error) -> ValueError:
    return ValueError(f"{path.name}: the file contradicts itself ({error})")


def _other(path, system, sizes, known, points, linearization=None) -> str:
    """What differs between the model of a file and another, in words; empty where nothing does."""
    if switches(system) != switches(sizes):
        return ", one that has modes" if sizes.modes else ", one without modes"
    if apart := sizes.apart(UnknownModel.of(system)):
        word, one, two = apart
        return f": it has {one} {word}, not {two}"
    found = probe(system, points, linearization)
    try:
        reason = difference(known, found, points)
    except _FAULTS as error:
        raise _contradiction(path, error) from None
    return reason and f": {reason}"


def _linearization(path, tree, state_size):
    name = tree.get("class") if isinstance(tree, dict) else None
    if name not in LINEARIZATIONS:
        raise ValueError(
            f"{path.name}: its linearization {name!r} is not the library's; "
            "wanted it as the argument `linearization`"
        )
    try:
        rule = unpacked(tree, {})
        if isinstance(rule, GaussHermite) and (
            rule.order > MOST_NODES or rule.order**state_size > MOST_POINTS
        ):
            raise ValueError(f"{rule} for {state_size} state components")
    except _FAULTS as error:
        raise _contradiction(path, error) from None
    return rule
