"""Conditionally minimax designs: the regressions by hand, known errors, and their ranges."""

import numpy as np
import pytest
import sympy

from oracles.linear import kalman
from seedslib.base import ELAPSED
from seedslib.design import BoundedPolynomial, grid_risk, minimax_synthesis
from seedslib.designed import Memory
from seedslib.models import DiscreteSystem, Noise, StochasticMap
from systems import EVEN, discrete_system, linear_numbers

x, v, w = sympy.symbols("x v w", real=True)
TIMES = np.arange(26.0)


def cubic_sensor():
    return DiscreteSystem(
        StochasticMap((x,), [x / (1 + x**2) + w], Noise((w,), cov=[[1]])),
        StochasticMap((x,), [x**3 + x + v], Noise((v,), cov=[[1]])),
        [0.1],
        [[1.16]],
    )


def root(t, forecast, y):
    """The cube root less the prediction, and the residual in units of the sensor's slope."""
    scaled = (y - forecast**3 - forecast) / (1 + 3 * forecast**2)
    return np.concatenate([np.cbrt(y) - forecast, scaled])


@pytest.fixture(scope="module")
def cubic():
    return cubic_sensor()


def by_hand(cubic, times, paths, seed, correction):
    """The recursion of Pankov and Bosov by least squares on the same paths."""
    streams = np.random.SeedSequence(seed).spawn(3)
    sets = [cubic.simulate(times, paths, stream) for stream in streams[:2]]
    found, z = [], [None, None]
    for k in range(len(times)):
        own, fits = k % 2, []
        for which in (own, 1 - own):
            state, y = sets[which].states[k, 0], sets[which].measurements[k, 0]
            if k == 0:
                ahead = np.full(paths, 0.1)
            else:
                xi = np.stack([np.ones(paths), z[which] / (1 + z[which] ** 2)], axis=1)
                if which == own:
                    fits.append(np.linalg.lstsq(xi, state, rcond=None)[0])
                ahead = xi @ fits[0]
            if correction is None:
                zeta = (y - ahead**3 - ahead)[None]
            else:
                zeta = correction(times[k], ahead[None], y[None])
            zeta = np.stack([np.ones(paths), *zeta], axis=1)
            if which == own:
                fits.append(np.linalg.lstsq(zeta, state - ahead, rcond=None)[0])
            z[which] = ahead + zeta @ fits[-1]
        found.append([fit.tolist() for fit in fits])
    last = len(times) % 2
    return found, np.mean((sets[last].states[-1, 0] - z[last]) ** 2)


@pytest.mark.parametrize(("correction", "paths"), [(None, 9000), (root, 600)])
def test_fits_are_the_two_regressions_of_each_measurement(cubic, correction, paths):
    """With more than one block of paths, and with basic functions of one's own."""
    made = minimax_synthesis(
        cubic, Memory(1), TIMES[:5], paths=paths, seed=3, correction=correction
    )
    wanted, error = by_hand(cubic, TIMES[:5], paths, 3, correction)
    for fit, parts in zip(made.fits, wanted, strict=True):
        rows = [[*part.offset, *part.gain[0]] for part in (fit.forecast, fit.correction)]
        for one, two in zip(rows[2 - len(parts) :], parts, strict=True):
            np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(made.covariances[-1, 0, 0], error, rtol=1e-9)
    np.testing.assert_allclose(made.predicted.rms[:, 0] ** 2, made.covariances[:, 0, 0])


def test_predicted_errors_are_those_of_the_dist_of_other_paths_and_of_another_program(cubic):
    """The distribution of state and memory on a grid; 0.2001 of another program's 20 000 paths."""
    made = minimax_synthesis(cubic, Memory(1), TIMES[:12], paths=12_000, seed=1, correction=root)
    risk = grid_risk(made, x=(-5.6, 5.6, 141), z=(-8, 8, 161), y=(-190, 190, 761))
    apart = made.predicted.rms[:, 0] - np.sqrt(risk.mse)
    assert (np.abs(apart) < 4.0 * made.predicted.error[:, 0]).all()
    data = cubic.simulate(TIMES[:12], 12_000, 7)
    square = (made.run(data.times, data.measurements).mean - data.states)[6:, 0] ** 2
    doubt = square.mean(axis=0).std() / np.sqrt(12_000)
    assert abs(square.mean() - 0.2001) < 4.0 * doubt + 0.001
    assert abs(made.covariances[6:].mean() - square.mean()) < 5.0 * doubt


def test_design_of_a_linear_system_is_the_kalman_filter():
    """Time-varying and without inputs, so that the means of the noises are all there is."""
    system = discrete_system(inputs=False)
    made = minimax_synthesis(system, Memory(1), EVEN[:5], paths=20_000, seed=2)
    y = system.simulate(EVEN[:5], 20, 5).measurements
    found = made.run(EVEN[:5], y, covariances=True)
    model = linear_numbers(EVEN[:5], None)
    wanted = [kalman(model, record) for record in np.moveaxis(y, 2, 0)]
    scale = np.sqrt(np.diagonal(wanted[0].cov, axis1=1, axis2=2))
    apart = found.mean - np.stack([row.mean for row in wanted], axis=-1)
    assert np.abs(apart / scale[..., None]).max() < 0.12
    claimed = found.cov.reshape(5, 3, 3, -1)[..., 0]
    relative = (claimed - wanted[0].cov) / (scale[:, :, None] * scale[:, None, :])
    assert np.abs(relative).max() < 0.05
    # the mean of the dynamics is the best prediction
    np.testing.assert_allclose(made.fits[3].forecast.gain, np.eye(3), atol=0.06)


def test_older_estimates_are_moved_through_all_steps_to_the_present():
    system = DiscreteSystem(
        StochasticMap((x,), [x * (1 - ELAPSED / 4) + w], Noise((w,), cov=[[0.5]])),
        StochasticMap((x,), [x + v], Noise((v,), cov=[[1]])),
        [0],
        [[1]],
    )
    made = minimax_synthesis(system, Memory(2, measurements=1), [0, 1, 1.5, 3.5], paths=500, seed=1)
    u = np.array([[2.0], [3.0], [7.0]])
    np.testing.assert_allclose(
        made.basics(3).prediction(u)[:, 0], [2 * 0.5, 3 * 0.875 * 0.5, 7.0], rtol=1e-14
    )
    np.testing.assert_allclose(made.basics(1).prediction(u[1:])[:, 0], [3 * 0.75, 7.0])


def test_bounded_polynomials_beat_the_residual_and_stay_in_the_range_of_the_states(cubic):
    residual, bounded = (
        minimax_synthesis(cubic, Memory(1), TIMES, paths=8000, seed=1, correction=correction)
        for correction in (None, BoundedPolynomial(3))
    )
    data = cubic.simulate(TIMES, 4000, 4)
    errors = [
        ((made.run(TIMES, data.measurements).mean - data.states)[10:] ** 2).mean()
        for made in (residual, bounded)
    ]
    assert errors[1] < 0.6 * errors[0]
    # absurd measurements end at the range of the design's states
    y = np.array([1e3, 1e9, 1e300, -1e3, -1e9, -1e300])
    record = np.concatenate([np.tile(data.measurements[:20, :, :1], (1, 1, 6)), y[None, None]])
    found = bounded.run(TIMES[:21], record).mean[20, 0]
    seen = cubic.simulate(TIMES, 8000, np.random.SeedSequence(1).spawn(3)[0]).states[20, 0]
    np.testing.assert_array_equal(found, [seen.max()] * 3 + [seen.min()] * 3)
