"""Any filter from words: a designed one in a file, one of the library's by its name, one's own."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

KINDS = {
    "KalmanFilter": None, "extended_kalman": None, "unscented_kalman": None,
    "cubature_kalman": None, "assumed_density": None, "CovarianceFilter": "linearization",
    "SwitchingFilter": "linearization", "ParticleFilter": "particles",
    "RaoBlackwellFilter": "particles", "GridBayesFilter": "grid",
}  # fmt: skip
"""Filters by their names in Python, and the option that they take beside the model."""

ALWAYS_MADE_ANEW = ("GridBayesFilter",)
"""Filters that take in the values of parameters when they are made."""


def add_kind(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose a filter of a model."""
    add = parser.add_argument
    add(
        "--kind", metavar="NAME",
        help=f"filter of the model, by its name in Python: {' | '.join(KINDS)}; without it "
        "MODEL.py defines `filter`, or a function filter() that makes one",
    )  # fmt: skip
    add("--linearization", metavar="NAME", help="of CovarianceFilter and SwitchingFilter, as in "
        "`design` (default gaussian)")  # fmt: skip
    add("--particles", type=int, metavar="N", help="of ParticleFilter and RaoBlackwellFilter")
    add("--grid", metavar="x=LOW:HIGH:COUNT", help="nodes of GridBayesFilter")
    add("--set", metavar="q=1.3,r=2", help="values of parameters, or FILE.json of `fit`")


def maker(options: argparse.Namespace) -> tuple[Callable[[], Any], Mapping[str, Any]]:
    """Function that makes the filter that is asked for, and the parameters of its model by name.

    Raises
    ------
    OSError, ValueError
        No such file, no such kind, options that the kind does not take.
    """
    from seedslib.commands.models import load_model, of_the_file

    path, word = options.filter, options.kind
    takes = KINDS.get(word)
    for name in ("linearization", "particles", "grid"):
        if getattr(options, name) is not None and name != takes:
            raise ValueError(f"{name}: wanted none for {word or path}, got one")
    if not path.endswith(".py"):
        return _designed(options), {}
    if getattr(options, "model", None) is not None:
        raise ValueError(f"model: wanted none beside {path}, got {options.model}")
    wanted = f"kind: wanted one of {', '.join(KINDS)}"
    if word is not None and word not in KINDS:
        raise ValueError(f"{wanted}; got {word}")
    model = load_model(path)
    if word is None:
        if model.filter is None:
            raise ValueError(f"{wanted}, or `filter` in {path}")
        return lambda: of_the_file(path, model.filter), model.parameters
    given = [] if takes is None else _given(takes, getattr(options, takes))
    return lambda: _made(path, word, model.known, given), model.parameters


@contextmanager
def chosen_filter(options: argparse.Namespace) -> Iterator[Any]:
    """The filter that is asked for, while the parameters of its model have the given values.

    Raises
    ------
    OSError, ValueError
        As `maker`; a filter that does not fit the model; parameters that the model has not.
    """
    from seedslib.base import assigned

    make, parameters = maker(options)
    with assigned(set_values(options, parameters)):
        yield make()


def set_values(options: argparse.Namespace, parameters: Mapping[str, Any]) -> dict[Any, float]:
    """Values of `--set` by the parameters that they are for.

    Raises
    ------
    ValueError
        Parameters that the model has not.
    """
    from seedslib.commands.words import as_values

    values = {} if options.set is None else as_values(options.set)
    return {parameter_named("set", name, parameters): value for name, value in values.items()}


def parameter_named(option: str, name: str, parameters: Mapping[str, Any]) -> Any:
    """The parameter of a name.

    Raises
    ------
    ValueError
        No such one.
    """
    if name not in parameters:
        known = ", ".join(parameters) or "the model's file names none"
        raise ValueError(f"{option}: wanted a `Parameter` of the model ({known}), got {name}")
    return parameters[name]


def _designed(options):
    from seedslib.commands.models import load_model
    from seedslib.designed import load

    if options.kind is not None or options.set is not None:
        raise ValueError(
            f"kind, set: wanted with MODEL.py only, got the designed filter {options.filter}"
        )
    system = None if options.model is None else load_model(options.model).known
    return lambda: load(options.filter, system)


def _given(option, text):
    """The argument that a kind takes after the model; none for the library's default."""
    from seedslib.commands import words

    if option == "linearization":
        return [words.linearization_of(text or "gaussian")]
    if option == "grid" and text is not None:
        axes = words.axes_of(option, [text], "x")["x"]
        return [axes if len(axes) > 1 else axes[0]]
    return [] if text is None else [text]


def _made(path, word, system, given):
    from seedslib import designed, filters

    room = designed if word == "SwitchingFilter" else filters
    try:
        return getattr(room, word)(system, *given)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{word} of {path}: {error}") from None
