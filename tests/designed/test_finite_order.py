"""Running a designed filter: steps, forecasts between measurements, missing data, batches."""

import csv
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import sympy
from scipy.linalg import expm

from seedslib import zoo
from seedslib.design import Affine, Continuous, Polynomial, synthesize
from seedslib.designed import Memory, finite_memory
from seedslib.designed.between import FORECAST_KINDS, Interval, at
from seedslib.designed.predictors import FLOOR, bounded_below, monomials
from seedslib.evaluation import compare
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise

TACTS = np.arange(7) * 0.5
GRID = np.linspace(0, 3, 61)


@pytest.fixture(scope="module")
def oscillator():
    return zoo.van_der_pol()


@pytest.fixture(scope="module")
def data(oscillator):
    return oscillator.simulate(GRID, 40, 9, measured=np.arange(7) * 10)


def design(system, memory=None, predictor=None, **options):
    options = {"paths": 3000, "seed": 1, "step": 0.02} | options
    return synthesize(
        system, memory or Memory(2), ExactGaussian(), TACTS, predictor=predictor or Affine(),
        **options,
    )  # fmt: skip


FAMILY = {
    "large order": (Memory(2), Affine()),
    "finite memory": (finite_memory(2), Affine()),
    "mixed": (Memory(1, 2), Affine()),
    "polynomial": (Memory(1), Polynomial(3, 2)),
    "polynomial mean": (Memory(1), Polynomial(2, 0)),
    "continuous": (Memory(1), Continuous()),
}


@pytest.fixture(scope="module", params=FAMILY)
def filter(request, oscillator):
    return design(oscillator, *FAMILY[request.param])


def test_steps_are_the_run(filter, data):
    """One path, step by step, with forecasts between, gives what the batch gives."""
    found = filter.run(GRID, data.measurements, covariances=True)
    state = filter.initial()
    for j, t in enumerate(GRID):
        if j % 10 == 0:
            state = filter.step(state, t, data.measurements[j, :, 3])
            mean, cov = state.mean, state.cov
            np.testing.assert_allclose(cov, found.cov[j, ..., 3], rtol=1e-10, atol=1e-12)
            assert state.loglik == pytest.approx(found.loglik[j, 3], rel=1e-9, abs=1e-9)
        else:
            mean = filter.forecast(state, t).mean
            assert np.isnan(found.cov[j]).all()
            assert not found.loglik[j].any()
        np.testing.assert_allclose(mean, found.mean[j, :, 3], rtol=1e-9, atol=1e-11)


def test_batch_axes_are_only_shape(filter, data):
    found = filter.run(GRID, data.measurements)
    folded = filter.run(GRID, data.measurements.reshape(61, 2, 8, 5))
    single = filter.run(GRID, data.measurements[..., 7])
    assert folded.mean.shape == (61, 2, 8, 5)
    assert single.mean.shape == (61, 2)
    np.testing.assert_allclose(folded.mean.reshape(found.mean.shape), found.mean, rtol=1e-12)
    np.testing.assert_allclose(single.mean, found.mean[..., 7], rtol=1e-9, atol=1e-11)
    assert folded.diverged.shape == (8, 5)
    assert not found.diverged.any()


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_missing_measurement_is_skipped_exactly(filter, data):
    """Without the measurement at 1 the estimate there is the forecast, to the last bit."""
    y = data.measurements.copy()
    y[20] = np.nan
    state = filter.initial((40,))
    for k in range(3):
        state = filter.predict(state, TACTS[k])
        before = state.mean
        state = filter.correct(state, y[10 * k])
    np.testing.assert_array_equal(state.mean, before)
    assert not state.loglik.any()
    assert np.isfinite(filter.run(GRID, y).mean).all()


def test_missing_component_is_skipped_exactly(filter, data):
    """Only the second component at 1: the scalar update by it, written out."""
    state = filter.initial((40,))
    for k in range(2):
        state = filter.step(state, TACTS[k], data.measurements[10 * k])
    state = filter.predict(state, 1.0)
    y = data.measurements[20].copy()
    y[0, ::2] = np.nan
    found = filter.correct(state, y)
    mean, cross, cov = filter.expect(state)
    gain = np.broadcast_to(cross[:, 1] / cov[1, 1], (2, 40))
    expected = state.mean + gain * (y[1] - mean[1])
    np.testing.assert_allclose(found.mean[:, ::2], expected[:, ::2], rtol=1e-12)
    whole = filter.correct(state, data.measurements[20])
    np.testing.assert_allclose(found.mean[:, 1::2], whole.mean[:, 1::2], rtol=1e-12)


def test_missing_first_measurement_gives_the_prior_mean(filter, oscillator):
    state = filter.step(filter.initial(), 0.0, [np.nan, np.nan])
    np.testing.assert_array_equal(state.mean, filter.start.mean)


def test_a_missing_measurement_is_remembered_as_its_forecast(oscillator):
    """What a memory of measurements holds then is the expectation of the missing one."""
    filter = design(oscillator, finite_memory(2))
    state = filter.step(filter.initial(), 0.0, [4.0, 0.5])
    state = filter.predict(state, 0.5)
    expected = filter.expect(state).mean
    state = filter.correct(state, [np.nan, 1.0])
    np.testing.assert_array_equal(state.past.vector, [expected[0], 1.0, 4.0, 0.5])


# Forecasts between measurements


def interval():
    times = np.array([1.0, 1.2, 1.5, 2.0])
    values = [np.array([v]) for v in (3.0, 4.0, 2.0, 7.0)]
    return Interval(times, values, 2, (0.0, np.array([2.5])), (0.8, np.array([2.0])))


@pytest.mark.parametrize(
    ("kind", "t", "value"),
    [
        ("constant", 1.9, 3.0),
        ("linear", 1.4, 3.0 + 0.5 * 0.4),
        ("piecewise constant", 1.1, 3.0),
        ("piecewise constant", 1.2, 4.0),
        ("piecewise constant", 1.99, 2.0),
        ("piecewise linear", 1.1, 3.0 + 5.0 * 0.1),
        ("piecewise linear", 1.3, 4.0 + 5.0 * 0.1),
        ("piecewise linear", 1.8, 2.0 - 2.0 / 0.3 * 0.3),
        ("piecewise linear, first constant", 1.1, 3.0),
        ("piecewise linear, first constant", 1.3, 4.5),
        ("interpolated", 1.1, 3.5),
        ("interpolated", 1.35, 3.0),
        ("interpolated", 1.75, 4.5),
        ("interpolated", 2.0, 7.0),
    ],
)
def test_kinds_of_forecast(kind, t, value):
    assert at(interval(), t, kind)[0] == pytest.approx(value)


def test_times_that_are_nodes_up_to_rounding_are_nodes():
    assert at(interval(), np.nextafter(1.2, 0), "piecewise constant")[0] == 4.0
    assert at(interval(), np.nextafter(1.0, 0), "piecewise constant")[0] == 3.0
    assert at(interval(), np.nextafter(1.0, 0), "interpolated")[0] == pytest.approx(3.0)


def test_linear_kinds_are_constant_where_there_is_no_past():
    first = interval()._replace(last=None, last_node=None)
    assert at(first, 1.1, "linear")[0] == 3.0
    assert at(first, 1.1, "piecewise linear")[0] == 3.0


def test_forecasts_of_a_run_use_the_nodes(oscillator, data):
    """The literal piecewise-linear forecast takes its first slope across the measurement."""
    filter = design(oscillator, nodes=4).forecasting("piecewise linear")
    found = filter.run(GRID, data.measurements).mean
    constant = filter.forecasting("piecewise constant").run(GRID, data.measurements).mean
    node, tact, between = 18, 20, 21  # .9 is the last node before the measurement at 1
    slope = (constant[tact] - constant[node]) / 0.1
    np.testing.assert_allclose(found[between], constant[tact] + 0.05 * slope, rtol=1e-9)
    whole = filter.forecasting("interpolated").run(GRID, data.measurements).mean
    np.testing.assert_allclose(whole[21], (constant[20] + constant[22]) / 2, rtol=1e-12)
    np.testing.assert_array_equal(whole[::10], found[::10])


def test_linear_forecast_at_the_first_interval_is_constant(oscillator, data):
    filter = design(oscillator, finite_memory(1)).forecasting("linear")
    found = filter.run(GRID, data.measurements).mean
    np.testing.assert_array_equal(found[5], found[0])
    slope = (found[10] - found[0]) / 0.5
    np.testing.assert_allclose(found[15], found[10] + 0.25 * slope, rtol=1e-12)


def test_ranking_of_forecasts(oscillator):
    """Time-averaged errors on the full grid; interpolation wins, the literal rule is harmful."""
    grid = np.linspace(0, 3, 301)
    filter = synthesize(oscillator, Memory(1), ExactGaussian(), TACTS, paths=16_384, seed=21)
    dense = synthesize(oscillator, Memory(1), ExactGaussian(), TACTS, nodes=49, paths=4096, seed=2)
    filters = {kind: filter.forecasting(kind) for kind in FORECAST_KINDS}
    filters["dense"] = dense.forecasting("piecewise constant")
    found = compare(filters, oscillator, grid, 8192, 22, components=1)
    printed = {
        "constant": 0.4121, "linear": 0.3998, "piecewise constant": 0.3736,
        "piecewise linear": 0.3773, "piecewise linear, first constant": 0.3729,
        "interpolated": 0.3718,
    }  # fmt: skip
    for kind, value in printed.items():
        combined = found[kind].average_error[0] * np.sqrt(2 + 8192 / 20_000)
        assert abs(found[kind].average[0] - value) < 4 * combined
    ranking = [
        "constant", "linear", "piecewise linear", "piecewise constant",
        "piecewise linear, first constant", "interpolated",
    ]  # fmt: skip
    for worse, better in pairwise(ranking):
        apart = found.difference(worse, better)
        assert apart.average[0] > 2 * apart.average_error[0], (worse, better)
    best = found.difference("interpolated", "dense")
    assert abs(best.average[0]) < 0.01


def test_continuous_forecast_is_the_mean_of_a_linear_system():
    """dZ/dt = A Z from an unbiased estimate: the forecast is exp(A t) Z up to Euler's step."""
    system = zoo.linear_gaussian()
    made = synthesize(
        system, Memory(1), Taylor(), TACTS[:3], predictor=Continuous(), paths=40_000, seed=3,
        step=0.01,
    )  # fmt: skip
    state = made.step(made.initial(), 0.0, [0.4])
    drift = np.array([[0.0, 1.0], [-1.0, -0.4]])
    for t in (0.2, 0.5):
        found = made.forecast(state, t).mean
        np.testing.assert_allclose(found, expm(t * drift) @ state.mean, atol=0.02)
    # Gamma_t z + kappa_t stays near z for an unbiased estimate with an independent error
    gains = np.array([fit.gain for fit in made.node_fits[1]])
    assert np.abs(gains - np.eye(2)).max() < 0.05


# Polynomial forecasts


def test_monomials_of_total_degree_with_cross_terms():
    point = np.random.default_rng(0).standard_normal((3, 7))
    found = monomials(point, 4)
    powers = [(a, b, c) for a in range(5) for b in range(5) for c in range(5) if 0 < a + b + c <= 4]
    expected = [point[0] ** a * point[1] ** b * point[2] ** c for a, b, c in powers]
    assert len(found) == len(powers)
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(expected, axis=0), rtol=1e-12)
    np.testing.assert_array_equal(found[: len(monomials(point, 2))], monomials(point, 2))


def test_floor_of_conditional_covariances():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((3, 3))
    mean_cov = root @ root.T
    items = rng.standard_normal((3, 3, 50))
    items = items + np.swapaxes(items, 0, 1)
    found = bounded_below(items, mean_cov)
    lower = np.linalg.cholesky(mean_cov)
    back = np.linalg.inv(lower)
    for i in range(50):
        values, vectors = np.linalg.eigh(back @ items[..., i] @ back.T)
        inner = (vectors * np.maximum(values, FLOOR)) @ vectors.T
        np.testing.assert_allclose(found[..., i], lower @ inner @ lower.T, atol=1e-10)


def test_floor_acts_on_some_paths_only(oscillator):
    """On 10 to 18 per cent of the paths for degrees (3, 2)."""
    made = synthesize(
        oscillator, Memory(1), ExactGaussian(), TACTS, predictor=Polynomial(3, 2), paths=16_384,
        seed=1, nodes=0,
    )  # fmt: skip
    data = oscillator.simulate(TACTS, 8192, 5)
    z = made.run(TACTS, data.measurements).mean
    shares = []
    for k, fit in enumerate(made.fits):
        cov = fit.forecast(z[k])[1]
        inside = np.linalg.solve(np.linalg.cholesky(fit.residual), np.moveaxis(cov, 2, 0))
        inside = np.linalg.solve(np.linalg.cholesky(fit.residual), np.swapaxes(inside, 1, 2))
        shares.append((np.linalg.eigvalsh(inside)[:, 0] < FLOOR * (1 + 1e-6)).mean())
    assert 0.05 < np.mean(shares) < 0.25
    assert max(shares) < 0.35


# What the filter says about itself


def test_summary_can_be_read(filter):
    text = str(filter)
    assert "Finite-order filter of order" in text
    assert "3000 paths, seed 1" in text
    assert "in-sample" in text
    assert "on 512 paths that the design has not seen" in text
    assert len(text.splitlines()) == 14
    assert max(map(len, text.splitlines())) <= 100
    assert repr(filter).startswith("<FiniteOrderFilter of order")


def test_a_designed_filter_is_frozen(filter):
    arrays = [filter.times, filter.start.cov, filter.start.moments.cross, filter.predicted.rms]
    for array in [*arrays, *(p for fit in filter.fits for p in fit if isinstance(p, np.ndarray))]:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
    with pytest.raises(AttributeError):
        filter.components = 1


def test_order_and_horizon(oscillator):
    made = design(oscillator, Memory(3), horizon=4.0)
    assert made.order == 6
    assert made.horizon == 4.0
    assert design(oscillator).horizon == 3.0
    state = made.initial()
    for t in TACTS:
        state = made.step(state, t, [1.0, 0.0])
    assert np.isfinite(made.forecast(state, 4.0).mean).all()


def test_parameters_count(oscillator):
    """Claim of the paper: the extended filter integrates 5 equations, these filters none."""
    state = extended_kalman(oscillator).initial()
    assert len(state.mean) + len(state.mean) * (len(state.mean) + 1) // 2 == 5
    made = design(oscillator, Memory(1)), design(oscillator, Memory(4))
    assert [filter.order for filter in made] == [2, 8]
    assert all(filter.rules.velocity is None for filter in made)


def test_committed_times():
    """The measured table says what the book says about it; nothing is timed here."""
    table = Path(__file__).resolve().parents[2] / "benchmarks" / "finite_order.csv"
    with table.open() as file:
        rows = {(r["filter"], r["paths"], r["output"]): r for r in csv.DictReader(file)}

    def seconds(*key):
        return float(rows[key]["microseconds_per_path"])

    def ratio(name, paths, output, peer="EKF Euler"):
        return seconds(peer, paths, output) / seconds(name, paths, output)

    columns = [
        (paths, output, f"EKF {method}")
        for paths in ("single", "batch") for output in ("measurements", "grid")
        for method in ("Euler", "RK4")
    ]  # fmt: skip
    small = [ratio("FMP", *column) for column in columns]
    large = [ratio(name, *column) for name in ("FBP 1", "FKP 4") for column in columns]
    assert min(small + large) > 1  # faster in every column, and
    assert max(small) > 8 * min(small)  # by factors that differ too much to decide a number
    assert max(large) > 8 * min(large)
    alike = [ratio("FKP 4", *column) / ratio("FBP 1", *column) for column in columns]
    assert max(np.abs(np.log(alike))) < np.log(1.6)


# Bad input


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (TACTS[1:], "times: wanted to begin at 0"),
        (TACTS + 0.25, "times: wanted to begin at 0"),
        ([0, 1.0], "times: wanted all measurement times of the design, 0.5"),
        ([0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5], "times: wanted at most 3"),
        ([0, 0, 1], "times: wanted strictly increasing"),
    ],
)
def test_times_that_do_not_fit(oscillator, times, message):
    made = design(oscillator)
    with pytest.raises(ValueError, match=message):
        made.run(times, np.full((len(times), 2), np.nan))


def test_measurements_that_do_not_fit(oscillator):
    made = design(oscillator)
    with pytest.raises(ValueError, match=r"wanted NaN at 0\.25"):
        made.run([0, 0.25, 0.5], np.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"measurements: wanted shape \(2, 2, "):
        made.run([0, 0.5], np.zeros((2, 3)))
    with pytest.raises(ValueError, match="finite numbers or NaN, got inf"):
        made.run([0, 0.5], [[1, np.inf], [0, 0]])
    state = made.predict(made.initial(), 0.0)
    with pytest.raises(ValueError, match="y: wanted finite numbers, got inf"):
        made.correct(state, [np.inf, 0.0])


def test_steps_out_of_order(oscillator):
    made = design(oscillator)
    start = made.initial()
    with pytest.raises(ValueError, match="call predict first"):
        made.correct(start, [0.0, 0.0])
    with pytest.raises(ValueError, match=r"wanted the next measurement time 0, got 0\.5"):
        made.predict(start, 0.5)
    forecast = made.predict(start, 0.0)
    with pytest.raises(ValueError, match="after a correction, got a forecast"):
        made.predict(forecast, 0.5)
    state = made.correct(forecast, [4.0, 0.0])
    with pytest.raises(ValueError, match=r"t: wanted a time from 0 to 0\.5"):
        made.forecast(state, 0.7)
    with pytest.raises(ValueError, match="kind: wanted one of"):
        made.forecast(state, 0.2, "cubic")
    with pytest.raises(ValueError, match="between: wanted one of"):
        made.forecasting("cubic")
    for t in TACTS[1:]:
        state = made.step(state, t, [4.0, 0.0])
    with pytest.raises(ValueError, match="at most the last measurement time 3"):
        made.predict(state, 3.5)


def test_singular_innovation_is_met_by_the_pseudo_inverse():
    """A sensor that shows one exact number twice: the estimate is that number."""
    x = sympy.Symbol("x")
    system = JumpDiffusion((x,), [-x], [[1]], [x, x], Noise(()), [0], [[1]])
    made = synthesize(system, Memory(1), Taylor(), [0, 0.5, 1], paths=2000, seed=1)
    data = system.simulate([0, 0.5, 1], 50, 2)
    found = made.run([0, 0.5, 1], data.measurements)
    np.testing.assert_allclose(found.mean, data.states, atol=1e-9)
    single = made.run([0, 0.5, 1], data.measurements[..., 4])
    np.testing.assert_allclose(single.mean, data.states[..., 4], atol=1e-9)


def test_threads_do_not_matter(oscillator):
    made = design(oscillator)
    data = oscillator.simulate(TACTS, 17_000, 3, step=0.02)
    one, two = (made.run(TACTS, data.measurements, workers=w) for w in (1, 2))
    np.testing.assert_array_equal(one.mean, two.mean)


def test_a_measurement_is_remembered_as_it_was():
    """The caller may read the next one into the same array."""
    times, y = np.arange(4.0), np.array([[1.0], [-2.0], [0.5], [3.0]])
    made = synthesize(
        zoo.linear_gaussian(), finite_memory(2), Taylor(), times, exact_moments=True, nodes=0
    )
    state, buffer = made.initial(), np.empty(1)
    for t, value in zip(times, y, strict=True):
        buffer[:] = value
        state = made.step(state, t, buffer)
    np.testing.assert_array_equal(state.mean, made.run(times, y).mean[-1])
    with pytest.raises(ValueError, match="indicators: wanted none"):
        made.run(times, y, indicators=np.zeros(4, dtype=int))


def test_steps_of_a_design_keep_what_was_predicted_of_them():
    """All steps are the design; without one, its predictions are gone and later ones move up."""
    design = synthesize(
        zoo.van_der_pol(), Memory(1), Taylor(), 0.5 * np.arange(5), paths=300, seed=1, nodes=2
    )
    whole = design.taking([0, 1, 2, 3, 4])
    assert np.array_equal(whole.predicted.times, design.predicted.times)
    assert np.array_equal(whole.predicted.rms, design.predicted.rms)
    some = design.taking([0, 1, 3, 4])
    kept = (design.predicted.times <= 0.5) | (design.predicted.times > 1.0)
    assert np.array_equal(some.predicted.rms, design.predicted.rms[kept])
    np.testing.assert_allclose(some.predicted.times, np.arange(10) / 6, atol=1e-15)
    assert np.array_equal(some.times, 0.5 * np.arange(4))
