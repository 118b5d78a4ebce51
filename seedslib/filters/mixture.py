"""Moments of a mixture of weighted laws."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Mixture(NamedTuple):
    """Mass, mean and covariance of several weighted laws together."""

    mass: np.ndarray
    mean: np.ndarray
    cov: np.ndarray


def mix(mass: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> Mixture:
    """Moments of a mixture, in centred form: no digits are lost far from the origin.

    Parameters
    ----------
    mass : ndarray, shape (P, *batch)
    mean : ndarray, shape (d, P, *batch)
    cov : ndarray, shape (d, d, P, *batch)
        Moments of parts without mass are not looked at.

    Returns
    -------
    Mixture
        Of no mass: mean zero and unit covariance, which nothing depends on.
    """
    empty = mass <= 0  # rules with negative weights give negative masses
    if empty.any():
        mass, mean, cov = (np.where(empty, 0.0, part) for part in (mass, mean, cov))
        total = mass.sum(axis=0)
        none = total == 0
        share = mass / np.where(none, 1.0, total)
    else:
        total = mass.sum(axis=0)
        none, share = None, mass / total
    middle = (share * mean).sum(axis=1)
    apart = mean - middle[:, None]
    weighted = share * apart
    spread = (share * cov).sum(axis=2)
    for i in range(len(mean)):
        for j in range(i + 1):
            between = (weighted[i] * apart[j]).sum(axis=0)
            spread[i, j] += between
            if j < i:
                spread[j, i] += between
    if none is not None and none.any():
        unit = np.eye(len(mean)).reshape(len(mean), len(mean), *(1,) * none.ndim)
        spread = np.where(none, unit, spread)
    return Mixture(total, middle, spread)
