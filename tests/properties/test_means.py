"""Distributions that every mean under a Gaussian obeys, whatever the function and the Gaussian."""

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from oracles.drawn import EIGHTHS, covariances, vectors
from seedslib.gaussian import (
    abs_moments,
    bivariate_normal_cdf,
    elevation_moments,
    expectation,
    expectation_function,
    max_moments,
    norm_mean,
    sine_moments,
)

A, B = STATE = sp.symbols("a b", real=True)
FUNCTIONS = {
    "polynomial": A**3 * B - 2 * A * B + B**2,
    "exponential": sp.exp(-(A**2) / 4 + B / 8),
    "half-plane": sp.Piecewise((A * B, A > B), (0, True)),
    "modulus": sp.Abs(A + 2 * B),
}
MEANS = {name: expectation_function(f, STATE) for name, f in FUNCTIONS.items()}
SWAPPED = {name: expectation_function(f, (B, A)) for name, f in FUNCTIONS.items()}


def close(found, wanted, scale=1.0, rtol=1e-11):
    np.testing.assert_allclose(found, wanted, rtol=rtol, atol=rtol * scale)


@given(vectors(2), covariances(2), EIGHTHS, EIGHTHS)
def test_they_are_linear(mean, cov, c, d):
    whole = expectation_function(c * FUNCTIONS["polynomial"] + d * FUNCTIONS["modulus"], STATE)
    parts = c * MEANS["polynomial"](mean, cov), d * MEANS["modulus"](mean, cov)
    close(whole(mean, cov), sum(parts), 1 + sum(map(abs, parts)))


@given(
    vectors(2, st.integers(-3, 3)),
    vectors((2, 2), st.integers(-2, 2)),
    vectors((2, 2), st.integers(-2, 2)),
)
def test_the_mean_of_the_mean_given_a_part_is_the_mean(mean, one, other):
    """E f(z + w) in two steps, in exact fractions: first over w, then over z."""

    def exact(part):
        return sp.Matrix(part.astype(int).tolist())

    first, second = (exact(root @ root.T) for root in (one, other))
    given_z = expectation(FUNCTIONS["polynomial"], STATE, list(STATE), second)
    both = expectation(FUNCTIONS["polynomial"], STATE, list(exact(mean[:, None])), first + second)
    assert sp.expand(expectation(given_z, STATE, list(exact(mean[:, None])), first) - both) == 0
    np.testing.assert_allclose(
        MEANS["polynomial"](mean, np.array((first + second).tolist(), dtype=float)),
        float(both),
        rtol=1e-12,
        atol=1e-9,
    )


@pytest.mark.parametrize("name", MEANS)
@given(mean=vectors(2), cov=covariances(2))
def test_names_of_the_components_do_not_matter(name, mean, cov):
    one, other = MEANS[name](mean, cov), SWAPPED[name](mean[::-1], cov[::-1, ::-1])
    close(other, one, 1 + abs(one))


@given(vectors(2), covariances(2), st.sampled_from([1e-140, 1e-9, 0.5, 1e7, 1e140]), EIGHTHS)
def test_units_and_origin_of_a_maximum(mean, cov, unit, shift):
    one, other = max_moments(mean, cov), max_moments(unit * mean, unit**2 * cov)
    close(other.mean / unit, one.mean, rtol=1e-12)
    close(other.var / unit**2, one.var, 1e-12 + np.trace(cov), rtol=1e-12)
    moved, turned = max_moments(mean + shift, cov), max_moments(mean[::-1], cov[::-1, ::-1])
    close(moved.mean, one.mean + shift, 10.0, rtol=1e-13)
    close([turned.mean, turned.var], [one.mean, one.var], 1 + np.trace(cov), rtol=1e-13)


@given(
    vectors(3), covariances(3), st.sampled_from([1e-100, 0.25, 1e100]), st.permutations(range(3))
)
def test_units_and_order_of_a_norm(mean, cov, unit, order):
    one = norm_mean(mean, cov)
    close(norm_mean(unit * mean, unit**2 * cov) / unit, one, rtol=1e-13)
    close(norm_mean(mean[order], cov[np.ix_(order, order)]), one, 1e-300, rtol=1e-13)
    # the triangle inequality, and that of Jensen from both sides
    assert np.linalg.norm(mean) * (1 - 1e-14) <= one
    assert one <= np.sqrt(mean @ mean + np.trace(cov)) * (1 + 1e-14)


@given(EIGHTHS, st.integers(0, 40), st.integers(-3, 3))
def test_turns_and_reflections(mean, var, turns):
    one, turned = (sine_moments(m, var / 8) for m in (mean, mean + 2 * np.pi * turns))
    close([turned.mean, turned.var], [one.mean, one.var], rtol=1e-13)
    back = sine_moments(-mean, var / 8)
    assert (back.mean, back.var) == (-one.mean, one.var)
    modulus, other = abs_moments(mean, var / 8), abs_moments(-mean, var / 8)
    assert (modulus.mean, modulus.var) == (other.mean, other.var)
    close(modulus.mean**2 + modulus.var, mean**2 + var / 8, rtol=1e-14)


@given(vectors(3), covariances(3, floor=0.5), st.sampled_from([1e-3, 1.0, 1e6]))
def test_an_elevation_has_no_unit_and_no_azimuth(mean, cov, unit):
    """Of a distribution that is round about the axis: turned by a right angle it is the same."""
    mean = mean + np.array([0.0, 0.0, 1.0]) * (mean[2] == 0)
    cov = np.diag([cov[0, 0], cov[0, 0], cov[2, 2]])
    one = elevation_moments(mean, cov)
    for m, c in ((unit * mean, unit**2 * cov), (mean[[1, 0, 2]], cov)):
        other = elevation_moments(m, c)
        close([other.mean, other.var], [one.mean, one.var], rtol=1e-8)
    below = elevation_moments(mean * [1, 1, -1], cov)
    close([below.mean, below.var], [-one.mean, one.var], rtol=1e-8)


@given(EIGHTHS, EIGHTHS, st.integers(-8, 8).map(lambda k: k / 8))
def test_quarters_of_the_plane_make_the_plane(h, k, rho):
    quarters = [bivariate_normal_cdf(s * h, t * k, s * t * rho) for s in (1, -1) for t in (1, -1)]
    close(sum(quarters), 1.0, rtol=1e-14)
    assert bivariate_normal_cdf(h, k, rho) == pytest.approx(
        bivariate_normal_cdf(k, h, rho), abs=2e-16
    )
    assert min(quarters) >= 0
