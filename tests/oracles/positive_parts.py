"""Mean of a product of positive parts: an oracle of the tests, with one kink in each factor."""

import numpy as np
from scipy.special import ndtr

from seedslib.gaussian import bivariate_normal_cdf
from seedslib.gaussian.errors.bivariate import FAR, density


def positive_part_product(h, k, rho):
    """Mean of ``(X + h)⁺ (Y + k)⁺`` for standard normals with correlation rho."""
    h, k, rho = np.broadcast_arrays(*(np.asarray(part, dtype=float) for part in (h, k, rho)))
    # with one factor a hundred standard deviations below zero the product underflows
    some = np.minimum(h, k) > -FAR
    product = _product(np.where(some, h, 0.0), np.where(some, k, 0.0), rho)
    return np.where(some, product, 0.0)[()]


def _product(h, k, rho):
    root = np.sqrt((1.0 - rho) * (1.0 + rho))
    regular = root > 0
    safe = np.where(regular, root, 1.0)
    to_k, to_h = (k - rho * h) / safe, (h - rho * k) / safe
    product = (
        (rho + h * k) * bivariate_normal_cdf(h, k, rho)
        + k * density(h) * ndtr(to_k)
        + h * density(k) * ndtr(to_h)
        + root * density(h) * density(to_k)
    )
    low, high = np.minimum(h, k), np.maximum(h, k)
    same = (h * k + 1.0) * ndtr(low) + high * density(low)
    mass = np.maximum(0.0, ndtr(low) - ndtr(-high))
    opposite = (h * k - 1.0) * mass + low * density(high) + high * density(low)
    opposite = np.where(low + high > 0, opposite, 0.0)
    limit = np.where(rho > 0, same, opposite)
    return np.maximum(np.where(regular, product, limit), 0.0)
