"""Pictures hold the numbers that they are given."""

import builtins

import matplotlib as mpl
import numpy as np
import pytest
from scipy.stats import chi2

from seedslib import zoo
from seedslib.base import Parameter
from seedslib.evaluation import compare, fit
from seedslib.extra import plot_comparison, plot_estimates, plot_profile
from seedslib.filters import Estimates, KalmanFilter, RaoBlackwellFilter, extended_kalman
from seedslib.models import LinearSystem

mpl.use("Agg")
from matplotlib import pyplot

TIMES = np.arange(5.0)


@pytest.fixture(autouse=True)
def nothing_is_shown(monkeypatch):
    monkeypatch.setattr(pyplot, "show", lambda *_: pytest.fail("a library does not show"))
    yield
    pyplot.close("all")


def lines(ax):
    return {line.get_label(): np.array(line.get_xydata()) for line in ax.lines}


def edges(ax):
    """Lower and upper edge of the band of an axes, by time."""
    (band,) = ax.collections
    points = band.get_paths()[0].vertices
    return [[points[points[:, 0] == t, 1].min(), points[points[:, 0] == t, 1].max()] for t in TIMES]


@pytest.fixture(scope="module")
def target():
    system = zoo.manoeuvring_target("noisy")
    data = system.simulate(TIMES, 4, 3)
    filter = RaoBlackwellFilter(system, 20)
    return data, filter.run(TIMES, data.measurements, indicators=data.indicators)


def test_estimates_of_one_record_of_many(target):
    data, found = target
    axes = plot_estimates(
        TIMES, found, truth=data.states, measurements={0: data.measurements[:, 0]},
        names=["position", "speed"], level=0.8, record=2,
    )  # fmt: skip
    assert [ax.get_ylabel() for ax in axes] == ["position", "speed", "probability"]
    drawn = lines(axes[0])
    assert list(drawn) == ["measured", "truth", "estimate"]
    np.testing.assert_array_equal(drawn["measured"][:, 1], data.measurements[:, 0, 2])
    for k in (0, 1):
        shown = lines(axes[k])
        np.testing.assert_array_equal(shown["estimate"].T, [TIMES, found.mean[:, k, 2]])
        np.testing.assert_array_equal(shown["truth"][:, 1], data.states[:, k, 2])
        np.testing.assert_allclose(edges(axes[k]), found.interval(0.8)[:, :, k, 2].T)
    modes = lines(axes[2])
    for i in (0, 1):
        np.testing.assert_array_equal(modes[f"mode {i}"][:, 1], found.mode_prob[:, i, 2])
    words = [text.get_text() for text in axes[0].get_legend().get_texts()]
    assert words == ["80 % interval", "measured", "truth", "estimate"]


def test_a_covariance_may_be_common_or_unknown():
    mean = np.arange(10.0).reshape(5, 1, 2)
    cov = np.linspace(1, 2, 5).reshape(5, 1, 1)
    both = plot_estimates(TIMES, Estimates(mean, cov), record=1)
    np.testing.assert_allclose(edges(both[0])[4], 9 + np.array([-1, 1]) * np.sqrt(2) * 1.959964)
    assert not plot_estimates(TIMES, Estimates(mean))[0].collections
    cov[0] = np.inf  # nothing is known at first
    drawn = plot_estimates(TIMES, Estimates(mean[..., 0], cov))[0].collections[0]
    assert np.isfinite(drawn.get_paths()[0].vertices).all()


def test_filters_are_compared_by_colour_and_dash():
    system = zoo.van_der_pol()
    filters = {"plain": extended_kalman(system), "euler": extended_kalman(system, bound=50)}
    found = compare(filters, system, TIMES * 0.5, 200, 1)
    figure, given = pyplot.subplots(2)
    axes = plot_comparison(found, names=["a", "b"], axes=given)
    assert axes[1].figure is figure
    for k, ax in enumerate(axes):
        assert ax.get_ylabel() == f"RMS error of {'ab'[k]}"
        looks = {(line.get_color(), line.get_linestyle()) for line in ax.lines}
        assert len({c for c, _ in looks}) == len({d for _, d in looks}) == 2
        for line, band, (name, row) in zip(ax.lines, ax.collections, found.items(), strict=True):
            assert line.get_label() == name
            np.testing.assert_array_equal(line.get_ydata(), row.rms[:, k])
            reach = band.get_paths()[0].vertices[:, 1]
            assert reach.max() == pytest.approx((row.rms + 2 * row.rms_error)[:, k].max())


def test_a_profile_is_cut_where_its_fall_is_half_the_quantile():
    """The level of white noise: a parabola, cut at the mean and 1.96 deviations of it."""
    y = np.random.default_rng(0).normal(3.0, 2.0, 50)
    size = Parameter("r", 3.0, positive=True)
    system = LinearSystem(1, 0.0, 1, size, 3.0, 0.0)
    found = fit(KalmanFilter(system), np.arange(50.0), y[:, None], [size])
    points = found.values[0] * np.array([1.2, 0.7, 1.0])
    (ax,) = plot_profile(found, size, points, level=0.9)
    drawn = lines(ax)
    square = np.sum((y - 3.0) ** 2)

    def loglik(r):
        return -0.5 * (50 * np.log(r) + square / r)

    wanted = loglik(np.sort(points)) - loglik(square / 50)
    np.testing.assert_allclose(drawn["profile"], np.stack([np.sort(points), wanted], 1), atol=1e-6)
    (cut,) = (xy for name, xy in drawn.items() if name == "cut for 90 %")
    np.testing.assert_allclose(cut[:, 1], -0.5 * chi2.ppf(0.9, 1))
    (best,) = (xy for name, xy in drawn.items() if name.startswith("maximum"))
    np.testing.assert_allclose(best, [[square / 50, 0.0]], rtol=1e-5)
    assert ax.get_xlabel() == "r"
    with pytest.raises(ValueError, match="level: wanted a number between 0 and 1, got 95"):
        plot_profile(found, size, points, level=95)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"times": TIMES[1:]}, "times: wanted 5, got 4"),
        ({"names": ["a"]}, "names: wanted 2, got 1"),
        ({"record": 4}, "record: wanted"),
        ({"measurements": {2: TIMES}}, "measurements: wanted components from 0 to 1"),
        ({"axes": [None]}, "axes: wanted 3, got 1"),
    ],
)
def test_bad_input_is_named(target, options, message):
    with pytest.raises(ValueError, match=message):
        plot_estimates(**({"times": TIMES, "estimates": target[1]} | options))


def test_without_matplotlib_it_says_what_is_wanted(target, monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r'wants matplotlib.*pip install "seedslib\[plots\]"'):
        plot_estimates(TIMES, target[1])
