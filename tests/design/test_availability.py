"""Designs that condition on what has arrived: claims after gaps, likely or not, are right."""

import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import Polynomial, stationary, synthesize
from seedslib.designed import Memory, load, save
from seedslib.designed.patterns import distances
from seedslib.evaluation import compare
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

p, q, v = sympy.symbols("p q v", real=True)
e, r = sympy.symbols("e1 e2", real=True), sympy.symbols("r1 r2", real=True)
TIMES = np.arange(26.0)


@pytest.fixture(scope="module")
def walk():
    """Its variance grows for as long as nothing arrives."""
    return DiscreteSystem(
        StochasticMap([p], [p + q], Noise([q])), StochasticMap([p], [p + v], Noise([v])),
        [0.0], [[1.0]],
    )  # fmt: skip


@pytest.fixture(scope="module")
def filter(walk):
    return synthesize(walk, Memory(1), Taylor(), TIMES, paths=8000, seed=1, availability=0.9)


@pytest.fixture(scope="module")
def pair():
    """Two components that turn into each other, each with a sensor."""
    moved = [0.95 * p + 0.3 * q + e[0], -0.3 * p + 0.92 * q + e[1]]
    return DiscreteSystem(
        StochasticMap([p, q], moved, Noise(e, cov=np.diag([0.05, 0.5]))),
        StochasticMap([p, q], [p + r[0], q + r[1]], Noise(r, cov=np.diag([0.5, 0.2]))),
        [0.0, 0.0], np.eye(2),
    )  # fmt: skip


def deviations(found, n, count):
    """Claimed deviations (K+1, n, count)."""
    cov = np.broadcast_to(
        found.cov.reshape(len(found.cov), n, n, -1), (len(found.cov), n, n, count)
    )
    return np.sqrt(np.einsum("kiij->kij", cov))


def test_claims_after_a_silence_are_those_of_the_kalman_filter(walk, filter):
    """After 1 to 15 missing rows, which by chance would hardly ever be met, and after their end."""
    data = walk.simulate(TIMES, 10_000, 3)
    kalman = extended_kalman(walk)
    for count in (1, 2, 4, 8, 15):
        y = data.measurements.copy()
        y[8 : 8 + count] = np.nan
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = filter.run(TIMES, y, covariances=True)
        claims = deviations(found, 1, 10_000)[:, 0].mean(axis=1)
        right = deviations(kalman.run(TIMES, y[..., :1]), 1, 1)[:, 0, 0]
        has = np.sqrt(((found.mean - data.states)[:, 0] ** 2).mean(axis=1))
        assert np.abs(claims / right - 1)[1:].max() < 0.03
        assert np.abs(has / claims - 1)[7:].max() < 0.03
        assert np.isfinite(found.loglik).all()


def test_claims_after_any_history_are_near_the_kalman_filters(walk, filter):
    y = walk.simulate(TIMES, 500, 4, availability=0.7).measurements
    claims = deviations(filter.run(TIMES, y, covariances=True), 1, 500)
    right = deviations(extended_kalman(walk).run(TIMES, y), 1, 500)
    error = np.log(claims / right)
    assert np.abs(error).max() < 0.1
    assert np.sqrt((error**2).mean()) < 0.02


def test_few_classes_still_predict_their_errors(walk, monkeypatch):
    """Each class holds its histories in their proportions, so errors are true."""
    monkeypatch.setattr("seedslib.design.histories.MOST", 3)
    with pytest.warns(UserWarning, match="3 classes of histories are few at time 1, and some hold"):
        made = synthesize(walk, Memory(1), Taylor(), TIMES, paths=8000, seed=1, availability=0.4)
    assert max(len(fit.prob) for fit in made.fits) == 3
    data = walk.simulate(TIMES, 20_000, 6, availability=0.4)
    error = made.run(TIMES, data.measurements).mean - data.states
    rms = np.sqrt((error**2).mean(axis=2))
    np.testing.assert_allclose(made.predicted.rms, rms, rtol=0.04)


@pytest.mark.filterwarnings("ignore:availability")
def test_silences_have_the_best_classes_where_there_are_too_many():
    """Two components, one sensor: more than 64 kinds of histories, and long gaps are rare."""
    moved = [0.95 * p + 0.3 * q + e[0], -0.3 * p + 0.92 * q + e[1]]
    turning = DiscreteSystem(
        StochasticMap([p, q], moved, Noise(e, cov=np.diag([0.05, 0.5]))),
        StochasticMap([p, q], [p + v], Noise([v], cov=[[0.5]])), [0.0, 0.0], np.eye(2),
    )  # fmt: skip
    times = TIMES[:24]
    made = synthesize(turning, Memory(1), Taylor(), times, paths=5000, seed=1, availability=0.9)
    y = np.repeat(turning.simulate(times, 1, 3).measurements, 15, axis=2)
    for count in range(15):
        y[8 : 9 + count, :, count] = np.nan
    claims = deviations(made.run(times, y, covariances=True), 2, 15)
    right = deviations(extended_kalman(turning).run(times, y), 2, 15)
    assert np.abs(claims / right - 1)[4:].max() < 0.04


def test_it_is_consistent_where_measurements_drop_out(walk, filter):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = compare(
            {"designed": filter, "kalman": extended_kalman(walk)}, walk, TIMES, 4000, 5,
            availability=0.9, consistency=True,
        )  # fmt: skip
    made, best = found["designed"], found["kalman"]
    assert abs(made.nees_ratio - 1) < 0.04
    assert abs(made.nis_ratio - 1) < 0.04
    assert abs(made.average_log_score - best.average_log_score) < 0.005
    # what it predicts of itself is an average over all histories
    np.testing.assert_allclose(filter.predicted.rms[5:, 0], made.rms[5:, 0], rtol=0.04)
    np.testing.assert_allclose(filter.held_out.rms, filter.predicted.rms, rtol=0.12)


def test_steps_are_the_run_and_files_keep_it(walk, filter, tmp_path):
    y = walk.simulate(TIMES, 4, 4, availability=0.6).measurements
    save(filter, tmp_path / "f.npz")
    again = load(tmp_path / "f.npz", walk)
    assert "availability 0.9; up to" in str(again)
    found = again.run(TIMES, y, covariances=True)
    state, single = filter.initial((4,)), filter.initial()
    for k, t in enumerate(TIMES):
        state, single = filter.predict(state, t), filter.predict(single, t)
        if k:
            assert np.isfinite(filter.expect(state).cov).all()
        state, single = filter.correct(state, y[k]), filter.correct(single, y[k, :, 0])
        np.testing.assert_allclose(state.mean, found.mean[k], rtol=1e-12)
        np.testing.assert_allclose(single.mean, found.mean[k, :, 0], rtol=1e-12)
        np.testing.assert_allclose(single.cov, found.cov[k, ..., 0], rtol=1e-12)
        np.testing.assert_allclose(state.loglik, found.loglik[k], rtol=1e-12)


def test_it_does_not_depend_on_threads(walk):
    made = [
        synthesize(walk, Memory(1), Taylor(), TIMES[:6], paths=5000, seed=1, availability=0.8,
                   workers=workers)
        for workers in (1, 2)
    ]  # fmt: skip
    for one, two in zip(*(f.fits for f in made), strict=True):
        assert np.array_equal(one.table, two.table)
        assert np.array_equal(one.fits.gain, two.fits.gain)


def test_it_goes_on_for_ever(walk, filter):
    lasting = stationary(filter, tolerance=0.05)
    long = np.arange(200.0)
    y = walk.simulate(long, 50, 9, availability=0.9).measurements
    y[100:112] = np.nan
    found = lasting.run(long, y, covariances=True)
    ratio = deviations(found, 1, 50) / deviations(extended_kalman(walk).run(long, y), 1, 50)
    assert np.abs(np.log(ratio)).max() < 0.1
    short = stationary(filter, tolerance=0.05, transient=3)
    other = short.run(long, y, covariances=True)
    assert np.abs(np.log(other.cov / found.cov))[30:].max() < 0.25


@pytest.mark.filterwarnings("ignore:availability")
def test_two_sensors_one_of_them_by_schedule(pair):
    """Rows of the second sensor at every third time; each is lost now and then."""
    times, mask = TIMES[:13], np.ones((13, 2), dtype=bool)
    mask[:, 1] = np.arange(13) % 3 == 0
    made = synthesize(pair, Memory(1), Taylor(), times, paths=6000, seed=1, measured=mask,
                      availability=[0.8, 0.9])  # fmt: skip
    y = pair.simulate(times, 400, 4, measured=mask, availability=[0.8, 0.9]).measurements
    claims = deviations(made.run(times, y, covariances=True), 2, 400)
    right = deviations(extended_kalman(pair).run(times, y), 2, 400)
    error = np.log(claims / right)
    assert np.abs(error).max() < 0.15
    assert np.sqrt((error**2).mean()) < 0.02
    # what was said to arrive always is a gap, and what is not read is refused
    sure = synthesize(pair, Memory(1), Taylor(), times[:5], paths=2000, seed=1,
                      availability=[1.0, 0.9])  # fmt: skip
    y = pair.simulate(times[:5], 3, 4, availability=[1.0, 0.5]).measurements.copy()
    y[2, 0, 1] = np.nan
    with pytest.warns(UserWarning, match="1 of 3 records have gaps, from 2 on"):
        found = sure.run(times[:5], y, covariances=True)
    assert np.isnan(found.cov[:, 0, 0]).sum(axis=0).tolist() == [0, 3, 0]
    y = pair.simulate(times, 3, 4).measurements
    with pytest.raises(ValueError, match="got component 1 of a measurement without it in row 1"):
        made.run(times, y)


@pytest.mark.filterwarnings("ignore:availability")
@pytest.mark.parametrize(
    ("memory", "told"),
    [(Memory(1), {"nodes": 1}), (Memory(2), {}), (Memory(1), {"predictor": Polynomial(2, 0)})],
)
def test_a_nonlinear_design_predicts_its_errors(memory, told):
    """A quadratic sensor: what the classes say is what a design for the schedule says."""
    system, times = zoo.van_der_pol(), 0.25 * np.arange(8)
    told = {"nodes": 0, **told}
    made = synthesize(system, memory, ExactGaussian(), times, paths=3000, seed=1,
                      availability=0.8, **told)  # fmt: skip
    data = system.simulate(times, 6000, 7, availability=0.8)
    error = made.run(times, data.measurements).mean - data.states
    at = made.clock.rows(made.predicted.times) if told["nodes"] == 0 else slice(0, None, 2)
    rms = np.sqrt((error**2).mean(axis=2))
    np.testing.assert_allclose(made.predicted.rms[at], rms, rtol=0.1)
    mask = np.ones(8, dtype=bool)
    mask[3:7] = False
    other = synthesize(system, memory, ExactGaussian(), times, paths=4000, seed=1, measured=mask,
                       **told)  # fmt: skip
    y = system.simulate(times, 2000, 7, measured=mask).measurements
    one, two = (
        deviations(f.run(times, y, covariances=True), 2, 2000).mean(axis=2) for f in (made, other)
    )
    np.testing.assert_allclose(one[3:7], two[3:7], rtol=0.05)


def test_how_far_covariances_are_apart():
    rng = np.random.default_rng(1)
    one, other = (a @ a.T for a in rng.normal(size=(2, 3, 3)))
    ratios = sorted(np.linalg.eigvals(np.linalg.solve(other, one)).real)
    wanted = max(-np.log(ratios[0]), np.log(ratios[-1]))
    basis = rng.normal(size=(3, 3))
    for a, b in ((one, other), (basis @ one @ basis.T, basis @ other @ basis.T)):
        np.testing.assert_allclose(distances(a[None], b[None]), [[wanted]], rtol=1e-5)
    np.testing.assert_allclose(distances(np.stack([one, other]), one[None])[:, 0], [0, wanted],
                               rtol=1e-5, atol=1e-12)  # fmt: skip


def test_what_does_not_fit_is_refused(walk, pair):
    def made(system=walk, **told):
        told = {"availability": 0.5, "paths": 600, "seed": 1, **told}
        return synthesize(system, Memory(1), Taylor(), TIMES[:3], **told)

    with pytest.raises(ValueError, match="availability: wanted a probability"):
        made(availability=1.5)
    with pytest.raises(ValueError, match="availability: wanted Affine or Polynomial"):
        made(checkpoint="x.npz")
    with pytest.raises(ValueError, match=r"horizon: wanted none beside availability, got 99\.0"):
        made(horizon=99.0)
    many = sympy.symbols("r1:6", real=True)
    wide = DiscreteSystem(walk.dynamics, StochasticMap([p], [p + s for s in many], Noise(many)),
                          [0.0], [[1.0]])  # fmt: skip
    with pytest.raises(ValueError, match=r"wanted at most 4 components .* for 16 patterns, got 5"):
        made(wide)
