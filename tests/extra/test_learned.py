"""Learned filters: how near they come to the exact one, what they claim."""

import sys

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression

from seedslib import zoo
from seedslib.design import grid_risk, synthesize
from seedslib.designed import large_order
from seedslib.export import to_c
from seedslib.extra import learn
from seedslib.linearization import ExactGaussian

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*Maximum iterations:UserWarning"),
    pytest.mark.filterwarnings("ignore:Stochastic Optimizer:UserWarning"),
    pytest.mark.filterwarnings("ignore:held out:UserWarning"),
    pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning"),
]
TIMES = 0.25 * np.arange(4)
GRID = {"x": (-3.5, 3.5, 141), "z": (-3.0, 3.0, 121), "y": (-8.0, 8.0, 97)}
EXACT = np.array([0.14782, 0.13492, 0.13355, 0.13374])
"""Risk of the exact filter of order one of the flip process, by the grid."""


@pytest.fixture(scope="module")
def flip():
    return zoo.flip_process()


@pytest.fixture(scope="module")
def boosted(flip):
    """Learned by the regressor that is the default."""
    return learn(flip, large_order(1), TIMES, paths=3000, seed=1, draws=2)


def test_the_default_regressor_comes_close_to_the_exact_filter_and_claims_its_true_error(boosted):
    risk = grid_risk(boosted, **GRID).mse
    assert (risk >= EXACT - 2e-4).all()
    assert (risk < 1.12 * EXACT).all()
    claimed, error = boosted.predicted.rms[:, 0], boosted.predicted.error[:, 0]
    assert (np.abs(claimed - np.sqrt(risk)) < 4 * error + 0.01 * claimed).all()
    assert "HistGradientBoostingRegressor on 2" in str(boosted)
    y = np.array([50.0, 1e6, 1e300, -50.0, -1e6, -1e300])  # beyond what was learned from
    mean = boosted.run(TIMES[:1], y.reshape(1, 1, 6)).mean[0, 0]
    assert np.ptp(mean[:3]) == np.ptp(mean[3:]) == 0.0


def test_linear_regression_in_a_linear_system_is_the_affine_filter():
    """Linear and Gaussian: the regression of theorem 1 is the filter of theorem 2."""
    linear, times = zoo.linear_gaussian(), 0.5 * np.arange(4)
    options = {"paths": 20_000, "seed": 2, "regressor": LinearRegression()}
    learned = learn(linear, large_order(1), times, **options)
    exact = synthesize(linear, large_order(1), ExactGaussian(), times, exact_moments=True)
    y = linear.simulate(times, 500, 9).measurements
    apart = learned.run(times, y).mean - exact.run(times, y).mean
    assert np.sqrt((apart**2).mean(axis=2)).max() < 0.025
    joint = learn(linear, large_order(1), times, joint=True, **options)
    np.testing.assert_allclose(joint.run(times, y).mean, learned.run(times, y).mean, atol=1e-12)


def test_any_object_that_fits_and_predicts_serves_also_without_scikit_learn(flip, monkeypatch):
    class Mean:
        def fit(self, given, wanted):
            self.mean = wanted.mean()
            return self

        def predict(self, given):
            return np.full(len(given), self.mean)

    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    options = {"paths": 100, "seed": 1}
    with pytest.raises(ImportError, match=r"^sklearn: .*seedslib\[learn\]"):
        learn(flip, large_order(1), TIMES[:2], **options)
    found = learn(flip, large_order(1), TIMES[:2], regressor=Mean(), **options)
    mean = found.run(TIMES[:2], np.array([[[1.0, 9.0]], [[-2.0, 3.0]]])).mean
    np.testing.assert_array_equal(mean[..., 0], mean[..., 1])


def test_to_c_refuses_a_learned_filter(boosted):
    with pytest.raises(TypeError, match=r"^filter: .*LearnedFilter"):
        to_c(boosted)
