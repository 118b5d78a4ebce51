"""Corrections of wide priors against the same formulas in rational numbers."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
import sympy

from seedslib.base import correct
from seedslib.base.diffuse import LOST, WIDE, correct_diffuse, narrowed
from seedslib.linearization import Moments

SMALL = np.array([[5.0, 2.0, -3.0], [2.0, 7.0, 1.0], [-3.0, 1.0, 11.0]])
"""A covariance in small whole numbers."""

SLOPE = np.array([[2.0, -1.0, 3.0], [1.0, 4.0, -2.0], [3.0, 1.0, 5.0]])
NOISE = np.array([[3.0, 1.0, -2.0], [1.0, 5.0, 2.0], [-2.0, 2.0, 7.0]])


def exact(matrix):
    return sympy.Matrix(np.shape(matrix)[0], np.shape(matrix)[1], lambda i, j: sympy.Rational(
        *Fraction(float(matrix[i][j])).as_integer_ratio()
    ))  # fmt: skip


def posterior(cov, slope, noise):
    """P - P Hᵀ (H P Hᵀ + R)⁻¹ H P without any rounding before the last one."""
    P, H, R = map(exact, (cov, slope, noise))
    return np.array(P - P * H.T * (H * P * H.T + R).inv() * H * P, dtype=float)


def measured(cov, slope, noise):
    spread = slope @ cov @ slope.T + noise
    return Moments(np.zeros(len(slope)), cov @ slope.T, spread)


def corrected(cov, slope, noise, told):
    moments = measured(cov, slope, noise)
    return correct(np.zeros(len(cov)), cov, np.zeros(len(slope)), moments, noise=lambda: told)[1]


def assert_near(found, wanted):
    """In units of the deviations that there are, of which a wide one brings its rounding along."""
    unit = np.sqrt(np.diag(wanted))
    unit = np.where(unit > 0, unit, unit.max())
    bound = 1e-12 + 1e-15 * unit.max() / unit.min()
    assert np.abs((found - wanted) / np.outer(unit, unit)).max() < bound
    assert np.array_equal(found, found.T)


WITHOUT_ONE = NOISE * np.outer([1, 0, 1], [1, 0, 1])
CASES = {
    "all told": (SMALL, SLOPE, NOISE),
    "two sensors": (SMALL, SLOPE[:2], NOISE[:2, :2]),
    "one sensor of one component": (SMALL, SLOPE[:1] * [0, 1, 0], NOISE[:1, :1]),
    "an exact sensor of a component": (SMALL, np.array([[2.0, -1, 3], [0, 1, 0], [3, 1, 5]]),
                                       WITHOUT_ONE),
    "an exact sensor first": (SMALL, np.array([[0.0, 0, 3], [2, -1, 3], [3, 1, 5]]),
                              NOISE * np.outer([0, 1, 1], [0, 1, 1])),
    "an exact sensor of the last of three unrelated components": (
        np.diag([5.0, 7.0, 11.0]), np.array([[0.0, 0, 3], [2, -1, 3], [3, 1, 5]]),
        NOISE * np.outer([0, 1, 1], [0, 1, 1]),
    ),
    "four sensors of two": (SMALL[:2, :2], np.array([[2.0, -1], [1, 4], [3, 1], [1, -2]]),
                            np.diag([3.0, 5.0, 7.0, 2.0]) + 1.0),
    "a component that is known": (SMALL * np.outer([1, 0, 1], [1, 0, 1]), SLOPE, NOISE),
}  # fmt: skip


@pytest.mark.parametrize("wide", [2.0**34, 2.0**44])
@pytest.mark.parametrize("name", CASES)
def test_wide_priors_are_corrected_to_the_last_digits(name, wide):
    """Where P is 1e10 and 1e13 times the noise, S alone would have kept six digits and three."""
    cov, slope, noise = CASES[name]
    found = corrected(wide * cov, slope, noise, noise)
    wanted = posterior(wide * cov, slope, noise)
    if name == "an exact sensor of a component":
        assert abs(found[1, 1]) <= 1e-14 * wide
        found, wanted = (np.delete(np.delete(part, 1, 0), 1, 1) for part in (found, wanted))
    if name.startswith("an exact sensor of the last"):
        assert found[2, 2] == 0.0
    if np.array_equal(slope[0], [0, 0, 3]):
        found, wanted = found[:2, :2], wanted[:2, :2]
    if name == "a component that is known":
        assert not found[1].any()
    assert_near(found, wanted)


def test_a_sensor_of_nothing_changes_nothing():
    """One that always shows zero, without noise, beside others."""
    wide, pick = 2.0**40 * SMALL[:2, :2], np.array([[2.0, -1.0], [0.0, 0.0], [3.0, 1.0]])
    apart = NOISE * np.outer([1, 0, 1], [1, 0, 1])
    for order in ([0, 1, 2], [1, 0, 2], [0, 2, 1]):
        slope, noise = pick[order], apart[np.ix_(order, order)]
        found = corrected(wide, slope, noise, noise)
        assert_near(found, posterior(wide, pick[[0, 2]], NOISE[np.ix_([0, 2], [0, 2])]))


def test_exact_sensors_are_left_to_the_usual_lines():
    """The path on which nothing is noisy is as if the noise were unknown, whatever the others."""
    cov, slope = 1.1e12 * SMALL, np.array([[0.0, 3.3, 0.0]])
    noise = np.array([[[0.0, 3.0]]])
    moments = Moments(np.zeros(1), cov @ slope.T, (slope @ cov @ slope.T)[..., None] + noise)
    told = correct(np.zeros(3), cov, np.zeros(1), moments, noise=lambda: noise)[1]
    plain = correct(np.zeros(3), cov, np.zeros(1), moments)[1]
    np.testing.assert_array_equal(told[..., 0], plain[..., 0])
    assert_near(told[..., 1], posterior(cov, slope, [[3.0]]))
    assert np.abs(plain[1, 1, 1] / told[1, 1, 1] - 1) > 1e-7


def test_noise_in_whole_numbers():
    wide = 2.0**40 * SMALL
    told = [[3, 1, -2], [1, 5, 2], [-2, 2, 7]]
    found = corrected(wide, SLOPE, NOISE, told)
    np.testing.assert_array_equal(found, corrected(wide, SLOPE, NOISE, NOISE))


def test_each_path_by_itself():
    """Wide and narrow paths, of which one misses a component: each as it is alone."""
    covs = [2.0**40 * SMALL, SMALL, 2.0**36 * SMALL, 2.0**38 * SMALL]
    y = np.arange(12.0).reshape(3, 4)
    y[1, 2] = np.nan
    parts = [measured(cov, SLOPE, NOISE) for cov in covs]
    moments = Moments(*(np.stack(part, axis=-1) for part in zip(*parts, strict=True)))
    mean, cov = np.zeros((3, 4)), np.stack(covs, axis=-1)
    found = correct(mean, cov, y, moments, noise=lambda: NOISE)[1]
    for k, part in enumerate(parts):
        alone = correct(mean[:, k], covs[k], y[:, k], part, noise=lambda: NOISE)[1]
        np.testing.assert_allclose(found[..., k], alone, rtol=1e-13)
        kept = np.isfinite(y[:, k])
        wanted = posterior(covs[k], SLOPE[kept], NOISE[np.ix_(kept, kept)])
        assert_near(found[..., k], wanted)
    # the noise is not asked where nothing narrows
    narrow = correct(mean[:, 1], covs[1], y[:, 1], parts[1], noise=lambda: 1 / 0)[1]
    np.testing.assert_array_equal(narrow, found[..., 1])


def test_what_slope_and_noise_do_not_explain_is_left():
    """A square seen besides: its variance is no noise, and the formulas would leave it out."""
    cov, slope = 2.0**30 * SMALL, SLOPE[:1]
    moments = measured(cov, slope, NOISE[:1, :1] + 2.0**26)
    plain = correct(np.zeros(3), cov, np.zeros(1), moments)[1]
    told = correct(np.zeros(3), cov, np.zeros(1), moments, noise=lambda: NOISE[:1, :1])[1]
    np.testing.assert_array_equal(plain, told)


@pytest.mark.parametrize("k", [0, 1, 2])
def test_one_component_that_narrows_is_enough(k):
    cov = np.stack([np.diag([2.0, 3.0, 5.0])] * 2, axis=-1)
    new = cov.copy()
    assert not narrowed(cov, new).any()
    new[k, k, 1] *= 0.9 * WIDE
    assert narrowed(cov, new).tolist() == [False, True]
    new[k, k, 1] = WIDE * cov[k, k, 1]
    assert not narrowed(cov, new).any()


def lost(component, claimed, noise=1.0, rest=1.0, paths=1):
    """Correct diagonal priors whose cov y is more than slope and noise, and listen."""
    cov = np.stack([np.diag([3.0, 5.0, 7.0])] * paths, axis=-1)
    new = 0.5 * cov
    new[component, component] = claimed * cov[component, component]
    cross = cov[:, component][:, None]
    spread = cov[component, component][None, None] + noise + rest
    before = new.copy()
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        suspect = narrowed(cov, new)
        correct_diffuse(cov, cross, spread, np.full((1, 1, paths), noise), suspect, new)
    np.testing.assert_array_equal(new, before)
    return [str(w.message) for w in heard]


@pytest.mark.parametrize("component", [0, 1, 2])
def test_a_variance_without_digits_is_told_by_its_name(component):
    found = lost(component, 0.5 * LOST)
    assert len(found) == 1
    assert found[0].startswith(f"cov: the variance of x{component + 1} fell below 1e-12")
    assert len(lost(component, 0.5 * LOST, paths=3)) == 1


def test_no_word_where_digits_are_left_or_nothing_is_noisy():
    assert lost(1, 2.0 * LOST) == []
    assert lost(1, 0.5 * LOST, noise=0.0) == []
    # of several paths one alone may be astray
    cov = np.stack([np.diag([3.0, 5.0])] * 2, axis=-1)
    new = 0.5 * cov
    new[0, 0, 0] *= LOST
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        spread = np.full((1, 1, 2), 9.0)
        correct_diffuse(
            cov, cov[:, :1], spread, np.ones((1, 1, 2)), np.array([True, False]), new
        )  # fmt: skip
