"""Learned filters: how near they come to the exact one, what they claim, and their C."""

import sys

import numpy as np
import pytest
from sklearn.ensemble import (
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.linear_model import LinearRegression
from sklearn.neural_network import MLPRegressor
from sklearn.tree import DecisionTreeRegressor

from extra.exported_filters import near
from seedslib import zoo
from seedslib.design import grid_risk, synthesize
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.extra import compiled, learn
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
    return learn(flip, large_order(1), TIMES, paths=3000, seed=1, draws=2, nodes=1)


def test_the_default_regressor_comes_close_to_the_exact_filter_and_claims_its_true_error(boosted):
    risk = grid_risk(boosted, **GRID).mse
    assert (risk >= EXACT - 2e-4).all()
    assert (risk < 1.12 * EXACT).all()
    claimed, error = boosted.predicted.rms[::2, 0], boosted.predicted.error[::2, 0]
    assert (np.abs(claimed - np.sqrt(risk)) < 4 * error + 0.01 * claimed).all()
    assert "HistGradientBoostingRegressor on 2" in str(boosted)
    y = np.array([50.0, 1e6, 1e300, -50.0, -1e6, -1e300])  # beyond what was learned from
    mean = boosted.run(TIMES[:1], y.reshape(1, 1, 6)).mean[0, 0]
    assert np.ptp(mean[:3]) == np.ptp(mean[3:]) == 0.0


def test_linear_regression_in_a_linear_system_is_the_affine_filter():
    """Linear and Gaussian: the regression of theorem 1 is the filter of theorem 2."""
    linear, times = zoo.linear_gaussian(), 0.5 * np.arange(4)
    options = {"paths": 20_000, "seed": 2, "regressor": LinearRegression(), "nodes": 0}
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
    with pytest.raises(ImportError, match="scikit-learn"):
        learn(flip, large_order(1), TIMES[:2], **options)
    found = learn(flip, large_order(1), TIMES[:2], regressor=Mean(), **options)
    mean = found.run(TIMES[:2], np.array([[[1.0, 9.0]], [[-2.0, 3.0]]])).mean
    np.testing.assert_array_equal(mean[..., 0], mean[..., 1])


def network(layers, activation):
    options = {"max_iter": 3, "tol": 0.0, "batch_size": 100, "activation": activation}
    return MLPRegressor(hidden_layer_sizes=layers, **options)


TREES = {"max_depth": 4}
BOOSTED = HistGradientBoostingRegressor(max_iter=6, max_leaf_nodes=7, early_stopping=False)
IN_C = [
    (network((6, 4), "relu"), Memory(1), {}),
    (network((5,), "tanh"), Memory(2), {"joint": True}),
    (network((4,), "logistic"), finite_memory(2), {}),
    (BOOSTED, Memory(2), {"components": 1}),
    (GradientBoostingRegressor(n_estimators=5), Memory(1), {"nodes": 2}),
    (RandomForestRegressor(4, **TREES), Memory(1), {}),
    (ExtraTreesRegressor(3, **TREES), Memory(1), {"joint": True}),
    (DecisionTreeRegressor(**TREES), finite_memory(1), {}),
]


@pytest.mark.parametrize(("regressor", "memory", "options"), IN_C)
def test_c_equals_the_learned_filter(regressor, memory, options, quick):
    """Also far beyond what was learned from, and without measurements where they may miss."""
    options = {"nodes": 1, "paths": 200, "seed": 1, "regressor": regressor, **options}
    made = [learn(zoo.van_der_pol(), memory, 0.5 * np.arange(4.0), **options) for _ in range(2)]
    filter, twin = made[0], compiled(made[1])  # equal seeds give equal filters
    grid = np.union1d(filter.times, np.concatenate([*filter.node_times]))
    y = np.full((len(grid), 2, 40), np.nan)
    at = np.searchsorted(grid, filter.times)
    y[at] = filter.system.simulate(filter.times, 40, 2).measurements
    y[at[1], 0, :4] = 1e6, -1e6, 50.0, -50.0
    if not memory.measurements:
        y[at[2], :, ::5] = np.nan
    found, wanted = (each.run(grid, y, covariances=True) for each in (twin, filter))
    near(found.mean, wanted.mean, 1e-13)
    cov = wanted.cov[..., None] if wanted.cov.ndim < found.cov.ndim else wanted.cov
    np.testing.assert_array_equal(found.cov, np.broadcast_to(cov, found.cov.shape))
    state = twin.initial()
    for k, t in enumerate(filter.times):
        state = twin.step(state, t, y[at[k], :, 1])
        near(state.mean, wanted.mean[at[k], :, 1], 1e-12)
