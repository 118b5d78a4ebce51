"""Annotations for arguments and fields that are arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = Any
"""A field that is given what NumPy can make an array of, and is an array."""

MaybeArray = np.ndarray | Any
"""An array, or None where there is none: readers know which, a type checker cannot."""

Count = int | np.integer
"""A whole number."""

Seed = int | np.integer | np.random.SeedSequence | np.random.Generator
"""What random numbers are drawn from."""
