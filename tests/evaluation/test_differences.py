"""Derivatives by differences: exact where the terms that they leave out are zero."""

import numpy as np

from seedslib.evaluation.differences import derivatives


def test_of_a_quartic_all_are_exact():
    """No fifth derivatives, so that fourth order leaves nothing out but rounding."""
    rng = np.random.default_rng(1)
    linear, square = rng.normal(size=3), rng.normal(size=(3, 3))
    point, asked = np.array([0.3, -0.7, 1.1]), []

    def function(u):
        asked.append(u.shape)
        return linear @ u + np.einsum("iN,ij,jN->N", u, square, u) + u[0] ** 3 * u[1]

    found = derivatives(function, point, [0, 2], True)
    x, y, _ = point
    slopes = linear + (square + square.T) @ point + [3 * x**2 * y, x**3, 0.0]
    bend = square + square.T + np.diag([6 * x * y, 0.0, 0.0])
    np.testing.assert_allclose(found.value, function(point[:, None])[0], rtol=1e-14)
    np.testing.assert_allclose(found.slopes, slopes[[0, 2]], rtol=1e-11)
    np.testing.assert_allclose(found.bend, bend[np.ix_([0, 2], [0, 2])], atol=1e-8)
    assert asked[0] == (3, 9 + 24)
    plain = derivatives(function, point, [1], False)
    np.testing.assert_allclose(plain.slopes, slopes[[1]], rtol=1e-11)
    assert plain.bend is None
