"""Linear to quartic forms by matrices: means by quadrature, errors by the sum over terms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from oracles.gaussian import hermite_mean, random_dist
from seedslib.gaussian import forms


def form(M, x):
    return np.einsum("i...,ij,j...->...", x, M, x)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_means_of_forms_match_quadrature_in_batches(n):
    """Matrices that are not symmetric; three nodes are exact to the fifth degree."""
    rng = np.random.default_rng(n)
    A, B = rng.normal(size=(2, n, n))
    flat = rng.normal(size=(3, n))
    dists = [random_dist(rng, n) for _ in range(2)]
    means = np.stack([mean for mean, _ in dists], axis=-1)
    covs = np.stack([cov for _, cov in dists], axis=-1)
    for found, f in [
        (forms.linear_mean(flat, means, covs), lambda *x: flat[1] @ np.array(x)),
        (forms.quadratic_mean(A, means, covs), lambda *x: form(A, np.array(x))),
        (
            forms.cubic_mean(flat, B, means, covs),
            lambda *x: (flat[1] @ np.array(x)) * form(B, np.array(x)),
        ),
        (
            forms.quartic_mean(A, B, means, covs),
            lambda *x: form(A, np.array(x)) * form(B, np.array(x)),
        ),
    ]:
        of_row = found[1] if found.ndim == 2 else found
        exact = [hermite_mean(f, *dist, 3) for dist in dists]
        assert_allclose(of_row, exact, rtol=1e-11, atol=1e-11)
    shared = forms.quartic_mean(A, B, means, covs[..., 0])
    assert shared[0] == pytest.approx(forms.quartic_mean(A, B, means, covs)[0], rel=1e-12)
