"""Covariances after very sharp measurements, against rational arithmetic."""

import numpy as np
import pytest
import sympy as sp

from seedslib.piecewise.precision import gram, sharpened


def exact(root, sensor, noise, seen):
    """(P^-1 + B' R^-1 B)^-1 in rational numbers, for the components that are seen."""
    root, sensor, noise = (
        sp.Matrix(*part.shape, [sp.Rational(x) for x in part.ravel().tolist()])
        for part in (root, sensor, noise)
    )
    cov, rows = root * root.T, [i for i, is_seen in enumerate(seen) if is_seen]
    sensor, noise = sensor.extract(rows, range(sensor.cols)), noise.extract(rows, range(noise.cols))
    spread = sensor * cov * sensor.T + noise * noise.T
    left = cov - cov * sensor.T * spread.inv() * sensor * cov
    return np.array(left.tolist(), dtype=float)


def setting(branches=2, depth=1, size=1e-7, rows=2):
    rng = np.random.default_rng(5)
    root = rng.integers(-8, 9, (3, 3, branches, depth)) / 4.0 + 3.0 * np.eye(3)[:, :, None, None]
    sensor = rng.integers(-8, 9, (rows, 3, branches, depth)) / 4.0
    noise = size * (rng.integers(-8, 9, (rows, 2, branches, depth)) / 8.0 + np.eye(rows, 2)[
        :, :, None, None])  # fmt: skip
    innovation = gram(np.einsum("ij...,jk...->ik...", sensor, root)) + gram(noise)
    return root, sensor, noise, innovation


def call(cov, parts, y):
    root, sensor, noise, innovation = parts
    return sharpened(cov, root, sensor, noise, innovation, y)


def close(found, wanted):
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    np.testing.assert_allclose(found / scale, wanted / scale, atol=1e-7)


def test_a_gram_matrix_is_the_root_times_its_transpose_and_symmetric():
    root = np.random.default_rng(0).standard_normal((3, 2, 4, 5))
    found = gram(root)
    np.testing.assert_allclose(found[..., 1, 2], root[..., 1, 2] @ root[..., 1, 2].T, rtol=1e-14)
    assert (found == np.swapaxes(found, 0, 1)).all()


@pytest.mark.parametrize("missing", [None, 0, 1])
def test_covariances_common_to_all_data_sets_are_rebuilt(missing):
    parts, y = setting(), np.zeros((2, 4))
    if missing is not None:
        y[missing] = np.nan
    found = call(np.full((3, 3, 2, 1), 7.0), parts, y)
    seen = [missing != 0, missing != 1]
    for b in range(2):
        root, sensor, noise = (part[:, :, b, 0] for part in parts[:3])
        close(found[:, :, b, 0], exact(root, sensor, noise, seen))


def test_every_data_set_misses_its_own_components():
    parts = setting(depth=3)
    y = np.array([[0.0, np.nan, 1.0], [2.0, 0.0, np.nan]])
    found = call(np.full((3, 3, 2, 3), 7.0), parts, y)
    for b in range(2):
        for n in range(3):
            root, sensor, noise = (part[:, :, b, n] for part in parts[:3])
            close(found[:, :, b, n], exact(root, sensor, noise, np.isfinite(y[:, n])))


def test_parts_that_all_data_sets_share_are_used_for_each():
    root, sensor, noise, innovation = setting()
    found = call(np.full((3, 3, 2, 2), 7.0), (root, sensor, noise, innovation), np.zeros((2, 2)))
    for n in range(2):
        close(
            found[:, :, 1, n], exact(root[..., 1, 0], sensor[..., 1, 0], noise[..., 1, 0], [1, 1])
        )


def test_nothing_is_measured_nothing_is_learned():
    root, sensor, noise, innovation = setting()
    found = call(
        np.full((3, 3, 2, 1), 7.0), (root, sensor, noise, innovation), np.full((2, 1), np.nan)
    )
    np.testing.assert_allclose(found, gram(root), rtol=1e-13)


@pytest.mark.parametrize("rows", [1, 2])
def test_only_noise_below_a_millionth_of_the_volume_counts_as_sharp(rows):
    """Determinants of the noise and of the whole are compared, branch by branch."""
    root, sensor, noise, _ = setting(rows=rows)
    volume = np.linalg.det(np.moveaxis(gram(noise), (0, 1), (-2, -1)))
    innovation = np.eye(rows)[:, :, None, None] * (volume * 1e6) ** (1 / rows)
    cov = np.full((3, 3, 2, 1), 7.0)
    blunt = innovation * (1 - 1e-9)
    assert call(cov, (root, sensor, noise, blunt), np.zeros((rows, 1))) is cov
    blunt[..., 1, :] *= 1 + 2e-9
    found = call(cov, (root, sensor, noise, blunt), np.zeros((rows, 1)))
    assert (found[:, :, 0] == 7.0).all()
    close(
        found[:, :, 1, 0], exact(root[..., 1, 0], sensor[..., 1, 0], noise[..., 1, 0], [1] * rows)
    )
    assert (cov == 7.0).all()


def test_one_branch_beyond_the_range_of_floats_leaves_the_others_sharp():
    root, sensor, noise, innovation = setting()
    root[..., 0, :] *= 1e200
    with np.errstate(over="ignore", invalid="ignore"):
        found = call(
            np.full((3, 3, 2, 1), 7.0), (root, sensor, noise, innovation), np.zeros((2, 1))
        )
    assert (found[:, :, 0] == 7.0).all()
    close(found[:, :, 1, 0], exact(root[..., 1, 0], sensor[..., 1, 0], noise[..., 1, 0], [1, 1]))
