"""Accuracy of filters on common paths: every number against the same paths, by hand."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.evaluation import compare, evaluate
from seedslib.filters import (
    Estimates,
    KalmanFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    extended_kalman,
)
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap
from systems import INPUTS, TIMES, recorded, switching_system

x, v, w = sympy.symbols("x v w", real=True)
GRID = np.arange(6.0)


class Guess:
    """Estimates zero, and decides the mode that the indicator shows."""

    takes = ("indicators",)

    def run(self, times, measurements, *, indicators):
        return Estimates(np.zeros((len(times), 3, measurements.shape[2])), modes=indicators)


class Scripted:
    """Estimates what the script says about each path."""

    def __init__(self, error, components=1):
        self.error, self.components = error, components

    def run(self, times, measurements):
        count = measurements.shape[2]
        mean = np.zeros((len(times), self.components, count))
        mean[:] = self.error(np.arange(count))
        return Estimates(mean, diverged=~np.isfinite(mean).all(axis=(0, 1)))


class Drawn:
    """Estimates random numbers and nothing else, and keeps some."""

    takes = ("seed",)

    def __init__(self):
        self.numbers = []

    def run(self, times, measurements, *, seed=0):
        rng = np.random.default_rng(seed)
        mean = rng.standard_normal((len(times), 1, measurements.shape[2]))
        self.numbers.append(mean[0, 0, :50])
        return Estimates(mean)


def resting():
    """A state that is always zero, so that estimates are errors."""
    return JumpDiffusion((x,), [0 * x], [[0]], [x + v], Noise((v,)), [0], [[0]])


def autoregression():
    return DiscreteSystem(
        StochasticMap([x], [0.9 * x + w], Noise([w])),
        StochasticMap([x], [x + v], Noise([v])),
        [0.0],
        [[1.0]],
    )


def averaged(values):
    """Mean over paths, the last axis, and its standard error."""
    return values.mean(axis=-1), values.std(axis=-1) / np.sqrt(values.shape[-1])


def rooted(squares):
    """Root of a mean square over paths and its standard error."""
    mean, error = averaged(squares)
    return np.sqrt(mean), error / (2 * np.sqrt(mean))


def test_errors_and_paired_differences_are_those_of_the_paths():
    """Modes, indicators, inputs of each path, gaps and a window, on two blocks of paths."""
    system, paths = recorded(switching_system()), 2500
    mask = np.ones((7, 3), dtype=bool)
    mask[[1, 2, 2, 4], [0, 1, 2, 2]] = False
    own = {u: row[:, None] * np.linspace(-1, 1, paths) for u, row in INPUTS.items()}
    bank = SwitchingFilter(system.system, Taylor())
    filters = {"guess": Guess(), "bank": bank}
    found = compare(filters, system, TIMES, paths, 5, window=(2, 4), measured=mask, inputs=own)
    assert len(system.made) == 2
    y, indicators = system.all("measurements"), system.all("indicators")
    np.testing.assert_array_equal(np.isnan(y).all(axis=2), ~mask[:, :2])
    runs = {
        "guess": Guess().run(TIMES, y, indicators=indicators),
        "bank": bank.run(TIMES, y, indicators=indicators, inputs=own),
    }
    errors = {name: run.mean - system.all("states") for name, run in runs.items()}
    wrong = {name: run.modes != system.all("modes") for name, run in runs.items()}
    for name, row in found.items():
        assert (row.paths, row.scored, row.diverged) == (paths, paths, 0)
        square, late = errors[name] ** 2, (errors[name] ** 2)[2:5].mean(axis=0)
        total = square.sum(axis=1)
        for field, wanted in (
            ("rms", rooted(square)),
            ("bias", averaged(errors[name])),
            ("average", rooted(late)),
            ("total", rooted(total)),
            ("average_total", rooted(total[2:5].mean(axis=0))),
            ("mode_error", averaged(wrong[name])),
            ("average_mode_error", averaged(wrong[name][2:5].mean(axis=0))),
        ):
            value, error = getattr(row, field), getattr(row, f"{field}_error")
            np.testing.assert_allclose(value, wanted[0], rtol=1e-8, atol=1e-12, err_msg=field)
            np.testing.assert_allclose(error, wanted[1], rtol=1e-6, err_msg=field)
    apart, paired = found.difference("guess", "bank"), [errors["guess"], errors["bank"]]
    miss = wrong["guess"].astype(float) - wrong["bank"]
    gap = (paired[0] ** 2 - paired[1] ** 2).sum(axis=1)
    influence = [e**2 / (2 * found[n].rms[..., None]) for n, e in errors.items()]
    late = [(e**2)[2:5].mean(axis=0) / (2 * found[n].average[:, None]) for n, e in errors.items()]
    for field, error, wanted in (
        ("rms", "error", (found["guess"].rms - found["bank"].rms, np.subtract(*influence))),
        (
            "average",
            "average_error",
            (found["guess"].average - found["bank"].average, np.subtract(*late)),
        ),
        ("square", "square_error", (gap.mean(axis=1), gap)),
        ("average_square", "average_square_error", (gap[2:5].mean(), gap[2:5].mean(axis=0))),
        ("mode", "mode_error", (miss.mean(axis=1), miss)),
        ("average_mode", "average_mode_error", (miss[2:5].mean(), miss[2:5].mean(axis=0))),
    ):
        np.testing.assert_allclose(getattr(apart, field), wanted[0], rtol=1e-7, err_msg=field)
        spread = averaged(wanted[1])[1]
        np.testing.assert_allclose(getattr(apart, error), spread, rtol=1e-6, err_msg=field)
    assert f"{found['bank'].average_mode_error:.4g} ± " in str(found)
    assert "average_mode_error" in str(found)
    assert "seconds_per_step" not in str(found)


# Diverged paths


def test_diverged_paths_are_counted_and_not_scored():
    """One of 100 paths is NaN for one filter: it is scored for none."""
    astray = Scripted(lambda i: np.where(i == 7, np.nan, 1.0))
    steady = Scripted(lambda i: np.where(i == 7, 5.0, 2.0))
    found = compare({"astray": astray, "steady": steady}, resting(), [0, 1], 100, 1)
    assert (found["astray"].diverged, found["steady"].diverged) == (1, 0)
    assert found["astray"].scored == found["steady"].scored == 99
    np.testing.assert_array_equal(found["astray"].rms, 1.0)
    np.testing.assert_array_equal(found["steady"].rms, 2.0)
    assert [line.split()[-1] for line in str(found).splitlines()] == ["diverged", "1", "0"]
    far = Scripted(lambda i: np.where(i % 10 == 0, -30.0, 1.0))
    beyond = evaluate(far, resting(), [0, 1], 100, 1, bound=20)
    assert (beyond.diverged, beyond.scored) == (10, 90)
    np.testing.assert_array_equal(beyond.rms, 1.0)
    assert evaluate(far, resting(), [0, 1], 100, 1, bound=30).diverged == 0
    with pytest.raises(ValueError, match="paths"):
        evaluate(Scripted(lambda i: np.nan + i), resting(), [0, 1], 50, 1)


def test_a_truth_that_diverges_is_left_out():
    system = JumpDiffusion((x,), [x**3 - x], [[0.1]], [x + v], Noise((v,)), [0], [[0.09]])
    filters = {"zero": Scripted(lambda i: 0.0 * i), "ekf": extended_kalman(system, bound=20)}
    found = compare(filters, system, np.arange(9) * 0.5, 2000, 1, consistency=True)
    assert found["zero"].diverged == 0
    assert 1900 < found["zero"].scored < 2000
    assert np.isfinite(found["ekf"].rms).all()


# What filters are given


def test_random_filters_have_numbers_of_their_own_in_every_block():
    system = autoregression()
    filters = {"one": Drawn(), "two": Drawn(), "plain": extended_kalman(system)}
    compare(filters, system, GRID, 2 * 2048, 1)
    rows = np.array([row for name in ("one", "two") for row in filters[name].numbers])
    assert rows.shape == (4, 50)
    assert len(np.unique(rows)) == rows.size
    # with 50 numbers a row independent rows are correlated by about 0.14
    assert np.abs(np.corrcoef(rows) - np.eye(4)).max() < 0.6


def test_comparisons_repeat_and_depend_neither_on_threads_nor_on_other_filters():
    system = autoregression()

    def once(workers):
        filters = {"drawn": ParticleFilter(system, 30), "plain": extended_kalman(system)}
        return compare(filters, system, GRID, 2 * 2048 + 100, 1, workers=workers)

    one, two = once(1), once(2)
    for name in one:
        np.testing.assert_array_equal(one[name].rms, two[name].rms)
        np.testing.assert_array_equal(one[name].rms_error, two[name].rms_error)
    alone = evaluate(extended_kalman(system), system, GRID, 2 * 2048 + 100, 1)
    np.testing.assert_array_equal(alone.rms, one["plain"].rms)
    assert 0 < alone.seconds_per_step < 1


def test_filters_get_indicators_and_modes_where_they_take_them():
    """A filter of a system without an indicator gets none, one of known modes gets these."""
    target, blind = zoo.manoeuvring_target("noisy"), zoo.manoeuvring_target("none")
    filters = {
        "known": KnownModeFilter(target),
        "blind": RaoBlackwellFilter(blind, 8),
        "blind, known": KnownModeFilter(blind),
        "seeing": RaoBlackwellFilter(target, 8),
        "zero": Scripted(lambda i: 0.0 * i, 2),
    }
    found = compare(filters, target, GRID, 400, 2)
    assert found["known"].average_mode_error == 0
    apart = found.difference("known", "blind, known")
    assert apart.average_square == pytest.approx(0, abs=1e-12)
    assert found["seeing"].average_mode_error < found["blind"].average_mode_error
    assert found["zero"].mode_error is None
    assert found["zero"].average_mode_error is None
    assert found.difference("known", "zero").mode is None


def test_windows_say_the_same_in_several_ways():
    mask = np.arange(6) >= 2
    system, rows = autoregression(), []
    for window in (slice(2, None), mask, [2, 3, 4, 5], (2, 5), (2, -1), (2, None), None):
        row = evaluate(extended_kalman(system), system, GRID, 100, 3, window=window)
        late = row.rms if window is None else row.rms[2:]
        np.testing.assert_allclose(row.average, np.sqrt((late**2).mean(axis=0)), rtol=1e-12)
        rows.append(row.average)
    assert rows[0] != rows[-1]


def test_measurements_come_at_the_times_of_the_designed_filters():
    """And errors of a design on its own seed are out of sample, within their standard errors."""
    system, times = zoo.flip_process(), np.arange(4) * 0.5
    filter = synthesize(
        system, Memory(1), ExactGaussian(), times, nodes=0, paths=1000, seed=1, step=0.05
    )
    observed = recorded(system)
    found = evaluate(filter, observed, np.linspace(0, 1.5, 16), 1000, 1, step=0.05)
    shown = ~np.isnan(observed.all("measurements")).any(axis=(1, 2))
    np.testing.assert_array_equal(np.flatnonzero(shown), [0, 5, 10, 15])
    at = found.rms[[0, 5, 10, 15]], found.rms_error[[0, 5, 10, 15]]
    assert np.abs(at[0] - filter.predicted.rms).min() > 1e-6
    combined = np.hypot(at[1], filter.predicted.error)
    np.testing.assert_array_less(np.abs(at[0] - filter.predicted.rms), 4 * combined)
    with pytest.raises(ValueError, match="measurements"):
        evaluate(filter, system, np.linspace(0, 1.5, 16), 100, 1, measured=np.arange(16), step=0.05)


# Truths that are not the model


def plane():
    a, b, p, q = sympy.symbols("a b p q", real=True)
    move = StochasticMap([a, b], [0.9 * a + 0.3 * b + v, 0.8 * b - 0.2 * a + w], Noise([v, w]))
    return DiscreteSystem(
        move, StochasticMap([a, b], [a + p, b + q], Noise([p, q])), [1, -1], np.eye(2)
    )


class Part:
    """A filter that is shown the first sensor only, as its own or beside one that is missing."""

    def __init__(self, system):
        self.filter = extended_kalman(system)

    def run(self, times, y):
        size = self.filter.system.measurement_size
        shown = np.full((len(y), size, y.shape[2]), np.nan)
        shown[:, :1] = y[:, :1]
        return self.filter.run(times, shown)


@pytest.mark.parametrize(("model", "truth"), [(autoregression, plane), (plane, autoregression)])
def test_a_model_of_another_size_is_scored_on_the_common_components(model, truth):
    system, filter = recorded(truth()), Part(model())
    found = compare({"part": filter, "again": filter}, system, GRID, 500, 3, consistency=True)
    run = filter.run(GRID, system.all("measurements"))
    error = run.mean[:, :1] - system.all("states")[:, :1]
    cov = run.cov[:, 0, 0] if run.cov.ndim == 4 else run.cov[:, 0, 0, None]
    for row in found.values():
        np.testing.assert_allclose(row.rms, np.sqrt((error**2).mean(axis=2)))
        assert row.nees_ratio == pytest.approx((error[:, 0] ** 2 / cov).mean(), rel=1e-9)
    one = evaluate(extended_kalman(plane()), plane(), GRID, 50, 3, components=1)
    assert one.rms.shape == (6, 1)


def test_errors_on_the_circle_are_as_without_the_cut():
    """An angle that turns by one each step, and its rate."""

    def turning(**circle):
        a, b = sympy.symbols("a b", real=True)
        return DiscreteSystem(
            StochasticMap([a, b], [a + b, b + v], Noise([v], cov=[[1e-4]]), **circle),
            StochasticMap([a, b], [a + w], Noise([w], cov=[[0.01]]), **circle),
            [3.0, 1.0],
            np.diag([0.01, 0.01]),
        )

    runs = [
        evaluate(extended_kalman(one), one, np.arange(12.0), 300, 3, consistency=True)
        for one in (turning(), turning(period={0: 2 * np.pi}))
    ]
    for name in ("rms", "average", "bias", "nees_ratio", "nis_ratio", "average_coverage"):
        wanted, other = (getattr(run, name) for run in runs)
        np.testing.assert_allclose(other, wanted, rtol=1e-8, atol=1e-12, err_msg=name)
    assert runs[0].rms[:, 0].max() < 0.15


def test_a_system_that_measures_nothing_at_first_is_evaluated():
    system = zoo.two_noises().stacked()
    times, later = np.arange(9.0), np.arange(1, 9)
    found = evaluate(KalmanFilter(system), system, times, 600, 3, consistency=True, measured=later)
    assert abs(found.nees_ratio - 1) < 4 * found.nees_ratio_error


def test_a_data_frame_holds_the_numbers():
    system = zoo.manoeuvring_target("noisy")
    filters = {"zero": Scripted(lambda i: 0.0 * i, 2), "<drawn>": RaoBlackwellFilter(system, 4)}
    found = compare(filters, system, GRID, 50, 1)
    frame = found.to_dataframe(["position", "speed"])
    assert list(frame.index) == list(found) == ["zero", "<drawn>"]
    assert len(found) == 2
    for name, row in found.items():
        assert frame.loc[name, "speed"] == row.average[1]
        assert frame.loc[name, "speed_error"] == row.average_error[1]
    assert np.isnan(frame.loc["zero", "average_mode_error"])
    drawn = found["<drawn>"]
    assert frame.loc["<drawn>", "average_mode_error_error"] == drawn.average_mode_error_error
    assert f"{drawn.average[0]:.4g} ± {drawn.average_error[0]:.2g}" in repr(found)
    assert f"{drawn.average[0]:.4g}" in repr(drawn)
    assert "seconds_per_step" in repr(found)
    apart = found.difference("zero", "<drawn>")
    assert f"{apart.average[0]:.4g} ± {apart.average_error[0]:.2g}" in repr(apart)
