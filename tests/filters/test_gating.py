"""Outliers are left out with the probability that is stated, and a gate does not lock itself."""

import pickle

import numpy as np
import pytest
import sympy as sp

from seedslib.design import synthesize
from seedslib.designed import large_order
from seedslib.evaluation import compare
from seedslib.filters import Gated, KalmanFilter, ParticleFilter, extended_kalman
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap

TIMES = np.arange(60.0)


def track(noise=0.5, **options):
    """Constant velocity, position and velocity measured."""
    F, Q = [[1.0, 1.0], [0.0, 1.0]], 0.01 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    given = {"mean0": [0.0, 1.0], "cov0": np.eye(2), **options}
    return LinearSystem(F, Q, np.eye(2), np.diag([noise**2, 0.1**2]), **given)


def test_good_measurements_are_lost_with_the_stated_probability():
    system = track()
    y = system.simulate(TIMES[:1], 8000, 1).measurements
    y[:, 1, ::3] = np.nan  # one degree of freedom less
    for probability in (0.9, 0.99):
        far = Gated(KalmanFilter(system), probability).run(TIMES[:1], y).rejected[0]
        for part in (far[::3], far[1::3]):
            doubt = np.sqrt(probability * (1 - probability) / len(part))
            assert abs(part.mean() - (1 - probability)) < 4 * doubt


def test_the_distance_is_the_quadratic_form():
    system = track()
    gated = Gated(KalmanFilter(system))
    state = gated.predict(gated.initial((3,)), 0.0)
    y = np.array([[1.0, np.nan, 5.0], [2.0, 3.0, np.nan]])
    spread = np.eye(2) + np.diag([0.25, 0.01])
    wanted = [
        (y[:, 0] - [0, 1]) @ np.linalg.solve(spread, y[:, 0] - [0, 1]),
        (3.0 - 1.0) ** 2 / spread[1, 1],
        5.0**2 / spread[0, 0],
    ]
    np.testing.assert_allclose(gated.distance(state.inner, y), wanted, rtol=1e-12)


def test_outliers_cost_little_where_they_are_left_out():
    """One in twenty is off by forty deviations: beside the errors of the same paths without."""
    system = track()
    data = system.simulate(TIMES, 400, 2)
    rng = np.random.default_rng(3)
    bad = rng.random((len(TIMES), 400)) < 0.05
    y = data.measurements.copy()
    y[:, 0] += np.where(bad, 20.0 * rng.choice([-1, 1], bad.shape), 0.0)
    plain = KalmanFilter(system)

    def rms(filter, y):
        return np.sqrt(((filter.run(TIMES, y).mean - data.states)[10:, 0] ** 2).mean())

    clean, spoilt, gated = rms(plain, data.measurements), rms(plain, y), rms(Gated(plain), y)
    assert spoilt > 3 * clean
    assert gated < 1.1 * clean
    found = Gated(plain).run(TIMES, y)
    assert found.rejected[bad].all()
    # what was left out is what was missing
    lost = np.where(found.rejected[:, None], np.nan, y)
    wanted = plain.run(TIMES, lost)
    np.testing.assert_array_equal(found.mean, wanted.mean)
    np.testing.assert_array_equal(found.loglik, wanted.loglik)
    one = Gated(plain).run(TIMES, y[..., 0])
    np.testing.assert_allclose(one.mean, found.mean[..., 0], rtol=1e-12)
    assert one.to_dataframe(TIMES)["rejected"].sum() == found.rejected[:, 0].sum()


def test_a_gate_opens_after_refusals():
    """A filter that is sure of a wrong place refuses the truth, but not for ever."""
    sure = track(mean0=[50.0, 1.0], cov0=np.diag([1e-4, 1e-4]))
    y = np.stack([TIMES, np.full_like(TIMES, 1.0)], axis=1)
    patient, stubborn = (Gated(KalmanFilter(sure), patience=p).run(TIMES, y) for p in (3, 10**6))
    assert patient.rejected[:3].all()
    assert not patient.rejected[3]
    assert abs(patient.mean[-1, 0] - TIMES[-1]) < 0.5
    assert stubborn.rejected[:20].all()
    gap = y.copy()
    gap[1] = np.nan  # no answer is no refusal
    assert not Gated(KalmanFilter(sure), patience=3).run(TIMES, gap).rejected[4]


def test_on_the_circle_and_with_unknown_numbers():
    x, w, v = sp.symbols("x w v", real=True)
    move = StochasticMap([x], [x + 0.1 * w], Noise([w]))
    seen = StochasticMap([x], [x + 0.1 * v], Noise([v]), period={0: 2 * np.pi})
    angle = DiscreteSystem(move, seen, [3.1], [[0.01]])
    gated = Gated(extended_kalman(angle))
    assert not gated.run([0.0], [[-3.15]]).rejected[0]  # 3.13 on the circle
    assert gated.run([0.0], [[2.0]]).rejected[0]
    diffuse = track(cov0=np.zeros((2, 2)), diffuse=(0, 1))
    y = np.array([[1e6, 5.0], [1e6 + 5, 5.0], [1e6 + 10, 5.0], [0.0, 5.0]])
    np.testing.assert_array_equal(
        Gated(KalmanFilter(diffuse)).run(TIMES[:4], y).rejected, [False, False, False, True]
    )


def test_in_comparisons_files_and_with_designs():
    system = track()
    gated = Gated(KalmanFilter(system), 0.9999)
    again = pickle.loads(pickle.dumps(gated))
    y = system.simulate(TIMES, 5, 4).measurements
    np.testing.assert_array_equal(gated.run(TIMES, y).mean, again.run(TIMES, y).mean)
    both = compare({"plain": KalmanFilter(system), "gated": gated}, system, TIMES, 200, 5)
    np.testing.assert_allclose(both["gated"].average, both["plain"].average, rtol=0.02)
    designed = Gated(
        synthesize(system, large_order(1), Taylor(), TIMES[:8], paths=5000, seed=1), 0.999
    )
    y = system.simulate(TIMES[:8], 50, 6).measurements
    y[4, 0, 0] = 1e3
    found = designed.run(TIMES[:8], y)
    assert found.rejected[4, 0]
    assert np.abs(found.mean).max() < 40


def test_bad_arguments():
    system = track()
    with pytest.raises(TypeError, match="filter: wanted one that says what it expects"):
        Gated(ParticleFilter(system))
    with pytest.raises(ValueError, match="probability: wanted a number between 0 and 1, got 1"):
        Gated(KalmanFilter(system), 1)
    with pytest.raises(ValueError, match="patience"):
        Gated(KalmanFilter(system), patience=0)
