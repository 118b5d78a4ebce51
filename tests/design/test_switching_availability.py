"""Switching designs that condition on which measurements and indicators have arrived."""

import warnings

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import stationary, synthesize
from seedslib.designed import Memory, load, save
from seedslib.evaluation import diff
from seedslib.extra import to_c
from seedslib.linearization import ExactGaussian, Taylor

TIMES = np.arange(10.0)


@pytest.fixture(scope="module")
def target():
    """Of one mode: a linear system, whose filter is that of Kalman."""
    return zoo.steady_target(1, noise=0.5)


@pytest.fixture(scope="module")
def filter(target):
    return synthesize(target, Memory(1), Taylor(), TIMES, paths=2000, seed=1, availability=0.8)


def riccati(there):
    """Covariances of the Kalman filter of the target, (K+1, 2, 2), from what arrived, (K+1,)."""
    move, push = np.array([[1, 1], [0, 0.98]]), 0.5 * np.array([0.5, 1])
    cov, found = np.diag([4.0, 1.0]), []
    for k, seen in enumerate(there):
        if k:
            cov = move @ cov @ move.T + np.outer(push, push)
        if seen:
            cov = cov - np.outer(cov[0], cov[0]) / (cov[0, 0] + 1.0)
        found.append(cov)
    return np.array(found)


def deviations(cov):
    return np.sqrt(np.einsum("kii...->ki...", cov))


@pytest.mark.parametrize("count", [1, 3, 7])
def test_claims_after_a_silence_are_those_of_the_kalman_filter(target, filter, count):
    data = target.simulate(TIMES, 1500, 3)
    y = data.measurements.copy()
    y[2 : 2 + count] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = filter.run(TIMES, y, covariances=True)
    claims = deviations(found.cov).mean(axis=2)
    right = deviations(riccati(~np.isnan(y[:, 0, 0])))
    assert np.abs(claims / right - 1)[1:].max() < 0.05
    has = np.sqrt(((found.mean - data.states) ** 2).mean(axis=2))
    assert np.abs(has / claims - 1).max() < 0.03 + 4 / np.sqrt(2 * 1500)
    assert np.isfinite(found.loglik).all()


@pytest.mark.filterwarnings("ignore:paths")  # some cells are thin
def test_two_modes_claim_the_errors_they_have():
    """Predicted errors and wrong modes are those of other paths; so are claims in gaps."""
    system, times = zoo.scalar_switching("A1H"), TIMES[:5]
    made = synthesize(system, Memory(1), ExactGaussian(), times, paths=2500, seed=1,
                      availability=0.6)  # fmt: skip
    data = system.simulate(times, 4000, 3, availability=0.6)
    found = made.run(times, data.measurements, covariances=True)
    square = (found.mean - data.states)[:, 0] ** 2
    rms, doubt = np.sqrt(square.mean(axis=1)), 4 * made.predicted.error[:, 0]
    assert (np.abs(rms - made.predicted.rms[:, 0]) < 2 * doubt).all()
    wrong = (found.modes != data.modes).mean(axis=1)
    assert (np.abs(wrong - made.predicted.mode_rate) < 8 * made.predicted.mode_error).all()
    # given that the last two did not arrive, of any history before
    lost = np.isnan(data.measurements[-2:, 0]).all(axis=0)
    ratio = square[-1, lost].mean() / found.cov[-1, 0, 0, lost].mean()
    assert abs(ratio - 1) < 4 * np.sqrt(2 / lost.sum())
    mask = np.array([True, True, False, False, True])
    other = synthesize(system, Memory(1), ExactGaussian(), times, paths=2500, seed=1, measured=mask)
    data = system.simulate(times, 8000, 3, measured=mask)
    one, two = (f.run(times, data.measurements, covariances=True) for f in (made, other))
    square = (one.mean - data.states)[:, 0] ** 2
    has, doubt = square.mean(axis=1), square.std(axis=1) / np.sqrt(8000)
    # claims are those of errors, which the normal laws of the modes alone are not
    ratio = one.cov[:, 0, 0].mean(axis=1) / has
    assert (np.abs(ratio - 1) < 0.02 + 4 * doubt / has).all()
    plain = two.cov[:, 0, 0].mean(axis=1) / has
    assert np.abs(plain - 1)[2:4].max() > 0.08
    assert np.sqrt(((one.mean - two.mean) ** 2).mean()) < 0.05 * np.sqrt(has.mean())


def test_steps_files_and_stationary_filters_keep_it(target, filter, tmp_path):
    y = target.simulate(TIMES, 4, 4, availability=0.6).measurements
    save(filter, tmp_path / "f.npz")
    again = load(tmp_path / "f.npz", target)
    assert "availability 0.8; up to" in str(again)
    assert diff(again, filter).equal
    found = again.run(TIMES, y, covariances=True)
    state, single = filter.initial((4,)), filter.initial()
    for k, t in enumerate(TIMES):
        state, single = filter.step(state, t, y[k]), filter.step(single, t, y[k, :, 0])
        np.testing.assert_allclose(state.mean, found.mean[k], rtol=1e-12)
        np.testing.assert_allclose(single.mean, found.mean[k, :, 0], rtol=1e-10)
        np.testing.assert_allclose(filter.report(single).cov, found.cov[k, ..., 0], rtol=1e-9)
    with pytest.raises(TypeError, match=r"fits: wanted laws in cells, .* to write in C"):
        to_c(filter, name="f")
    lasting = stationary(filter, tolerance=0.2, paths=200)
    long = np.arange(40.0)
    y = target.simulate(long, 20, 4, availability=0.8).measurements
    claims = deviations(lasting.run(long, y, covariances=True).cov)
    right = np.stack([deviations(riccati(~np.isnan(row))) for row in y[:, 0].T], axis=-1)
    assert np.sqrt((np.log(claims / right)[20:] ** 2).mean()) < 0.04


def test_what_is_sure_is_the_old_design(target):
    told = {"paths": 600, "seed": 1}
    old, sure = (
        synthesize(target, Memory(1), Taylor(), TIMES[:4], availability=rate, **told)
        for rate in (None, 1.0)
    )
    assert sure.availability is None
    for one, other in zip(old.fits, sure.fits, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # nothing arrives
        blind = synthesize(target, Memory(1), Taylor(), TIMES[:4], availability=0.0, **told)
    found = blind.run(TIMES[:4], np.full((4, 1, 1), np.nan), covariances=True)
    np.testing.assert_allclose(found.mean, 0.0, atol=0.3)
    right = deviations(riccati(np.zeros(4, dtype=bool)))
    np.testing.assert_allclose(deviations(found.cov)[..., 0], right, rtol=4 / np.sqrt(2 * 600))


def test_what_does_not_fit_is_refused(target):
    told = {"paths": 600, "seed": 1}
    with pytest.raises(ValueError, match="wanted every indicator that the memory keeps"):
        synthesize(zoo.manoeuvring_target("noisy"), Memory(1, 0, 1), ExactGaussian(), TIMES[:3],
                   availability=0.5, **told)  # fmt: skip
    with pytest.raises(ValueError, match="availability: wanted a probability"):
        synthesize(target, Memory(1), Taylor(), TIMES[:3], availability=-0.5, **told)
