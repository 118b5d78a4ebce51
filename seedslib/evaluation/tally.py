"""Sums of squared errors over blocks of paths, for several filters at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Tally(NamedTuple):
    """Sums over paths of one block; F filters, J times and their average, c components.

    After the squared errors of the components come their sum and further numbers of each path,
    such as whether a mode was wrong: C = c + 1 + len(more).
    """

    simulated: int  # paths whose truth is finite
    count: int  # of them those on which no filter diverged
    mean: np.ndarray  # (F, J + 1, C) of the squared errors
    products: np.ndarray  # (F, F, J + 1, C), centred
    error: np.ndarray  # (F, J, c) sums of the errors
    everything: np.ndarray  # (F, J, c) sums of the squares of all paths
    diverged: np.ndarray  # (F,)
    normalised: list[Any]  # for each filter the `ErrorSums` of NEES, NIS and coverage
    seconds: np.ndarray  # (F,) per block
    steps: int  # measurements times paths
    more: tuple[str, ...] = ()  # names of the further numbers


class ErrorSums(NamedTuple):
    """Sums over paths of values that may be unknown at times; `...` are none or components."""

    sums: np.ndarray  # (J, ...)
    counts: np.ndarray  # (J, ...) paths on which it is known
    expected: np.ndarray  # (J, ...) what the sums are expected to be
    paths: np.ndarray  # (2, ...) sums over the window too, of the values and of the expected
    products: np.ndarray  # (2, 2, ...) sums over paths of the products of these two


SUMS = "simulated", "count", "error", "everything", "diverged", "seconds", "steps"
"""What is added up as it is."""


def tally(
    error: Any, good: Any, truth: Any, astray: Any, normalised: Any, seconds: float, steps: int, *,
    more: Any = None, window: Any = None,
) -> Tally:  # fmt: skip
    """Sums of one block.

    Parameters
    ----------
    error : ndarray, shape (F, J, c, N)
    good, truth : ndarray of bool, shape (N,)
        Paths without a divergence of any filter; paths whose truth is finite.
    astray : ndarray of bool, shape (F, N)
    normalised : list
        For each filter None or its squares of errors and of innovations, and what its intervals
        cover, each with what is expected of it on the mean; NaN where it is not known.
    seconds : ndarray, shape (F,)
    steps : int
    more : mapping of str to (ndarray, ndarray), optional
        Further numbers (F, J, N), NaN where there are none, and the times (J,) that are averaged.
    window : ndarray of bool, shape (J,), optional
        Times that are averaged, all by default.
    """
    everything, more = None, more or {}
    window = np.ones(error.shape[1], bool) if window is None else window
    if not good.all():
        with np.errstate(over="ignore", invalid="ignore"):
            everything = np.where(np.isnan(error), np.inf, error)[..., truth] ** 2
            everything = everything.sum(axis=-1)
        error = error[..., good]
    count, size = error.shape[-1], error.shape[2]
    squares = np.empty((len(error), error.shape[1] + 1, size + 1 + len(more), count))
    np.square(error, out=squares[:, :-1, :size])
    squares[:, :-1, size] = squares[:, :-1, :size].sum(axis=2)
    squares[:, -1, : size + 1] = squares[:, :-1, : size + 1][:, window].mean(axis=1)
    for k, (values, when) in enumerate(more.values(), size + 1):
        squares[:, :-1, k] = values[..., good]
        squares[:, -1, k] = squares[:, :-1, k][:, when].mean(axis=1) if when.any() else np.nan
    total = squares.sum(axis=-1)
    everything = total[:, :-1, :size] if everything is None else everything
    mean = total / max(count, 1)
    centred = squares
    centred -= mean[..., None]
    products = np.empty((len(mean), *mean.shape))
    for a, b in zip(*np.tril_indices(len(mean)), strict=True):
        products[a, b] = products[b, a] = np.einsum("jcN,jcN->jc", centred[a], centred[b])
    sums = [
        None if parts is None else [_sum(part, good, window) for part in parts]
        for parts in normalised
    ]
    return Tally(
        int(truth.sum()), count, mean, products, error.sum(axis=-1), everything,
        (astray & truth).sum(axis=1), sums, seconds, steps, tuple(more),
    )  # fmt: skip


def _sum(part, good, window):
    """Sums over the good paths of values (J, ..., N) and of what is expected of them."""
    if part is None:
        return None
    values, expected = part[0][..., good], part[1]
    expected = expected if np.isscalar(expected) else expected[..., good]
    known = ~np.isnan(values)
    values, expected = np.where(known, values, 0.0), np.where(known, expected, 0.0)
    paths = np.stack([values[window].sum(axis=0), expected[window].sum(axis=0)])
    products = np.einsum("a...N,b...N->ab...", paths, paths)
    counts = np.count_nonzero(known, axis=-1)
    return ErrorSums(
        values.sum(axis=-1), counts, expected.sum(axis=-1), paths.sum(axis=-1), products
    )


def merged(a: Any, b: Any) -> Tally:
    """Sums of two sets of blocks (Chan's update of means and products)."""
    share = b.count / max(a.count + b.count, 1)
    shift = b.mean - a.mean
    products = a.products + b.products + a.count * share * shift[:, None] * shift[None, :]
    normalised = [
        None
        if one is None
        else [
            None if s is None else ErrorSums(*(u + v for u, v in zip(s, t, strict=True)))
            for s, t in zip(one, two, strict=True)
        ]
        for one, two in zip(a.normalised, b.normalised, strict=True)
    ]
    sums = {name: getattr(a, name) + getattr(b, name) for name in SUMS}
    return a._replace(mean=a.mean + share * shift, products=products, normalised=normalised, **sums)
