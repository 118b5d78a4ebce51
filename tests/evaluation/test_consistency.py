"""Normalised squares of errors, singular covariances among them."""

import numpy as np

from seedslib.evaluation.consistency import mahalanobis


def test_singular_covariances_are_met_on_their_range():
    """Errors u c with covariance u uᵀ have the square c², whatever rounding does to u uᵀ."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal((3, 50)) * np.array([[1.0], [1e3], [1e-3]])
    c = rng.standard_normal(50)
    cov = np.einsum("iN,jN->ijN", u, u)[None]
    error = (u * c)[None]
    for turn in range(20):
        noise = 1 + 1e-16 * rng.standard_normal((3, 3, 50)) * turn
        noise = 0.5 * (noise + np.swapaxes(noise, 0, 1))
        squares, freedom = mahalanobis(error, cov * noise)
        np.testing.assert_allclose(squares[0], c**2, rtol=1e-9)
    assert freedom == 3


def test_regular_and_unknown_ones_stand_side_by_side():
    rng = np.random.default_rng(1)
    half = rng.standard_normal((2, 2))
    cov = np.stack([half @ half.T, np.full((2, 2), np.nan), np.zeros((2, 2))], axis=-1)[None]
    error = rng.standard_normal((1, 2, 3))
    squares, _ = mahalanobis(error, cov)
    right = error[0, :, 0] @ np.linalg.inv(half @ half.T) @ error[0, :, 0]
    np.testing.assert_allclose(squares[0, 0], right, rtol=1e-10)
    assert np.isnan(squares[0, 1])
    assert squares[0, 2] == 0.0
