"""The piecewise-linear filter in a plane: against the product of two lines, and the line."""

import numpy as np
import pytest

from oracles.piecewise import TIMES, lozi, plane_posterior, plane_system, records, tent
from seedslib.piecewise import PiecewiseLinearFilter, PiecewiseLinearSystem, line_cells

FIELDS = "mean", "cov", "loglik", "mode_prob"


def test_a_product_of_two_lines_in_oblique_coordinates():
    """Four cells, a third state with noise; everything varies with time, records have gaps."""
    system = plane_system()
    y, filter_ = records(system, 4), PiecewiseLinearFilter(system)
    found = filter_.run(TIMES, y.reshape(5, 2, 2, 2))
    for n in range(3):
        for field, wanted in zip(FIELDS, plane_posterior(y[..., n]), strict=True):
            part = getattr(found, field)[(..., *divmod(n, 2))]
            np.testing.assert_allclose(part, wanted, rtol=1e-10, atol=1e-11, err_msg=field)
    state, wanted = filter_.initial(), plane_posterior(y[..., 2])
    for k, t in enumerate(TIMES[:4]):  # the first, the third and the fourth time are only predicted
        state = filter_.predict(state, t)
        if k == 1:
            state = filter_.correct(state, y[k, :, 2])
        for field, part in zip(FIELDS, wanted, strict=True):
            np.testing.assert_allclose(getattr(state, field), part[k], rtol=1e-10, atol=1e-11)


def test_more_cells_with_the_same_coefficients_change_nothing():
    """Three lines, seven cells and a number without one, in place of two."""
    fine = line_cells([[1.0, 0.3, 0.0], [0.0, 1.0, 1.0]], [0.0, 0.2, -0.3])
    left = np.arange(8) < 4
    coarse = lozi()
    A = np.asarray(coarse.dynamics[1])
    split = PiecewiseLinearSystem(
        fine,
        (coarse.dynamics[0], A[:, :, np.where(left, 0, 1)]),
        coarse.sensor,
        coarse.sensor_noise,
        coarse.mean0,
        coarse.cov0,
    )
    y = coarse.simulate(3, 3, 8).measurements
    one, other = (PiecewiseLinearFilter(s).run(3, y) for s in (coarse, split))
    for field in FIELDS[:3]:
        np.testing.assert_allclose(getattr(one, field), getattr(other, field), atol=1e-11)
    halves = [other.mode_prob[:, left == side].sum(axis=1) for side in (True, False)]
    np.testing.assert_allclose(one.mode_prob, np.stack(halves, axis=1), atol=1e-11)


@pytest.mark.parametrize("slopes", [(1.8, -1.8), (0.0, 0.5)])
def test_a_map_of_rank_one_in_the_plane_agrees_with_the_line(slopes):
    """x moves alone, and z = x / 2 follows it or not; where x collapses, so does the plane."""
    line = tent(dynamics=([[1.0, 0.4]], [[slopes]]))
    rows = np.array([slopes, [0.5 * (s != 0) for s in slopes]])
    plane = PiecewiseLinearSystem(
        line_cells([[1.0], [0.0]], [0.0]),
        ([[1.0, 0.4], [0.0, 0.0]], np.stack([rows, 0 * rows], 1)),
        ([[0.0, 0.0]], [[[-1.0, 1.0], [0.0, 0.0]]]),
        [[0.2]],
        [0.1, 0.3],
        [[0.25, 0.1], [0.1, 0.5]],
    )
    y = line.simulate(4, 3, 2).measurements
    one, other = (PiecewiseLinearFilter(s).run(4, y) for s in (line, plane))
    np.testing.assert_allclose(other.mean[:, :1], one.mean, atol=1e-10)
    np.testing.assert_allclose(other.cov[:, :1, :1], one.cov, atol=1e-10)
    np.testing.assert_allclose(other.loglik, one.loglik, atol=1e-10)
    np.testing.assert_allclose(other.mode_prob, one.mode_prob, atol=1e-10)


@pytest.mark.parametrize("spread", [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])
def test_a_start_that_is_known_in_some_direction(spread):
    """Of the Lozi map, against a sum over the other component; and of the tent map."""
    base, y = lozi(), [0.6, -0.2, 0.4]
    system = PiecewiseLinearSystem(
        base.regions, base.dynamics, base.sensor, base.sensor_noise, base.mean0, np.diag(spread)
    )
    line = tent(cov0=[[spread[0]]])
    for case, power in ((system, 1), (line, 0)):
        found = PiecewiseLinearFilter(case).run(3, np.r_[np.nan, y][:, None])
        step = np.linspace(-8.0, 8.0, 200_001) if any(spread) else np.zeros(1)
        x, z = (0.1 + np.sqrt(part) * step for part in spread)
        weight = np.exp(-0.5 * step**2) / np.exp(-0.5 * step**2).sum()
        slope, sd = (1.7, 0.3) if power else (1.8, 0.2)
        for t, value in enumerate(y, start=1):
            x, z = 1 - slope * np.abs(x) + power * z, 0.5 * x
            density = np.exp(-0.5 * ((value - (x if power else np.abs(x))) / sd) ** 2) / sd
            total = (weight * density).sum()
            weight = weight * density / total
            states = np.stack([x, z])[: len(case.mean0)]
            np.testing.assert_allclose(found.mean[t], states @ weight, atol=1e-7)
            loglik = np.log(total / np.sqrt(2 * np.pi))
            assert found.loglik[t] == pytest.approx(loglik, abs=1e-7)
