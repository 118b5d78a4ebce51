"""Designs that condition on what has arrived: estimates and claims after gaps, likely or not."""

import warnings
from itertools import product

import numpy as np
import pytest
import sympy

from oracles.linear import Linear, kalman
from seedslib import zoo
from seedslib.design import Polynomial, synthesize
from seedslib.designed import Memory, load, save
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

p, q, v, w = sympy.symbols("p q v w", real=True)
TIMES = np.arange(3.0, 12.0)
TURN, PUSH = np.array([[0.95, 0.3], [-0.3, 0.92]]), np.diag([0.05, 0.5])


def model(moves, noise, shows, sensor_noise, mean0, cov0, steps=9):
    """A linear system of constant parts, and its numbers for `kalman`."""
    states, loud = [p, q][: len(moves)], np.diag(np.broadcast_to(sensor_noise, len(shows)))
    drives, faults = sympy.symbols(f"d1:{len(moves) + 1}"), sympy.symbols(f"f1:{len(shows) + 1}")
    formulas = (np.array(moves) @ states + drives, np.array(shows) @ states + faults)
    system = DiscreteSystem(
        StochasticMap(states, formulas[0], Noise(drives, cov=noise)),
        StochasticMap(states, formulas[1], Noise(faults, cov=loud)),
        mean0,
        cov0,
    )
    F, Q, H, R = (np.tile(part, (steps, 1, 1)) for part in (moves, noise, shows, loud))
    b, d = np.zeros((steps, len(moves))), np.zeros((steps, len(shows)))
    return system, Linear(F[1:], b[1:], Q[1:], H, d, R, np.array(mean0), np.array(cov0))


WALK = [[0.95]], [[0.7]], [[1.0]], 1.0, [0.5], [[1.0]]
"""Errors after a silence are up to three times those without."""


def kalmans(numbers, y):
    """Means (K+1, n, records) and deviations of the Kalman filter of each record."""
    rows = [kalman(numbers, record) for record in np.moveaxis(y, 2, 0)]
    means, covs = (np.stack(part, axis=-1) for part in zip(*(row[:2] for row in rows), strict=True))
    return means, np.sqrt(np.einsum("kiij->kij", covs))


def deviations(found, y):
    """Claimed deviations (K+1, n, records)."""
    n = found.mean.shape[1]
    cov = found.cov.reshape(len(found.cov), n, n, -1)
    return np.sqrt(np.einsum("kiij->kij", np.broadcast_to(cov, (*cov.shape[:3], y.shape[2]))))


def made(maker, **told):
    """A design of the walk."""
    system, memory, simulated = model(*WALK)[0], Memory(1), {"paths": 8000, "seed": 1}
    if maker == "affine":
        return synthesize(system, memory, Taylor(), TIMES, **simulated, **told)
    told |= {"predictor": Polynomial(2, 0)}
    return synthesize(system, memory, Taylor(), TIMES, **simulated, **told)


MAKERS = {  # largest and typical relative error of claims, of estimates in deviations
    "affine": (0.06, 0.02, 0.06),
    "polynomial": (0.08, 0.03, 0.15),
}


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.filterwarnings("ignore:paths:UserWarning")
def test_claims_and_estimates_of_every_history_are_those_of_the_kalman_filter(maker, tmp_path):
    """Random gaps, silences that hardly ever come by chance; steps, batches, and files."""
    filter, (most, typical, far) = made(maker, availability=0.75), MAKERS[maker]
    y = filter.system.simulate(TIMES, 60, 4, availability=0.6).measurements.copy()
    for count in range(1, 8):
        y[1 : 1 + count, :, count] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = filter.run(TIMES, y, covariances=True)
    numbers = model(*WALK)[1]
    means, wanted = kalmans(numbers, y)
    error = np.log(deviations(found, y) / wanted)[1:]
    assert np.abs(error).max() < most
    assert np.sqrt((error**2).mean()) < typical
    assert np.sqrt((((found.mean - means) / wanted) ** 2).mean()) < far
    # what is predicted is the mean over all histories
    mean = np.zeros(4)
    for history in product((True, False), repeat=4):
        chance = np.prod(np.where(history, 0.75, 0.25))
        record = np.where(history, 0.0, np.nan)[:, None, None]
        mean += chance * kalmans(numbers, record)[1][:, 0, 0] ** 2
    slack = 4 * filter.predicted.error[:4, 0] + 0.03 * np.sqrt(mean)
    np.testing.assert_array_less(np.abs(filter.predicted.rms[:4, 0] - np.sqrt(mean)), slack)
    np.testing.assert_allclose(filter.held_out.rms, filter.predicted.rms, rtol=0.15)
    for part in filter.fits:
        assert part.prob.sum() == pytest.approx(1.0)
    save(filter, tmp_path / "f.npz")
    again = load(tmp_path / "f.npz", filter.system).run(TIMES, y, covariances=True)
    np.testing.assert_array_equal(again.mean, found.mean)
    np.testing.assert_array_equal(again.cov, found.cov)
    state, single = filter.initial((60,)), filter.initial()
    for k, t in enumerate(TIMES):
        state, single = filter.step(state, t, y[k]), filter.step(single, t, y[k, :, 0])
        np.testing.assert_allclose(state.mean, found.mean[k], rtol=1e-10)
        np.testing.assert_allclose(single.mean, found.mean[k, :, 0], rtol=1e-9)


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_always_arrives_is_the_plain_design_and_what_never_does_the_forecast(maker):
    plain, sure = made(maker), made(maker, availability=1.0)
    y = plain.system.simulate(TIMES, 5, 4).measurements
    np.testing.assert_array_equal(sure.run(TIMES, y).mean, plain.run(TIMES, y).mean)
    np.testing.assert_array_equal(sure.predicted.rms, plain.predicted.rms)
    nothing = np.full((9, 1, 2), np.nan)
    found = made(maker, availability=0.0).run(TIMES, nothing, covariances=True)
    means, wanted = kalmans(model(*WALK)[1], nothing)
    np.testing.assert_allclose(found.mean, means, atol=0.12)
    np.testing.assert_allclose(deviations(found, nothing), wanted, rtol=0.05)


@pytest.mark.filterwarnings("ignore:availability:UserWarning")
def test_two_unlike_sensors_by_schedule_and_by_chance():
    """Of two components that turn into each other: claims and estimates of each history."""
    mask = np.ones((9, 2), dtype=bool)
    mask[:, 1] = np.arange(9) % 3 == 0
    told = {"measured": mask, "availability": [0.8, 0.9]}
    system, numbers = model(TURN, PUSH, np.eye(2), [0.5, 0.2], [0.0, 0.0], np.eye(2))
    filter = synthesize(system, Memory(1), Taylor(), TIMES, paths=6000, seed=1, **told)
    y = system.simulate(TIMES, 100, 4, **told).measurements
    means, wanted = kalmans(numbers, y)
    found = filter.run(TIMES, y, covariances=True)
    error = np.log(deviations(found, y) / wanted)
    assert np.abs(error).max() < 0.15
    assert np.sqrt((error**2).mean()) < 0.02
    assert np.sqrt((((found.mean - means) / wanted) ** 2).mean()) < 0.06
    with pytest.raises(ValueError, match="measurements"):
        filter.run(TIMES, system.simulate(TIMES, 3, 4).measurements)


@pytest.mark.filterwarnings("ignore:availability:UserWarning")
def test_a_curved_sensor_has_the_predicted_errors_of_all_histories():
    """With nodes between measurements, and a memory of two estimates."""
    system, times = zoo.van_der_pol(), 0.25 * np.arange(6)
    options = {"paths": 2500, "seed": 1, "step": 0.05, "nodes": 1}
    filter = synthesize(system, Memory(2), ExactGaussian(), times, availability=0.8, **options)
    stops, shown = filter.predicted.times, np.arange(11) % 2 == 0
    data = system.simulate(stops, 4000, 7, measured=shown, availability=0.8, step=0.05)
    error = filter.run(stops, data.measurements).mean - data.states
    np.testing.assert_allclose(filter.predicted.rms, np.sqrt((error**2).mean(axis=2)), rtol=0.12)


def test_classes_that_are_too_few_are_warned_of_and_still_predict_their_errors():
    """Three sensors of two numbers: more histories than classes."""
    shows, times = [[1, 0], [0, 1], [1, -1]], TIMES[:6]
    system, _ = model([[1.1, 1], [0, 0.95]], np.eye(2), shows, [9, 1, 25], [0, 0], np.eye(2))
    with pytest.warns(UserWarning, match="availability"):
        filter = synthesize(
            system, Memory(1), Taylor(), times, paths=1000, seed=1, availability=0.5
        )
    assert 40 < max(len(fit.prob) for fit in filter.fits) <= 64
    data = system.simulate(times, 6000, 6, availability=0.5)
    error = filter.run(times, data.measurements).mean - data.states
    np.testing.assert_allclose(filter.predicted.rms, np.sqrt((error**2).mean(axis=2)), rtol=0.1)
