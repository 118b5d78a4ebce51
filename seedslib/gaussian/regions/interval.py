"""Moments of a scalar Gaussian law over an interval, accurate in tails and narrow intervals."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real
from seedslib.gaussian.arguments import as_bound, blockwise, variance_argument
from seedslib.gaussian.regions.nodes import flat_interval
from seedslib.gaussian.regions.regions import RegionMoments

_BLOCK = 16384  # intervals at a time


def interval(
    mean: ArrayLike, var: ArrayLike, lower: ArrayLike, upper: ArrayLike, about: ArrayLike = 0.0
) -> RegionMoments:
    """Mass, mean and variance of a scalar Gaussian law over the interval (lower, upper).

    The literal formulas (Kolessa, lemma 2) subtract nearly equal numbers in tails and narrow
    intervals; here positive sums around the peak of the density are taken instead. Errors, in
    tails down to ``ln P = -1e8``, in intervals of any width: ``ln P`` to 1e-15 ``max(1, |ln P|)``,
    mean to 2e-14 standard deviations of the conditioned law (or to the last bits of the number
    itself), variance to 2e-14 relative.

    Parameters
    ----------
    mean, var : array_like
        Mean and variance of the law; ``var = 0`` (a point) is legal.
    lower, upper : array_like
        Ends of the interval, ``lower <= upper``; infinite ends are legal. The interval is
        half-open, ``lower <= x < upper``, which matters only where ``var = 0``.
    about : array_like
        Reference point of the second moment `RegionMoments.second`.

    All arguments are broadcast against each other.

    Returns
    -------
    RegionMoments
        Arrays of the broadcast shape. An interval of zero mass has ``log_mass = -inf`` and NaN
        mean and variance.

    Raises
    ------
    TypeError
        An argument is not made of real numbers.
    ValueError
        A NaN, an infinite `mean`, `var` or `about`, a negative `var`, ``lower > upper``, or
        shapes that do not broadcast.
    """
    mean, var = as_real("mean", mean), variance_argument("var", var)
    lower, upper = as_bound("lower", lower), as_bound("upper", upper)
    try:
        flat = np.broadcast_arrays(mean, var, lower, upper)
    except ValueError as error:
        raise ValueError(
            "mean, var, lower, upper: wanted shapes that broadcast, got "
            f"{mean.shape}, {var.shape}, {lower.shape}, {upper.shape}"
        ) from error
    if (lower > upper).any():
        raise ValueError("lower: wanted lower <= upper, got an interval with lower > upper")
    shape, flat = flat[0].shape, [item.ravel() for item in flat]
    found = blockwise(
        lambda block: flat_interval(*(item[block] for item in flat)), flat[0].size, _BLOCK
    )
    return RegionMoments(*(part.reshape(shape)[()] for part in found)).referred_to(about)
