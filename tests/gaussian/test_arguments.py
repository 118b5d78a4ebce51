"""What every mean and error owes its caller: aligned batches, and no silent overflow."""

import numpy as np
import pytest
import sympy as sp
from scipy.stats import norm

from seedslib.gaussian import (
    approximate_errors,
    bivariate_normal_cdf,
    elevation_moments,
    expectation_function,
    mean_square_errors,
    posterior_variance_function,
)

x, y = sp.symbols("x y", real=True)
FUNCTIONS = {
    "polynomial": [x**2 * y, x],
    "exponential": sp.exp(x / 3) * sp.sin(y),
    "tilt": sp.exp(-(x**2) / 3),
    "piecewise": [sp.Abs(x - y), x * y],
    "one coordinate": sp.Max(y, 0),
    "norm": sp.sqrt(x**2 + y**2),
}


@pytest.mark.parametrize("make", [expectation_function, posterior_variance_function])
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize(
    ("batch", "of_cov"), [((3, 3), (3,)), ((2, 3), (3,)), ((2, 4, 3), (4, 3)), ((2, 0), (0,))]
)
@pytest.mark.parametrize("rank", [0, 1, 2])
def test_batch_axes_are_aligned_at_the_end(make, name, batch, of_cov, rank):
    rng = np.random.default_rng(4)
    function = make(FUNCTIONS[name], [x, y])
    mean, factor = rng.normal(size=(2, *batch)), rng.normal(size=(2, rank, *of_cov))
    cov = np.einsum("ik...,jk...->ij...", factor, factor)
    result = function(mean, cov)
    assert result.shape[result.ndim - len(batch) :] == batch
    whole = np.broadcast_to(
        cov.reshape(2, 2, *(1,) * (len(batch) - len(of_cov)), *of_cov), (2, 2, *batch)
    )
    for index in np.ndindex(*batch):
        one = function(mean[:, *index], whole[:, :, *index])
        assert result[..., *index] == pytest.approx(one, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize(
    ("f", "mean"), [(x**4, 1e80), (sp.exp(x), 800.0), (sp.cosh(x), -800.0), (x * sp.Abs(x), 1e160)]
)
def test_overflow_is_refused(f, mean):
    for call in (
        lambda: expectation_function(f, [x])([mean], [[1.0]]),
        lambda: posterior_variance_function(f, [x])([mean], [[1.0]]),
        lambda: mean_square_errors(f, [x])([mean], [[1.0]], [[0.5]]),
    ):
        with pytest.raises(ValueError, match=r"mean, cov.*range of float64"):
            call()


@pytest.mark.parametrize("f", [(-2) ** x, (-2) ** (-x), sp.exp(sp.acos(2) * x), sp.acos(2) * x])
def test_complex_values_without_a_conjugate_are_refused(f):
    with pytest.raises(ValueError, match="f: wanted real"):
        expectation_function(f, [x])


@pytest.mark.parametrize(
    "f", [-sp.oo * x, sp.exp(1000) * x, sp.exp(x + 1000), sp.Float("1e310") * x, 0**x]
)
def test_coefficients_out_of_range_are_refused(f):
    with pytest.raises(ValueError, match="f: wanted"):
        expectation_function(f, [x])


def test_coefficients_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match="f: wanted numbers"):
        expectation_function(sp.Function("g")(2) * x, [x])


def test_poles_of_an_approximated_function_are_refused():
    with pytest.raises(ValueError, match="wanted finite values"):
        approximate_errors(sp.log(x), [x])([0.0], [[1.0]], [[0.5]])


@pytest.mark.parametrize("rho", [-1.0, -1 + 1e-12, 0.0, 0.5, 1 - 1e-16, 1.0])
def test_far_limits_of_the_bivariate_law(rho):
    assert bivariate_normal_cdf(1e308, 0.3, rho) == pytest.approx(norm.cdf(0.3), rel=1e-14)
    assert bivariate_normal_cdf(-1e200, 1e150, rho) == 0.0
    assert bivariate_normal_cdf(1e-300, 1e150, rho) == pytest.approx(0.5, rel=1e-14)


@pytest.mark.parametrize("unit", [1e-150, 1e150])
def test_elevation_does_not_depend_on_the_unit_of_length(unit):
    mean, cov = np.array([1.0, 0.5, 0.7]), np.array([[1, 0.2, 0], [0.2, 2, 0.1], [0, 0.1, 0.5]])
    near = elevation_moments(mean, cov)
    assert elevation_moments(unit * mean, unit**2 * cov) == pytest.approx(near, rel=1e-12)


@pytest.mark.parametrize("mean", [1e2, 1e5, 1e8, 1e12, 1e17, 1e100])
def test_errors_far_from_the_kink_are_those_of_the_polynomial_there(mean):
    law = [mean], [[1.0]], [[0.3]]
    for f, smooth in ((sp.Abs(x), x), (x * sp.Abs(x), x**2), (sp.Max(x, 0) ** 2, x**2)):
        errors, known = (mean_square_errors(g, [x])(*law) for g in (f, smooth))
        assert errors == pytest.approx(known, rel=1e-13)


@pytest.mark.parametrize(("size", "far"), [(3, 1e8), (4, 1e3), (5, 1e6), (7, 1e5), (9, 1e8)])
def test_norm_far_from_the_origin_is_almost_linear(size, far):
    """From ``|y| = r + u + |v|^2/2r - u|v|^2/2r^2``: to the order 1/r^2 the prior cancels."""
    state = sp.symbols(f"s:{size}", real=True)
    errors = mean_square_errors(sp.sqrt(sum(s**2 for s in state)), state)
    mean, share = np.eye(size)[0] * far, 0.3
    optimal, plugin = errors(mean, np.eye(size), share * np.eye(size))
    across = (size - 1) / far**2
    lost = -0.5 * share**2 * across
    assert optimal == pytest.approx(share + lost, rel=1e-10, abs=1e-3 * abs(lost) + 4e-15)
    bias = share**2 * ((size - 1) / (2 * far)) ** 2
    assert plugin - optimal == pytest.approx(bias, rel=1e-2, abs=4e-15)
