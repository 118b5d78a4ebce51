"""Whether the arrays of a designed filter fit together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from seedslib.base.checks import require_shape
from seedslib.base.linalg import INDEFINITE


def check_array(name: str, array: Any, *shape: int | None, finite: bool = True) -> None:
    """Refuse what is no float64 array of finite numbers of a shape (None is any length).

    Raises
    ------
    TypeError, ValueError
        Something else; the message says what.
    """
    if not isinstance(array, np.ndarray) or array.dtype != np.float64:
        got = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise TypeError(f"{name}: wanted an array of float64, got {got}")
    require_shape(name, array, shape)
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name}: wanted finite numbers, got others")


def check_fields(name: str, owner: Any, **shapes: tuple[int | None, ...]) -> None:
    """`check_array` of the named fields of an object."""
    for field, shape in shapes.items():
        check_array(f"{name}.{field}", getattr(owner, field), *shape)


def check_covariances(name: str, covariances: Iterable[np.ndarray]) -> None:
    """Refuse covariances (..., n, n) that are clearly indefinite.

    Held against their largest eigenvalue, as designs clip them: a variance in small units beside
    one in large units may be a rounding error.

    Raises
    ------
    ValueError
        One that has a negative eigenvalue.
    """
    by_shape: dict[tuple, list] = {}
    for cov in covariances:
        by_shape.setdefault(cov.shape, []).append(cov)
    for shape, several in by_shape.items():
        if not all(shape):
            continue
        values = np.linalg.eigvalsh(np.stack(several))
        if (values[..., 0] < -INDEFINITE * np.maximum(values[..., -1], 0.0)).any():
            raise ValueError(
                f"{name}: wanted positive semidefinite covariances, got eigenvalue "
                f"{values.min():.3g}"
            )
