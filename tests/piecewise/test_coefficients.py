"""Coefficients of the cells: shapes that are taken and refused, and the maps that they make."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from seedslib.piecewise import PiecewiseLinearSystem
from seedslib.piecewise.cells import Intervals, line_cells
from seedslib.piecewise.coefficients import affine_map, as_coefficients

INF = np.inf
CELLS = Intervals([-INF, 0.0, 1.0, INF])


def test_arrays_with_and_without_axes_of_cells_and_data_sets():
    rng = np.random.default_rng(0)
    offset, matrix, noise = (rng.standard_normal(s) for s in ((2,), (2, 4, 3), (2, 5, 3, 6)))
    c = as_coefficients("sensor", (offset, matrix, noise), 3, 4, None)
    assert (c.offset.shape, c.matrix.shape) == ((2, 3, 1), (2, 4, 3, 1))
    assert c.noise.shape == (2, 5, 3, 6)
    for i in range(3):
        assert (c.offset[:, i, 0] == offset).all()
        assert (c.matrix[:, :, i, 0] == matrix[:, :, i]).all()
    assert (c.noise == noise).all()
    plain = as_coefficients("dynamics", ([1.0], [[2.0]], np.zeros((1, 0))), 3, 1, 1)
    assert plain.noise.shape == (1, 0, 3, 1)
    assert plain.matrix.tolist() == [[[[2.0], [2.0], [2.0]]]]


ONE = np.ones


@pytest.mark.parametrize(
    ("parts", "rows", "message"),
    [
        ((ONE(2), ONE((2, 4))), None, "sensor: wanted an offset, a matrix and a noise, got Non"),
        ((ONE(2), None, ONE((2, 1))), None, "sensor: wanted an offset, a matrix and a noise, got"),
        (
            (ONE(2), ONE((2, 3)), ONE((2, 1))), None,
            r"sensor \(matrix\): wanted shape \(2, 4\) and the cells, got \(2, 3\)$",
        ),
        (
            (ONE(2), ONE((3, 4)), ONE((2, 1))), None,
            r"sensor \(matrix\): wanted shape \(2, 4\) and the cells, got \(3, 4\)$",
        ),
        (
            (ONE(2), ONE((2, 4)), ONE((3, 1))), None,
            r"sensor \(noise\): wanted shape \(2, 1\) and the cells, got \(3, 1\)$",
        ),
        (
            (ONE(2), ONE((2, 4)), ONE(2)), None,
            r"sensor \(noise\): wanted shape \(2, -1\) and the cells, got \(2,\)$",
        ),
        (
            (ONE(2), ONE((2, 4)), ONE((2, 1))), 4,
            r"sensor \(offset\): wanted shape \(4,\) and the cells, got \(2,\)$",
        ),
        (
            (1.0, ONE((1, 4)), ONE((1, 1))), 1,
            r"sensor \(offset\): wanted shape \(1,\) and the cells, got \(\)$",
        ),
        ((1.0, ONE((1, 4)), ONE((1, 1))), None, r"sensor \(offset\): wanted shape"),
        (
            (ONE((2, 3, 1, 1)), ONE((2, 4)), ONE((2, 1))), None,
            r"sensor \(offset\): wanted shape \(2,\) and the cells, got \(2, 3, 1, 1\)$",
        ),
        (
            (ONE((2, 5)), ONE((2, 4)), ONE((2, 1))), None,
            r"sensor \(offset\): wanted 3 cells along axis 1, got shape \(2, 5\)$",
        ),
        (
            (ONE(2), ONE((2, 4, 1)), ONE((2, 1))), None,
            r"sensor \(matrix\): wanted 3 cells along axis 2, got shape \(2, 4, 1\)$",
        ),
        ((ONE(2), ONE((2, 4)), ONE((2, 1)) * np.nan), None, r"sensor \(noise\): wanted finite n"),
        ((ONE(2) * INF, ONE((2, 4)), ONE((2, 1))), None, r"sensor \(offset\): wanted finite numb"),
    ],
)  # fmt: skip
def test_shapes_that_are_refused(parts, rows, message):
    with pytest.raises(ValueError, match=message):
        as_coefficients("sensor", parts, 3, 4, rows)


def test_a_map_takes_the_coefficients_of_its_time_and_of_the_cell():
    """Value, mean, covariance and density against the matrices of each cell."""
    rng = np.random.default_rng(1)
    arrays = [rng.standard_normal(s) for s in ((2, 3), (2, 2, 3), (2, 3, 3))]

    def coefficients(t):
        scale = {2.0: 1.0, 5.0: -0.5}[t]
        return as_coefficients("dynamics", (arrays[0], scale * arrays[1], arrays[2]), 3, 2, 2)

    map_ = affine_map(CELLS, 2, coefficients, 2.0)
    x = np.array([[-0.5, 0.0, 0.7, 1.0], [3.0, -2.0, 1.0, 0.5]])
    v, y = rng.standard_normal((3, 4)), rng.standard_normal((2, 4))
    y[0, 1] = np.nan
    mean, cov = map_.conditional_moments(5.0, x)
    value, density = map_.value(5.0, x, v), map_.log_density(5.0, y, x)
    for n, i in enumerate([0, 1, 1, 2]):
        a, A, G = arrays[0][:, i], -0.5 * arrays[1][:, :, i], arrays[2][:, :, i]
        center = a + A @ x[:, n]
        np.testing.assert_allclose(mean[:, n], center, rtol=1e-14)
        np.testing.assert_allclose(value[:, n], center + G @ v[:, n], rtol=1e-13)
        np.testing.assert_allclose(cov[:, :, n], G @ G.T, rtol=1e-13)
        seen = np.flatnonzero(np.isfinite(y[:, n]))
        law = multivariate_normal(center[seen], (G @ G.T)[np.ix_(seen, seen)])
        np.testing.assert_allclose(density[n], law.logpdf(y[seen, n]), rtol=1e-12)
    alone = map_.value(5.0, x[:, 2], v[:, 2])
    np.testing.assert_allclose(alone, value[:, 2], rtol=1e-14)
    np.testing.assert_allclose(map_.log_density(5.0, y[:, 2], x[:, 2]), density[2], rtol=1e-13)
    table = map_.value(5.0, x.reshape(2, 2, 2), v.reshape(3, 2, 2))
    np.testing.assert_allclose(table.reshape(2, 4), value, rtol=1e-14)


def system(**changes):
    parts = {
        "regions": [-INF, 0.0, INF], "dynamics": lambda t: ([1.0, 0.0], t * np.eye(2)),
        "sensor": lambda t: ([0.5] * int(t), np.full((int(t), 2), 2.0)),
        "sensor_noise": lambda t: np.eye(int(t)), "noise": lambda t: [[0.0], [t]],
        "mean0": [0.3, 0.4], "cov0": np.eye(2),
    }  # fmt: skip
    return PiecewiseLinearSystem(**(parts | changes))


def test_sizes_of_a_system_of_functions_of_time():
    """The sensor has as many components as its time says."""
    found = system()
    assert (found.state_size, found.measurement_size) == (2, 1)
    assert found.sensor_at(3.0).offset.shape == (3, 2, 1)
    assert found.dynamics_at(4.0).noise[1, 0].tolist() == [[4.0], [4.0]]
    assert found.dynamics_at(4.0).matrix[1, 1].tolist() == [[4.0], [4.0]]
    pair = found.discrete(times=(0.0, 2.0))
    assert pair.sensor.value(2.0, np.array([1.0, 2.0]), np.zeros(2)).tolist() == [6.5, 6.5]
    assert found.discrete().sensor.value(1.0, np.array([1.0, 2.0]), np.zeros(1)).tolist() == [6.5]
    assert pair.dynamics.value(3.0, np.array([1.0, 2.0]), np.ones(1)).tolist() == [4.0, 9.0]


def test_constant_coefficients_are_checked_when_a_system_is_made():
    with pytest.raises(ValueError, match=r"dynamics \(offset\): wanted shape \(2,\)"):
        system(dynamics=([1.0], np.eye(2)), noise=None)
    with pytest.raises(ValueError, match=r"sensor \(matrix\): wanted shape \(1, 2\)"):
        system(sensor=([1.0], np.eye(2)), sensor_noise=[[1.0]])
    later = system(dynamics=([1.0], np.eye(2)))  # a function of time is asked when it is needed
    with pytest.raises(ValueError, match=r"dynamics \(offset\): wanted shape \(2,\)"):
        later.dynamics_at(0.0)
    later = system(sensor=([1.0], np.eye(2)))
    with pytest.raises(ValueError, match=r"sensor \(matrix\): wanted shape \(1, 2\)"):
        later.sensor_at(1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mean0": [[0.3, 0.4]]}, r"mean0: wanted 1 axes, got shape \(1, 2\)$"),
        ({"mean0": [0.3, np.nan]}, "mean0: wanted finite numbers"),
        ({"cov0": [[1.0, np.inf], [0.0, 1.0]]}, "cov0: wanted finite numbers"),
        ({"cov0": np.eye(3)}, "mean0, cov0: wanted shapes"),
        ({"cov0": np.diag([1.0, -1.0])}, "cov0: wanted a positive semidefinite"),
        ({"cov0": [[1.0, 0.5], [0.0, 1.0]]}, "cov0: wanted a symmetric"),
        (
            {"mean0": [0.3], "cov0": [[1.0]],
             "regions": [np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])]},
            "regions: wanted cells that cover the plane",
        ),
    ],
)  # fmt: skip
def test_priors_that_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        system(**changes)


def test_a_plane_needs_a_state_of_two_components():
    told = "mean0: wanted at least 2 components for these regions, got 1$"
    with pytest.raises(ValueError, match=told):
        system(regions=line_cells([[1.0], [0.0]], [0.0]), mean0=[0.3], cov0=[[1.0]])
