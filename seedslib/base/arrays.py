"""Annotations for arguments and fields that are arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

MYPY = False  # true for mypy, which does not take a descriptor for a field
if MYPY:
    Array = Any
elif TYPE_CHECKING:

    class Array:
        """A field that is given what NumPy can make an array of, and is an array."""

        def __get__(self, obj: object, owner: object = None) -> np.ndarray: ...
        def __set__(self, obj: object, value: ArrayLike) -> None: ...

else:
    Array = np.ndarray

MaybeArray = np.ndarray | Any
"""An array, or None where there is none: readers know which, a type checker cannot."""

Count = int | np.integer
"""A whole number."""

Seed = int | np.integer | np.random.SeedSequence | np.random.Generator
"""What random numbers are drawn from."""
