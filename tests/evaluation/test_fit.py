"""Fits against dense Gaussian likelihoods, the Nile, and their own coverage."""

import logging
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import multivariate_normal

from oracles.linear import Regression
from seedslib.base import Parameter
from seedslib.designed import SwitchingFilter
from seedslib.evaluation import fit
from seedslib.filters import GridBayesFilter, KalmanFilter, ParticleFilter
from seedslib.linearization import Taylor
from seedslib.models import LinearSystem, Noise, SwitchingSystem
from systems import INPUTS, TIMES, linear_numbers, linear_system, record

NILE = np.loadtxt(Path(__file__).parents[1] / "data" / "nile.csv", delimiter=",", skiprows=1)[:, 1]
YEARS = np.arange(100.0)
Q, R = Parameter("q", 1000.0, positive=True), Parameter("r", 1e4, positive=True)


def dense(q, r):
    """Log-likelihood of the flows about a level that starts as N(1000, 1e5), by one matrix."""
    level = 1e5 + q * np.minimum.outer(YEARS, YEARS)
    return multivariate_normal.logpdf(NILE, np.full(100, 1000.0), level + r * np.eye(100))


@pytest.fixture(scope="module")
def nile():
    system = LinearSystem(1, Q, 1, R, 1000, 1e5)
    return fit(KalmanFilter(system), YEARS, NILE[:, None], [Q, R])


def test_maximum_and_errors_are_those_of_the_dense_likelihood(nile):
    best = minimize(lambda u: -dense(*np.exp(u)), np.log(nile.values), tol=1e-12)
    assert nile.converged
    assert nile.loglik == pytest.approx(-best.fun, abs=1e-9)
    assert np.allclose(nile.values, np.exp(best.x), rtol=1e-5)
    q, r = nile.values
    h, k = 1e-2 * q, 1e-2 * r
    here = dense(q, r)
    square = np.empty((2, 2))
    square[0, 0] = (dense(q + h, r) - 2 * here + dense(q - h, r)) / h**2
    square[1, 1] = (dense(q, r + k) - 2 * here + dense(q, r - k)) / k**2
    mixed = dense(q + h, r + k) - dense(q + h, r - k) - dense(q - h, r + k) + dense(q - h, r - k)
    square[0, 1] = square[1, 0] = mixed / (4 * h * k)
    assert np.allclose(nile.cov, np.linalg.inv(-square), rtol=1e-3)
    for level, width in ((0.95, 1.959964), (0.5, 0.674490)):
        low, high = nile.interval(level).T
        np.testing.assert_allclose((high - low) / 2, width * nile.errors, rtol=1e-6)
        np.testing.assert_allclose((high + low) / 2, nile.values)
    filter = KalmanFilter(LinearSystem(1, Q, 1, R, 1000, 1e5)).bind(nile.numbers)
    again = filter.run(YEARS, NILE[:, None])
    assert again.loglik.sum() == pytest.approx(nile.loglik, abs=1e-9)
    assert f"{q:.6g}" in str(nile)
    assert "not converged" not in str(nile)


def test_a_profile_is_the_largest_likelihood_of_the_others(nile):
    found = nile.profile(Q, [500.0, 3000.0])
    for value, point in zip(found, (500.0, 3000.0), strict=True):
        best = minimize(lambda u, q=point: -dense(q, *np.exp(u)), [np.log(1.5e4)], tol=1e-10)
        assert value == pytest.approx(-best.fun, abs=1e-6)
    with pytest.raises(ValueError, match="parameter"):
        nile.profile(Parameter("k", 1.0), [1.0])


def test_the_maximum_of_the_diffuse_likelihood_is_that_of_the_textbook():
    # Durbin and Koopman, Time Series Analysis by State Space Methods: 1469.1 and 15098.5
    system = LinearSystem(1, Q, 1, R, 0, 0, diffuse=(0,))
    found = fit(KalmanFilter(system), YEARS, NILE[:, None], [Q, R])
    assert found.values == pytest.approx([1469.18, 15098.5], rel=1e-5)


def test_records_with_gaps_and_inputs_of_their_own_are_fitted_by_the_sum_of_their_likelihoods():
    """The factor of an input, positive or any, against the regression of each record."""
    model = linear_numbers(means=False)
    F, cov, b = linear_system().dynamics.formulas
    H, noise, d = linear_system().sensor.formulas
    start = model.mean0, model.cov0
    own = {u: row[:, None] * [1.0, 0.3, -0.5] for u, row in INPUTS.items()}
    each = [
        linear_numbers(TIMES, {u: v[:, k] for u, v in own.items()}, means=False) for k in range(3)
    ]
    y = np.stack([record(one, seed)[1] for seed, one in enumerate(each)], axis=-1)

    def exact(g):
        models = (one._replace(b=g * one.b) for one in each)
        return sum(Regression(one).loglik(y[..., k]) for k, one in enumerate(models))

    best = minimize(lambda u: -exact(u[0]), [0.8], tol=1e-10)
    point = best.x[0]
    bend = (exact(point + 0.1) - 2 * exact(point) + exact(point - 0.1)) / 0.01
    for factor in (Parameter("g", 0.4), Parameter("g", 0.4, positive=True)):
        system = LinearSystem(F, cov, H, noise, *start, b=b * factor, d=d)
        found = fit(KalmanFilter(system), TIMES, y, [factor], inputs=own)
        assert found.converged
        assert found.values[0] == pytest.approx(point, rel=1e-5)
        assert found.loglik == pytest.approx(-best.fun, abs=1e-8)
        assert found.errors[0] == pytest.approx(1 / np.sqrt(-bend), rel=1e-4)


def test_indicators_of_each_record_are_told():
    """The maximum is that of the records one by one, each with its own indicators."""
    x, v, w = sp.symbols("x v w")
    level = Parameter("c", 0.2)
    system = SwitchingSystem(
        (x,),
        [[0.8 * x + v], [0.3 * x + 1 + v]],
        Noise((v,)),
        [[0.9, 0.1], [0.2, 0.8]],
        [[x + w], [x + level + w / 2]],
        Noise((w,)),
        [(0.5, [0], [[1]])] * 2,
        indicator=[[0.8, 0.2], [0.1, 0.9]],
    )
    times, bank = range(20), SwitchingFilter(system, Taylor())
    data = system.bind({level: 1.5}).simulate(times, 3, 1)
    y, shown = data.measurements, data.indicators
    found = fit(bank, times, y, [level], indicators=shown)

    def loglik(value):
        bound = bank.bind({level: value})
        runs = (bound.run(times, y[..., k], indicators=shown[:, k]) for k in range(3))
        return sum(run.loglik.sum() for run in runs)

    best = found.values[0]
    assert found.loglik == pytest.approx(loglik(best), abs=1e-8)
    assert loglik(best) > max(loglik(best + 0.05), loglik(best - 0.05))
    assert abs(best - 1.5) < 4 * found.errors[0]


def test_a_filter_on_a_grid_is_made_for_every_value():
    """Its chain takes in the values when it is made: a function that makes it is called."""
    x, v, w = sp.symbols("x v w")
    deviation = Parameter("s", 1.0, positive=True)
    system = SwitchingSystem(
        (x,),
        [[0.8 * x + 0.5 * v], [0.3 * x + 1 + 0.5 * v]],
        Noise((v,)),
        [[0.9, 0.1], [0.2, 0.8]],
        [[x + deviation * w]] * 2,
        Noise((w,)),
        [(0.5, [0], [[1]])] * 2,
    )
    axis, times = (-5.0, 5.0, 21), np.arange(15.0)
    bound = system.bind({deviation: 0.5})
    y = np.asarray(bound.simulate(times, 1, 2).measurements)[..., 0]
    made = lambda numbers: GridBayesFilter(system.bind(numbers), axis)  # noqa: E731
    found = fit(made, times, y, [deviation])

    def loglik(value):
        return made({deviation: value}).run(times, y).loglik.sum()

    best = found.values[0]
    assert found.converged
    assert found.loglik == pytest.approx(loglik(best), abs=1e-9)
    assert max(loglik(0.9 * best), loglik(1.1 * best)) < found.loglik
    bend = (loglik(best + 0.01) - 2 * loglik(best) + loglik(best - 0.01)) / 1e-4
    assert found.errors[0] == pytest.approx(1 / np.sqrt(-bend), rel=1e-2)


def test_a_line_of_each_step_goes_to_who_listens(caplog):
    with caplog.at_level(logging.INFO, logger="seedslib"):
        found = fit(KalmanFilter(LinearSystem(1, Q, 1, R, 1000, 1e5)), YEARS, NILE[:, None], [Q])
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0].startswith("fit: step 0, log-likelihood")
    assert f"{found.loglik:.6f}" in lines[-1]


def test_steps_that_meet_no_number_are_shortened():
    """The variance log(3 - a) is negative beyond a = 2, and none beyond 3; the start is far off."""
    times = np.arange(200.0)
    true = LinearSystem(0.9, 0.1, 1, 0.05, 0, 1)
    y = true.simulate(times, 1, 3).measurements[..., 0]
    a, r = Parameter("a", -20.0), Parameter("r", 1.0, positive=True)
    found = fit(KalmanFilter(LinearSystem(0.9, 0.1, 1, sp.log(3 - a), 0, 1)), times, y, [a])
    plain = fit(KalmanFilter(LinearSystem(0.9, 0.1, 1, r, 0, 1)), times, y, [r])
    assert found.converged
    assert plain.converged
    assert np.log(3 - found.values[0]) == pytest.approx(plain.values[0], rel=1e-5)
    assert found.loglik == pytest.approx(plain.loglik, abs=1e-8)


def test_a_start_beside_no_number_is_refused_by_name():
    a = Parameter("a", 1.9995)
    filter = KalmanFilter(LinearSystem(0.9, 0.1, 1, sp.log(3 - a), 0, 1))
    with pytest.raises(ValueError, match=r"free: .*1\.9995.*no number beside it in a"):
        fit(filter, YEARS, NILE[:, None], [a])


def test_a_parameter_at_its_bound_is_named_and_the_others_have_their_errors():
    """White noise has a level that does not move: the rest is a fit without its variance."""
    y = np.random.default_rng(0).standard_normal((100, 1))
    q, r = Parameter("q", 0.1, positive=True), Parameter("r", 2.0, positive=True)
    found = fit(KalmanFilter(LinearSystem(1, q, 1, r, 0, 1)), YEARS, y, [q, r])
    fixed = fit(KalmanFilter(LinearSystem(1, 0, 1, r, 0, 1)), YEARS, y, [r])
    assert not found.converged
    assert found.message == "q goes to zero, its bound"
    assert found.values[1] == pytest.approx(fixed.values[0], rel=1e-5)
    assert found.errors[1] == pytest.approx(fixed.errors[0], rel=1e-4)
    assert np.isnan(found.errors[0])


def test_a_likelihood_of_random_numbers_is_called_rough():
    q = Parameter("q", 0.5, positive=True)
    system = LinearSystem(0.9, q, 1, 1, 0, 1)
    y = system.simulate(range(30), 1, 1).measurements[..., 0]
    found = fit(ParticleFilter(system, 200), range(30), y, [q])
    assert not found.converged
    assert "rough in q" in found.message


@pytest.mark.parametrize("whole", [True, False])
def test_a_parameter_of_the_first_state_is_fitted(whole):
    """A stationary start of an autoregression, by formulas or a function, and its dense
    distribution."""
    phi = Parameter("phi", 0.5)
    formulas = KalmanFilter(LinearSystem(phi, 1, 1, 0.3, 0, 1 / (1 - phi**2)))

    def one(numbers):
        return KalmanFilter(LinearSystem(numbers[phi], 1, 1, 0.3, 0, 1 / (1 - numbers[phi] ** 2)))

    made = formulas if whole else one
    times = np.arange(60.0)
    y = LinearSystem(0.8, 1, 1, 0.3, 0, 1 / 0.36).simulate(times, 1, 4).measurements[..., 0]
    found = fit(made, times, y, [phi])

    def dense(value):
        cov = value ** np.abs(np.subtract.outer(times, times)) / (1 - value**2)
        return multivariate_normal.logpdf(y[:, 0], None, cov + 0.3 * np.eye(60))

    best = minimize_scalar(lambda u: -dense(u), bounds=(0.1, 0.99), options={"xatol": 1e-9})
    assert found.converged
    assert found.values[0] == pytest.approx(best.x, rel=1e-5)
    assert found.loglik == pytest.approx(-best.fun, abs=1e-9)


@pytest.mark.parametrize("step", [0.7, None])
def test_rates_of_a_continuous_system_are_fitted(step):
    """An Ornstein-Uhlenbeck process that reverts to a level, against its dense likelihood."""
    rate, noise = Parameter("rate", 1.0, positive=True), Parameter("noise", 1.0, positive=True)
    level = Parameter("level", 0.0)
    system = LinearSystem.from_continuous(
        -rate, noise, 1, 0.05, level, noise / (2 * rate), step=step, b=rate * level
    )
    rng = np.random.default_rng(5)
    times = 0.7 * np.arange(80.0) if step else np.cumsum(rng.choice([0.2, 0.5, 1.4], 80))
    true = system.bind(rate=0.6, noise=0.8, level=2.0)
    y = true.simulate(times, 1, 7).measurements[..., 0]

    def dense(theta, square, mean):
        cov = square / (2 * theta) * np.exp(-theta * np.abs(np.subtract.outer(times, times)))
        return multivariate_normal.logpdf(y[:, 0], np.full(80, mean), cov + 0.05 * np.eye(80))

    found = fit(KalmanFilter(system), times, y, [rate, noise, level])
    start = [*np.log(found.values[:2]), found.values[2]]
    best = minimize(lambda u: -dense(*np.exp(u[:2]), u[2]), start, tol=1e-12)
    assert found.converged
    assert found.loglik == pytest.approx(-best.fun, abs=1e-8)
    assert found.values == pytest.approx([*np.exp(best.x[:2]), best.x[2]], rel=1e-4)
    several = {rate: [0.6, 0.6, -0.3], noise: [0.8, 1.1, 0.8], level: [2.0, 0.0, 1.0]}
    records = KalmanFilter(system).bind(several).run(times, np.repeat(y[..., None], 3, 2))
    wanted = dense(0.6, 0.8, 2.0), dense(0.6, 1.1, 0.0)
    assert records.loglik.sum(axis=0)[:2] == pytest.approx(wanted, abs=1e-8)
    assert np.isnan(records.loglik[:, 2]).all()  # no covariance, so no likelihood


def test_parameters_that_the_data_do_not_tell_apart_are_not_converged():
    b, c = Parameter("b", 1.0, positive=True), Parameter("c", 2.0, positive=True)
    found = fit(KalmanFilter(LinearSystem(1, b * c, 1, R, 1000, 1e5)), YEARS, NILE[:, None], [b, c])
    assert not found.converged
    assert "not converged" in str(found)
    assert found.message.endswith("does not curve down along b, c: too many parameters")
    assert np.isnan(found.errors).all()
