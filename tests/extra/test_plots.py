"""Pictures hold the numbers that they are given."""

import matplotlib as mpl
import numpy as np
import pytest
from scipy.stats import norm

from seedslib import zoo
from seedslib.extra import plot_estimates
from seedslib.filters import Estimates, RaoBlackwellFilter

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
