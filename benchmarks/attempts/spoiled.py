"""Ways to spoil an argument, and ways to write the same argument differently."""

from __future__ import annotations

import datetime
import decimal
import fractions
from collections.abc import Iterator

import numpy as np
import sympy

HUGE, TINY = 1e60, 1e-60


class Pretender:
    """An array-like of another library."""

    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return np.array(self.array, dtype=dtype)


class Hostile:
    """An array-like that fails."""

    def __array__(self, dtype=None, copy=None):
        raise ValueError("array: wanted somebody else")


def no_numbers() -> Iterator[tuple[str, object]]:
    """What is no array of real numbers, whatever its shape should be."""
    yield from {
        "text": "x",
        "empty text": "",
        "bytes": b"1",
        "object": object(),
        "type": float,
        "dict": {},
        "set": {1.0},
        "function": abs,
        "symbol": sympy.Symbol("q"),
        "ragged": [[1.0], [1.0, 2.0]],
        "list of none": [None],
        "list of text": ["1.0"],
        "date": np.datetime64("2026-01-02"),
        "dates": np.array(["2026-01-02"], "M8[D]"),
        "durations": np.array([1], "m8[s]"),
        "python date": datetime.date(2026, 1, 2),
        "decimal": decimal.Decimal("1.5"),
        "fraction": [fractions.Fraction(1, 2)],
        "complex": 1j,
        "complexes": np.array([[1 + 0j]]),
        "record": np.zeros(1, "f8,f8"),
        "generator": (v for v in (1.0, 2.0)),
        "NaN": np.nan,
        "inf": np.inf,
        "-inf": -np.inf,
        "masked": np.ma.masked_all((1, 1)),
        "masked constant": np.ma.masked,
        "empty": [],
        "empty matrix": [[]],
        "module": np,
        "exception": ValueError("x"),
        "sympy zoo": sympy.zoo,
        "sympy nan": sympy.nan,
        "void": np.void(b"ab"),
        "ellipsis": ...,
        "slice": slice(3),
        "nested": [[[[[[1.0]]]]]],
        "range of none": range(0),
    }.items()


def spoiled(good: object, *, missing: bool = False) -> Iterator[tuple[str, object]]:
    """An array with an entry or a shape that it cannot have; NaN is legal where it is missing."""
    array = np.asarray(good, dtype=float)
    for where in {(0,) * array.ndim, tuple(n - 1 for n in array.shape)}:
        for name, value in (("nan", np.nan), ("inf", np.inf), ("-inf", -np.inf)):
            if missing and name == "nan":
                continue
            bad = array.copy()
            bad[where] = value
            yield f"{name} at {where}", bad
    yield "complex", array + 0j
    yield "text", array.astype(str)
    yield "objects", array.astype(object)
    yield "bytes", array.astype("S9")
    if not missing:
        yield "masked", np.ma.array(array, mask=np.ones(array.shape, bool))
    yield "one axis more", array[..., None, None]
    yield "many axes", array.reshape(array.shape + (1,) * 7)
    if array.ndim:
        yield "one more", np.concatenate([array, array[:1]])
        yield "doubled", np.concatenate([array, array])
        yield "none", array[:0]
        yield "flat and doubled", np.repeat(array.ravel(), 2)
    if array.ndim > 1 and array.shape[-1] > 1:
        yield "cut", array[..., :-1]
    if array.ndim > 1 and array.shape[0] != array.shape[-1]:
        yield "turned", np.swapaxes(array, 0, -1)


def same(good: object) -> Iterator[tuple[str, object]]:
    """The same numbers, passed in another way."""
    array = np.asarray(good, dtype=float)
    yield "lists", array.tolist()
    yield "pretender", Pretender(array)
    yield "swapped bytes", array.astype(">f8")
    yield "long double", array.astype(np.longdouble)
    yield "mask without entries", np.ma.array(array)
    if (array == array.astype(np.float32)).all():
        yield "float32", array.astype(np.float32)
    if (array == array.astype(np.int64)).all():
        yield "integers", array.astype(int)
    if not array.ndim:
        yield "scalar of numpy", np.float64(array)
        return
    yield "tuple", tuple(array.tolist())
    yield "columns first", np.asfortranarray(array)
    wide = np.full((*array.shape[:-1], 2 * array.shape[-1]), np.nan)
    wide[..., ::2] = array
    yield "every second", wide[..., ::2]
    yield "turned round twice", array[::-1].copy()[::-1]
    frozen = array.copy()
    frozen.flags.writeable = False
    yield "read-only", frozen
    if array.ndim == 2:
        yield "transposed twice", array.T.copy().T


def no_covariance(good: object) -> Iterator[tuple[str, object]]:
    """Symmetric or not, but no covariance."""
    cov = np.atleast_2d(np.asarray(good, dtype=float))
    size = len(cov)
    for scale in (1.0, HUGE, TINY):
        yield f"negative {scale:g}", -scale * np.eye(size)
        one = np.eye(size)
        one[-1, -1] = -scale
        yield f"one negative {scale:g}", one
        yield f"hardly negative {scale:g}", np.diag([*[1.0] * (size - 1), -1e-7 * scale])
    if size > 1:
        for big in (1e3, 1e12, 1e60):
            yield f"negative beside {big:g}", np.diag([big, *[-1.0] * (size - 1)])
            scales = np.sqrt(np.array([big, *[1 / big] * (size - 1)]))
            indefinite = np.full((size, size), 1.5) - 0.5 * np.eye(size)
            yield f"indefinite in units of {big:g}", indefinite * np.outer(scales, scales)
        skew = cov.copy()
        skew[0, 1] += 0.3
        yield "asymmetric", skew
        yield (
            "antisymmetric",
            np.array(np.triu(np.ones((size, size))) - np.tril(np.ones((size,) * 2))),
        )


def no_times(good: object) -> Iterator[tuple[str, object]]:
    """Grids of times that are none."""
    times = np.asarray(good, dtype=float)
    yield "decreasing", times[::-1].copy()
    yield "constant", np.full_like(times, times[-1])
    yield "negative", times - 1 - times[-1]
    yield "twice the first", np.concatenate([times[:1], times])
    yield "back at the end", np.concatenate([times, times[:1]])
    yield "a matrix", times[:, None]


def no_counts(least: int) -> Iterator[tuple[str, object]]:
    """What is no whole number of at least so many."""
    yield from {
        "less": least - 1,
        "negative": -3,
        "huge negative": -(10**30),
        "half": least + 0.5,
        "float": float(least),
        "text": str(least),
        "true": True,
        "list": [least],
        "nan": np.nan,
        "inf": np.inf,
        "complex": least + 0j,
        "bytes": b"1",
        "object": object(),
        "array": np.array([least]),
        "decimal": decimal.Decimal(least),
        "dict": {},
        "float of numpy": np.float64(least),
        "symbol": sympy.Symbol("k"),
    }.items()


def no_positives() -> Iterator[tuple[str, object]]:
    """What is no positive number."""
    yield from {
        "zero": 0.0,
        "negative": -1.0,
        "nan": np.nan,
        "inf": np.inf,
        "-inf": -np.inf,
        "text": "1",
        "complex": 1j,
        "list": [1.0, 2.0],
        "object": object(),
        "dict": {},
        "bytes": b"1",
        "symbol": sympy.Symbol("k"),
        "date": np.datetime64("2026-01-02"),
    }.items()
