"""A model from a Python file of the user's own, which is run as any script is."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from seedslib.base import Parameter
from seedslib.base.checks import as_times
from seedslib.models import JumpDiffusion, SwitchingSystem
from seedslib.models.discrete import DiscreteSystem

System = JumpDiffusion | DiscreteSystem | SwitchingSystem

NAME = "seedslib_model"
"""Under this name the file's module is known while it runs."""


class Model(NamedTuple):
    """What a file defines: its model, measurement times, filter and parameters by name, if any.

    A filter may also be a function without arguments that makes one.
    """

    system: System | None
    times: np.ndarray | None = None
    filter: Any = None
    parameters: Mapping[str, Parameter] = {}
    path: Path = Path()

    @property
    def known(self) -> System:
        """The model.

        Raises
        ------
        ValueError
            There is none.
        """
        if self.system is None:
            raise ValueError(f"{self.path}: wanted `system`, got only `filter`")
        return self.system


def load_model(path: str | PathLike[str]) -> Model:
    """What a file defines.

    Parameters
    ----------
    path : path-like
        A Python file. `system` is the model or a function without arguments that returns it; it
        may be left out where there is a `filter`. The file may import its neighbours.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        The file fails or ends the program, the message says where; no `system` in it, or one of
        another kind.
    """
    path = Path(path)
    source = path.read_bytes()
    module = ModuleType(NAME)
    module.__file__ = str(path)
    sys.modules[NAME] = module
    sys.path.insert(0, str(path.resolve().parent))
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
        system = getattr(module, "system", None)
        if callable(system):
            system = system()
    except (Exception, SystemExit, GeneratorExit) as error:
        raise ValueError(f"{path}: {_told(error, str(path))}") from None
    finally:
        sys.path.remove(str(path.resolve().parent))
    filter = getattr(module, "filter", None)
    if not isinstance(system, System):
        if filter is None:
            got = "none" if system is None else type(system).__name__
            raise ValueError(
                f"{path}: wanted a JumpDiffusion, DiscreteSystem or SwitchingSystem called "
                f"`system`, or a function system() that returns one; got {got}"
            )
        system = None
    times = getattr(module, "times", None)
    if times is not None:
        try:
            times = as_times("times", times)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: {error}") from None
    found = [value for value in vars(module).values() if type(value) is Parameter]
    return Model(system, times, filter, {str(p): p for p in sorted(found, key=str)}, path)


def of_the_file(path: str, filter: Any) -> Any:
    """The filter that a model's file defines, made where it is a function.

    Raises
    ------
    ValueError
        The function fails, or it is no filter.
    """
    try:
        made = filter() if callable(filter) and not hasattr(filter, "run") else filter
    except (Exception, SystemExit, GeneratorExit) as error:
        raise ValueError(f"{path}: {_told(error, path)}") from None
    if not (hasattr(made, "run") and hasattr(getattr(made, "system", None), "measurement_size")):
        raise ValueError(
            f"{path}: wanted `filter` with the verbs of seedslib.filters.Filter, got "
            f"{type(made).__name__}"
        )
    return made


def _told(error, place):
    """The error in one line, with the last line of the file that had a part in it."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == place]
    line = error.lineno if isinstance(error, SyntaxError) else lines[-1] if lines else None
    where = f" (line {line})" if line else ""
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    if isinstance(error, SystemExit):
        return f"wanted a file that runs to its end, got sys.exit({error.code!r}){where}"
    return " ".join(f"{type(error).__name__}: {text}{where}".split())
