"""Exact errors of estimators with given, greedy and separate gains."""

import numpy as np
import pytest

from oracles.delay import Regression, general_system
from seedslib import zoo
from seedslib.delay import (
    StructureGains,
    apply_gains,
    error_covariance,
    greedy_gains,
    optimal_gains,
    repaired_gains,
    separate_gains,
)


def traces(cov):
    return np.trace(cov, axis1=1, axis2=2)


def coefficients(system, gains):
    """Errors as linear functions of start and noises, and the covariance of these.

    One "record" for each of them; estimates are affine in the record, so those of zeros go off.
    """
    truth = Regression(system, len(gains.gain) - 1)
    y, zero = truth.outputs.copy(), np.zeros_like(truth.outputs)
    y[0] = zero[0] = np.nan
    estimates = apply_gains(system, gains, y) - apply_gains(system, gains, zero)
    return truth.states[truth.reach :] - estimates, truth.spread


def by_coefficients(system, gains):
    error, spread = coefficients(system, gains)
    return error @ spread @ error.swapaxes(1, 2)


def some_gains(system, steps, corrected):
    rng = np.random.default_rng(2)
    n, m = system.state_size, system.measurement_size
    past = 0.2 * rng.standard_normal((steps + 1, system.max_delay, n, m))
    for k in range(steps + 1):
        past[k, max(k - 1, 0) :] = 0.0
    return StructureGains(0.3 * rng.standard_normal((steps + 1, n, m)), past, corrected)


@pytest.mark.parametrize("corrected", [False, True])
@pytest.mark.parametrize("delays", [(0, 3), (0, 1, 4), (0,), (2,)])
def test_error_covariance_of_any_gains_equals_the_linear_expansion(delays, corrected):
    system = general_system(delays)
    gains = some_gains(system, 15, corrected)
    wanted = by_coefficients(system, gains)
    assert np.abs(error_covariance(system, gains) - wanted).max() <= 1e-13 * np.abs(wanted).max()


def test_estimates_of_given_gains_by_hand():
    """Both structures on one record, written out for the delays 0 and 1; the start has a mean."""
    system = general_system((0, 1))
    y = system.simulate(3, 2, 4).measurements.reshape(4, 2, 1, 2)
    for corrected in (False, True):
        gains = some_gains(system, 3, corrected)
        x = {-1: np.zeros((3, 1, 1)), 0: system.mean0[:, None, None]}
        nu = {}
        for k in (1, 2, 3):
            a, b = system.dynamics.values()
            plain = np.tensordot(a, x[k - 1], 1) + np.tensordot(b, x[k - 2], 1)
            mean = plain if k == 1 else plain + np.tensordot(gains.past[k, 0], nu[k - 1], 1)
            nu[k] = y[k] - np.tensordot(system.sensor, mean if corrected else plain, 1)
            x[k] = mean + np.tensordot(gains.gain[k], nu[k], 1)
        estimates = apply_gains(system, gains, y)
        for k in (1, 2, 3):
            np.testing.assert_allclose(estimates[k], x[k], atol=1e-13)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"past": 1},
        {"past": 2, "keep": "oldest"},
        {"corrected": True},
        {"past": 1, "keep": "oldest", "corrected": True},
        {"criterion": "sum"},
    ],
)
def test_greedy_gains_minimise_their_criterion_among_the_kept_innovations(options):
    """The derivative of the criterion by every gain of the last instant vanishes."""
    system, last = general_system((0, 1, 3)), 6
    best = greedy_gains(system, last, **options)
    np.testing.assert_allclose(best.cov, by_coefficients(system, best.gains), atol=1e-11)
    kept = options.get("past", 3)
    lags = range(kept) if options.get("keep") != "oldest" else range(3 - kept, 3)
    free = [("gain", (i, c)) for i, c in np.ndindex(3, 2)]
    free += [("past", (j, i, c)) for j in lags for i, c in np.ndindex(3, 2)]
    unused = np.delete(best.gains.past, list(lags), axis=1)
    assert not unused.any()

    def value(gains):
        error, spread = coefficients(system, gains)
        error = error[-4:].sum(axis=0) if options.get("criterion") == "sum" else error[-1]
        return np.trace(error @ spread @ error.T)

    for name, at in free:
        ends = []
        for shift in (-0.1, 0.0, 0.1):
            table = getattr(best.gains, name).copy()
            table[-1][at] += shift
            ends.append(value(best.gains._replace(**{name: table})))
        assert ends[0] - ends[2] == pytest.approx(0.0, abs=1e-9)
        assert min(ends[0], ends[2]) > ends[1]


def test_all_true_innovations_give_the_optimal_filter():
    """Theorem R: the greedy gains of structure (R1) are those of (R2)."""
    system = general_system((0, 1, 4))
    greedy, wanted = greedy_gains(system, 12, corrected=True), repaired_gains(system, 12)
    np.testing.assert_allclose(greedy.cov, optimal_gains(system, 12).cov, atol=1e-11)
    np.testing.assert_allclose(greedy.gains.gain, wanted.gain, atol=1e-11)
    np.testing.assert_allclose(greedy.gains.past, wanted.past, atol=1e-11)


@pytest.mark.parametrize("delay", [1, 2, 4])
def test_greedy_structure_is_optimal_up_to_instant_delay_plus_one(delay):
    system = zoo.delayed_scalar(0.6, 0.3, 1.0, delay)
    best = optimal_gains(system, delay + 2).cov[:, 0, 0]
    greedy = greedy_gains(system, delay + 2).cov[:, 0, 0]
    np.testing.assert_allclose(greedy[:-1], best[:-1], atol=1e-12)
    assert greedy[-1] > best[-1] + 1e-8


def test_separate_gains_are_those_of_the_formulas():
    """(20), (21) with exact covariances of prediction error and innovations; no minimum."""
    system = general_system((0, 3))
    separate, truth = separate_gains(system, 8), Regression(system, 8)
    np.testing.assert_allclose(separate.cov, by_coefficients(system, separate.gains), atol=1e-11)
    error, spread = coefficients(system, separate.gains)
    chain = np.concatenate([truth.states[: truth.reach], error])
    ahead, nu = {}, {}
    for k in range(1, 9):
        now = truth.reach + k
        ahead[k] = truth.states[now] - sum(
            a @ (truth.states[now - 1 - d] - chain[now - 1 - d]) for d, a in system.dynamics.items()
        )
        nu[k] = truth.outputs[k] - system.sensor @ (truth.states[now] - ahead[k])
        left = ahead[k] @ spread @ ahead[k].T
        for j in range(1, min(3, k - 1) + 1):
            cross = ahead[k] @ spread @ nu[k - j].T
            gain = cross @ np.linalg.inv(nu[k - j] @ spread @ nu[k - j].T)
            np.testing.assert_allclose(separate.gains.past[k, j - 1], gain, atol=1e-10)
            left = left - gain @ cross.T
        inner = nu[k] @ spread @ nu[k].T
        own = left @ system.sensor.T @ np.linalg.inv(inner)
        np.testing.assert_allclose(separate.gains.gain[k], own, atol=1e-10)
    joint = greedy_gains(system, 8).cov
    assert traces(separate.cov)[4] > traces(joint)[4]
