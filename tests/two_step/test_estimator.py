import numpy as np
import pytest
import sympy as sp
from scipy.optimize import minimize_scalar

from seedslib.gaussian import (
    NoClosedForm,
    abs_errors,
    fifth_degree,
    gauss_hermite,
    max_errors,
    norm_mean,
    sine_errors,
)
from seedslib.two_step import KalmanBucyFilter, LinearDiffusion, TwoStepEstimator

X, Y, A, B = sp.symbols("x y a b", real=True)
SIGNAL = LinearDiffusion(-1, 0.5, 1, 0.1, [0], 4)
POWER = TwoStepEstimator(SIGNAL, X**2, variables=[X])
PLANAR = LinearDiffusion(
    [[0.2, 1], [-2, -0.3]],
    [[0.4, 0.1], [0.1, 0.2]],
    [[1, 0.5]],
    0.2,
    [1, -1],
    [[0.5, 0.1], [0.1, 0.3]],
)
GRID = np.linspace(0, 1, 51)


def loss(times, estimator=POWER):
    optimal, plugin = estimator.errors(times)
    return 100 * (plugin / optimal - 1)


# ---------------------------------------------------------------- example 6


def test_example_6_table():
    times = [0, 0.1, 0.3, 0.5, 1.1, 2, 4]
    optimal = [32, 8.613391, 2.351369, 1.140823, 0.347983, 0.142768, 0.103658]
    plugin = [48, 9.144052, 2.424566, 1.175266, 0.369575, 0.163785, 0.124668]
    np.testing.assert_allclose(POWER.mse_optimal(times), optimal, atol=5.01e-7, rtol=0)
    np.testing.assert_allclose(POWER.mse_plugin(times), plugin, atol=5.01e-7, rtol=0)
    np.testing.assert_allclose(
        loss(times), [50, 6.161, 3.113, 3.019, 6.205, 14.721, 20.269], atol=5.01e-4, rtol=0
    )
    steady = POWER.steady_errors()
    law = 0.5 / np.sqrt(1 + 0.5 / 0.1)  # the steady loss depends on q/(r a²) alone
    assert steady.plugin / steady.optimal - 1 == pytest.approx(law, rel=1e-12)
    assert steady.optimal == pytest.approx(0.1029286, abs=5e-8)
    assert steady.plugin == pytest.approx(0.1239388, abs=5e-8)
    assert 100 * (steady.plugin / steady.optimal - 1) == pytest.approx(20.412, abs=5e-4)
    moments = KalmanBucyFilter(SIGNAL).moments(times)
    p, c = moments.error_cov[:, 0, 0], moments.cov[:, 0, 0]
    np.testing.assert_allclose(POWER.mse_optimal(times), 4 * p * c - 2 * p**2, rtol=1e-13)


def test_example_6_loss_between_three_and_six_per_cent():
    window = np.linspace(0.1, 1.1, 1001)
    values = loss(window)
    assert round(values.min()) == 3
    assert round(values.max()) == 6
    assert values.min() == pytest.approx(2.939, abs=5e-4)
    assert window[values.argmin()] == pytest.approx(0.4109, abs=6e-4)
    assert np.all(np.diff(loss(np.linspace(0.45, 8, 200))) > 0)


def test_example_6_is_steady_to_printed_digits_after_six_seconds():
    assert np.abs(np.ravel(POWER.errors([4.0])) - [0.1029, 0.1239]).min() > 5e-5
    assert POWER.errors([5.85]).optimal[0] == pytest.approx(0.1029, abs=5e-5)
    assert POWER.errors([6.2]).plugin[0] == pytest.approx(0.1239, abs=5e-5)
    assert loss([4.0])[0] == pytest.approx(20.412, rel=0.01)


def test_example_6_prior_variance_four_is_the_one_that_fits():
    """Erratum: only a prior variance of 4 gives losses between 3 and 6 %."""
    window = np.linspace(0.1, 1.1, 101)
    for variance, low, high in ((2, 5.5, 11.0), (16, 0.8, 1.9)):
        system = LinearDiffusion(-1, 0.5, 1, 0.1, [0], variance)
        values = loss(window, TwoStepEstimator(system, X**2, variables=[X]))
        assert values.min() == pytest.approx(low, abs=0.1)
        assert values.max() == pytest.approx(high, abs=0.35)


def test_example_6_on_simulated_paths():
    times = np.linspace(0, 2, 401)
    sample = SIGNAL.simulate(times, 8000, 7)
    run = POWER.run(times, sample.increments)
    truth = sample.states[:, 0] ** 2
    for k in (100, 200, 400):
        exact = POWER.errors([times[k]])
        for guess, value in ((run.mean, exact.optimal[0]), (run.plugin, exact.plugin[0])):
            squares = (guess[k] - truth[k]) ** 2
            assert abs(squares.mean() - value) < 4 * squares.std() / np.sqrt(8000)
        spread = run.variance[k]
        assert abs(spread.mean() - exact.optimal[0]) < 4 * spread.std() / np.sqrt(8000)
        # paired: the plug-in estimate differs from the optimal one by P
        gap = run.mean[k] - run.plugin[k]
        np.testing.assert_allclose(gap**2, exact.plugin[0] - exact.optimal[0], rtol=1e-10)


# ---------------------------------------------------------------- examples 2 to 5


def static(mean, var, intensity):
    return LinearDiffusion(0, 0, 1, intensity, [mean], var)


def test_example_3_errors_fade():
    sine = TwoStepEstimator(static(0, 2, 1), sp.sin(X), variables=[X])
    assert sine.kind == "exponential-polynomial"
    times = np.array([0, 0.2692247, 1, 5, 10, 100])
    np.testing.assert_allclose(loss(times, sine), [0, 22.17, 14.8, 4.33, 2.28, 0.24], atol=5.1e-2)
    optimal, plugin = sine.errors(times)
    exact = sine_errors(0, 2, 2 / (1 + 2 * times))
    np.testing.assert_allclose(optimal, exact.optimal, rtol=1e-12)
    np.testing.assert_allclose(plugin, exact.plugin, rtol=1e-12)
    peak = minimize_scalar(lambda t: -loss([t], sine)[0], (0.1, 0.25, 0.6))
    assert peak.x == pytest.approx(0.2692, abs=5e-5)
    assert -peak.fun == pytest.approx(22.17, abs=5e-3)
    wide = TwoStepEstimator(static(0, 4, 1), sp.sin(X), variables=[X])
    assert loss([0.0960], wide)[0] == pytest.approx(54.80, abs=5e-3)
    fading = loss(np.linspace(0.27, 50, 200), sine)
    assert np.all(np.diff(fading) < 0)


def test_example_4_advantage_is_weak_with_the_printed_mean():
    printed = TwoStepEstimator(static(1, 1, 0.2), sp.Abs(X), variables=[X])
    assert printed.kind == "piecewise"
    optimal, plugin = printed.errors([0.1125])
    assert optimal[0] == pytest.approx(0.45414, abs=5.1e-6)
    assert plugin[0] == pytest.approx(0.49882, abs=5.1e-6)
    np.testing.assert_allclose(loss([0.1125, 1, 10], printed), [9.84, 5.08, 1.57], atol=5.1e-3)
    times = np.array([0.0, 0.1, 1.0])
    centred = TwoStepEstimator(static(0, 1, 0.2), sp.Abs(X), variables=[X])
    np.testing.assert_allclose(loss(times, centred), [175, 44, 10.3], rtol=5e-3)
    exact = abs_errors(0, 1, 1 / (1 + times / 0.2))
    np.testing.assert_allclose(centred.mse_optimal(times), exact.optimal, rtol=1e-11)
    np.testing.assert_allclose(centred.mse_plugin(times), exact.plugin, rtol=1e-11)


def test_examples_3_and_4_change_places_with_the_printed_mean():
    """The sine's worst loss lies above that of the modulus for the mean 1, below for the mean 0."""
    times = np.linspace(0, 5, 101)
    sine = sine_errors(0, 2, 2 / (1 + 2 * times))
    worst = {m: np.max(np.divide(*abs_errors(m, 1, 1 / (1 + times / 0.2))[::-1])) for m in (0, 1)}
    assert worst[1] < np.max(sine.plugin / sine.optimal) < worst[0]


def test_example_5_length_of_the_error():
    """f depends on the estimate too: the optimal estimate is a constant, whatever the data."""
    cov = np.array([[1.5, -0.5], [-0.5, 1.5]])
    length = TwoStepEstimator(
        PLANAR, sp.sqrt((X - A) ** 2 + (Y - B) ** 2), variables=[X, Y], estimate_variables=[A, B]
    )
    values = length.estimate(np.random.default_rng(0).normal(size=(2, 5)), cov)
    np.testing.assert_allclose(values, 1.5240384175392, rtol=1e-13)
    assert 100 * (np.sqrt(3) / values[0] - 1) == pytest.approx(13.649, abs=5e-4)
    np.testing.assert_array_equal(length.plugin(np.ones((2, 3))), 0.0)
    times = [0.0, 0.5, 2.0]
    optimal, plugin = length.errors(times)
    for k, p in enumerate(KalmanBucyFilter(PLANAR).moments(times).error_cov):
        assert optimal[k] == pytest.approx(np.trace(p) - norm_mean([0, 0], p) ** 2, rel=1e-11)
        assert plugin[k] == pytest.approx(np.trace(p), rel=1e-12)


def test_quadratic_function_of_state_and_estimate():
    squared = TwoStepEstimator(
        PLANAR, (X - A) * (Y - B) + A, variables=[X, Y], estimate_variables=[A, B]
    )
    cov = np.array([[0.4, 0.1], [0.1, 0.2]])
    assert squared.estimate([0.7, 0.1], cov) == pytest.approx(0.1 + 0.7, rel=1e-14)
    assert squared.variance([0.7, 0.1], cov) == pytest.approx(0.4 * 0.2 + 0.01, rel=1e-13)


# ---------------------------------------------------------------- example 7


@pytest.mark.parametrize(
    ("sign", "early", "middle", "steady"),
    [
        (1, (36.8619, 36.8748), (19116.14, 19116.37), (2.097833, 2.141873, 2.099)),
        (-1, (36.9137, 36.9262), (12991.58, 12991.78), (0.438623, 0.466305, 6.311)),
    ],
)
def test_example_7_wind_tunnel(sign, early, middle, steady):
    """The paper's 0.89, 0.94 and 5.6 % are not reproduced; these are the errors of its matrices."""
    drift = np.array([[-0.4032, 0, 0], [0, sign * 0.1245, 0.0701], [0, -2.5247, -0.5488]])
    x = sp.symbols("x1:4", real=True)
    speed = sum(sp.Rational(float(c)) * s for c, s in zip(drift[1], x, strict=True))
    energy = sp.Float(7.39) / 2 * x[2] ** 2 + sp.Float(0.136) / 2 * speed**2
    tunnel = LinearDiffusion(
        drift,
        0.01 * np.eye(3),
        [[1, 0, 0], [0, 0, 1]],
        0.05 * np.eye(2),
        [3, 28, 10],
        np.diag([1, 1, 0]),
    )
    errors = TwoStepEstimator(tunnel, energy, variables=x)
    optimal, plugin = errors.errors([0.07, 1.0])
    np.testing.assert_allclose([optimal[0], plugin[0]], early, atol=5.1e-5)
    np.testing.assert_allclose([optimal[1], plugin[1]], middle, atol=5.1e-3)
    last = errors.steady_errors()
    np.testing.assert_allclose([last.optimal, last.plugin], steady[:2], atol=5.1e-7)
    assert 100 * (last.plugin / last.optimal - 1) == pytest.approx(steady[2], abs=5.1e-4)
    assert abs(last.optimal - 0.89) > 0.4
    # the sign of the first mode does not matter: it is decoupled from the energy
    drift[0, 0] = 0.4032
    other = LinearDiffusion(
        drift,
        0.01 * np.eye(3),
        [[1, 0, 0], [0, 0, 1]],
        0.05 * np.eye(2),
        [3, 28, 10],
        np.diag([1, 1, 0]),
    )
    again = TwoStepEstimator(other, energy, variables=x).errors([0.07, 1.0])
    np.testing.assert_allclose(again.optimal, optimal, rtol=1e-11)


def test_example_7_matrix_is_a_discretised_tunnel():
    """The printed matrix is exp(0.2 A) - I/2 of the standard tunnel, to every digit."""
    from scipy.linalg import block_diag, expm

    tunnel = block_diag(-1 / 1.964, [[0, 1], [-36, -9.6]])
    printed = [[0.4032, 0, 0], [0, 0.1245, 0.0701], [0, -2.5247, -0.5488]]
    np.testing.assert_allclose(expm(0.2 * tunnel) - 0.5 * np.eye(3), printed, atol=5e-5)


# ---------------------------------------------------------------- every class of function


CLASSES = [
    (X**2 * Y + Y**3 - X, "polynomial", 1e-11),
    (sp.sin(X) * sp.exp(Y / 2), "exponential-polynomial", 1e-11),
    (sp.exp(-(X**2) - Y**2 / 3), "tilt", 1e-6),
    (sp.Max(X, Y), "piecewise", 3e-2),
    (sp.sqrt(X**2 + Y**2), "norm", 3e-2),
]


@pytest.mark.parametrize(("f", "kind", "accuracy"), CLASSES)
def test_closed_forms_against_quadrature(f, kind, accuracy):
    """Smooth functions agree closely; at a kink the rule converges only algebraically."""
    ours = TwoStepEstimator(PLANAR, f, variables=[X, Y])
    rule = TwoStepEstimator(PLANAR, f, variables=[X, Y], quadrature=gauss_hermite(2, 24))
    assert ours.kind == kind
    assert rule.kind == "quadrature"
    times = [0.0, 0.3, 1.0]
    for exact, close in zip(ours.errors(times), rule.errors(times), strict=True):
        np.testing.assert_allclose(close, exact, rtol=accuracy)
    mean, cov = np.array([[0.4, -1.0], [0.2, 0.5]]), np.array([[0.4, 0.1], [0.1, 0.2]])
    np.testing.assert_allclose(rule.estimate(mean, cov), ours.estimate(mean, cov), rtol=accuracy)
    np.testing.assert_allclose(rule.variance(mean, cov), ours.variance(mean, cov), rtol=accuracy)
    np.testing.assert_allclose(rule.plugin(mean), ours.plugin(mean), rtol=1e-12)


@pytest.mark.parametrize(("f", "kind", "accuracy"), CLASSES)
def test_errors_against_draws_at_one_time(f, kind, accuracy):
    ours = TwoStepEstimator(PLANAR, f, variables=[X, Y])
    moments = KalmanBucyFilter(PLANAR).moments([0.4])
    mean, cov, error_cov = (value[0] for value in moments)
    rng = np.random.default_rng(4)
    guess = rng.multivariate_normal(mean, cov - error_cov, 100_000).T
    truth = ours.plugin(guess + rng.multivariate_normal([0, 0], error_cov, 100_000).T)
    optimal, plugin = ours.errors([0.4])
    for value, estimate in (
        (optimal[0], ours.estimate(guess, error_cov)),
        (plugin[0], ours.plugin(guess)),
    ):
        squares = (truth - estimate) ** 2
        assert abs(squares.mean() - value) < 4 * squares.std() / np.sqrt(squares.size)
    assert optimal[0] <= plugin[0]


def test_closed_forms_of_the_maximum_agree():
    """The general piecewise route and the half-sum of the modulus are written independently."""
    ours = TwoStepEstimator(PLANAR, sp.Max(X, Y), variables=[X, Y])
    times = [0.0, 0.4, 2.0]
    optimal, plugin = ours.errors(times)
    for k, law in enumerate(zip(*KalmanBucyFilter(PLANAR).moments(times), strict=True)):
        exact = max_errors(*law)
        assert optimal[k] == pytest.approx(float(exact.optimal), rel=1e-11)
        assert plugin[k] == pytest.approx(float(exact.plugin), rel=1e-11)


def test_vector_function():
    both = TwoStepEstimator(PLANAR, [X * Y, X**2], variables=[X, Y])
    mean, cov = np.array([[0.4, -1.0], [0.2, 0.5]]), np.array([[0.4, 0.1], [0.1, 0.2]])
    np.testing.assert_allclose(
        both.estimate(mean, cov), [mean[0] * mean[1] + 0.1, mean[0] ** 2 + 0.4]
    )
    assert both.variance(mean, cov).shape == (2, 2, 2)
    optimal, plugin = both.errors([0.0, 0.5])
    assert optimal.shape == plugin.shape == (2, 2, 2)
    single = TwoStepEstimator(PLANAR, X**2, variables=[X, Y]).errors([0.0, 0.5])
    np.testing.assert_allclose(optimal[:, 1, 1], single.optimal, rtol=1e-13)
    assert np.linalg.eigvalsh(plugin - optimal).min() > -1e-14
    run = both.run(GRID, PLANAR.simulate(GRID, 7, 0).increments)
    assert [v.shape for v in run] == [(51, 2, 7), (51, 2, 2, 7), (51, 2, 7)]
    rule = TwoStepEstimator(PLANAR, [X * Y, X**2], variables=[X, Y], quadrature=fifth_degree(2))
    np.testing.assert_allclose(rule.estimate(mean, cov), both.estimate(mean, cov), rtol=1e-12)
    np.testing.assert_allclose(rule.variance(mean, cov), both.variance(mean, cov), rtol=1e-12)


def test_a_python_function_with_a_rule():
    rule = gauss_hermite(2, 40)
    ours = TwoStepEstimator(PLANAR, lambda p: np.sin(p[0]) * p[1], quadrature=rule)
    exact = TwoStepEstimator(PLANAR, sp.sin(X) * Y, variables=[X, Y])
    for a, b in zip(ours.errors([0.2, 1.0]), exact.errors([0.2, 1.0]), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11)
    assert ours.estimate([0.1, 0.2], np.eye(2)) == pytest.approx(
        float(exact.estimate([0.1, 0.2], np.eye(2))), rel=1e-12
    )


def test_degenerate_covariances():
    """No error of the state, no error of the function; no data, the prior covariance."""
    for f, _, _ in CLASSES:
        ours = TwoStepEstimator(PLANAR, f, variables=[X, Y])
        point = np.array([0.3, -0.8])
        exact = float(sp.lambdify((X, Y), f)(*point))
        assert ours.estimate(point, np.zeros((2, 2))) == pytest.approx(exact, rel=1e-12)
        assert ours.variance(point, np.zeros((2, 2))) == pytest.approx(0.0, abs=1e-14)
        start = ours.errors([0.0]).optimal[0]
        prior = ours.variance(PLANAR.mean0, PLANAR.cov0)
        assert start == pytest.approx(float(prior), rel=1e-9)
    known = LinearDiffusion(-1, 0.5, 1, 0.1, [1.0], 0)
    assert TwoStepEstimator(known, X**2, variables=[X]).errors([0.0]) == ([0.0], [0.0])
    constant = TwoStepEstimator(SIGNAL, sp.Integer(3), variables=[X])
    assert constant.errors([1.0]) == ([0.0], [0.0])
    assert constant.estimate([0.2], [[1.0]]) == 3.0


# ---------------------------------------------------------------- online table, prediction


@pytest.mark.parametrize("f", [X**2 * Y + Y**3, sp.sin(X), [X * Y, X**2 - Y]])
@pytest.mark.parametrize("lead", [0.0, 0.3])
def test_table_agrees_with_the_run(f, lead):
    ours = TwoStepEstimator(PLANAR, f, variables=[X, Y], lead=lead)
    increments = PLANAR.simulate(GRID, 6, 1).increments
    run, table = ours.run(GRID, increments), ours.table(GRID)
    state = np.tile(table.start[:, None], 6)
    for k in range(50):
        state = table.update(k, state, increments[k])
    value, variance = table.estimate(50, state)
    np.testing.assert_allclose(value, run.mean[50], rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(variance, run.variance[50], rtol=1e-10, atol=1e-12)
    single, _ = table.estimate(50, state[:, 2])
    np.testing.assert_allclose(single, run.mean[50][..., 2], rtol=1e-11, atol=1e-12)
    assert (table.exponents is None) == (f == sp.sin(X))


def test_tabulated_variance_keeps_its_accuracy_for_a_precise_sensor():
    precise = LinearDiffusion(-1, 0.5, 1, 1e-14, [3.0], 1e-9)
    ours = TwoStepEstimator(precise, X**3, variables=[X])
    times = np.array([0.0, 1e-8, 2e-8])
    table = ours.table(times)
    error_var = table.cov[2, 0, 0]
    _, variance = table.estimate(2, [3.0])
    exact = 9 * 3.0**4 * error_var + 36 * 3.0**2 * error_var**2 + 15 * error_var**3
    assert variance == pytest.approx(exact, rel=1e-13)


def test_prediction_of_the_function():
    """Errors of a prediction: draws of the predicted law at one time."""
    ahead = TwoStepEstimator(SIGNAL, X**2, variables=[X], lead=0.5)
    moments = KalmanBucyFilter(SIGNAL).moments([1.0], lead=0.5)
    p, c = moments.error_cov[0, 0, 0], moments.cov[0, 0, 0]
    assert ahead.errors([1.0]).optimal[0] == pytest.approx(4 * p * c - 2 * p * p, rel=1e-13)
    assert ahead.steady_errors().optimal > POWER.steady_errors().optimal
    late = ahead.errors([40.0]).optimal[0]
    assert ahead.steady_errors().optimal == pytest.approx(late, rel=1e-9)
    times = np.linspace(0, 1, 201)
    sample = SIGNAL.simulate(np.append(times, 1.5), 20_000, 3)
    run = ahead.run(times, sample.increments[:-1])
    squares = (run.mean[-1] - sample.states[-1, 0] ** 2) ** 2
    exact = ahead.errors([1.0]).optimal[0]
    assert abs(squares.mean() - exact) < 4 * squares.std() / np.sqrt(squares.size)


# ---------------------------------------------------------------- bad input


def test_functions_without_a_closed_form_are_refused():
    with pytest.raises(NoClosedForm, match="gamma"):
        TwoStepEstimator(PLANAR, sp.gamma(X), variables=[X, Y])
    with pytest.raises(TypeError, match="name a quadrature rule"):
        TwoStepEstimator(PLANAR, lambda p: p[0])
    asked = TwoStepEstimator(SIGNAL, sp.atan(X), variables=[X], quadrature=gauss_hermite(1, 80))
    assert asked.kind == "quadrature"
    assert 0 < asked.errors([0.5]).optimal[0] < asked.errors([0.5]).plugin[0]


def test_bad_input():
    with pytest.raises(ValueError, match="variables: wanted 2 symbols, got 1"):
        TwoStepEstimator(PLANAR, X, variables=[X])
    with pytest.raises(ValueError, match="variables: wanted 1 symbols, got none"):
        TwoStepEstimator(SIGNAL, X)
    with pytest.raises(ValueError, match="estimate_variables: wanted 2"):
        TwoStepEstimator(PLANAR, X, variables=[X, Y], estimate_variables=[A])
    with pytest.raises(ValueError, match="wanted known symbols"):
        TwoStepEstimator(SIGNAL, X * Y, variables=[X])
    with pytest.raises(ValueError, match="quadrature: wanted a rule in 2 dimensions"):
        TwoStepEstimator(PLANAR, X, variables=[X, Y], quadrature=gauss_hermite(1, 5))
    with pytest.raises(ValueError, match="lead: wanted a nonnegative time"):
        TwoStepEstimator(SIGNAL, X, variables=[X], lead=-1.0)
    with pytest.raises(TypeError, match="system: wanted a LinearDiffusion"):
        TwoStepEstimator("signal", X, variables=[X])
    with pytest.raises(ValueError, match="mean: wanted shape"):
        POWER.estimate([0.0, 1.0], np.eye(2))
    with pytest.raises(ValueError, match="mean: wanted shape"):
        POWER.plugin(0.0)
    with pytest.raises(ValueError, match="cov: wanted a positive semidefinite"):
        POWER.estimate([0.0], [[-1.0]])
    with pytest.raises(ValueError, match="times"):
        POWER.errors([])
    with pytest.raises(ValueError, match="Hurwitz"):
        TwoStepEstimator(static(0, 1, 1), X**2, variables=[X]).steady_errors()
    growing = TwoStepEstimator(static(0, 1, 1), sp.exp(X**2), variables=[X])
    with pytest.raises(ValueError, match="infinite"):
        growing.errors([0.0])
    table = POWER.table([0.0, 0.1])
    with pytest.raises(ValueError, match="k: wanted 0 to 0, got 1"):
        table.update(1, [0.0], [0.0])
    with pytest.raises(TypeError, match="k: wanted a whole number"):
        table.estimate(0.5, [0.0])
    with pytest.raises(ValueError, match="mean: wanted shape"):
        table.estimate(0, [0.0, 1.0])


def test_estimates_out_of_range_are_refused():
    table, large = POWER.table(GRID), np.full((50, 1), 1e200)
    for call in (
        lambda: POWER.run(GRID, large),
        lambda: POWER.plugin([1e200]),
        lambda: table.estimate(3, [1e200]),
    ):
        with pytest.raises(ValueError, match="range of float64"):
            call()


@pytest.mark.parametrize("f", [1 / X, sp.log(X), lambda point: np.full(point.shape[1], np.nan)])
def test_quadrature_refuses_values_that_are_not_finite(f):
    rule = gauss_hermite(1, 5)
    estimator = TwoStepEstimator(SIGNAL, f, variables=[X], quadrature=rule)
    with pytest.raises(ValueError, match="f: wanted finite values"):
        estimator.errors([0.0, 1.0])
    with pytest.raises(ValueError, match="f: wanted finite values"):
        estimator.estimate([0.0], [[1.0]])


def test_quadrature_needs_one_value_for_each_point():
    with pytest.raises(ValueError, match="f: wanted values of shape"):
        TwoStepEstimator(SIGNAL, lambda point: np.ones(3), quadrature=gauss_hermite(1, 5))


def test_wrong_kinds_of_arguments_are_named():
    with pytest.raises(TypeError, match="quadrature: wanted a Rule"):
        TwoStepEstimator(SIGNAL, X**2, variables=[X], quadrature=5)
    with pytest.raises(TypeError, match="variables: wanted a sequence"):
        TwoStepEstimator(SIGNAL, X**2, variables=X)


def test_no_paths_and_no_steps_are_legal():
    assert POWER.run(GRID, np.zeros((50, 1, 0))).variance.shape == (51, 0)
    start = POWER.run([0.0], np.zeros((0, 1, 2)))
    np.testing.assert_allclose(start.mean, [[4.0, 4.0]])
    np.testing.assert_allclose(start.variance, [[32.0, 32.0]])
