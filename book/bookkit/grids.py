"""Grids of parameters, and the notebook's own check of each of their points."""

from __future__ import annotations

import ast
import contextlib
import io
import itertools
import math
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import nbformat
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bookkit.files import read_yaml
from bookkit.parameters import explain

_SHOWN = 10

MOST_POINTS = 10_000
"""Points of a grid, unless more are asked for: checking them takes seconds."""


def _scalar_or_list(value: Any) -> Any:
    items = value if isinstance(value, list) else [value]
    if not all(isinstance(item, bool | int | float | str) for item in items):
        raise ValueError("wanted a number, a string, a boolean, or a flat list of them")
    return value


Value = Annotated[Any, AfterValidator(_scalar_or_list)]


class Grid(BaseModel):
    """A grid file: the notebook it is for, and the values of each parameter."""

    model_config = ConfigDict(extra="forbid", strict=True)
    notebook: str | None = None
    grid: Annotated[
        dict[str, Annotated[list[Value], Field(min_length=1)]],
        Field(min_length=1),
    ]

    def points(self, most: int = MOST_POINTS) -> list[dict[str, Any]]:
        """All combinations, the first parameter slowest.

        Raises
        ------
        ValueError
            More than `most` of them.
        """
        names, size = list(self.grid), math.prod(map(len, self.grid.values()))
        if size > most:
            raise ValueError(
                f"grid: wanted at most {most} points, got {size}; the option --points allows more"
            )
        return [
            dict(zip(names, values, strict=True))
            for values in itertools.product(*self.grid.values())
        ]


def read_grid(path: Path) -> Grid:
    """Grid of a YAML file.

    Raises
    ------
    ValueError
        No such file, not YAML, or not a grid.
    """
    content = read_yaml(path, "grid file")
    if not isinstance(content, dict):
        raise ValueError(f"{path}: wanted a valid dictionary with the key 'grid'")
    try:
        return Grid.model_validate(content)
    except ValidationError as error:
        raise ValueError(f"{path}: {explain(error)}") from None


def check_points(notebook: nbformat.NotebookNode, points: list[dict[str, Any]]) -> None:
    """Run the notebook's own check cell for every point, before any point is run.

    Raises
    ------
    ValueError
        The notebook has no parameters or no check cell after them, a name is unknown or not
        checked, or the check refuses a point; all faults in one message.
    """
    defaults, check = _cells(notebook)
    known = [name for name, value in defaults.items() if not _is_foreign(name, value)]
    checked = _checked(check)
    faults = []
    for name in points[0]:
        if name not in known:
            faults.append(f"{name}: unknown parameter, the notebook has {', '.join(known)}")
        elif name not in checked:
            faults.append(f"{name}: the notebook's check cell does not check it")
    for point in [] if faults else points:
        try:
            _run(check, {**defaults, **point})
        except (Exception, SystemExit) as error:
            faults.append(str(error))
    faults = list(dict.fromkeys(faults))
    if len(faults) > _SHOWN:
        faults[_SHOWN:] = [f"and {len(faults) - _SHOWN} more"]
    if faults:
        raise ValueError("; ".join(faults))


def _cells(notebook: nbformat.NotebookNode) -> tuple[dict[str, Any], str]:
    """What the parameters cell sets, and the source of the code cell after it."""
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    at = next(
        (i for i, cell in enumerate(code) if "parameters" in cell.metadata.get("tags", [])), None
    )
    if at is None:
        raise ValueError("the notebook has no cell tagged 'parameters'")
    if at + 1 == len(code) or not _checked(code[at + 1].source):
        raise ValueError("the notebook has no check cell after its parameters")
    defaults: dict[str, Any] = {}
    try:
        _run(code[at].source, defaults)
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"the parameters cell does not run: {type(error).__name__}: {error}"
        ) from None
    return defaults, code[at + 1].source


def _run(source: str, namespace: dict[str, Any]) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        exec(source, namespace)


def _is_foreign(name: str, value: object) -> bool:
    """Whether a name of the parameters cell is no parameter: imported, or Python's own."""
    return name.startswith("__") or isinstance(value, ModuleType) or callable(value)


def _checked(source: str) -> set[str]:
    """The parameters that a cell hands to `check`; empty when it calls no such thing."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return set()
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    return {
        keyword.arg
        for call in calls
        if getattr(call.func, "id", getattr(call.func, "attr", "")) == "check"
        for keyword in call.keywords
        if keyword.arg
    }
