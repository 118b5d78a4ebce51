"""Evaluation of filters: errors, their standard errors, paired differences, consistency."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base.blocks import as_seed_sequence
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.evaluation import compare, evaluate
from seedslib.evaluation.consistency import bounds, mahalanobis
from seedslib.evaluation.tally import merged, tally
from seedslib.filters import Estimates, extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import JumpDiffusion, Noise

TIMES = np.arange(4) * 0.5


@pytest.fixture(scope="module")
def oscillator():
    return zoo.van_der_pol()


@pytest.fixture(scope="module")
def pair(oscillator):
    return {
        f"order {l}": synthesize(
            oscillator, Memory(l), ExactGaussian(), TIMES, nodes=0, paths=3000, seed=1, step=0.02
        )
        for l in (1, 2)
    }


class Scripted:
    """Filter whose estimate is what the script says about each path."""

    def __init__(self, error, components=1):
        self.error, self.components = error, components

    def run(self, times, measurements):
        count = measurements.shape[2]
        mean = np.zeros((len(times), self.components, count))
        mean[:] = self.error(np.arange(count))
        return Estimates(mean, diverged=~np.isfinite(mean).all(axis=(0, 1)))


def resting():
    """A state that is always zero, so that estimates are errors."""
    x, v = sympy.symbols("x v")
    return JumpDiffusion((x,), [0 * x], [[0]], [x + v], Noise((v,)), [0], [[0]])


def test_errors_are_those_of_the_paths(oscillator, pair):
    """Recomputed from the same simulated blocks by hand."""
    found = compare(pair, oscillator, TIMES, 3000, 5, step=0.02)
    squares = {name: [] for name in pair}
    errors = {name: [] for name in pair}
    sizes = [2048, 952]
    for stream, count in zip(as_seed_sequence(5).spawn(2), sizes, strict=True):
        data = oscillator.simulate(TIMES, count, stream, step=0.02)
        for name, filter in pair.items():
            error = filter.run(TIMES, data.measurements).mean - data.states
            errors[name].append(error)
            squares[name].append(error**2)
    squares = {name: np.concatenate(parts, axis=2) for name, parts in squares.items()}
    for name, part in squares.items():
        rms = np.sqrt(part.mean(axis=2))
        np.testing.assert_allclose(found[name].rms, rms, rtol=1e-12)
        error = part.std(axis=2) / np.sqrt(3000) / (2 * rms)
        np.testing.assert_allclose(found[name].rms_error, error, rtol=1e-9)
        bias = np.concatenate(errors[name], axis=2)
        np.testing.assert_allclose(found[name].bias, bias.mean(axis=2), rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(found[name].bias_error, bias.std(axis=2) / np.sqrt(3000))
        average = part.mean(axis=0)
        np.testing.assert_allclose(found[name].average, np.sqrt(average.mean(axis=1)))
    influence = [part / (2 * found[name].rms[..., None]) for name, part in squares.items()]
    apart = found.difference("order 1", "order 2")
    np.testing.assert_allclose(apart.rms, found["order 1"].rms - found["order 2"].rms)
    expected = (influence[0] - influence[1]).std(axis=2) / np.sqrt(3000)
    np.testing.assert_allclose(apart.error, expected, rtol=1e-6, atol=1e-12)
    assert apart.error[3, 0] < found["order 1"].rms_error[3, 0]


def test_standard_errors_are_those_of_repetitions(oscillator, pair):
    found = [compare(pair, oscillator, TIMES, 400, seed, step=0.05) for seed in range(60)]
    for name in pair:
        rms = np.array([c[name].rms for c in found])
        claimed = np.mean([c[name].rms_error for c in found], axis=0)
        # the spread of a standard deviation from 60 repetitions is 9 %
        np.testing.assert_allclose(rms.std(axis=0, ddof=1), claimed, rtol=0.4)
    apart = [c.difference("order 1", "order 2") for c in found]
    spread = np.std([d.rms for d in apart], axis=0, ddof=1)
    claimed = np.mean([d.error for d in apart], axis=0)
    np.testing.assert_allclose(spread[2:], claimed[2:], rtol=0.5)


def test_threads_do_not_matter(oscillator, pair):
    one, two = (compare(pair, oscillator, TIMES, 5000, 3, workers=w, step=0.05) for w in (1, 2))
    for name in pair:
        np.testing.assert_array_equal(one[name].rms, two[name].rms)
        np.testing.assert_array_equal(one[name].rms_error, two[name].rms_error)


def test_test_paths_are_not_the_design_paths_even_for_equal_seeds(oscillator, pair):
    filter = pair["order 1"]
    assert filter.predicted.in_sample
    found = evaluate(filter, oscillator, TIMES, 3000, 1, step=0.02)
    assert np.abs(found.rms - filter.predicted.rms).min() > 1e-6
    combined = np.hypot(found.rms_error, filter.predicted.error)
    np.testing.assert_array_less(np.abs(found.rms - filter.predicted.rms), 4 * combined)


# Diverged paths


def test_diverged_paths_are_counted_and_reported_both_ways():
    """One of 100 paths is NaN; the others err by one."""
    astray = Scripted(lambda i: np.where(i == 7, np.nan, 1.0))
    steady = Scripted(lambda i: np.where(i == 7, 5.0, 2.0))
    found = compare({"astray": astray, "steady": steady}, resting(), [0, 1], 100, 1)
    assert found["astray"].diverged == 1
    assert found["steady"].diverged == 0
    assert found["astray"].scored == found["steady"].scored == 99
    np.testing.assert_array_equal(found["astray"].rms, 1.0)
    assert np.all(np.isinf(found["astray"].rms_all))
    np.testing.assert_array_equal(found["steady"].rms, 2.0)
    np.testing.assert_allclose(found["steady"].rms_all, np.sqrt((99 * 4 + 25) / 100))
    assert "1 of 100 paths diverged" in str(found)
    for name in found:
        assert all(np.isfinite(part).all() for part in found[name][1:3])


def test_bound_says_what_is_absurd():
    far = Scripted(lambda i: np.where(i % 10 == 0, 30.0, 1.0))
    found = evaluate(far, resting(), [0, 1], 100, 1, bound=20)
    assert found.diverged == 10
    np.testing.assert_array_equal(found.rms, 1.0)
    np.testing.assert_allclose(found.rms_all, np.sqrt((90 + 10 * 900) / 100))
    assert evaluate(far, resting(), [0, 1], 100, 1).diverged == 0


def test_truth_that_diverges_is_left_out():
    x, v = sympy.symbols("x v")
    system = JumpDiffusion((x,), [x**3 - x], [[0.1]], [x + v], Noise((v,)), [0], [[0.09]])
    filters = {"zero": Scripted(lambda i: 0.0 * i), "ekf": extended_kalman(system, bound=20)}
    found = compare(filters, system, np.arange(9) * 0.5, 4000, 1)
    assert found["zero"].diverged == 0
    assert 3900 < found["zero"].scored < 4000
    assert np.isfinite(found["zero"].rms_all).all()
    assert np.isfinite(found["ekf"].rms).all()


def test_all_paths_diverged_is_an_error():
    lost = Scripted(lambda i: np.nan + i)
    with pytest.raises(ValueError, match="paths: wanted at least 2 without divergence, got 0"):
        evaluate(lost, resting(), [0, 1], 50, 1)


def test_extended_filter_diverges_rarely_and_the_table_stays_finite():
    """Kicked Duffing: 15 of 2e4 paths by Euler steps with the bound 20 on either component."""
    duffing = zoo.kicked_duffing()
    grid = np.linspace(0, 6, 61)
    ekf = extended_kalman(duffing, integrator="euler")
    found = evaluate(ekf, duffing, grid, 8192, 3, bound=20, measured=np.arange(0, 61, 5))
    assert 0 < found.diverged < 6.1 + 4 * np.sqrt(6.1)
    assert np.isfinite(found.rms).all()
    assert np.isfinite(found.rms_error).all()
    assert found.rms_all.max() > found.rms.max()


# Consistency


def test_kalman_filter_is_consistent():
    """NEES and NIS within their 95 % bounds about 95 % of the time, never far outside."""
    system = zoo.linear_gaussian()
    times = np.arange(21) * 0.5
    exact = synthesize(system, Memory(2), Taylor(), times, exact_moments=True)
    filters = {"designed": exact, "extended": extended_kalman(system)}
    found = compare(filters, system, times, 6000, 7, consistency=True, step=0.005)
    for name in filters:
        for values, (low, high), freedom in (
            (found[name].nees, found[name].nees_bounds, 2),
            (found[name].nis, found[name].nis_bounds, 1),
        ):
            assert ((low < freedom) & (freedom < high)).all()
            outside = (values < low) | (values > high)
            assert outside.mean() <= 0.25
            assert np.abs(values - freedom).max() < 2.2 * (high - freedom).min()
    np.testing.assert_allclose(found["designed"].nees, found["extended"].nees, rtol=1e-6)


def test_linearised_filter_believes_too_much(oscillator):
    ekf = extended_kalman(oscillator, integrator="euler")
    found = evaluate(ekf, oscillator, np.arange(7) * 0.5, 2048, 3, consistency=True)
    assert found.nees[-1] > 2 * found.nees_bounds[1][-1]
    assert found.nis[-1] > found.nis_bounds[1][-1]


def test_filters_without_covariance_have_no_consistency():
    found = evaluate(Scripted(lambda i: 1.0 + i), resting(), [0, 1], 20, 1, consistency=True)
    assert found.nees is None
    assert found.nis is None


def test_normalised_squares_against_explicit_inverses():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((2, 3, 3, 5))
    cov = np.einsum("jikN,jlkN->jilN", root, root)
    error = rng.standard_normal((2, 3, 5))
    found, freedom = mahalanobis(error, cov)
    assert freedom == 3
    for j in range(2):
        for i in range(5):
            expected = error[j, :, i] @ np.linalg.inv(cov[j, ..., i]) @ error[j, :, i]
            assert found[j, i] == pytest.approx(expected, rel=1e-9)
    cov[1, ..., 2] = np.nan
    found, _ = mahalanobis(error, cov)
    assert np.isnan(found[1, 2])
    assert np.isfinite(found).sum() == 9
    singular = np.zeros((1, 2, 2))
    singular[0, 0, 0] = 4.0
    found, _ = mahalanobis(np.full((1, 2, 1), 2.0), singular)
    assert found[0, 0] == pytest.approx(1.0)


def test_bounds_of_chi_square():
    """P(chi² with 2 degrees < x) = 1 - exp(-x / 2)."""
    low, high = bounds(2, 1)
    assert low == pytest.approx(-2 * np.log(0.975))
    assert high == pytest.approx(-2 * np.log(0.025))
    low, high = bounds(2, 10**6)
    assert (high - low) / 2 == pytest.approx(1.96 * 2 / 1000, rel=1e-3)


# Pieces and bad input


def test_sums_of_blocks_merge_to_those_of_the_whole():
    rng = np.random.default_rng(4)
    error = rng.standard_normal((3, 4, 2, 900)) + np.arange(3)[:, None, None, None]
    good, astray = np.ones(900, bool), np.zeros((3, 900), bool)
    astray[1, ::7] = True
    good &= ~astray.any(axis=0)

    def part(piece):
        chosen = np.ones(len(good[piece]), bool)
        return tally(
            error[..., piece], good[piece], chosen, astray[:, piece], [None] * 3, np.ones(3), 1
        )

    whole = part(slice(None))
    both = merged(part(slice(0, 333)), part(slice(333, None)))
    for name in ("mean", "products", "error", "everything", "diverged"):
        np.testing.assert_allclose(getattr(both, name), getattr(whole, name), rtol=1e-11)
    assert both.count == whole.count == good.sum()


def test_time_per_step_is_measured(oscillator, pair):
    found = evaluate(pair["order 1"], oscillator, TIMES, 500, 1, step=0.1)
    assert 0 < found.seconds_per_step < 1


def test_measurement_times_are_those_of_the_designed_filters(oscillator, pair):
    grid = np.linspace(0, 1.5, 16)
    found = evaluate(pair["order 1"], oscillator, grid, 500, 1, step=0.05)
    assert found.rms.shape == (16, 2)
    with pytest.raises(ValueError, match=r"measurements: wanted NaN at 0\.1"):
        evaluate(pair["order 1"], oscillator, grid, 100, 1, measured=np.arange(16), step=0.05)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"filters": {}}, TypeError, "filters: wanted a mapping"),
        ({"filters": [Scripted(abs)]}, TypeError, "filters: wanted a mapping"),
        ({"paths": 0}, ValueError, "paths: wanted at least 1"),
        ({"seed": None}, TypeError, "seed: wanted"),
        ({"times": [1, 0]}, ValueError, "times: wanted strictly increasing"),
        ({"components": 2}, ValueError, "components: wanted at most 1, got 2"),
        ({"measured": [5]}, ValueError, "measured: wanted indices"),
    ],
)
def test_bad_input_is_named(changes, error, message):
    options = {
        "filters": {"one": Scripted(lambda i: 1.0 + i)}, "system": resting(), "times": [0, 1],
        "paths": 10, "seed": 1,
    } | changes  # fmt: skip
    first = [options.pop(name) for name in ("filters", "system", "times", "paths", "seed")]
    with pytest.raises(error, match=message):
        compare(*first, **options)
