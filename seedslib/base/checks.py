"""Checks of arguments; every message names the argument, what came and what is wanted."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from seedslib.base.clock import when

ASYMMETRY = 1e-10
NEGATIVE_EIGENVALUE = 1e-10

LONGEST = 80
"""Characters of a value in a message."""


def as_real(
    name: str,
    value: object,
    shape: tuple[Any, ...] | None = None,
    *,
    nan: bool = False,
    infinite: bool = False,
) -> np.ndarray:
    """Float64 array of real numbers, finite unless said otherwise.

    Parameters
    ----------
    name : str
        The caller's name of the argument, for the message.
    value : array_like
    shape : tuple, optional
        Wanted lengths of the axes, see `require_shape`.
    nan, infinite : bool
        Whether NaN (a missing value) and infinities are allowed.

    Raises
    ------
    TypeError
        `value` is complex, an array of other objects than numbers, text, ragged, or masked.
    ValueError
        Another shape, or an entry that is not allowed.
    """
    if isinstance(value, np.ma.MaskedArray):  # NumPy would read the numbers behind the mask
        raise TypeError(f"{name}: wanted NaN for missing numbers, got a masked array")
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TypeError(f"{name}: wanted an array of real numbers, got a ragged list") from error
    if array.dtype.kind == "O" and all(isinstance(part, int | float) for part in array.flat):
        array = _as_floats(name, array)
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name}: wanted real numbers, got {_no_numbers(array)}")
    array = array.astype(float)
    if shape is not None:
        require_shape(name, array, shape)
    if (nan and infinite) or np.isfinite(array).all():
        return array
    bad = ~(np.isfinite(array) | (nan & np.isnan(array)) | (infinite & np.isinf(array)))
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ValueError(f"{name}: wanted finite numbers, got {array[where]} at index {where}")
    return array


def _as_floats(name: str, array: np.ndarray) -> np.ndarray:
    try:
        return array.astype(float)
    except OverflowError:
        raise ValueError(f"{name}: wanted numbers in the range of float64, got others") from None


def _no_numbers(array: np.ndarray) -> str:
    """What an array of something else is, and what may have been meant."""
    if array.dtype.kind in "mM":
        hint = "take time since the first in a unit: (t - t[0]) / np.timedelta64(1, 's')"
        return f"an array of dtype {array.dtype}; {hint}"
    if array.dtype.kind != "O":
        return f"an array of dtype {array.dtype}"
    symbols = {str(s) for part in array.flat for s in getattr(part, "free_symbols", ())}
    if symbols:
        return f"formulas of {', '.join(sorted(symbols))}; fit takes a function of their numbers"
    return brief(array.tolist())


def brief(value: object) -> str:
    """A value as a message shows it: as it is written, or what it is where that is long."""
    text = repr(value)
    if len(text) <= LONGEST:
        return text
    if hasattr(value, "shape"):
        return f"an array of shape {value.shape}"
    if isinstance(value, Mapping):
        return f"a mapping of {', '.join(map(repr, value))}"
    return f"a {type(value).__name__}: {text[:LONGEST]}..."


def require_shape(name: str, array: np.ndarray, shape: tuple[Any, ...]) -> None:
    """Refuse an array of another shape.

    -1 or None leaves the length of an axis free; ``...`` at the end stands for any batch axes.

    Raises
    ------
    ValueError
        Another number of axes, or another length of one.
    """
    core = len(shape) - (shape[-1:] == (...,))
    fits = array.ndim == core if core == len(shape) else array.ndim >= core
    pairs = zip(shape[:core], array.shape, strict=False)
    if not fits or any(wanted not in (-1, None, got) for wanted, got in pairs):
        words = {-1: "any", None: "any", ...: "..."}
        wanted = ", ".join(words.get(size, str(size)) for size in shape)
        raise ValueError(f"{name}: wanted shape ({wanted}), got {array.shape}")


def as_covariance(
    name: str, value: object, size: int | None = None, *, definite: bool = False
) -> np.ndarray:
    """Symmetric positive semidefinite (or definite) matrix, returned exactly symmetric.

    A number is the matrix of one component. Eigenvalues are those of the matrix scaled to unit
    diagonal, so that units do not matter. Negative ones within rounding (1e-10 of the largest)
    are accepted and left alone: nothing is silently regularised. A negative variance is never
    rounding.

    Raises
    ------
    TypeError, ValueError
        As `as_real`; `ValueError` also when the matrix is not square, not of the wanted `size`,
        not symmetric (relative 1e-10), or has a negative variance or a negative eigenvalue
        (below -1e-10 of the largest), or is not positive definite where `definite` asks for it.
    """
    matrix = as_real(name, value)
    if matrix.ndim == 0 and size == 1:
        matrix = matrix.reshape(1, 1)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"{name}: wanted a square matrix, got shape {matrix.shape}")
    if size is not None and matrix.shape[0] != size:
        raise ValueError(f"{name}: wanted shape ({size}, {size}), got {matrix.shape}")
    scale = np.abs(matrix).max(initial=0.0)
    asymmetry = np.abs(matrix - matrix.T).max(initial=0.0)
    if asymmetry > ASYMMETRY * scale:
        raise ValueError(f"{name}: wanted a symmetric matrix, got asymmetry {asymmetry:.3g}")
    matrix = 0.5 * (matrix + matrix.T)
    if matrix.size:
        smallest = require_semidefinite(name, matrix)
        if definite and smallest <= 0.0:
            raise ValueError(
                f"{name}: wanted a positive definite matrix, got eigenvalue {smallest:.6g}"
            )
    return matrix


def require_semidefinite(name: str, matrices: np.ndarray) -> float:
    """Smallest eigenvalue of symmetric matrices (..., n, n), scaled to unit diagonal.

    Raises
    ------
    ValueError
        A negative variance, or an eigenvalue below -1e-10 of the largest of its matrix.
    """
    several = matrices.ndim > 2
    wanted = "positive semidefinite matrices" if several else "a positive semidefinite matrix"
    variances = np.einsum("...ii->...i", matrices)
    if (variances < 0).any():
        raise ValueError(f"{name}: wanted {wanted}, got variance {variances.min():.6g}")
    units = np.sqrt(np.where(variances > 0, variances, 1.0))
    values = np.linalg.eigvalsh(matrices / units[..., :, None] / units[..., None, :])
    low = values[..., 0] + NEGATIVE_EIGENVALUE * np.maximum(values[..., -1], 0.0)
    smallest = float(values.min())
    if (low < -1e-300).any():
        raise ValueError(
            f"{name}: wanted {wanted}, got eigenvalue {smallest:.6g} when scaled to unit diagonal"
        )
    return smallest


def is_whole(value: object) -> bool:
    """Whether a value is a whole number, of Python or NumPy; True and False are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def as_positive(name: str, value: object, *, zero: bool = False, infinite: bool = False) -> float:
    """Positive number, zero or infinite where it may be; of any kind of number.

    Raises
    ------
    TypeError, ValueError
        Anything else, such as text.
    """
    try:
        array = np.asarray(value)
        number = float(array if array.dtype.kind in "fiubO" else None)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"{name}: wanted a number, got {value!r}") from None
    if not (0.0 < number < np.inf or (zero and number == 0.0) or (infinite and number == np.inf)):
        wanted = "nonnegative" if zero else "positive"
        raise ValueError(f"{name}: wanted a {wanted} number, got {value}")
    return number


def as_count(name: str, value: object, least: int = 1, most: int | None = None) -> int:
    """Whole number of at least `least` and, where it is given, at most `most`.

    Raises
    ------
    TypeError, ValueError
        No whole number; out of range.
    """
    if not is_whole(value):
        raise TypeError(f"{name}: wanted a whole number, got {value!r}")
    if value < least or (most is not None and value > most):
        wanted = f"at least {least}" if most is None else f"{least} to {most}"
        raise ValueError(f"{name}: wanted {wanted}, got {value}")
    return int(value)


def as_whole(name: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    """Whole numbers in the wanted shape.

    Raises
    ------
    TypeError, ValueError
        Other numbers, another shape.
    """
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "iu":
        raise TypeError(f"{name}: wanted whole numbers, got an array of dtype {numbers.dtype}")
    require_shape(name, numbers, shape)
    return numbers


def as_times(name: str, value: object) -> np.ndarray:
    """Strictly increasing grid of at least one nonnegative time, shape (K,).

    Raises
    ------
    TypeError, ValueError
        As `as_real`; `ValueError` also for an empty, negative, or not increasing grid.
    """
    times = as_real(name, value, (None,))
    if times.size == 0:
        raise ValueError(f"{name}: wanted at least one time, got an empty grid")
    if times[0] < 0:
        raise ValueError(f"{name}: wanted nonnegative times, got {when(times[0])}")
    if times.size > 1 and np.diff(times).min() <= 0:
        where = int(np.argmin(np.diff(times)))
        raise ValueError(
            f"{name}: wanted strictly increasing times, "
            f"got {when(times[where])} then {when(times[where + 1])} at index {where}"
        )
    return times


@contextmanager
def optional(extra: str) -> Iterator[None]:
    """Imports inside of packages that come with an extra of this library, or a word how to get it.

    Raises
    ------
    ImportError
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise ImportError(
            f"{str(error.name).partition('.')[0]}: wanted this package, which is not installed; "
            f"pip install 'seedslib[{extra}]'"
        ) from None


def outside() -> int:
    """Level on the stack of the first caller outside the library, for a warning given here."""
    frame, level = sys._getframe(1), 1
    while frame is not None and frame.f_globals.get("__name__", "").startswith("seedslib."):
        frame, level = frame.f_back, level + 1
    return level
