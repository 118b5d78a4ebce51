"""Means of the derivatives of a polynomial map, as multi-indices and as symmetric tensors."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from math import factorial, prod

import numpy as np

from seedslib.gaussian.means.polynomial import Index, monomial_means


def factorial_of(index: Index) -> int:
    """``beta! = prod beta_i!``."""
    return prod(map(factorial, index))


def mean_derivatives(
    polynomial: Mapping[Index, np.ndarray], mean: np.ndarray, cov: np.ndarray
) -> dict[Index, np.ndarray]:
    """``E (d/dx)^beta f`` (p,) for every multi-index beta that does not annihilate f."""
    splits = [
        (alpha, beta, tuple(a - b for a, b in zip(alpha, beta, strict=True)))
        for alpha in polynomial
        for beta in product(*(range(k + 1) for k in alpha))
    ]
    means = monomial_means(dict.fromkeys(rest for *_, rest in splits), mean, cov)
    result: dict[Index, np.ndarray] = {}
    for alpha, beta, rest in splits:
        weight = factorial_of(alpha) // factorial_of(rest)
        result[beta] = result.get(beta, 0.0) + weight * means[rest] * polynomial[alpha]
    return result


MOST_AXES, MOST_ENTRIES = 63, 10**8
"""Of a tensor of derivatives."""


def contracted(means: Mapping[Index, np.ndarray], order: int, factor: np.ndarray) -> np.ndarray:
    """Symmetric tensor ``E grad^k f`` with every axis contracted with the factor."""
    size = factor.shape[0]
    values = len(next(iter(means.values())))
    if order > MOST_AXES or values * size**order > MOST_ENTRIES:
        raise ValueError(f"f: wanted a polynomial of lower degree, got {order} in {size} variables")
    tensor = np.zeros((values, *(size,) * order))
    # a multi-index and the axes of a tensor entry meet in one code: digit i counts the axes i
    digits = (order + 1) ** np.arange(size)
    codes = digits[np.indices((size,) * order).reshape(order, size**order)].sum(axis=0)
    flat = tensor.reshape(values, -1)
    wanted = {int(np.dot(digits, beta)): m for beta, m in means.items() if sum(beta) == order}
    present, place = np.unique(codes, return_inverse=True)
    table = np.array([wanted.get(int(code), np.zeros(values)) for code in present])
    flat[:] = table[place].T
    for _ in range(order):
        # contracting the first tensor axis moves it to the end: after `order` turns all are done
        tensor = np.tensordot(tensor, factor, axes=(1, 0))
    return tensor
