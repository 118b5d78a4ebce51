"""Whether the arrays of a designed filter have the shapes that its memory and times ask for."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.base.checks import require_shape


def check_fields(name: str, owner: Any, **shapes: tuple[int | None, ...]) -> None:
    """Refuse fields of an object that are no finite float64 arrays of a shape; None is any length.

    Raises
    ------
    TypeError, ValueError
        The first that is something else.
    """
    for field, shape in shapes.items():
        array, place = getattr(owner, field), f"{name}.{field}".lstrip(".")
        if not isinstance(array, np.ndarray) or array.dtype != np.float64:
            raise TypeError(f"{place}: wanted an array of float64, got {type(array).__name__}")
        require_shape(place, array, shape)
        if not np.isfinite(array).all():
            raise ValueError(f"{place}: wanted finite numbers, got others")
