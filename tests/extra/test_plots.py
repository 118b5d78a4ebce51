"""Pictures hold the numbers that they are given."""

import matplotlib as mpl
import numpy as np
import pytest
from scipy.stats import chi2, norm

from seedslib import zoo
from seedslib.base import Parameter
from seedslib.evaluation import compare, fit
from seedslib.extra import plot_comparison, plot_estimates, plot_profile
from seedslib.filters import Estimates, KalmanFilter, RaoBlackwellFilter, extended_kalman
from seedslib.models import LinearSystem
from systems import growth

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


def edges(band):
    """Lower and upper edge of a band, by time."""
    points = band.get_paths()[0].vertices
    return [[points[points[:, 0] == t, 1].min(), points[points[:, 0] == t, 1].max()] for t in TIMES]


def test_estimates_of_one_record_of_many():
    system = zoo.manoeuvring_target("noisy")
    data = system.simulate(TIMES, 4, 3)
    filter = RaoBlackwellFilter(system, 20)
    found = filter.run(TIMES, data.measurements, indicators=data.indicators)
    options = {"names": ["position", "speed"], "level": 0.8, "record": 2, "truth": data.states}
    seen = {0: data.measurements[:, 0]}
    axes = plot_estimates(TIMES, found, measurements=seen, **options)
    assert [ax.get_ylabel() for ax in axes] == ["position", "speed", "probability"]
    drawn = lines(axes[0])
    assert list(drawn) == ["measured", "truth", "estimate"]
    np.testing.assert_array_equal(drawn["measured"][:, 1], data.measurements[:, 0, 2])
    for k in (0, 1):
        drawn = lines(axes[k])
        np.testing.assert_array_equal(drawn["estimate"].T, [TIMES, found.mean[:, k, 2]])
        np.testing.assert_array_equal(drawn["truth"][:, 1], data.states[:, k, 2])
        np.testing.assert_allclose(edges(axes[k].collections[0]), found.interval(0.8)[:, :, k, 2].T)
    modes = lines(axes[2])
    for i in (0, 1):
        np.testing.assert_array_equal(modes[f"mode {i}"][:, 1], found.mode_prob[:, i, 2])
    assert len(axes[0].get_legend().get_texts()) == 4


def test_a_covariance_may_be_common_unknown_or_infinite():
    mean = np.arange(10.0).reshape(5, 1, 2)
    cov = np.linspace(1, 2, 5).reshape(5, 1, 1)
    (ax,) = plot_estimates(TIMES, Estimates(mean, cov), record=1)
    reach = norm.ppf(0.975) * np.sqrt(cov[:, 0, 0])
    np.testing.assert_allclose(
        edges(ax.collections[0]), mean[:, 0, 1, None] + np.outer(reach, [-1, 1])
    )
    assert not plot_estimates(TIMES, Estimates(mean))[0].collections
    cov[0] = np.inf  # nothing is known at first
    drawn = plot_estimates(TIMES, Estimates(mean[..., 0], cov))[0].collections[0]
    assert np.isfinite(drawn.get_paths()[0].vertices).all()


def test_filters_are_compared_by_colour_and_dash_on_given_axes():
    system = growth()
    filters = {"plain": extended_kalman(system), "bounded": extended_kalman(system, bound=50)}
    found = compare(filters, system, TIMES, 50, 1)
    figure, given = pyplot.subplots()
    (ax,) = plot_comparison(found, names=["size"], axes=[given])
    assert ax.figure is figure
    assert "size" in ax.get_ylabel()
    looks = [{line.get_color() for line in ax.lines}, {line.get_linestyle() for line in ax.lines}]
    assert list(map(len, looks)) == [2, 2]
    for line, band, (name, row) in zip(ax.lines, ax.collections, found.items(), strict=True):
        assert line.get_label() == name
        np.testing.assert_array_equal(line.get_ydata(), row.rms[:, 0])
        wanted = row.rms[:, :1] + 2 * row.rms_error[:, :1] * np.array([-1, 1])
        np.testing.assert_allclose(edges(band), wanted)


def test_a_profile_is_cut_where_its_fall_is_half_the_quantile():
    """The variance of white noise, whose likelihood is a formula."""
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
    (cut,) = (xy for name, xy in drawn.items() if name.startswith("cut"))
    np.testing.assert_allclose(cut[:, 1], -0.5 * chi2.ppf(0.9, 1))
    (best,) = (xy for name, xy in drawn.items() if name.startswith("maximum"))
    np.testing.assert_allclose(best, [[square / 50, 0.0]], rtol=1e-5)
    assert ax.get_xlabel() == "r"
