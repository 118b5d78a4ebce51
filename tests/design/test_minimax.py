from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from seedslib.base import ELAPSED
from seedslib.design import (
    BoundedPolynomial,
    grid_risk,
    minimax_synthesis,
    stationary,
    tabulated,
)
from seedslib.designed import Memory, load, save
from seedslib.evaluation import compare
from seedslib.filters import KalmanFilter, extended_kalman
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap

TIMES = np.arange(31.0)
GRID = {"x": (-5.6, 5.6, 225), "z": (-12, 12, 385), "y": (-190, 190, 1141)}


def cubic_sensor():
    x, w, v = sp.symbols("x w v", real=True)
    return DiscreteSystem(
        StochasticMap((x,), [x / (1 + x**2) + w], Noise((w,), cov=[[1]])),
        StochasticMap((x,), [x**3 + x + v], Noise((v,), cov=[[1]])),
        [0.1], [[1.16]],
    )  # fmt: skip


def root(t, forecast, y):
    """The cube root less the prediction, and the residual in units of the sensor's slope."""
    scaled = (y - forecast**3 - forecast) / (1 + 3 * forecast**2)
    return np.concatenate([np.cbrt(y) - forecast, scaled])


@pytest.fixture(scope="module")
def cubic():
    return cubic_sensor()


@pytest.fixture(scope="module")
def data(cubic):
    return cubic.simulate(TIMES, 20_000, 7)


@pytest.fixture(scope="module")
def bounded(cubic):
    return minimax_synthesis(
        cubic, Memory(1), TIMES, paths=20_000, seed=1, correction=BoundedPolynomial(3)
    )


def by_hand(cubic, times, paths, seed, correction):
    """The recursion of Pankov and Bosov by least squares on the same paths."""
    streams = np.random.SeedSequence(seed).spawn(3)
    sets = [cubic.simulate(times, paths, s) for s in streams[:2]]
    found, z = [], [None, None]
    for k in range(len(times)):
        own, fits = k % 2, []
        for which in (own, 1 - own):
            x, y = sets[which].states[k, 0], sets[which].measurements[k, 0]
            if k == 0:
                ahead = np.full(paths, 0.1)
            else:
                xi = np.stack([np.ones(paths), z[which] / (1 + z[which] ** 2)], axis=1)
                if which == own:
                    fits.append(np.linalg.lstsq(xi, x, rcond=None)[0])
                ahead = xi @ fits[0]
            if correction is None:
                zeta = (y - ahead**3 - ahead)[None]
            else:
                zeta = correction(times[k], ahead[None], y[None])
            zeta = np.stack([np.ones(paths), *zeta], axis=1)
            if which == own:
                fits.append(np.linalg.lstsq(zeta, x - ahead, rcond=None)[0])
            z[which] = ahead + zeta @ fits[-1]
        found.append([f.tolist() for f in fits])
    return found, np.mean((sets[len(times) % 2].states[-1, 0] - z[len(times) % 2]) ** 2)


@pytest.mark.parametrize("correction", [None, root])
def test_regressions_by_hand(cubic, correction):
    filter = minimax_synthesis(
        cubic, Memory(1), TIMES[:7], paths=600, seed=3, correction=correction
    )
    wanted, error = by_hand(cubic, TIMES[:7], 600, 3, correction)
    for fit, parts in zip(filter.fits, wanted, strict=True):
        made = [[*f.offset, *f.gain[0]] for f in (fit.forecast, fit.correction)]
        for one, two in zip(made[2 - len(parts) :], parts, strict=True):
            np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(filter.covariances[-1, 0, 0], error, rtol=1e-9)


@pytest.mark.parametrize(("correction", "error"), [(None, 0.3590), (root, 0.2001)])
def test_errors_of_the_cubic_sensor(cubic, data, correction, error):
    """Mean square errors that another program found with 20 000 paths, ±.0015 and ±.0004."""
    filter = minimax_synthesis(cubic, Memory(1), TIMES, paths=20_000, seed=1, correction=correction)
    square = (filter.run(TIMES, data.measurements).mean - data.states)[10:, 0] ** 2
    doubt = square.mean(axis=0).std() / np.sqrt(20_000)
    assert abs(square.mean() - error) < 3.0 * doubt + 0.001
    assert abs(filter.covariances[10:].mean() - square.mean()) < 4.0 * doubt


def test_predicted_errors_are_those_of_the_law(cubic):
    """The law of state and memory on a grid, without random numbers, confirms the design."""
    filter = minimax_synthesis(cubic, Memory(1), TIMES[:5], paths=20_000, seed=1, correction=root)
    risk = grid_risk(filter, **GRID)
    apart = filter.predicted.rms[:, 0] - np.sqrt(risk.mse)
    assert (np.abs(apart) < 4.0 * filter.predicted.error[:, 0]).all()


def test_of_a_linear_system_it_is_the_kalman_filter():
    linear = LinearSystem(
        [[1.0, 0.5], [0.0, 0.9]], np.diag([0.1, 0.4]), [[1, 0]], 0.5, [0, 0], np.eye(2)
    )
    a, b, p, q, r = sp.symbols("a b p q r", real=True)
    move = StochasticMap(
        (a, b), [a + b / 2 + p, 0.9 * b + q], Noise((p, q), cov=np.diag([0.1, 0.4]))
    )
    see = StochasticMap((a, b), [a + r], Noise((r,), cov=[[0.5]]))
    made = minimax_synthesis(
        DiscreteSystem(move, see, [0, 0], np.eye(2)), Memory(1), TIMES[:8], paths=50_000, seed=2
    )
    y = linear.simulate(TIMES[:8], 200, 5).measurements
    wanted = KalmanFilter(linear).run(TIMES[:8], y)
    found = made.run(TIMES[:8], y, covariances=True)
    assert np.sqrt(np.mean((found.mean - wanted.mean) ** 2)) < 0.01
    np.testing.assert_allclose(found.cov, wanted.cov, atol=0.02)
    first = made.fits[3].forecast
    np.testing.assert_allclose(first.gain, np.eye(2), atol=0.03)  # the mean is the best prediction


def test_older_estimates_come_to_the_present():
    """Two remembered estimates, by steps of other lengths: each is moved through all of them."""
    x, w, v = sp.symbols("x w v", real=True)
    system = DiscreteSystem(
        StochasticMap((x,), [x * (1 - ELAPSED / 4) + w], Noise((w,), cov=[[0.5]])),
        StochasticMap((x,), [x + v], Noise((v,), cov=[[1]])), [0], [[1]],
    )  # fmt: skip
    made = minimax_synthesis(system, Memory(2, measurements=1), [0, 1, 1.5, 3.5], paths=500, seed=1)
    u = np.array([[2.0], [3.0], [7.0]])
    np.testing.assert_allclose(
        made.basics(3).prediction(u)[:, 0], [2 * 0.5, 3 * 0.875 * 0.5, 7.0], rtol=1e-14
    )
    np.testing.assert_allclose(made.basics(1).prediction(u[1:])[:, 0], [3 * 0.75, 7.0])


def test_basic_functions_are_told_the_time(cubic):
    """The prediction the time that it leaves, the correction the one of the measurement."""
    left, met = [], []

    def prediction(t, u):
        left.append(t)
        return u

    def correction(t, forecast, y):
        met.append(t)
        return y - forecast

    filter = minimax_synthesis(
        cubic, Memory(1), [0, 2, 4], paths=100, seed=1, prediction=prediction, correction=correction
    )
    assert (sorted(set(left)), sorted(set(met))) == ([0, 2], [0, 2, 4])
    left.clear(), met.clear()
    filter.run([0, 2, 4], np.ones((3, 1)))
    assert (left, met) == ([0, 2], [0, 2, 4])


def test_bounded_polynomials_beat_the_residual(cubic, data, bounded):
    residual = minimax_synthesis(cubic, Memory(1), TIMES, paths=20_000, seed=1)
    result = compare({"residual": residual, "bounded": bounded}, cubic, TIMES, 4000, 4)
    mse = [(result[name].rms[10:] ** 2).mean() for name in ("residual", "bounded")]
    assert mse[1] < 0.6 * mse[0]


def test_no_measurement_moves_an_estimate_out_of_the_states(cubic, bounded):
    """Absurd measurements end at the range of the design's states; the polynomial in its own."""
    y = np.array([1e3, 1e9, 1e300, -1e3, -1e9, -1e300])
    found = bounded.steps[20].shown([y, np.full(6, 0.3)]).mean[0]
    fit = bounded.fits[20].bounded
    low, high = fit.states[:, 0]
    np.testing.assert_array_equal(found, [high] * 3 + [low] * 3)
    sets = [cubic.simulate(TIMES, 20_000, s) for s in np.random.SeedSequence(1).spawn(3)[:2]]
    seen = sets[0].states[20, 0]
    assert (low, high) == (seen.min(), seen.max())
    corners = np.array([[9.0, 9.0, -9.0, -9.0], [99.0, -99.0, 99.0, -99.0]])
    wild, tame = fit.powers.mean(corners)[0], fit(corners)[0]
    assert wild.max() > fit.values[1, 0] or wild.min() < fit.values[0, 0]  # it would go on
    np.testing.assert_array_equal(tame, np.minimum(np.maximum(wild, fit.values[0]), fit.values[1]))


def test_a_million_steps(cubic, bounded):
    filter = stationary(bounded, 0.1)
    times = np.arange(1000.0)
    data = cubic.simulate(times, 1000, 11)
    square = (filter.run(times, data.measurements).mean - data.states)[:, 0] ** 2
    quarters = square[20:].reshape(4, -1).mean(axis=1)
    assert np.ptp(quarters) < 0.05 * quarters.mean()
    assert square.max() < 200.0


def test_step_by_step_missing_and_files(cubic, bounded, tmp_path):
    y = cubic.simulate(TIMES, 5, 8).measurements
    y[7, :, 2] = np.nan
    whole = bounded.run(TIMES, y)
    state = bounded.initial((5,))
    for k, t in enumerate(TIMES):
        state = bounded.predict(state, t)
        if k == 7:
            before = whole.mean[6, 0]
            moved = before / (1 + before**2)
            fit = bounded.fits[7].forecast
            np.testing.assert_allclose(state.mean[0], fit.gain[0, 0] * moved + fit.offset[0])
            np.testing.assert_array_equal(whole.mean[7, 0, 2], state.mean[0, 2])
        state = bounded.correct(state, y[k])
        np.testing.assert_array_equal(state.mean, whole.mean[k])
    for filter in (bounded, replace(bounded, cycle=1)):
        save(filter, tmp_path / "f.npz")
        again = load(tmp_path / "f.npz", cubic_sensor())
        assert again.cycle == filter.cycle
        assert str(again) == str(filter)
        np.testing.assert_array_equal(again.run(TIMES, y).mean, whole.mean)
    with pytest.raises(ValueError, match="evaluates its model"):
        load(tmp_path / "f.npz")
    own = minimax_synthesis(cubic, Memory(1), TIMES[:3], paths=500, seed=1, correction=root)
    with pytest.raises(
        TypeError, match="correction: wanted a description or numbers, got function"
    ):
        save(own, tmp_path / "g.npz")


def test_a_filter_of_functions_of_ones_own_as_tables(cubic, data, tmp_path):
    own = minimax_synthesis(cubic, Memory(1), TIMES[:5], paths=4000, seed=1, correction=root)
    table = tabulated(own, y=(-150, 150, 3001), z=(-6, 6, 121))
    y = data.measurements[:5, :, :200]
    apart = table.run(TIMES[:5], y).mean - own.run(TIMES[:5], y).mean
    assert np.sqrt(np.mean(apart**2)) < 0.02
    save(table, tmp_path / "t.npz")
    np.testing.assert_array_equal(
        load(tmp_path / "t.npz").run(TIMES[:5], y).mean, table.run(TIMES[:5], y).mean
    )


def test_what_is_refused(cubic):
    def made(system=cubic, **other):
        return minimax_synthesis(system, Memory(1), TIMES[:3], paths=200, seed=1, **other)

    with pytest.raises(TypeError, match="correction: wanted a function, a BoundedPolynomial"):
        made(correction=3)
    with pytest.raises(TypeError, match="prediction: wanted a function or None, got 'mean'"):
        made(prediction="mean")
    with pytest.raises(ValueError, match=r"correction: wanted \(rows, 200\) from the function"):
        made(correction=lambda t, forecast, y: y[0])
    with pytest.raises(ValueError, match="degree"):
        BoundedPolynomial(0)
    with pytest.raises(TypeError, match="DiscreteSystem"):
        made(system=extended_kalman(cubic))
    filter = made(correction=BoundedPolynomial(2))
    with pytest.raises(ValueError, match=r"correction.gain: wanted shape \(1, 1\)"):
        replace(filter, method=made().method)
    with pytest.raises(ValueError, match=r"fits\[1\].*gain"):
        replace(filter, fits=(filter.fits[0], filter.fits[0], filter.fits[2]))
