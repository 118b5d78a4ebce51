"""Annotations for arguments and fields that are arrays, and their batch axes, which come last."""

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


def align(array: np.ndarray, core: int, depth: int) -> np.ndarray:
    """Array whose `core` leading axes are followed by `depth` batch axes, new ones of length one.

    NumPy broadcasts from the last axis on; after this the batch axes of arrays with different
    core axes meet each other.
    """
    missing = core + depth - array.ndim
    if missing <= 0:
        return array
    return array.reshape(array.shape[:core] + (1,) * missing + array.shape[core:])


def batch_shape(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Shape that these broadcast to; equal ones and ones of 1, as in a step, cost next to nothing.

    `np.broadcast_shapes` takes twenty times longer.
    """
    joint = ()
    for shape in shapes:
        if shape != joint and shape != ():
            if joint.count(1) == len(joint) <= len(shape):
                joint = shape
            elif not shape.count(1) == len(shape) <= len(joint):
                return np.broadcast_shapes(*shapes)
    return joint


def product(A: np.ndarray, B: np.ndarray, core: int) -> np.ndarray:
    """Matrix A (m, n) or (m, n, *batch) times B: a vector (core 1) or a matrix (core 2) per item.

    A matrix that is common to all items multiplies all of them at once, laid side by side.
    """
    if A.ndim == 2:
        return (A @ B.reshape(len(B), -1)).reshape(len(A), *B.shape[1:])
    return np.einsum("ij...,j...->i..." if core == 1 else "ij...,jk...->ik...", A, B)
