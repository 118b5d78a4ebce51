"""Fits against dense Gaussian likelihoods, the Nile, and their own coverage."""

from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from seedslib.base import Parameter, assigned
from seedslib.evaluation import fit
from seedslib.filters import GridBayesFilter, KalmanFilter, extended_kalman
from seedslib.models import JumpDiffusion, LinearSystem, Noise, SwitchingSystem

DATA = Path(__file__).resolve().parents[2] / "benchmarks" / "data"
NILE = np.loadtxt(DATA / "nile.csv", delimiter=",", skiprows=1)[:, 1]
YEARS = np.arange(100.0)
Q, R = Parameter("q", 1000.0, positive=True), Parameter("r", 1e4, positive=True)


def dense(q, r):
    """Log-likelihood of the flows about a level that starts as N(1000, 1e5), by one matrix."""
    level = 1e5 + q * np.minimum.outer(YEARS, YEARS)
    return multivariate_normal.logpdf(NILE, np.full(100, 1000.0), level + r * np.eye(100))


@pytest.fixture(scope="module")
def nile():
    system = LinearSystem(1, Q, 1, R, 1000, 1e5)
    return fit(KalmanFilter(system), YEARS, NILE[:, None], [Q, R], starts=2)


def test_the_maximum_is_that_of_the_dense_likelihood(nile):
    best = minimize(lambda u: -dense(*np.exp(u)), np.log(nile.values), tol=1e-12)
    assert nile.converged
    assert nile.loglik == pytest.approx(-best.fun, abs=1e-9)
    assert np.allclose(nile.values, np.exp(best.x), rtol=1e-5)
    assert np.allclose(nile.tried[:, -1], nile.loglik, atol=1e-5)


def test_standard_errors_are_those_of_the_dense_likelihood(nile):
    q, r = nile.values
    h, k = 1e-2 * q, 1e-2 * r
    here = dense(q, r)
    square = np.empty((2, 2))
    square[0, 0] = (dense(q + h, r) - 2 * here + dense(q - h, r)) / h**2
    square[1, 1] = (dense(q, r + k) - 2 * here + dense(q, r - k)) / k**2
    mixed = dense(q + h, r + k) - dense(q + h, r - k) - dense(q - h, r + k) + dense(q - h, r - k)
    square[0, 1] = square[1, 0] = mixed / (4 * h * k)
    assert np.allclose(nile.cov, np.linalg.inv(-square), rtol=1e-3)
    width = (nile.interval()[:, 1] - nile.interval()[:, 0]) / (2 * nile.errors)
    assert width == pytest.approx([1.959964, 1.959964], abs=1e-6)


def test_the_textbook_maximum_of_the_diffuse_likelihood():
    # Durbin and Koopman, Time Series Analysis by State Space Methods: 1469.1 and 15098.5
    system = LinearSystem(1, Q, 1, R, 0, 0, diffuse=(0,))
    found = fit(KalmanFilter(system), YEARS, NILE[:, None], [Q, R])
    assert found.values == pytest.approx([1469.18, 15098.5], rel=1e-5)


def test_a_profile_is_the_largest_likelihood_of_the_others(nile):
    found = nile.profile(Q, [500.0, 3000.0])
    for value, point in zip(found, (500.0, 3000.0), strict=True):
        best = minimize(lambda u, q=point: -dense(q, *np.exp(u)), [np.log(1.5e4)], tol=1e-10)
        assert value == pytest.approx(-best.fun, abs=1e-6)


def test_three_parameters_of_a_jump_diffusion_are_found_again():
    x, v, z = sp.symbols("x v z")
    a, q, r = Parameter("a", 0.5), Parameter("q", 0.5, positive=True), Parameter("r", 0.5)
    system = JumpDiffusion(
        [x], [-a * x], [[q]], [x + r * v], Noise((v,)), [0], [[1]], intensity=0.2, jump=[1.5 * z],
        marks=Noise((z,)), step=0.1,
    )  # fmt: skip
    times = np.arange(0, 20, 0.1)
    truth = {a: 1.0, q: 0.8, r: 0.3}
    with assigned(truth):
        y = system.simulate(times, 8, 3).measurements
    found = fit(extended_kalman(system), times, y, [a, q, r], bounds={r: (0.01, 2.0)})
    # the filter takes the jumps for noise of their variance, so the truth is near
    assert found.converged
    assert np.all(np.abs(found.values - list(truth.values())) < 4 * found.errors)
    with found.assigned():
        again = extended_kalman(system).run(times, y).loglik.sum()
    assert again == pytest.approx(found.loglik, abs=1e-8)


def test_a_filter_on_a_grid_is_made_for_every_value():
    """Its chain takes in the values when it is made: a function that makes it is called."""
    x, v, w = sp.symbols("x v w")
    shift, deviation = Parameter("b", 0.5), Parameter("s", 1.0, positive=True)

    def system(b, s):
        return SwitchingSystem(
            (x,), [[0.8 * x + 0.5 * v], [0.3 * x + b + 0.5 * v]], Noise((v,)),
            [[0.9, 0.1], [0.2, 0.8]], [[x + s * w], [x + s * w]], Noise((w,)),
            [(0.5, [0], [[1]])] * 2,
        )  # fmt: skip

    axis, times = (-5.0, 5.0, 81), np.arange(40.0)
    y = np.asarray(system(1.5, 0.5).simulate(times, 1, 2).measurements)[..., 0]
    named = system(shift, deviation)
    found = fit(lambda: GridBayesFilter(named, axis), times, y, [deviation])
    wanted = GridBayesFilter(system(0.5, found.values[0]), axis).run(times, y).loglik.sum()
    assert found.converged
    assert found.loglik == pytest.approx(wanted, abs=1e-9)
    for factor in (0.9, 1.1):
        other = GridBayesFilter(system(0.5, factor * found.values[0]), axis)
        assert other.run(times, y).loglik.sum() < found.loglik


def test_intervals_cover_the_truth():
    a, r = Parameter("a", 0.5), Parameter("r", 1.0, positive=True)
    system = LinearSystem(a, 1, 1, r, 0, 1)
    filter, times, covered = KalmanFilter(system), np.arange(80.0), []
    with assigned({a: 0.7, r: 0.5}):
        y = system.simulate(times, 20, 1).measurements
    for path in range(20):
        low, high = fit(filter, times, y[..., path], [a, r]).interval()[0]
        covered.append(low < 0.7 < high)
    # 95 per cent of 20 are 19, with a standard error of 1
    assert sum(covered) >= 16


def test_too_many_parameters_are_told():
    b, c = Parameter("b", 1.0, positive=True), Parameter("c", 2.0, positive=True)
    found = fit(KalmanFilter(LinearSystem(1, b * c, 1, R, 1000, 1e5)), YEARS, NILE[:, None], [b, c])
    assert not found.converged
    assert "too many parameters" in found.message
    assert "not converged" in str(found)
    assert np.isnan(found.errors).all()


def test_what_cannot_be_fitted_is_refused():
    filter = KalmanFilter(LinearSystem(1, Q, 1, R, 1000, 1e5))
    y = NILE[:, None]
    with pytest.raises(TypeError, match="free: wanted parameters of the model"):
        fit(filter, YEARS, y, [sp.Symbol("q")])
    with pytest.raises(TypeError, match="free: wanted parameters"):
        fit(filter, YEARS, y, [])
    with pytest.raises(ValueError, match="free: wanted parameters of the model, got k"):
        fit(filter, YEARS, y, [Parameter("k", 1.0)])
    with pytest.raises(ValueError, match="start: wanted a value between 0 and 10, got 1000"):
        fit(filter, YEARS, y, [Q], bounds={Q: (0.0, 10.0)})
    with pytest.raises(ValueError, match="bounds: wanted a lower one first"):
        fit(filter, YEARS, y, [Q], bounds={Q: (2.0, 1.0)})
    with pytest.raises(ValueError, match="bounds: wanted those of free parameters"):
        fit(filter, YEARS, y, [Q], bounds={R: (0.0, 1.0)})

    class Silent(KalmanFilter):
        def run(self, *arguments, **options):
            return super().run(*arguments, **options)._replace(loglik=None)

    with pytest.raises(ValueError, match="gives no likelihood"):
        fit(Silent(filter.system), YEARS, y, [Q])
    with pytest.raises(ValueError, match="gives no likelihood"):
        fit(lambda: Silent(filter.system), YEARS, y, [Q])
