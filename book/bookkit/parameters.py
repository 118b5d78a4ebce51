"""Parameters of a notebook: declared once, checked in the cell after they are set.

The check cell of a notebook is the only description of what its parameters may be. The
notebook itself runs it, and so does the sweep driver for every point of a grid before it
starts the first one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model


def real(**bounds: float) -> Any:
    """A finite real number; bounds as in pydantic: ``gt``, ``ge``, ``lt``, ``le``."""
    return Annotated[float, Field(strict=True, allow_inf_nan=False, **bounds)]


def integer(**bounds: int) -> Any:
    """A whole number; bounds ``gt``, ``ge``, ``lt``, ``le``, ``multiple_of``."""
    return Annotated[int, Field(strict=True, **bounds)]


def choice(*options: str | int) -> Any:
    """One of the given values."""
    return Literal[options]


def explain(error: ValidationError) -> str:
    """All errors that pydantic reports, one clause each: name, value, what is wanted."""
    clauses = []
    for one in error.errors(include_url=False):
        name = ".".join(str(part) for part in one["loc"])
        wanted = one["msg"][:1].lower() + one["msg"][1:]
        missing = one["type"] == "missing"
        clauses.append(f"{name} is not set" if missing else f"{name} = {one['input']!r}: {wanted}")
    return "; ".join(clauses)


def check(namespace: Mapping[str, object], /, **fields: Any) -> None:
    """Check a notebook's parameters; every error is named in one message.

    Parameters
    ----------
    namespace : mapping
        The variables, by name: ``globals()`` in a notebook.
    **fields
        For each parameter what it may be: `real`, `integer`, `choice`, or any type
        that pydantic understands.

    Raises
    ------
    ValueError
        A parameter is missing, of the wrong type, or out of bounds.
    """
    if not fields:
        raise ValueError("check: wanted at least one parameter")
    model: type[BaseModel] = create_model(
        "Parameters",
        __config__=ConfigDict(strict=True, arbitrary_types_allowed=True),
        **{name: (kind, ...) for name, kind in fields.items()},
    )
    try:
        model(**{name: namespace[name] for name in fields if name in namespace})
    except ValidationError as error:
        raise ValueError(f"bad parameters: {explain(error)}") from None
