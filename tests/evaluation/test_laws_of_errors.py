"""Whether a filter's laws fit: bands, ratios over the window, coverage, log scores, schedules."""

import numpy as np
import pytest
import sympy
from scipy.stats import chi2, norm

from seedslib.base.blocks import as_seed_sequence
from seedslib.delay import DelayKalmanFilter
from seedslib.delay.examples import two_noises
from seedslib.evaluation import compare, evaluate
from seedslib.evaluation.consistency import bounds, ratio_of_sums
from seedslib.evaluation.tally import ErrorSums
from seedslib.filters import extended_kalman, unscented_kalman
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

TIMES = np.arange(8.0)
PATHS = 1500
F, Q = np.array([[0.9, 0.3], [-0.2, 0.8]]), np.diag([0.3, 0.1])
H, R = np.array([[1.0, 0.0], [0.5, 1.0]]), np.diag([0.4, 0.7])
MASK = np.array([[1, 0], [0, 1], [0, 0], [1, 1], [0, 1], [1, 0], [1, 1], [0, 0]], dtype=bool)
WINDOW = (2, 6)


def linear(noise_cov=Q):
    x, v, w = (sympy.symbols(f"{name}1:3", real=True) for name in "xvw")
    state, moved, shown = (sympy.Matrix(part) for part in (x, v, w))
    dynamics = StochasticMap(x, list(sympy.Matrix(F) * state + moved), Noise(v, cov=noise_cov))
    sensor = StochasticMap(x, list(sympy.Matrix(H) * state + shown), Noise(w, cov=R))
    return DiscreteSystem(dynamics, sensor, [1.0, -1.0], np.eye(2))


def by_hand(y):
    """Kalman filter of one path (J, 2) with NaN for what is missing, written out."""
    mean, cov, rows = np.array([1.0, -1.0]), np.eye(2), []
    for k, shown in enumerate(y):
        if k:
            mean, cov = F @ mean, F @ cov @ F.T + Q
        seen = ~np.isnan(shown)
        density, square = 0.0, np.nan
        if seen.any():
            h, s = H[seen], H[seen] @ cov @ H[seen].T + R[np.ix_(seen, seen)]
            error = shown[seen] - h @ mean
            square = error @ np.linalg.inv(s) @ error
            density = -0.5 * (square + np.log(np.linalg.det(2 * np.pi * s)))
            gain = cov @ h.T @ np.linalg.inv(s)
            mean, cov = mean + gain @ error, cov - gain @ h @ cov
        rows.append((mean, cov, density, square))
    return [np.array(part) for part in zip(*rows, strict=True)]


@pytest.fixture(scope="module")
def system():
    return linear()


@pytest.fixture(scope="module")
def filters(system):
    return {"right": extended_kalman(system), "bold": extended_kalman(linear(0.2 * Q))}


@pytest.fixture(scope="module")
def found(system, filters):
    return compare(filters, system, TIMES, PATHS, 3, measured=MASK, window=WINDOW, consistency=True)


@pytest.fixture(scope="module")
def hand(system):
    """The same paths with the filter written out: error, covariance, density, square."""
    data = system.simulate(TIMES, PATHS, as_seed_sequence(3).spawn(1)[0], measured=MASK)
    rows = [by_hand(data.measurements[..., i]) for i in range(PATHS)]
    mean, cov, density, square = (np.stack(part, axis=-1) for part in zip(*rows, strict=True))
    return mean - data.states, cov, density, square


def test_log_scores_are_those_of_the_densities(found, hand):
    density, rows = hand[2], MASK.any(axis=1)
    right = found["right"]
    np.testing.assert_allclose(right.log_score[rows], density.mean(axis=1)[rows], rtol=1e-9)
    assert np.isnan(right.log_score[~rows]).all()
    spread = density.std(axis=1)[rows] / np.sqrt(PATHS)
    np.testing.assert_allclose(right.log_score_error[rows], spread, rtol=1e-7)
    late = density[[3, 4, 5, 6]].mean(axis=0)
    assert right.average_log_score == pytest.approx(late.mean(), rel=1e-9)
    assert right.average_log_score_error == pytest.approx(late.std() / np.sqrt(PATHS), rel=1e-7)


def test_the_law_of_the_model_scores_best_on_common_paths(system, filters, found):
    apart = found.difference("right", "bold")
    assert apart.average_log_score > 8 * apart.average_log_score_error
    right, bold = found["right"], found["bold"]
    assert apart.average_log_score == pytest.approx(
        right.average_log_score - bold.average_log_score, abs=1e-12
    )
    data = system.simulate(TIMES, PATHS, as_seed_sequence(3).spawn(1)[0], measured=MASK)
    one, two = (filters[n].run(TIMES, data.measurements).loglik for n in ("right", "bold"))
    late = (one - two)[3:7].mean(axis=0)
    wanted = late.std() / np.sqrt(PATHS)
    assert apart.average_log_score_error == pytest.approx(wanted, rel=1e-6)
    assert apart.log_score_error[6] == pytest.approx((one - two)[6].std() / np.sqrt(PATHS))
    assert apart.mode is None


def test_ratios_and_coverage_are_those_of_the_paths(found, hand):
    error, cov, _, square = hand
    right = found["right"]
    inverse = np.linalg.inv(np.moveaxis(cov, 3, 0))
    nees = np.einsum("jiN,Njik,jkN->jN", error, inverse, error)
    np.testing.assert_allclose(right.nees, nees.mean(axis=1), rtol=1e-8)
    per_path = nees[2:7].mean(axis=0) / 2
    assert right.nees_ratio == pytest.approx(per_path.mean())
    assert right.nees_ratio_error == pytest.approx(per_path.std() / np.sqrt(PATHS), rel=1e-6)
    rows = MASK.any(axis=1)
    np.testing.assert_allclose(right.nis[rows], square.mean(axis=1)[rows], rtol=1e-8)
    assert np.isnan(right.nis[~rows]).all()
    per_path = np.nansum(square[2:7], axis=0) / MASK[2:7].sum()
    assert right.nis_ratio == pytest.approx(per_path.mean())
    assert right.nis_ratio_error == pytest.approx(per_path.std() / np.sqrt(PATHS), rel=1e-6)
    width = norm.ppf(0.975) * np.sqrt(np.einsum("jiiN->jiN", cov))
    inside = np.abs(error) <= width
    np.testing.assert_allclose(right.coverage, inside.mean(axis=2))
    np.testing.assert_allclose(right.coverage_error, inside.std(axis=2) / np.sqrt(PATHS))
    late = inside[2:7].mean(axis=0)
    np.testing.assert_allclose(right.average_coverage, late.mean(axis=1))
    np.testing.assert_allclose(
        right.average_coverage_error, late.std(axis=1) / np.sqrt(PATHS), rtol=1e-6
    )


def test_a_consistent_filter_is_told_from_a_bold_one(found):
    right, bold = found["right"], found["bold"]
    for name, wanted in (("nees_ratio", 1), ("nis_ratio", 1), ("average_coverage", 0.95)):
        off, error = np.abs(getattr(right, name) - wanted), getattr(right, f"{name}_error")
        assert np.all(off < 4 * error), name
        off, error = np.abs(getattr(bold, name) - wanted), getattr(bold, f"{name}_error")
        assert np.all(off > 6 * error), name


def test_bands_are_quantiles_of_chi_square(found):
    """Of the sum of the degrees of freedom: one or two components are measured."""
    right, count = found["right"], MASK.sum(axis=1)
    for name, freedom in (("nees", np.full(8, 2)), ("nis", count)):
        for bound, p in zip(getattr(right, f"{name}_bounds"), (0.025, 0.975), strict=True):
            known = freedom > 0
            wanted = chi2.ppf(p, freedom[known] * PATHS) / PATHS
            np.testing.assert_allclose(bound[known], wanted, rtol=1e-9)
            assert np.isnan(bound[~known]).all()
    low, high = right.nees_bounds
    assert ((low < right.nees) & (right.nees < high)).sum() >= 6
    assert np.isnan(bounds(2, 0)).all()


def test_the_error_of_a_ratio_is_that_of_repetitions(system):
    """Forty runs of 100 paths whose measurements arrive now and then, so that counts vary."""
    kalman = extended_kalman(system)
    rows = np.array([
        (run.nis_ratio, run.nis_ratio_error, run.nees_ratio, run.nees_ratio_error)
        for run in (
            evaluate(kalman, system, TIMES, 100, s, consistency=True, availability=[0.3, 0.6])
            for s in range(40)
        )
    ])  # fmt: skip
    for value, error in (rows[:, :2].T, rows[:, 2:].T):
        # the spread of a standard deviation from 40 repetitions is 11 %
        assert value.std(ddof=1) == pytest.approx(error.mean(), rel=0.4)
        assert abs(value.mean() - 1) < 4 * error.mean() / np.sqrt(40)


def test_the_ratio_of_paths_that_know_different_times():
    """Two paths with sums 3 of 1 and 1 of 3: ratio 1, its error by the linear formula."""
    paths = np.array([[3.0, 1.0], [1.0, 3.0]])
    known = ErrorSums(np.zeros(1), np.zeros(1), np.zeros(1), paths.sum(axis=1), paths @ paths.T)
    assert ratio_of_sums(known) == (pytest.approx(1.0), pytest.approx(np.sqrt(8) / 4))


def test_dropouts_leave_a_filter_that_skips_them_consistent(system, filters):
    found = compare(filters, system, TIMES, 2500, 4, consistency=True, availability=0.5)
    right = found["right"]
    assert abs(right.nees_ratio - 1) < 4 * right.nees_ratio_error
    assert abs(right.nis_ratio - 1) < 4 * right.nis_ratio_error
    low, high = right.nis_bounds
    assert ((low < right.nis) & (right.nis < high)).sum() >= 6
    # of the records with a measurement two thirds have one component, and one third both
    assert right.nis.mean() == pytest.approx(4 / 3, abs=0.05)


def test_two_sensors_of_different_rates():
    """Position ten times a second with gaps, speed twice: EKF and UKF claim what they err by."""
    p, s, d = sympy.symbols("p s d", real=True)
    r = sympy.symbols("r1 r2", real=True)
    system = JumpDiffusion(
        [p, s, d], [s, -p - 0.3 * s + d, -0.2 * d], [[0], [0.1], [0.1]],
        [p + r[0], sympy.tanh(s) + r[1]], Noise(r, cov=np.diag([0.05**2, 0.1**2])),
        [0, 0, 0], np.eye(3) * 0.2, step=0.01,
    )  # fmt: skip
    times = np.arange(31) / 10
    number = np.arange(31)
    mask = np.stack([number % 5 != 3, number % 5 == 0], axis=1)
    filters = {"extended": extended_kalman(system), "unscented": unscented_kalman(system)}
    found = compare(
        filters, system, times, 600, 5, measured=mask, consistency=True, window=(10, None)
    )
    for name, row in found.items():
        assert abs(row.nees_ratio - 1) < 4 * row.nees_ratio_error, name
        assert abs(row.nis_ratio - 1) < 4 * row.nis_ratio_error, name
        assert row.nees_ratio_error < 0.05
    assert np.isnan(found["extended"].nis[mask.sum(axis=1) == 0]).all()


# Truths that are not the model, circles


def test_a_filter_may_have_another_model(system):
    """A filter of the first component alone, which thinks that the second is noise."""
    x, v, w = sympy.symbols("x v w", real=True)
    small = DiscreteSystem(
        StochasticMap([x], [0.9 * x + v], Noise([v], cov=[[0.6]])),
        StochasticMap([x], [x + w], Noise([w], cov=[[0.4]])), 1.0, 1.0,
    )  # fmt: skip

    class First:
        """The filter, shown the first sensor only."""

        def run(self, times, measurements):
            return extended_kalman(small).run(times, measurements[:, :1])

    filters = {"first": First(), "whole": extended_kalman(system)}
    found = compare(filters, system, TIMES, 800, 3, consistency=True)
    assert found["first"].rms.shape == found["whole"].rms.shape == (8, 1)
    assert found["first"].average[0] > found["whole"].average[0]
    data = system.simulate(TIMES, 800, as_seed_sequence(3).spawn(1)[0])
    error = First().run(TIMES, data.measurements).mean[:, 0] - data.states[:, 0]
    np.testing.assert_allclose(found["first"].rms[:, 0], np.sqrt((error**2).mean(axis=1)))
    # a filter of more components than the truth has is compared on those of the truth
    data = small.simulate(TIMES, 800, as_seed_sequence(3).spawn(1)[0])

    class Both:
        """The filter of two components, shown the first sensor only."""

        def run(self, times, measurements):
            y = np.concatenate([measurements, np.full_like(measurements, np.nan)], axis=1)
            return extended_kalman(system).run(times, y)

    wide = evaluate(Both(), small, TIMES, 800, 3, consistency=True)
    got = Both().run(TIMES, data.measurements)
    error = got.mean[:, 0] - data.states[:, 0]
    np.testing.assert_allclose(wide.rms[:, 0], np.sqrt((error**2).mean(axis=1)))
    # on the mean: one covariance serves all paths
    cov = got.cov[:, 0, 0] if got.cov.ndim == 4 else got.cov[:, 0, 0, None]
    np.testing.assert_allclose(wide.nees, (error**2 / cov).mean(axis=1), rtol=1e-9)


@pytest.fixture(scope="module")
def turning():
    """An angle that turns by one each step and its rate, on the circle and on the line."""
    x = sympy.symbols("a b", real=True)
    v, w = sympy.symbols("v w", real=True)

    def made(**circle):
        return DiscreteSystem(
            StochasticMap(x, [x[0] + x[1], x[1] + v], Noise([v], cov=[[1e-4]]), **circle),
            StochasticMap(x, [x[0] + w], Noise([w], cov=[[0.01]]), **circle),
            [3.0, 1.0], np.diag([0.01, 0.01]),
        )  # fmt: skip

    return made(period={0: 2 * np.pi}), made()


def test_errors_on_the_circle_are_as_without_the_cut(turning):
    circle, line = turning
    runs = [
        evaluate(extended_kalman(one), one, np.arange(12.0), 500, 3, consistency=True)
        for one in turning
    ]
    for name in ("rms", "average", "bias", "nees", "nis", "coverage", "average_coverage"):
        one, two = (getattr(run, name) for run in runs)
        np.testing.assert_allclose(one, two, rtol=1e-8, atol=1e-12, err_msg=name)
    assert runs[0].rms[:, 0].max() < 0.15
    # a system that does not know of the circle is told: here the filter's angle lies on it
    told = evaluate(
        extended_kalman(circle), line, np.arange(12.0), 500, 3, period={0: 2 * np.pi},
        consistency=True,
    )  # fmt: skip
    np.testing.assert_allclose(told.rms, runs[1].rms, rtol=1e-8)
    with pytest.raises(ValueError, match="period: wanted components from 0 to 1, got 2"):
        evaluate(extended_kalman(line), line, TIMES, 10, 1, period={2: 1.0})


def test_a_system_that_shows_nothing_at_first_has_no_score_there():
    plant = two_noises()
    found = evaluate(DelayKalmanFilter(plant), plant, np.arange(9.0), 600, 3, consistency=True)
    score = found.log_score
    assert np.isnan(score[0])
    assert np.isfinite(score[1:]).all()
    assert found.average_log_score == pytest.approx(score[1:].mean())
    assert abs(found.nees_ratio - 1) < 4 * found.nees_ratio_error
