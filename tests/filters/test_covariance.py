import numpy as np
import pytest
import sympy
from scipy.linalg import block_diag, expm
from scipy.stats import multivariate_normal

from seedslib import zoo
from seedslib.filters import (
    CovarianceFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.gaussian import NoClosedForm
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

RULES = (Taylor(), ExactGaussian(), Unscented(), Unscented(0.7, 2, 1), Cubature(), GaussHermite(3))


# Linear systems: every linearization is the Kalman filter


def linear_case():
    """Random linear system with three states, two sensors, offsets and correlated noises."""
    rng = np.random.default_rng(12)
    f, h = 0.5 * rng.standard_normal((3, 3)), rng.standard_normal((2, 3))
    q, r, p = (
        (lambda a: a @ a.T + 0.1 * np.eye(len(a)))(rng.standard_normal((k, k))) for k in (3, 2, 3)
    )
    offset = np.array([0.3, -1.0, 2.0])
    x, w, v = sympy.symbols("x:3"), sympy.symbols("w:3"), sympy.symbols("v:2")
    moved = sympy.Matrix(f) * sympy.Matrix(x) + sympy.Matrix(w) + sympy.Matrix(offset)
    seen = sympy.Matrix(h) * sympy.Matrix(x) + sympy.Matrix(v)
    system = DiscreteSystem(
        StochasticMap(x, list(moved), Noise(w, cov=q)),
        StochasticMap(x, list(seen), Noise(v, cov=r)),
        [1, 2, 3],
        p,
    )
    return system, (f, h, q, r, p, offset)


def joint_law(case, steps):
    """Mean and covariance of all states stacked over time, by the moving-average form."""
    f, _, q, _, p, offset = case
    mean, means = np.array([1.0, 2.0, 3.0]), []
    root = np.zeros((3 * steps, 3 * steps))
    for k in range(steps):
        means.append(mean)
        mean = f @ mean + offset
        for j in range(k + 1):
            root[3 * k : 3 * k + 3, 3 * j : 3 * j + 3] = np.linalg.matrix_power(f, k - j)
    return np.concatenate(means), root @ block_diag(p, *[q] * (steps - 1)) @ root.T


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("missing", [False, True])
def test_linear_gaussian_record_against_one_batch_regression(rule, missing):
    """Means, covariances and likelihoods of six steps at once, no recursion."""
    system, case = linear_case()
    _, h, _, r, _, _ = case
    times = np.arange(6.0)
    record = system.simulate(times, 3, 1).measurements
    if missing:
        record[1, 0, 0] = record[2, :, 0] = record[3, 1, 1] = np.nan
        record[4] = np.nan
    got = CovarianceFilter(system, rule).run(times, record)
    mean, cov = joint_law(case, 6)
    wide = np.kron(np.eye(6), h)
    for path in range(3):
        total = 0.0
        for k in range(6):
            seen = record[: k + 1, :, path].ravel()
            kept = np.flatnonzero(np.isfinite(seen))
            c = wide[kept]
            s = c @ cov @ c.T + np.kron(np.eye(6), r)[np.ix_(kept, kept)]
            now = slice(3 * k, 3 * k + 3)
            gain = np.linalg.solve(s, c @ cov[:, now]).T
            np.testing.assert_allclose(
                got.mean[k, :, path],
                mean[now] + gain @ (seen[kept] - c @ mean),
                rtol=1e-11,
                atol=1e-12,
            )
            own = got.cov[k] if got.cov.ndim == 3 else got.cov[k, :, :, path]
            np.testing.assert_allclose(own, cov[now, now] - gain @ c @ cov[:, now], atol=1e-12)
            before, total = total, multivariate_normal(c @ mean, s).logpdf(seen[kept])
            np.testing.assert_allclose(got.loglik[k, path], total - before, atol=1e-10)


def test_covariance_common_to_all_paths_is_given_once():
    system, _ = linear_case()
    times = np.arange(4.0)
    record = system.simulate(times, 5, 1).measurements
    assert extended_kalman(system).run(times, record).cov.shape == (4, 3, 3)
    record[2, 0, 3] = np.nan
    got = extended_kalman(system).run(times, record)
    assert got.cov.shape == (4, 3, 3, 5)
    np.testing.assert_array_equal(got.cov[:2, ..., 0], got.cov[:2, ..., 3])


def kalman_covariances(steps):
    """Variance of the estimated position of the linear oscillator, by Van Loan's method."""
    drift = np.array([[0, 1], [-1, -0.4]])
    big = np.zeros((4, 4))
    big[:2, :2], big[:2, 2:], big[2:, 2:] = -drift, np.diag([0.0, 1.0]), drift.T
    big = expm(big * 0.5)
    phi = big[2:, 2:].T
    noise, h = phi @ big[:2, 2:], np.array([[1.0, 0.0]])
    cov, result = np.eye(2), []
    for k in range(steps):
        if k:
            cov = phi @ cov @ phi.T + noise
        gain = cov @ h.T / (h @ cov @ h.T + 0.25)
        cov = cov - gain @ h @ cov
        result.append(cov[0, 0])
    return np.array(result)


@pytest.mark.parametrize(
    "options", [{"step": 0.002}, {"integrator": "adaptive", "rtol": 1e-12, "atol": 1e-14}]
)
def test_continuous_linear_oscillator(options):
    """Section 9.4: 0.2, .1507645623, .1530811068, .1400092003, .1398418705, .1398407929."""
    system = zoo.linear_gaussian()
    times = 0.5 * np.arange(21)
    record = np.zeros((21, 1))
    got = extended_kalman(system, **options).run(times, record).cov[:, 0, 0]
    np.testing.assert_allclose(got, kalman_covariances(21), rtol=1e-11)
    printed = [0.2, 0.1507645623, 0.1530811068, 0.1400092003, 0.1398418705, 0.1398407929]
    np.testing.assert_allclose(got[[0, 1, 2, 5, 10, 20]], printed, atol=5e-11)


@pytest.mark.parametrize(
    "make", [extended_kalman, assumed_density, unscented_kalman, cubature_kalman]
)
def test_all_four_agree_on_the_linear_oscillator(make):
    system = zoo.linear_gaussian()
    times = 0.5 * np.arange(6)
    record = system.simulate(times, 4, 2).measurements
    got, want = (f(system).run(times, record) for f in (make, extended_kalman))
    np.testing.assert_allclose(got.mean, want.mean, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(got.loglik, want.loglik, rtol=1e-10)


# Numbers of the paper's examples (section 9 of the review), 4 combined standard errors


def rms(errors, groups=20):
    """Root mean square over the last axis and its standard error by groups of paths."""
    squares = (errors**2).reshape(*errors.shape[:-1], groups, -1).mean(axis=-1)
    value = np.sqrt(squares.mean(axis=-1))
    return value, squares.std(axis=-1, ddof=1) / np.sqrt(groups) / (2 * value)


@pytest.fixture(scope="module")
def oscillator():
    system = zoo.van_der_pol()
    return system, system.simulate(0.5 * np.arange(7), 20_000, 5)


@pytest.mark.parametrize(
    ("make", "printed", "options"),
    [
        (extended_kalman, [0.2149, 0.198, 0.235, 0.318, 0.385, 0.435, 0.481], {}),
        (
            extended_kalman,
            [0.2149, 0.198, 0.236, 0.319, 0.388, 0.438, 0.484],
            {"integrator": "euler"},
        ),
        (assumed_density, [0.2133, 0.196, 0.228, 0.289, 0.326, 0.357, 0.390], {}),
    ],
)
def test_van_der_pol(oscillator, make, printed, options):
    system, run = oscillator
    got = make(system, bound=20, **options).run(run.times, run.measurements)
    value, error = rms((got.mean - run.states)[:, 0])
    assert (np.abs(value - printed) < 4 * np.sqrt(1 + 1 / 5) * error + 0.0006).all()
    assert got.diverged.sum() == 0


def test_exact_means_beat_expansion_on_the_oscillator(oscillator):
    """Paired on the same paths: squared errors of the EKF minus the assumed-density filter."""
    system, run = oscillator
    errors = [
        (make(system).run(run.times, run.measurements).mean - run.states)[-1, 0]
        for make in (extended_kalman, assumed_density)
    ]
    difference = errors[0] ** 2 - errors[1] ** 2
    assert difference.mean() > 4 * difference.std() / np.sqrt(len(difference))


def test_kicked_oscillator_and_its_diverged_paths():
    """Section 9.2: RMS at the times k >= 4 of .769 (EKF) and .726 (FNA); Euler loses paths."""
    system, times = zoo.kicked_duffing(), 0.5 * np.arange(13)
    run = system.simulate(times, 8000, 8)
    for make, printed in ((extended_kalman, 0.769), (assumed_density, 0.726)):
        # the equations are not stiff: steps of 0.05 change the RMS by less than 1e-4
        got = make(system, bound=20, step=0.05).run(times, run.measurements)
        kept = ~got.diverged
        errors = (got.mean - run.states)[4:, 0][:, kept]
        errors = errors[:, : errors.shape[1] // 20 * 20]
        squares = (errors**2).mean(axis=0)
        value = np.sqrt(squares.mean())
        error = squares.std() / np.sqrt(len(squares)) / (2 * value)
        assert abs(value - printed) < 4 * np.sqrt(1.4) * error + 0.0006
        assert got.diverged.sum() <= 5
    euler = extended_kalman(system, bound=20, integrator="euler").run(times, run.measurements)
    assert euler.diverged.sum() >= 1
    beyond = (np.abs(euler.mean) > 20).any(axis=(0, 1)) | np.isnan(euler.mean).any(axis=(0, 1))
    np.testing.assert_array_equal(euler.diverged, beyond)


def test_flip_process():
    """Section 9.3, mean squared errors at k = 0, 1, 2, 4, 6, 8, 12; the reference has ±.002."""
    system, times = zoo.flip_process(), 0.25 * np.arange(13)
    run = system.simulate(times, 10_000, 9)
    for make, printed in (
        (assumed_density, [0.148, 0.203, 0.205, 0.204, 0.199, 0.201, 0.201]),
        (extended_kalman, [0.148, 0.217, 0.214, 0.208, 0.204, 0.204, 0.203]),
    ):
        got = make(system, step=0.025).run(times, run.measurements)
        squares = ((got.mean - run.states)[[0, 1, 2, 4, 6, 8, 12], 0]) ** 2
        error = squares.std(axis=1) / np.sqrt(squares.shape[1])
        difference = np.abs(squares.mean(axis=1) - printed)
        assert (difference < 4 * np.hypot(error, 0.002)).all()


# What the results may depend on


@pytest.mark.parametrize("integrator", ["rk4", "adaptive"])
def test_threads_and_other_paths_do_not_matter(integrator):
    system, times = zoo.van_der_pol(), 0.5 * np.arange(3)
    record = system.simulate(times, 17_000, 3).measurements
    filter_ = extended_kalman(system, integrator=integrator, step=0.1)
    one, two = (filter_.run(times, record, workers=k) for k in (1, 2))
    for a, b in zip(one, two, strict=True):
        if a is not None:
            np.testing.assert_array_equal(a, b)
    alone = filter_.run(times, record[..., 8000])
    assert alone.mean.shape == (3, 2)
    assert alone.cov.shape == (3, 2, 2)
    tolerance = 1e-13 if integrator == "rk4" else 1e-5
    np.testing.assert_allclose(alone.mean, one.mean[..., 8000], rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(alone.cov, one.cov[..., 8000], rtol=tolerance, atol=tolerance)
    folded = filter_.run(times, record[..., :12].reshape(3, 2, 3, 4))
    assert folded.cov.shape == (3, 2, 2, 3, 4)
    np.testing.assert_allclose(folded.mean.reshape(3, 2, 12), one.mean[..., :12], rtol=tolerance)


def test_integrators_agree():
    system, times = zoo.kicked_duffing(), 0.5 * np.arange(5)
    record = system.simulate(times, 50, 3).measurements
    fixed = assumed_density(system, step=0.005).run(times, record)
    free = assumed_density(system, integrator="adaptive", step=0.5, rtol=1e-9).run(times, record)
    np.testing.assert_allclose(fixed.mean, free.mean, atol=1e-6)
    np.testing.assert_allclose(fixed.cov, free.cov, atol=1e-6)


def test_jumps_enter_the_forecast():
    """Without them the covariance of the kicked oscillator would be far too small."""
    system = zoo.kicked_duffing()
    calm = zoo.kicked_duffing(kick=(0.0, 1e-6))
    record = np.full((2, 1), np.nan)
    with_jumps, without = (assumed_density(s).run([0.0, 0.5], record) for s in (system, calm))
    assert with_jumps.cov[-1, 1, 1] > 5 * without.cov[-1, 1, 1]
    states = system.simulate([0.0, 0.5], 40_000, 1).states[1]
    assert abs(states[1].var() - with_jumps.cov[-1, 1, 1]) < 0.1 * states[1].var()


def test_times_without_a_measurement_give_forecasts():
    system, times = zoo.van_der_pol(), np.array([0.0, 0.2, 0.5])
    record = system.simulate(times, 6, 2, measured=[0, 2]).measurements
    filter_ = assumed_density(system)
    whole = filter_.run(times, record)
    state = filter_.step(filter_.initial((6,)), 0.0, record[0])
    forecast = filter_.forecast(state, 0.2)
    np.testing.assert_allclose(whole.mean[1], forecast.mean, rtol=1e-12)
    np.testing.assert_allclose(whole.cov[1], forecast.cov, rtol=1e-12)
    assert (whole.loglik[1] == 0).all()
    # the state itself has not moved, and the two halves of a step are the step
    assert state.time == 0.0
    later = filter_.correct(filter_.predict(state, 0.5), record[2])
    np.testing.assert_allclose(later.mean, whole.mean[2], rtol=1e-9)
    np.testing.assert_array_equal(later.mean, filter_.step(state, 0.5, record[2]).mean)


def test_array_functions_with_points():
    symbolic = zoo.van_der_pol()
    numeric = JumpDiffusion.from_functions(
        lambda t, x: np.stack([x[1], -((0.1 * np.pi) ** 2) * x[0] + 2 * x[1] * (1 - x[0] ** 2)]),
        lambda t, x: np.stack([0 * x[0], x[0]])[:, None],
        StochasticMap.from_functions(
            2, 2, lambda t, x, v: np.stack([x[0] ** 2 + v[0], x[1] + v[1]]), Noise(2)
        ),
        [2, 0],
        0.15 * np.eye(2),
    )
    times = 0.5 * np.arange(3)
    record = symbolic.simulate(times, 5, 1).measurements
    rule = GaussHermite(4)
    got, want = (
        CovarianceFilter(s, rule, step=0.05).run(times, record) for s in (numeric, symbolic)
    )
    np.testing.assert_allclose(got.mean, want.mean, rtol=1e-9)
    with pytest.raises(NoClosedForm, match="use Unscented, Cubature or GaussHermite"):
        extended_kalman(numeric)


def test_sensor_that_depends_on_time():
    x, v, t = sympy.symbols("x v t")
    system = JumpDiffusion(
        (x,), [0], [[0]], [(1 + t) * x + v], Noise((v,)), mean0=[0], cov0=[[1]], step=1.0
    )
    got = extended_kalman(system).run([0.0, 1.0, 2.0], np.ones((3, 1)))
    np.testing.assert_allclose(got.cov[:, 0, 0], 1 / (1 + np.array([1, 5, 14])), rtol=1e-12)
    np.testing.assert_allclose(
        got.mean[:, 0], np.array([1, 3, 6]) / np.array([2, 6, 15]), rtol=1e-12
    )


# Bad input


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"integrator": "heun"}, ValueError, "integrator: wanted one of rk4, euler, adaptive"),
        ({"step": 0.0}, ValueError, "step: wanted a positive number, got 0"),
        ({"bound": -1}, ValueError, "bound: wanted a positive number, got -1"),
        ({"linearization": "ekf"}, TypeError, "linearization: wanted a Linearization, got 'ekf'"),
    ],
)
def test_bad_options(options, error, message):
    given = {"linearization": Taylor()} | options
    with pytest.raises(error, match=message):
        CovarianceFilter(zoo.linear_gaussian(), **given)


@pytest.mark.parametrize(
    ("times", "record", "message"),
    [
        ([0.0, 0.0], np.zeros((2, 1)), "times: wanted strictly increasing"),
        (
            [0.0, 1.0],
            np.zeros((3, 1)),
            r"measurements: wanted shape \(2, 1, \*batch\), got \(3, 1\)",
        ),
        ([0.0, 1.0], np.zeros(2), r"measurements: wanted shape \(2, 1"),
        ([0.0, 1.0], [[0.0], [np.inf]], r"got inf at index \(1, 0\)"),
    ],
)
def test_bad_records(times, record, message):
    with pytest.raises(ValueError, match=message):
        extended_kalman(zoo.linear_gaussian()).run(times, record)


def test_states_out_of_order():
    filter_ = extended_kalman(zoo.linear_gaussian())
    with pytest.raises(ValueError, match="state: wanted a state with a time"):
        filter_.correct(filter_.initial(), [0.0])
    state = filter_.predict(filter_.initial(), 1.0)
    with pytest.raises(ValueError, match=r"t: wanted a time from 1 on, got 0\.5"):
        filter_.predict(state, 0.5)
