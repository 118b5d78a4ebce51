import pickle

import numpy as np
import pytest
from scipy.linalg import expm

from seedslib.filters import KalmanFilter, extended_kalman
from seedslib.models import LinearSystem

F, Q = [[0.9, 0.2], [0.0, 0.7]], [[1.0, 0.3], [0.3, 0.5]]
H, R = [[1.0, 0.5]], 0.4
START = [1.0, -1.0], [[2.0, 0.1], [0.1, 1.0]]


def test_paths_have_the_moments_of_the_matrices():
    system = LinearSystem(F, Q, H, R, *START)
    sim = system.simulate(np.arange(4.0), 40_000, 0)
    mean, cov = (np.array(part) for part in START)
    for _ in range(3):
        mean, cov = F @ mean, F @ cov @ np.transpose(F) + Q
    states = np.asarray(sim.states)[-1]
    assert np.abs(states.mean(axis=1) - mean).max() < 4 * np.sqrt(cov.max() / 40_000)
    assert np.abs(np.cov(states) - cov).max() < 6 * cov.max() / np.sqrt(40_000)
    errors = np.asarray(sim.measurements)[-1] - H @ states
    assert abs(errors.var() - R) < 6 * R / np.sqrt(40_000)


def test_functions_of_time_take_the_time_they_leave():
    system = LinearSystem(lambda t: [[1 + t]], lambda t: [[0.0]], lambda t: [[t]], 0, 1, 0)
    sim = system.simulate(np.arange(4.0), 1, 0)
    assert np.asarray(sim.states)[:, 0, 0].tolist() == [1.0, 1.0, 2.0, 6.0]
    assert np.asarray(sim.measurements)[:, 0, 0].tolist() == [0.0, 1.0, 4.0, 18.0]


def test_exact_discretisation_against_the_integral():
    drift, diffusion, h = np.array([[0, 1], [-1, -0.4]]), np.array([[0, 0], [0, 0.5]]), 0.3
    system = LinearSystem.from_continuous(drift, diffusion, H, R, *START, step=h)
    s, w = np.polynomial.legendre.leggauss(20)
    moves = [expm(drift * h * (1 + p) / 2) for p in s]
    integral = sum(h / 2 * weight * m @ diffusion @ m.T for weight, m in zip(w, moves, strict=True))
    assert np.allclose(system.dynamics.slope_at(0.0), expm(drift * h), rtol=1e-13)
    assert np.allclose(system.dynamics.cov_at(0.0), integral, rtol=1e-12)


def test_matrices_and_functions_of_them_are_the_same_system():
    times, y = np.arange(6.0), np.sin(np.arange(6.0))[:, None]
    fixed = LinearSystem(F, Q, H, R, *START)
    timed = LinearSystem(lambda t: F, lambda t: Q, lambda t: H, lambda t: [[R]], *START)
    one, two = KalmanFilter(fixed).run(times, y), KalmanFilter(timed).run(times, y)
    three = extended_kalman(fixed).run(times, y)
    assert np.array_equal(one.mean, two.mean)
    assert np.allclose(one.mean, three.mean, rtol=1e-13)
    assert np.allclose(one.loglik, three.loglik, rtol=1e-13)
    assert timed.sensor.has_log_density


def test_it_travels():
    system = pickle.loads(pickle.dumps(LinearSystem(F, Q, H, R, *START)))
    assert np.array_equal(system.dynamics.slope_at(0.0), F)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"F": [[1.0]]}, r"F: wanted shape \(2, 2\), got \(1, 1\)"),
        ({"H": [[1.0]]}, r"H: wanted shape \(1, 2\), got \(1, 1\)"),
        ({"Q": [[1.0, 2.0], [2.0, 1.0]]}, "Q: wanted a positive semidefinite"),
        ({"diffuse": (2,)}, "diffuse: wanted distinct components from 0 to 1"),
        ({"diffuse": (0, 0)}, "diffuse: wanted distinct"),
        ({"diffuse": (0,)}, "cov0: wanted zeros in the rows of diffuse components"),
    ],
)
def test_what_does_not_fit_is_refused(changes, message):
    given = {"F": F, "Q": Q, "H": H, "R": R, "mean0": START[0], "cov0": START[1], **changes}
    with pytest.raises(ValueError, match=message):
        LinearSystem(**given)


def test_a_diffuse_system_has_one_filter_and_no_paths():
    system = LinearSystem(1, 1, 1, 1, 0, 0, diffuse=(0,))
    with pytest.raises(ValueError, match="see KalmanFilter"):
        extended_kalman(system)
    with pytest.raises(ValueError, match="no law to draw from"):
        system.simulate(np.arange(4.0), 1, 0)
