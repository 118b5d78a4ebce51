"""Designs on simulated paths: what is fitted, on which paths, and what is said of them."""

import warnings
from itertools import combinations_with_replacement

import numpy as np
import pytest
import sympy

from oracles.linear import kalman
from seedslib import zoo
from seedslib.design import Continuous, Executor, Polynomial, synthesize
from seedslib.designed import Memory, finite_memory
from seedslib.evaluation import evaluate
from seedslib.linearization import Cubature, ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise
from systems import TIMES, discrete_system, linear_numbers, with_gaps

x, y, v, w, t = sympy.symbols("x y v w t")
u = sympy.sin(3 * t)
STOPS = np.array([0.3, 0.8, 1.8, 2.4])
READ = np.array([[True, True], [False, True], [True, True], [True, False]])
HELD_OUT = 0x48454C44
"""Key of the held-out paths among the children of a seed."""


@pytest.fixture(scope="module")
def curved():
    """Two unlike components, time in state and sensor."""
    return JumpDiffusion(
        (x, y),
        [y + u / 2, -sympy.sin(x) - 0.3 * y + t / 4],
        [[0.3, 0], [0.2, 0.5]],
        [x + y**2 / 4 + u / 3 + v, y + (1 + t / 5) * w],
        Noise((v, w), cov=[[0.3, 0.1], [0.1, 0.5]]),
        [0.4, -0.2],
        [[0.5, 0.1], [0.1, 0.3]],
        step=0.1,
    )


@pytest.fixture(scope="module")
def oscillator():
    return zoo.van_der_pol()


def best(features, targets):
    """Least-squares forecast of the targets from features and a constant."""
    known = np.vstack([*features, np.ones(targets.shape[1])])
    return np.linalg.lstsq(known.T, targets.T, rcond=None)[0].T @ known


def powers(memory, degree):
    """Products of up to so many standardised components, cut at 3.5 deviations."""
    z = (memory - memory.mean(axis=1)[:, None]) / memory.std(axis=1)[:, None]
    z = np.clip(z, -3.5, 3.5)
    return [
        np.prod(z[list(chosen)], axis=0)
        for total in range(1, degree + 1)
        for chosen in combinations_with_replacement(range(len(z)), total)
    ]


def positive(cov):
    """Where a covariance, (n, n, N), is well above the floor of a polynomial forecast."""
    mean = cov.mean(axis=2)
    relative = np.linalg.eigvals(np.linalg.solve(mean, np.moveaxis(cov, 2, 0))).real
    return relative.min(axis=1) > 0.06


CASES = {
    "one component of two, gaps": (Memory(2), Taylor(), {"components": 1, "measured": READ}),
    "estimates and measurements": (Memory(1, 1), ExactGaussian(), {"scheme": "heun"}),
    "polynomials of estimates": (Memory(1), Taylor(), {"predictor": Polynomial(3, 2)}),
    "polynomials of measurements": (
        finite_memory(2),
        Cubature(),
        {"predictor": Polynomial(2, 0), "step": 0.05},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_design_is_a_run_on_its_own_paths_with_least_squares_forecasts(curved, case):
    memory, rule, options = CASES[case]
    n, paths = options.get("components", 2), 1500
    made = synthesize(curved, memory, rule, STOPS, nodes=1, paths=paths, seed=8, **options)
    stops = made.predicted.times
    rows = np.searchsorted(stops, STOPS)
    np.testing.assert_array_equal(rows, [0, 2, 4, 6])
    mask = np.zeros((7, 2), dtype=bool)
    mask[rows] = options.get("measured", True)
    simulation = {key: options[key] for key in ("step", "scheme") if key in options}
    data = curved.simulate(stops, paths, 8, measured=mask, **simulation)
    found = made.run(stops, data.measurements).mean
    squares = (found - data.states[:, :n]) ** 2
    np.testing.assert_allclose(made.predicted.rms, np.sqrt(squares.mean(axis=2)), rtol=1e-9)
    error = squares.std(axis=2) / np.sqrt(paths) / (2 * made.predicted.rms)
    np.testing.assert_allclose(made.predicted.error, error, rtol=1e-8)
    assert made.predicted.in_sample
    first = np.concatenate([data.states[0], data.measurements[0]])
    np.testing.assert_allclose(made.start.mean, first[:2].mean(axis=1))
    np.testing.assert_allclose(made.start.moments.mean, first[2:].mean(axis=1))
    cov = np.cov(first, bias=True)
    np.testing.assert_allclose(made.start.cov, cov[:2, :2])
    np.testing.assert_allclose(made.start.moments.cross, cov[:2, 2:])
    np.testing.assert_allclose(made.start.moments.cov, cov[2:, 2:])
    z, shown = found[rows], data.measurements[rows]
    for k, fit in enumerate(made.fits):
        newest = slice(k, None, -1)
        parts = [*z[newest][: memory.estimates], *shown[newest][: memory.measurements]]
        known = np.concatenate(parts)
        predictor, features = options.get("predictor"), known
        if predictor:
            features = powers(known, predictor.mean_degree)
        target = data.states[rows[k + 1]]
        wanted = best(features, target)
        np.testing.assert_allclose(fit.mean(known), wanted, rtol=1e-6, atol=1e-8)
        rest = target - wanted
        np.testing.assert_allclose(fit.cov, rest @ rest.T / paths, rtol=1e-7)
        if predictor and predictor.cov_degree:
            products = np.stack([rest[0] ** 2, rest[0] * rest[1], rest[1] ** 2])
            a, b, c = best(powers(known, predictor.cov_degree), products)
            cov = np.array([[a, b], [b, c]])
            good = positive(cov)
            assert good.mean() > 0.5
            claimed = fit.forecast(known)[1]
            np.testing.assert_allclose(claimed[..., good], cov[..., good], rtol=1e-5, atol=1e-7)
        target = data.states[rows[k] + 1][:n]
        (fit,) = made.node_fits[k]
        wanted = best(known, target)
        np.testing.assert_allclose(fit.mean(known), wanted, rtol=1e-6, atol=1e-8)
        rest = target - wanted
        np.testing.assert_allclose(fit.cov, rest @ rest.T / paths, rtol=1e-7)


def test_continuous_forecast_is_fitted_at_every_step(oscillator):
    times, paths = [0.0, 0.2, 0.4], 1000
    made = synthesize(
        oscillator,
        Memory(1),
        Taylor(),
        times,
        predictor=Continuous(),
        paths=paths,
        seed=3,
        step=0.05,
    )
    stops = made.predicted.times
    np.testing.assert_allclose(stops, 0.05 * np.arange(9))
    data = oscillator.simulate(stops, paths, 3, measured=[0, 4, 8], step=0.05)
    found = made.run(stops, data.measurements).mean
    rms = np.sqrt(((found - data.states) ** 2).mean(axis=2))
    np.testing.assert_allclose(made.predicted.rms, rms, rtol=1e-9)
    for k, fits in enumerate(made.node_fits):
        for fit, z, state in zip(fits, found[4 * k :], data.states[4 * k :], strict=False):
            wanted = best(z, state)
            np.testing.assert_allclose(fit.mean(z), wanted, rtol=1e-6, atol=1e-8)
            rest = state - wanted
            np.testing.assert_allclose(fit.cov, rest @ rest.T / paths, rtol=1e-7)
    state = made.correct(made.predict(made.initial((paths,)), 0.0), data.measurements[0])
    forecast = made.predict(state, 0.2)
    rest = data.states[4] - forecast.mean
    assert np.abs(rest.mean(axis=1)).max() < 1e-12
    np.testing.assert_allclose(forecast.cov, rest @ rest.T / paths, rtol=1e-7)


def test_held_out_errors_are_those_of_a_run_on_other_paths_of_the_seed(curved):
    """An eighth as many as in the design, as `evaluate` simulates and scores them."""
    made = synthesize(
        curved, Memory(2), Taylor(), STOPS, nodes=1, paths=66_000, seed=7, measured=READ
    )
    root, held = np.random.SeedSequence(7, spawn_key=(HELD_OUT,)), made.held_out
    wanted = evaluate(made, curved, STOPS, 8250, root, measured=READ)
    assert (held.paths, held.diverged) == (8250, 0)
    np.testing.assert_allclose(held.rms, wanted.rms, rtol=1e-12)
    np.testing.assert_allclose(held.error, wanted.rms_error, rtol=1e-10)
    np.testing.assert_array_equal(held.times, STOPS)


def test_a_seed_of_any_kind_gives_one_design_and_a_generator_is_drawn_from_once(oscillator):
    def made(seed):
        return synthesize(
            oscillator, Memory(1), Taylor(), [0, 0.2], paths=600, seed=seed, step=0.05, nodes=0
        )

    one, two, other = made(3), made(np.random.SeedSequence(3)), made(4)
    np.testing.assert_array_equal(one.fits[0].gain, two.fits[0].gain)
    np.testing.assert_array_equal(one.held_out.rms, two.held_out.rms)
    assert not np.array_equal(one.fits[0].gain, other.fits[0].gain)
    assert one.design.entropy == 3
    assert (one.design.paths, one.held_out.paths) == (600, 512)
    rng = np.random.default_rng(5)
    assert not np.array_equal(made(rng).fits[0].gain, made(rng).fits[0].gain)


def numbers(part):
    """All arrays of a design, or of a part of one."""
    if hasattr(part, "predicted"):
        part = (part.predicted, part.held_out, part.fits, getattr(part, "node_fits", ()))
    if isinstance(part, tuple):
        return [array for each in part for array in numbers(each)]
    return [] if part is None else [np.asarray(part)]


@pytest.mark.parametrize(
    ("system", "options"),
    [
        (zoo.van_der_pol(), {"nodes": 2}),
        (zoo.van_der_pol(), {"predictor": Polynomial(2, 2)}),
        (zoo.van_der_pol(), {"predictor": Continuous()}),
        (zoo.van_der_pol(), {"availability": 0.8}),
        (zoo.scalar_switching(), {}),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_design_does_not_depend_on_threads_bit_by_bit(system, options):
    """Of several blocks of paths, of modes two of those held out too."""
    times, options = [0.0, 1.0, 2.0], {"seed": 5, "paths": 70_000, **options}
    if not hasattr(system, "modes"):
        times = [0.0, 0.2, 0.4]
        options |= {"step": 0.1, "paths": 17_000}
    one, two = (
        synthesize(system, Memory(1), ExactGaussian(), times, workers=workers, **options)
        for workers in (Executor(), 2)
    )
    for a, b in zip(numbers(one), numbers(two), strict=True):
        np.testing.assert_array_equal(a, b)


def test_discrete_reference_system_is_designed_to_its_kalman_filter():
    """Time-varying, with noise means, a late irregular start and a schedule of gaps."""
    mask = ~np.isnan(with_gaps(np.zeros((7, 2))))
    system, numbers = discrete_system(inputs=False), linear_numbers(inputs=None)
    made = synthesize(system, Memory(1), Taylor(), TIMES, paths=20_000, seed=1, measured=mask)
    assert all(len(nodes) == 0 for nodes in made.node_times)
    data = system.simulate(TIMES, 200, 2, measured=mask)
    wanted = kalman(numbers, data.measurements[..., 0])
    for fit, cov in zip(made.fits, wanted.predicted_cov[1:], strict=True):
        unit = np.sqrt(np.outer(np.diagonal(cov), np.diagonal(cov)))
        np.testing.assert_allclose(fit.cov / unit, cov / unit, atol=4 * np.sqrt(2 / 20_000))
    deviation = np.sqrt(np.diagonal(wanted.cov, axis1=1, axis2=2))
    np.testing.assert_allclose(made.predicted.rms, deviation, rtol=4 / np.sqrt(2 * 20_000))
    means = [kalman(numbers, record).mean for record in data.measurements[..., :5].T.swapaxes(1, 2)]
    found = made.run(TIMES, data.measurements[..., :5]).mean
    apart = (found - np.moveaxis(means, 0, -1)) / deviation[..., None]
    assert np.abs(apart).max() < 0.1


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_nodes_are_even(oscillator):
    options = {"paths": 300, "seed": 1, "step": 0.1}
    made = synthesize(oscillator, Memory(1), Taylor(), [0.5, 1.5], nodes=4, **options)
    np.testing.assert_allclose(made.predicted.times, 0.5 + 0.2 * np.arange(6))


def exploding():
    """Paths that start far from zero leave the range of numbers in finite time."""
    return JumpDiffusion((x,), [x**3 - x], [[0.1]], [x + v], Noise((v,)), [0], [[0.09]], step=0.02)


@pytest.mark.filterwarnings("ignore:held out:UserWarning")
def test_paths_that_leave_the_range_of_numbers_are_left_out_and_counted():
    with pytest.warns(UserWarning, match="paths: .* diverged"):
        made = synthesize(
            exploding(), Memory(1), ExactGaussian(), [0, 4, 8], paths=3000, seed=1, nodes=0
        )
    assert 0 < made.design.diverged < 100
    assert all(np.isfinite(part).all() for part in numbers(made))


@pytest.mark.filterwarnings("ignore:(paths|held out):UserWarning")
def test_errors_that_rest_on_few_paths_are_warned_of():
    with pytest.warns(UserWarning, match="rest on very few paths"):
        made = synthesize(
            exploding(), Memory(1), ExactGaussian(), np.arange(9) * 0.5, paths=5000, seed=1
        )
    assert all(np.isfinite(part).all() for part in numbers(made))


def test_few_paths_are_warned_of(oscillator):
    for paths, few in ((99, 1), (100, 0)):  # fifty for each of two coefficients
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            synthesize(oscillator, Memory(1), Taylor(), [0, 0.2], paths=paths, seed=1, step=0.1)
        assert sum(str(one.message).startswith("paths") for one in said) == few
