"""Checks of arguments; every message names the argument, what came and what is wanted."""

from __future__ import annotations

import numpy as np

ASYMMETRY = 1e-10
NEGATIVE_EIGENVALUE = 1e-10


def as_real(name: str, value: object, *, ndim: int | None = None, nan: bool = False) -> np.ndarray:
    """Float64 array of finite real numbers.

    Parameters
    ----------
    name : str
        The caller's name of the argument, for the message.
    value : array_like
        What the caller passed.
    ndim : int, optional
        Wanted number of axes.
    nan : bool
        Whether NaN (a missing value) is allowed; infinities never are.

    Raises
    ------
    TypeError
        `value` is complex, an object array, text, or ragged.
    ValueError
        Wrong number of axes, or an entry that is not finite.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TypeError(f"{name}: wanted an array of real numbers, got a ragged list") from error
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name}: wanted real numbers, got an array of dtype {array.dtype}")
    array = array.astype(float)
    if ndim is not None and array.ndim != ndim:
        raise ValueError(f"{name}: wanted {ndim} axes, got shape {array.shape}")
    bad = np.isinf(array) if nan else ~np.isfinite(array)
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ValueError(f"{name}: wanted finite numbers, got {array[where]} at index {where}")
    return array


def as_shape(name: str, value: object, shape: tuple[int, ...], *, nan: bool = False) -> np.ndarray:
    """Real array (see `as_real`) of exactly the given shape; -1 leaves an axis free.

    Raises
    ------
    TypeError, ValueError
        As `as_real`; `ValueError` also for a wrong shape.
    """
    array = as_real(name, value, nan=nan)
    fits = array.ndim == len(shape) and all(
        want in (-1, got) for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join("any" if s == -1 else str(s) for s in shape) + ")"
        raise ValueError(f"{name}: wanted shape {wanted}, got {array.shape}")
    return array


def as_covariance(
    name: str, value: object, size: int | None = None, *, definite: bool = False
) -> np.ndarray:
    """Symmetric positive semidefinite (or definite) matrix, returned exactly symmetric.

    Negative eigenvalues within rounding (1e-10 of the largest) are accepted and left alone:
    nothing is silently regularised.

    Raises
    ------
    TypeError, ValueError
        As `as_real`; `ValueError` also when the matrix is not square, not of the wanted `size`,
        not symmetric (relative 1e-10), or has a negative eigenvalue (below -1e-10 of the
        largest), or is not positive definite where `definite` asks for it.
    """
    matrix = as_real(name, value, ndim=2)
    if matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"{name}: wanted a square matrix, got shape {matrix.shape}")
    if size is not None and matrix.shape[0] != size:
        raise ValueError(f"{name}: wanted shape ({size}, {size}), got {matrix.shape}")
    scale = np.abs(matrix).max(initial=0.0)
    asymmetry = np.abs(matrix - matrix.T).max(initial=0.0)
    if asymmetry > ASYMMETRY * scale:
        raise ValueError(f"{name}: wanted a symmetric matrix, got asymmetry {asymmetry:.3g}")
    matrix = 0.5 * (matrix + matrix.T)
    if matrix.size:
        eigenvalues = np.linalg.eigvalsh(matrix)
        if eigenvalues[0] < -NEGATIVE_EIGENVALUE * max(eigenvalues[-1], 0.0) - 1e-300:
            raise ValueError(
                f"{name}: wanted a positive semidefinite matrix, "
                f"got eigenvalue {eigenvalues[0]:.6g}"
            )
        if definite and eigenvalues[0] <= 0.0:
            raise ValueError(
                f"{name}: wanted a positive definite matrix, got eigenvalue {eigenvalues[0]:.6g}"
            )
    return matrix


def as_times(name: str, value: object) -> np.ndarray:
    """Strictly increasing grid of at least one nonnegative time, shape (K,).

    Raises
    ------
    TypeError, ValueError
        As `as_real`; `ValueError` also for an empty, negative, or not increasing grid.
    """
    times = as_real(name, value, ndim=1)
    if times.size == 0:
        raise ValueError(f"{name}: wanted at least one time, got an empty grid")
    if times[0] < 0:
        raise ValueError(f"{name}: wanted nonnegative times, got {times[0]:g}")
    if times.size > 1 and np.diff(times).min() <= 0:
        where = int(np.argmin(np.diff(times)))
        raise ValueError(
            f"{name}: wanted strictly increasing times, "
            f"got {times[where]:g} then {times[where + 1]:g} at index {where}"
        )
    return times
