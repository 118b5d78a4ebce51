"""Forecasts fitted to samples, and likelihoods on a grid: against least squares and densities."""

import numpy as np
import pytest
import sympy

from seedslib.base.tables import Axis
from seedslib.design import grid_risk, synthesize
from seedslib.design.fitting import coefficients_of, fit_forecast
from seedslib.design.regression import scatter
from seedslib.design.tables.carriers import Lesson
from seedslib.design.tables.fitted import _log_density, _summed
from seedslib.designed import Memory
from seedslib.designed.memory import Past
from seedslib.designed.predictors import Affine, Polynomial, monomials, standardised
from seedslib.linearization import Taylor
from seedslib.models import Noise, SwitchingSystem

rng = np.random.default_rng(9)
N = 400
U = np.array([[1.3, 0.0], [0.5, 0.8]]) @ rng.normal(size=(2, N)) + [[0.4], [-0.7]]
X = np.stack([U[0] ** 2 - 0.3 * U[1], 0.5 * U[0] * U[1] + 1.0]) + 0.2 * rng.normal(size=(2, N))
SIZE = np.sqrt((U**2).mean(axis=1))


def hinted():
    """Two modes, an indicator that tells of them, sensors of their own."""
    x, v, w = sympy.symbols("x v w")
    return SwitchingSystem(
        (x,), [[0.9 * x + 0.4 + 0.3 * v], [0.5 * x - 0.7 + 0.8 * v]], Noise((v,)),
        [[0.85, 0.15], [0.3, 0.7]], [[x + 0.5 * w], [1.3 * x + 0.7 * w]], Noise((w,)),
        [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])], indicator=[[0.8, 0.2], [0.3, 0.7]],
    )  # fmt: skip


def gather(rows):
    return scatter(rows(X, U))


def least_squares(features, targets):
    known = np.vstack([features, np.ones(features.shape[1])])
    return np.linalg.lstsq(known.T, targets.T, rcond=None)[0].T @ known


def test_affine():
    fit = fit_forecast(Affine(), gather, 2, SIZE)
    wanted = least_squares(U, X)
    np.testing.assert_allclose(fit.mean(U), wanted, rtol=1e-8)
    np.testing.assert_allclose(fit.cov, np.cov(X - wanted, bias=True), rtol=1e-8)


@pytest.mark.parametrize("degrees", [(2, 1), (3, 0), (1, 2)])
def test_polynomials(degrees):
    """Of the memory in units of its deviations, cut at 3.5; the products of the errors too."""
    fit = fit_forecast(Polynomial(*degrees), gather, 2, SIZE)
    assert coefficients_of(Polynomial(*degrees), 2) == {1: 2, 2: 5, 3: 9}[max(degrees)]
    assert coefficients_of(Affine(), 7) == 7
    point = np.clip((U - U.mean(axis=1)[:, None]) / U.std(axis=1)[:, None], -3.5, 3.5)
    np.testing.assert_allclose(standardised(U, fit.centre, fit.scale), point, rtol=1e-9)
    wanted = least_squares(monomials(point, degrees[0]), X)
    np.testing.assert_allclose(fit.mean(U), wanted, rtol=1e-7, atol=1e-9)
    error = X - wanted
    np.testing.assert_allclose(fit.cov, np.cov(error, bias=True), rtol=1e-7)
    if degrees[1]:
        products = np.stack([error[0] ** 2, error[0] * error[1], error[1] ** 2])
        wanted = least_squares(monomials(point, degrees[1]), products)
        found = fit.cov_gain @ monomials(point, degrees[1]) + fit.cov_offset[:, None]
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)


def test_a_wide_prior_keeps_the_digits_of_what_is_left():
    """And what is constant beside its size is no regressor, before and after."""
    wide = 1e9 * rng.normal(size=(1, N))
    still = 1e-13 * rng.normal(size=N)
    memory, noise = np.stack([wide[0] + 0.3 * rng.normal(size=N), still]), np.zeros(1)
    fit = fit_forecast(Affine(), lambda rows: scatter(rows(wide, memory)), 1, np.array([1.0, 1.0]))
    assert fit.gain[0, 1] == 0.0
    error = wide - fit.mean(memory)
    assert abs(error.mean()) < 1e-2
    best = least_squares(memory[:1] / 1e9, wide - memory[:1]) + memory[:1]
    np.testing.assert_allclose(fit.cov, [[((wide - best) ** 2).mean()]], rtol=1e-3)
    # a constant component of a polynomial's memory drops out
    flat = np.stack([U[0], np.full(N, 2.0)])
    fit = fit_forecast(Polynomial(2, 1), lambda rows: scatter(rows(X, flat)), 2, SIZE)
    assert fit.scale[1] == noise[0]
    wanted = least_squares(monomials(standardised(U[:1], fit.centre[:1], fit.scale[:1]), 2), X)
    np.testing.assert_allclose(fit.mean(flat), wanted, rtol=1e-7, atol=1e-9)


def test_likelihoods_of_indicator_and_measurement():
    """Over the values of the indicator they add up to that of the measurement alone."""
    system, axis = hinted(), Axis(-2.0, 3.0, 5)
    states, modes = np.array([[0.3, -0.8, 1.4]]), np.array([1, 0, 1])
    lesson = Lesson(states, None, Past(), modes)
    found = _log_density(system, 0.0, lesson, (axis,))(slice(None)).reshape(3, 3, 5)
    part = _log_density(system, 0.0, lesson, (axis,))(slice(1, 3)).reshape(2, 3, 5)
    np.testing.assert_array_equal(part, found[1:])
    np.testing.assert_allclose(np.logaddexp(found[:, 0], found[:, 1]), found[:, 2], rtol=1e-9)
    grid = np.linspace(-2.0, 3.0, 5)[None]
    for path, mode in enumerate(modes):
        there = np.full((1, 5), states[0, path])
        for j in range(2):
            wanted = system.readings[mode][j].log_density(0.0, grid, there)
            np.testing.assert_allclose(found[path, j], wanted, rtol=1e-12)


def test_likelihoods_of_some_components():
    """Summed over the axes of the others, whichever they are."""
    whole = rng.normal(size=(4, 2, 3, 5, 2))
    axes = [3, 5, 2]
    for rows in ([0], [1], [2], [0, 1], [0, 2], [1, 2]):
        found = _summed(lambda part: whole[part].reshape(len(whole[part]), -1), axes, rows,
                        slice(1, 3))  # fmt: skip
        others = tuple(2 + i for i in range(3) if i not in rows)
        wanted = np.log(np.exp(whole[1:3]).sum(axis=others)).reshape(2, -1)
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)


def test_the_risk_of_a_filter_of_modes_is_that_on_paths():
    """With an indicator; on other paths than those of the design."""
    filter = synthesize(hinted(), Memory(1), Taylor(), np.arange(3.0), paths=4000, seed=1)
    risk = grid_risk(filter, x=(-7, 7, 57), z=(-6, 6, 25), y=(-11, 11, 45))
    held = filter.held_out
    apart = np.abs(np.sqrt(risk.mse) - held.rms[:, 0]) / held.error[:, 0]
    assert apart.max() < 4
    assert (np.abs(risk.mode_error - held.mode_rate) / held.mode_error).max() < 4
