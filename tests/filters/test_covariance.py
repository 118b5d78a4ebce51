"""Covariance filters in continuous time, nonlinear ones, and states that are known exactly."""

import numpy as np
import pytest
import sympy

from oracles.linear import Linear, Regression, constant, discretised, kalman, moment_rates, moments
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    KnownModeFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
)
from systems import (
    INPUTS,
    TIMES,
    U,
    continuous_numbers,
    continuous_system,
    growth,
    linear_numbers,
    record,
)

x, v, w = sympy.symbols("x v w", real=True)
t = sympy.Symbol("t")
FILTERS = [
    extended_kalman,
    assumed_density,
    unscented_kalman,
    cubature_kalman,
    lambda system: unscented_kalman(system, alpha=0.5, beta=2.0),
    lambda system: CovarianceFilter(system, GaussHermite(5)),
]
RULES = [Taylor(), ExactGaussian(), Unscented(), Unscented(0.5, 2, 0), Cubature(), GaussHermite(3)]
Y = record(linear_numbers())[1]
PUSH = INPUTS[U]


def moment_filter(move):
    """The Kalman filter of the reference system with moments moved by a function of the step."""
    model = continuous_numbers()
    sensor = model.sensor(TIMES, PUSH)
    return kalman(Linear(None, None, None, *sensor, model.mean0, model.cov0), Y, move)


def close(estimates, wanted, rtol):
    for name in ("mean", "cov", "loglik"):
        found, exact = getattr(estimates, name), getattr(wanted, name)
        np.testing.assert_allclose(found, exact, rtol=rtol, atol=rtol, err_msg=name)


# Continuous time, with jumps, inputs and gaps


@pytest.mark.parametrize("rule", RULES)
def test_jump_diffusion_equals_its_moment_equations(rule):
    """With state-dependent jumps; a first-order filter takes their square at the mean."""
    model, first_order = continuous_numbers(), isinstance(rule, Taylor)

    def move(k, m, P):
        return moments(model, TIMES[k], TIMES[k + 1], m, P, PUSH[k], first_order=first_order)

    filter, wanted = CovarianceFilter(continuous_system(step=0.05), rule), moment_filter(move)
    close(filter.run(TIMES, Y, inputs={U: PUSH}), wanted, 3e-6)
    state = filter.initial((1,))
    for k, now in enumerate(TIMES[:3]):
        state = filter.predict(state, now, inputs={U: PUSH[max(k - 1, 0)]})
        state = filter.correct(state, Y[k, :, None], inputs={U: PUSH[k]})
    np.testing.assert_allclose(state.mean[:, 0], wanted.mean[2], rtol=3e-6)
    ahead = filter.forecast(
        filter.predict(state, 2.8, inputs={U: PUSH[2]}), TIMES[3], inputs={U: PUSH[2]}
    )
    np.testing.assert_allclose(ahead.mean[:, 0], wanted.predicted_mean[3], rtol=3e-6)


def test_euler_steps_take_their_rates_at_their_beginning():
    """Long steps written out; the step of the system is the default, and the last one ends it."""
    model = continuous_numbers()

    def move(k, m, P):
        start, stop = TIMES[k], TIMES[k + 1]
        steps = int(np.ceil((stop - start) / 0.2 - 1e-9))
        h = (stop - start) / steps
        for j in range(steps):
            rates = moment_rates(model, start + j * h, m, P, PUSH[k], first_order=True)
            m, P = m + h * rates[0], P + h * rates[1]
        return m, P

    filter = extended_kalman(continuous_system(step=0.2), integrator="euler")
    close(filter.run(TIMES, Y, inputs={U: PUSH}), moment_filter(move), 1e-11)


def test_runge_kutta_is_of_order_four():
    system, wanted = (
        continuous_system(jumps=False),
        discretised(continuous_numbers(jumps=False), TIMES, PUSH),
    )
    exact = Regression(wanted).filtered(Y)[0]
    errors = [
        np.abs(extended_kalman(system, step=h).run(TIMES, Y, inputs={U: PUSH}).mean - exact).max()
        for h in (0.1, 0.05)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.4)


def test_threads_and_blocks_give_equal_bits():
    filter = extended_kalman(growth())
    times = np.arange(4.0)
    y = growth().simulate(times, 9000, 3).measurements
    one, two = (filter.run(times, y, workers=count) for count in (1, 2))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
    alone = filter.run(times, y[..., 8999])
    np.testing.assert_allclose(alone.mean, one.mean[..., 8999], rtol=1e-12)


# Nonlinear systems in discrete time


# Exact sensors, known states, outliers


@pytest.mark.parametrize("make", FILTERS[:4])
def test_state_that_is_known_exactly_stays_so(make):
    rng = np.random.default_rng(4)
    a, start, none = rng.standard_normal((4, 4)) / 4, rng.standard_normal(4), np.zeros((4, 4))
    system = LinearSystem(a, none, np.ones((1, 4)), 1, start, none)
    estimates = make(system).run(np.arange(30.0), rng.standard_normal((30, 1)))
    wanted = [np.linalg.matrix_power(a, k) @ start for k in range(30)]
    np.testing.assert_allclose(estimates.mean, wanted, rtol=1e-9, atol=1e-15)
    assert (estimates.cov == 0).all()


SURE = SwitchingSystem(
    (x,), [[x]] * 2, Noise(), [[0.9, 0.1], [0.2, 0.8]], [[x]] * 2, Noise(), [(0.5, [0], [[1]])] * 2
)
STILL = DiscreteSystem(
    StochasticMap((x,), [x], Noise()), StochasticMap((x,), [x], Noise()), [0], [[1]]
)


@pytest.mark.parametrize(
    "make",
    [
        lambda: KalmanFilter(LinearSystem(1, 0, 1, 0, 0, 1)),
        *(lambda make=make: make(STILL) for make in FILTERS),
        lambda: KnownModeFilter(SURE),
        lambda: RaoBlackwellFilter(SURE, 10),
    ],
)
def test_what_an_exact_sensor_has_measured_once_is_so(make):
    filter, y = make(), np.full((6, 1, 3), 1.3)
    y[3, 0, 1:] = 1.3 * (1 + 1e-12), 1.4
    options = {"modes": np.zeros((6, 3), dtype=int)} if "modes" in filter.takes else {}
    estimates = filter.run(np.arange(6.0), y, **options)
    assert not estimates.diverged.any()
    assert np.isfinite(estimates.loglik).all()
    np.testing.assert_allclose(estimates.mean, 1.3)


@pytest.mark.parametrize("make", [KalmanFilter, *FILTERS])
def test_outlier_of_a_million_deviations_is_filtered_as_any_other(make):
    model = constant(0.9, 0.3, 1, 0.5, 0, 1, 7)
    y = np.array([0.3, -1.0, 0.2, 1e6, 0.1, np.nan, 0.4, -0.6])[:, None]
    estimates = make(LinearSystem(0.9, 0.3, 1, 0.5, 0, 1)).run(np.arange(8.0), y)
    assert not estimates.diverged
    close(estimates, kalman(model, y), 1e-9)


def test_mean_beyond_the_bound_has_diverged():
    """One that is as far as the bound has not; in a run it counts at any time."""
    system = LinearSystem(np.eye(2), np.eye(2), np.eye(2), 0 * np.eye(2), [0, 0], np.eye(2))
    filter = extended_kalman(system, bound=3.0)
    y = np.array([[3.0, -3.5, 1.0, 0.0], [2.0, 1.0, -3.0, np.nextafter(3.0, 4.0)]])
    state = filter.step(filter.initial((4,)), 0.0, y)
    assert filter.report(state).diverged.tolist() == [False, True, False, True]
    estimates = filter.run([0.0, 1.0], np.stack([y, 0 * y]))
    assert estimates.diverged.tolist() == [False, True, False, True]
    assert extended_kalman(system).report(state).diverged is None


@pytest.mark.parametrize("options", [{}, {"integrator": "euler"}])
def test_path_that_overflows_has_diverged_alone(options):
    """Of two records, and of one, whose numbers are plain floats."""
    system = JumpDiffusion(
        (x,),
        [x**101 - 20 * x],
        [[1]],
        [x + v / 100],
        Noise((v,)),
        [1.0],
        [[1000.0]],
        step=0.02,
    )
    filter, y = extended_kalman(system, **options), np.array([[[0.0, 9.0]], [[0.0, 0.0]]])
    estimates = filter.run([0.0, 1.0], y)
    assert estimates.diverged.tolist() == [False, True]
    assert np.isfinite(estimates.mean[..., 0]).all()
    assert filter.run([0.0, 1.0], y[..., 1]).diverged


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("start", [0.0, 0.3])
def test_points_follow_a_known_position_that_is_driven_through_its_velocity(order, start):
    """In the first stages of a step its variance is zero and its covariance is not."""
    pick = np.array(order)
    state, noise = np.array([x, v])[pick], np.array([[0], [1]])[pick]
    drift, cov0 = np.array([v, -v / 2])[pick], np.diag([0.0, start])[np.ix_(pick, pick)]
    system = JumpDiffusion(state, drift, noise, [x + w], Noise([w]), [0, 0], cov0, step=0.1)
    wanted = extended_kalman(system).run(TIMES, Y[:, :1])
    for filter in (unscented_kalman(system), cubature_kalman(system)):
        close(filter.run(TIMES, Y[:, :1]), wanted, 1e-12)
