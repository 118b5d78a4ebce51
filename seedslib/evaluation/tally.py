"""Sums of squared errors over blocks of paths, for several filters at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Tally(NamedTuple):
    """Sums over paths of one block; F filters, J times and their average, c components.

    After the squared errors of the components come their sum and, for a switching system,
    whether the mode was wrong: C = c + 1 or c + 2 numbers.
    """

    simulated: int  # paths whose truth is finite
    count: int  # of them those on which no filter diverged
    mean: np.ndarray  # (F, J + 1, C) of the squared errors
    products: np.ndarray  # (F, F, J + 1, C), centred
    error: np.ndarray  # (F, J, c) sums of the errors
    everything: np.ndarray  # (F, J, c) sums of the squares of all paths
    diverged: np.ndarray  # (F,)
    normalised: list[Any]  # for each filter sums and counts of NEES and NIS
    seconds: np.ndarray  # (F,) per block
    steps: int  # measurements times paths


SUMS = "simulated", "count", "error", "everything", "diverged", "seconds", "steps"
"""What is added up as it is."""


def tally(
    error: Any, good: Any, truth: Any, astray: Any, normalised: Any, seconds: float, steps: int, *,
    wrong: Any = None, window: Any = None,
) -> Tally:  # fmt: skip
    """Sums of one block.

    Parameters
    ----------
    error : ndarray, shape (F, J, c, N)
    good, truth : ndarray of bool, shape (N,)
        Paths without a divergence of any filter; paths whose truth is finite.
    astray : ndarray of bool, shape (F, N)
    normalised : list
        For each filter None or its squares of errors and innovations, see `consistency`.
    seconds : ndarray, shape (F,)
    steps : int
    wrong : ndarray, shape (F, J, N), optional
        One where the decided mode is wrong, NaN where none is decided.
    window : ndarray of bool, shape (J,), optional
        Times that are averaged, all by default.
    """
    everything = None
    if not good.all():
        with np.errstate(over="ignore", invalid="ignore"):
            everything = np.where(np.isnan(error), np.inf, error)[..., truth] ** 2
            everything = everything.sum(axis=-1)
        error = error[..., good]
    count, size = error.shape[-1], error.shape[2]
    squares = np.empty((len(error), error.shape[1] + 1, size + 1 + (wrong is not None), count))
    np.square(error, out=squares[:, :-1, :size])
    squares[:, :-1, size] = squares[:, :-1, :size].sum(axis=2)
    if wrong is not None:
        squares[:, :-1, -1] = wrong[..., good]
    squares[:, -1] = squares[:, :-1][:, slice(None) if window is None else window].mean(axis=1)
    total = squares.sum(axis=-1)
    everything = total[:, :-1, :size] if everything is None else everything
    mean = total / max(count, 1)
    centred = squares
    centred -= mean[..., None]
    products = np.empty((len(mean), *mean.shape))
    for a, b in zip(*np.tril_indices(len(mean)), strict=True):
        products[a, b] = products[b, a] = np.einsum("jcN,jcN->jc", centred[a], centred[b])
    sums = [None if pair is None else [_sum(part, good) for part in pair] for pair in normalised]
    return Tally(
        int(truth.sum()), count, mean, products, error.sum(axis=-1), everything,
        (astray & truth).sum(axis=1), sums, seconds, steps,
    )  # fmt: skip


def _sum(values, good):
    """Sums over the good paths, the numbers of those that are known, degrees of freedom."""
    if values is None:
        return None
    squares, freedom = values
    squares = squares[:, good]
    known = ~np.isnan(squares)
    return np.where(known, squares, 0.0).sum(axis=1), np.count_nonzero(known, axis=1), freedom


def merged(a: Any, b: Any) -> Tally:
    """Sums of two sets of blocks (Chan's update of means and products)."""
    share = b.count / max(a.count + b.count, 1)
    shift = b.mean - a.mean
    products = a.products + b.products + a.count * share * shift[:, None] * shift[None, :]
    normalised = [
        None
        if one is None
        else [
            None if s is None else (s[0] + t[0], s[1] + t[1], s[2])
            for s, t in zip(one, two, strict=True)
        ]
        for one, two in zip(a.normalised, b.normalised, strict=True)
    ]
    sums = {name: getattr(a, name) + getattr(b, name) for name in SUMS}
    return a._replace(mean=a.mean + share * shift, products=products, normalised=normalised, **sums)
