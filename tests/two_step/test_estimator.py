"""The two-step estimator: functions of a linear state, exact errors, tables, steady laws."""

import numpy as np
import pytest
import sympy as sp

from oracles.diffusion import constant_diffusion, varying_diffusion
from seedslib.gaussian import fifth_degree, gauss_hermite, norm_mean
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion, TwoStepEstimator

X, Y, A, B = sp.symbols("x y a b", real=True)
SIGNAL = LinearDiffusion(-1, 0.5, 1, 0.1, [0.7], 4)
PLANAR = constant_diffusion()
GRID = np.linspace(0.1, 0.6, 26)

CLASSES = {
    "polynomial": X**2 * Y + Y**3 - X,
    "exponential-polynomial": sp.sin(X) * sp.exp(Y / 2),
    "tilt": sp.exp(-(X**2) - Y**2 / 3),
    "piecewise": sp.Max(X, Y),
    "norm": sp.sqrt(X**2 + Y**2),
}


def estimator(f, **options):
    return TwoStepEstimator(PLANAR, f, variables=[X, Y], **options)


@pytest.mark.parametrize("lead", [0.0, 0.4])
def test_the_power_of_a_signal_in_closed_form(lead):
    """x² under N(x̂, P): mean x̂² + P, variance 2 P² + 4 x̂² P; on average over x̂ ~ N(m, C - P)."""
    power = TwoStepEstimator(SIGNAL, X**2, variables=[X], lead=lead)
    assert power.kind == "polynomial"
    times = [0.0, 0.1, 1.1, 4.0]
    mean, c, p = (part.ravel() for part in KalmanBucyFilter(SIGNAL).moments(times, lead))
    optimal, plugin = power.errors(times)
    np.testing.assert_allclose(optimal, 2 * p**2 + 4 * p * (mean**2 + c - p), rtol=1e-12)
    np.testing.assert_allclose(plugin - optimal, p**2, rtol=1e-9)
    np.testing.assert_array_equal(power.mse_optimal(times), optimal)
    np.testing.assert_array_equal(power.mse_plugin(times), plugin)
    assert power.estimate([0.3], [[0.2]]) == pytest.approx(0.29, rel=1e-14)
    assert power.variance([0.3], [[0.2]]) == pytest.approx(0.08 + 4 * 0.09 * 0.2, rel=1e-14)
    assert power.plugin([0.3]) == pytest.approx(0.09, rel=1e-14)
    steady, late = power.steady_errors(), power.errors([40.0])
    np.testing.assert_allclose(np.ravel(steady), np.ravel(late), rtol=1e-9)
    if not lead:  # the steady loss depends on q / (r a²) alone
        loss = steady.plugin / steady.optimal - 1
        assert loss == pytest.approx(0.5 / np.sqrt(1 + 0.5 / 0.1), rel=1e-11)


@pytest.mark.parametrize("kind", CLASSES)
def test_closed_forms_against_quadrature_and_draws(kind):
    """Smooth functions agree closely with a rule; at a kink it converges only algebraically."""
    f = CLASSES[kind]
    ours, rule = estimator(f), estimator(f, quadrature=gauss_hermite(2, 32))
    assert (ours.kind, rule.kind) == (kind, "quadrature")
    accuracy = {"piecewise": 3e-2, "norm": 3e-2, "tilt": 1e-7}.get(kind, 1e-11)
    for exact, close in zip(ours.errors([0.1, 0.4]), rule.errors([0.1, 0.4]), strict=True):
        np.testing.assert_allclose(close, exact, rtol=accuracy)
    mean, cov = np.array([[0.4, -1.0], [0.2, 0.5]]), np.array([[0.4, 0.1], [0.1, 0.2]])
    for one, other in zip(
        (rule.estimate(mean, cov), rule.variance(mean, cov), rule.plugin(mean)),
        (ours.estimate(mean, cov), ours.variance(mean, cov), ours.plugin(mean)),
        strict=True,
    ):
        np.testing.assert_allclose(one, other, rtol=accuracy)
    mean, cov, error_cov = (part[0] for part in KalmanBucyFilter(PLANAR).moments([0.4]))
    rng = np.random.default_rng(4)
    guess = rng.multivariate_normal(mean, cov - error_cov, 50_000).T
    truth = ours.plugin(guess + rng.multivariate_normal([0, 0], error_cov, 50_000).T)
    for value, found in zip(
        ours.errors([0.4]), (ours.estimate(guess, error_cov), ours.plugin(guess)), strict=True
    ):
        squares = (truth - found) ** 2
        assert abs(squares.mean() - value[0]) < 4 * squares.std() / np.sqrt(squares.size)
    point = np.array([0.3, -0.8])  # no error of the state, no error of the function
    assert ours.estimate(point, np.zeros((2, 2))) == pytest.approx(float(ours.plugin(point)))
    assert ours.variance(point, np.zeros((2, 2))) == pytest.approx(0.0, abs=1e-14)


def test_vector_functions_by_closed_forms_and_by_an_exact_rule():
    f, cov = [X * Y, X**2], np.array([[0.4, 0.1], [0.1, 0.2]])
    both, mean = estimator(f), np.array([[0.4, -1.0], [0.2, 0.5]])
    np.testing.assert_allclose(
        both.estimate(mean, cov), [mean[0] * mean[1] + 0.1, mean[0] ** 2 + 0.4], rtol=1e-13
    )
    exact = np.zeros((2, 2, 2))
    for j, (m, n) in enumerate(mean.T):  # products of Gaussian variables, by Isserlis
        exact[0, 0, j] = m * m * 0.2 + n * n * 0.4 + 2 * m * n * 0.1 + 0.08 + 0.01
        exact[0, 1, j] = exact[1, 0, j] = 2 * m * n * 0.4 + 2 * m * m * 0.1 + 2 * 0.4 * 0.1
        exact[1, 1, j] = 4 * m * m * 0.4 + 2 * 0.16
    np.testing.assert_allclose(both.variance(mean, cov), exact, rtol=1e-12)
    rule = estimator(f, quadrature=fifth_degree(2))
    call = TwoStepEstimator(
        PLANAR, lambda p: np.stack([p[0] * p[1], p[0] ** 2]), quadrature=fifth_degree(2)
    )
    for other in (rule, call):
        np.testing.assert_allclose(other.variance(mean, cov), exact, rtol=1e-12)
        for one, two in zip(other.errors([0.0, 0.5]), both.errors([0.0, 0.5]), strict=True):
            assert one.shape == (2, 2, 2)
            np.testing.assert_allclose(one, two, rtol=1e-11)
    single = estimator(X**2).errors([0.0, 0.5])
    np.testing.assert_allclose(both.errors([0.0, 0.5]).optimal[:, 1, 1], single.optimal, rtol=1e-13)


def test_functions_of_state_and_estimate():
    """The length of the error has one optimal estimate, whatever the data; and a product."""
    length = estimator(sp.sqrt((X - A) ** 2 + (Y - B) ** 2), estimate_variables=[A, B])
    times = [0.0, 0.5]
    optimal, plugin = length.errors(times)
    for k, p in enumerate(KalmanBucyFilter(PLANAR).moments(times).error_cov):
        assert optimal[k] == pytest.approx(np.trace(p) - norm_mean([0, 0], p) ** 2, rel=1e-11)
        assert plugin[k] == pytest.approx(np.trace(p), rel=1e-12)
    cov = np.array([[0.4, 0.1], [0.1, 0.2]])
    np.testing.assert_allclose(
        length.estimate(np.ones((2, 3)), cov), norm_mean([0, 0], cov), rtol=1e-13
    )
    np.testing.assert_array_equal(length.plugin(np.ones((2, 3))), 0.0)
    for quadrature in (None, gauss_hermite(4, 3)):
        product = estimator(
            (X - A) * (Y - B) + A * Y, estimate_variables=[A, B], quadrature=quadrature
        )
        assert product.estimate([0.7, 0.3], cov) == pytest.approx(0.1 + 0.21, rel=1e-12)
        wanted = 0.4 * 0.2 + 0.1**2 + 0.7**2 * 0.2
        assert product.variance([0.7, 0.3], cov) == pytest.approx(wanted, rel=1e-12)


RUNS = {
    "polynomial": {"f": X**2 * Y + Y**3},
    "other function": {"f": sp.sin(X) + Y},
    "vector": {"f": [X * Y, X**2 - Y]},
    "lead": {"f": X**2 * Y + Y**3, "lead": 0.3},
    "lead, vector": {"f": [X * Y, sp.sin(Y)], "lead": 0.3},
}


@pytest.mark.parametrize("system", [PLANAR, varying_diffusion()])
@pytest.mark.parametrize("name", RUNS)
def test_run_and_table_are_the_two_steps_one_after_the_other(name, system):
    ours = TwoStepEstimator(system, variables=[X, Y], **RUNS[name])
    increments = system.simulate(GRID, 6, 1).increments.reshape(25, 2, 3, 2)
    run, table = ours.run(GRID, increments), ours.table(GRID)
    first, state = KalmanBucyFilter(system).run(GRID, increments), table.start[:, None, None]
    state = np.tile(state, (1, 3, 2))
    for k, t in enumerate(GRID):
        move, noise = system.transition(t, t + ours.lead)
        mean = np.tensordot(move, first.mean[k], 1)
        cov = move @ first.cov[k] @ move.T + noise
        np.testing.assert_allclose(run.mean[k], ours.estimate(mean, cov), rtol=1e-11, atol=1e-13)
        np.testing.assert_allclose(run.variance[k], ours.variance(mean, cov), rtol=1e-10)
        np.testing.assert_allclose(run.plugin[k], ours.plugin(mean), rtol=1e-11, atol=1e-13)
        value, variance = table.estimate(k, state)
        np.testing.assert_allclose(value, run.mean[k], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(variance, run.variance[k], rtol=1e-9, atol=1e-12)
        if k < 25:
            state = table.update(k, state, increments[k])
    one, _ = table.estimate(25, state[:, 1, 1])
    np.testing.assert_allclose(one, run.mean[25][..., 1, 1], rtol=1e-10)


def test_what_is_stored_for_the_power_are_the_coefficients_of_its_mean():
    """Section 2.5: x̂² + P, and 4 P x̂² + 2 P² for the variance."""
    times = np.linspace(0, 1, 26)
    table = TwoStepEstimator(SIGNAL, X**2, variables=[X]).table(times)
    p = KalmanBucyFilter(SIGNAL).moments(times).error_cov[:, 0, 0]
    powers = [int(k) for (k,) in table.exponents]
    for coefficients, wanted in (
        (table.mean_coefficients[:, 0], {0: p, 2: 1 + 0 * p}),
        (table.variance_coefficients[:, 0, 0], {0: 2 * p**2, 2: 4 * p}),
    ):
        for power in powers:
            np.testing.assert_allclose(
                coefficients[:, powers.index(power)], wanted.get(power, 0 * p), rtol=1e-12
            )


def test_smoothed_estimates_and_their_exact_errors():
    ours, times = estimator(X**2 + X * Y), np.linspace(0, 1, 51)
    sample = PLANAR.simulate(times, 1500, 7)
    found, exact = ours.smooth(times, sample.increments), ours.smoothed_errors(times)
    law = KalmanBucyFilter(PLANAR).smooth(times, sample.increments)
    np.testing.assert_allclose(found.mean[9], ours.estimate(law.mean[9], law.cov[9]), rtol=1e-12)
    for k in (0, 25):
        squares = (found.mean[k] - ours.plugin(sample.states[k])) ** 2
        assert abs(squares.mean() - exact.optimal[k]) < 4 * squares.std() / np.sqrt(1500)
    lagged = ours.smoothed_errors(times, lag=10).optimal
    assert (exact.optimal < lagged)[:30].all()
    assert (lagged < ours.errors(times).optimal)[:40].all()


@pytest.mark.parametrize("lead", [0.0, 0.4])
@pytest.mark.parametrize("sensor", [[[1.0, 0.0], [0.0, 1.0]], [[1.0, 0.0]]])
@pytest.mark.parametrize("growth", [0.0, 0.7])
def test_a_component_apart_changes_no_steady_error(growth, sensor, lead):
    """It wanders or grows, seen by a sensor of its own or by none."""
    system = LinearDiffusion(
        np.diag([-1.0, growth]), np.diag([0.5, 0.3]), sensor, 0.1 * np.eye(len(sensor)),
        [0.7, 0.0], np.diag([4.0, 1.0]),
    )  # fmt: skip
    for f in (X**2, [X, X**3]):
        found = TwoStepEstimator(system, f, variables=[X, Y], lead=lead).steady_errors()
        alone = TwoStepEstimator(SIGNAL, f, variables=[X], lead=lead).steady_errors()
        np.testing.assert_allclose(found.optimal, alone.optimal, rtol=1e-10)
        np.testing.assert_allclose(found.plugin, alone.plugin, rtol=1e-10)


def test_a_wandering_component_in_the_same_sensor_disturbs():
    system = LinearDiffusion(
        np.diag([-1.0, 0.0]), np.diag([0.5, 0.3]), [[1.0, 1.0]], 0.1, [0.0, 0.0], np.eye(2)
    )
    ours = TwoStepEstimator(system, X**2, variables=[X, Y])
    steady, late = ours.steady_errors(), ours.errors([40.0])
    np.testing.assert_allclose(np.ravel(steady), np.ravel(late), rtol=1e-8)
