"""A model from a Python file of the user's own, which is run as any script is."""

from __future__ import annotations

import sys
import traceback
from os import PathLike
from pathlib import Path
from types import ModuleType

import numpy as np

from seedslib.base.checks import as_times
from seedslib.models import JumpDiffusion, SwitchingSystem
from seedslib.models.discrete import DiscreteSystem

System = JumpDiffusion | DiscreteSystem | SwitchingSystem

NAME = "seedslib_model"
"""Under this name the file's module is known while it runs."""


def load_model(path: str | PathLike[str]) -> tuple[System, np.ndarray | None]:
    """Model of a file that defines `system`, and its measurement times if it defines `times`.

    Parameters
    ----------
    path : path-like
        A Python file. `system` is the model or a function without arguments that returns it.
        The file may import its neighbours.

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
    except (Exception, SystemExit) as error:
        raise ValueError(f"{path}: {_told(error, str(path))}") from None
    finally:
        sys.path.remove(str(path.resolve().parent))
    if not isinstance(system, System):
        got = "none" if system is None else type(system).__name__
        raise ValueError(
            f"{path}: wanted a JumpDiffusion, DiscreteSystem or SwitchingSystem called `system`, "
            f"or a function system() that returns one; got {got}"
        )
    times = getattr(module, "times", None)
    if times is not None:
        try:
            times = as_times("times", times)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: {error}") from None
    return system, times


def _told(error, place):
    """The error in one line, with the last line of the file that had a part in it."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == place]
    line = error.lineno if isinstance(error, SyntaxError) else lines[-1] if lines else None
    where = f" (line {line})" if line else ""
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    if isinstance(error, SystemExit):
        return f"wanted a file that runs to its end, got sys.exit({error.code!r}){where}"
    return " ".join(f"{type(error).__name__}: {text}{where}".split())
