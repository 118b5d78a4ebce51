"""Distributions that a correction by measurements obeys: their order, what is missing, units."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from oracles.drawn import covariances, vectors
from seedslib.base import update
from seedslib.linearization import Moments

UNITS = st.sampled_from([1e-150, 1e-70, 1e-6, 1.0, 2.5, 1e8, 1e70, 1e150])
NOISE = st.integers(1, 32).map(lambda k: k / 8)


def corrected(mean, cov, y, sensor, noise):
    """By a linear sensor with independent noises."""
    cross = cov @ sensor.T
    moments = Moments(sensor @ mean, cross, sensor @ cross + np.diag(noise))
    return update(mean, cov, y, moments)


def same(one, other, rtol=1e-9):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * (1 + np.abs(b).max()))


PROBLEM = (
    vectors(3),
    covariances(3, floor=0.125),
    vectors(2),
    vectors((2, 3)),
    st.tuples(NOISE, NOISE).map(np.array),
)


@given(*PROBLEM)
def test_independent_measurements_may_come_in_any_order(mean, cov, y, sensor, noise):
    both = corrected(mean, cov, y, sensor, noise)
    turned = corrected(mean, cov, y[::-1], sensor[::-1], noise[::-1])
    same(turned, both)
    first = corrected(mean, cov, y[:1], sensor[:1], noise[:1])
    then = corrected(*first[:2], y[1:], sensor[1:], noise[1:])
    same((*then[:2], first[2] + then[2]), both)


@given(*PROBLEM)
def test_a_missing_component_is_not_there(mean, cov, y, sensor, noise):
    missing = corrected(mean, cov, np.array([np.nan, y[1]]), sensor, noise)
    same(missing, corrected(mean, cov, y[1:], sensor[1:], noise[1:]), rtol=1e-14)
    nothing = corrected(mean, cov, np.full(2, np.nan), sensor, noise)
    np.testing.assert_array_equal(nothing[0], mean)
    np.testing.assert_array_equal(nothing[1], cov)
    assert nothing[2] == 0.0


@given(*PROBLEM, UNITS, UNITS)
def test_units_of_state_and_measurement_do_not_matter(mean, cov, y, sensor, noise, a, b):
    one = corrected(mean, cov, y, sensor, noise)
    other = corrected(a * mean, a * cov * a, b * y, sensor * (b / a), b * noise * b)
    same((other[0] / a, other[1] / a / a, other[2] + 2 * np.log(b)), one)


@given(*PROBLEM)
def test_what_is_measured_makes_no_less_certain(mean, cov, y, sensor, noise):
    after = corrected(mean, cov, y, sensor, noise)[1]
    np.testing.assert_array_equal(after, after.T)
    assert np.linalg.eigvalsh(after).min() > 0
    assert np.linalg.eigvalsh(cov - after).min() > -1e-12 * np.trace(cov)
    # many records at once are the same as each alone
    batch = [np.stack([part, part], axis=-1) for part in (mean, cov, y)]
    cross = (cov @ sensor.T)[..., None].repeat(2, axis=-1)
    spread = (sensor @ cov @ sensor.T + np.diag(noise))[..., None].repeat(2, axis=-1)
    whole = update(*batch, Moments((sensor @ mean)[:, None].repeat(2, axis=1), cross, spread))
    np.testing.assert_allclose(whole[1][..., 1], after, rtol=1e-12, atol=1e-13)
