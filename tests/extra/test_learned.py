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
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures
from sklearn.tree import DecisionTreeRegressor

from extra.test_export import near
from seedslib import zoo
from seedslib.design import grid_risk, synthesize
from seedslib.designed import Memory, TableFilter, finite_memory, large_order, load, save
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
CUBIC = make_pipeline(PolynomialFeatures(3), LinearRegression())


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
    assert isinstance(boosted.steps[0].shown.models[0], HistGradientBoostingRegressor)
    assert "HistGradientBoostingRegressor on 2" in str(boosted)


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
    part = learn(linear, large_order(1), times, components=1, **options)
    assert part.run(times, y).mean.shape == (4, 1, 500)


def test_predicted_errors_are_true_of_a_regressor_that_remembers_its_data(flip):
    """It claims no error in its sample, and makes a large one elsewhere."""
    found = learn(
        flip, large_order(1), TIMES[:2], paths=1500, seed=1, nodes=0,
        regressor=KNeighborsRegressor(n_neighbors=1),
    )  # fmt: skip
    # the function jumps from datum to datum: fine axes for its risk
    risk = grid_risk(found, **{**GRID, "y": (-8.0, 8.0, 1201)}).mse
    claimed, error = found.predicted.rms[:, 0], found.predicted.error[:, 0]
    assert risk[1] > 1.5 * EXACT[1]
    assert (np.abs(claimed - np.sqrt(risk)) < 4 * error).all()


def test_equal_seeds_give_equal_filters_and_leave_the_regressor_alone(flip):
    y = flip.simulate(TIMES[:2], 50, 1).measurements
    network = MLPRegressor(hidden_layer_sizes=(4,), max_iter=3, tol=0.0, batch_size=200)
    regressor, found = make_pipeline(PolynomialFeatures(2), network), []
    for seed in (1, 1, 2):
        options = {"paths": 400, "seed": seed, "regressor": regressor, "nodes": 0}
        each = learn(flip, large_order(1), TIMES[:2], **options)
        found.append(each.run(TIMES[:2], y).mean)
    assert np.array_equal(found[0], found[1])
    assert not np.array_equal(found[0], found[2])
    assert regressor.get_params()["mlpregressor__random_state"] is None
    assert not hasattr(network, "coefs_")


def test_read_off_on_axes_it_is_a_table_filter_that_goes_to_files(flip, tmp_path):
    learned = learn(flip, large_order(1), TIMES, paths=1000, seed=1, nodes=1, regressor=CUBIC)
    table = learned.tabulated(y=(-8, 8, 161), z=(-3, 3, 121))
    assert isinstance(table, TableFilter)
    y = flip.simulate(TIMES, 500, 1).measurements
    apart = table.run(TIMES, y).mean - learned.run(TIMES, y).mean
    assert np.sqrt((apart**2).mean()) < 5e-3
    state = learned.step(learned.initial(), 0.0, np.array([1.0]))
    wanted = learned.forecast(state, 0.1).mean
    np.testing.assert_allclose(table.forecast(state, 0.1).mean, wanted, atol=1e-3)
    save(table, tmp_path / "a.npz")
    back = load(tmp_path / "a.npz", flip)
    np.testing.assert_array_equal(back.run(TIMES, y).mean, table.run(TIMES, y).mean)


def test_beyond_what_was_learned_the_estimate_is_constant(boosted):
    y = np.array([50.0, 1e6, 1e300, -50.0, -1e6, -1e300])
    mean = boosted.run(TIMES[:1], y.reshape(1, 1, 6)).mean[0, 0]
    assert np.ptp(mean[:3]) == np.ptp(mean[3:]) == 0.0
    assert np.abs(mean).max() < 4.0
    assert mean[0] != mean[3]


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
    return MLPRegressor(
        hidden_layer_sizes=layers, activation=activation, max_iter=3, tol=0.0, batch_size=100
    )


IN_C = {
    "networks": (network((6, 4), "relu"), Memory(1), {}),
    "a network for all": (network((5,), "tanh"), Memory(2), {"joint": True}),
    "networks of measurements": (network((4,), "logistic"), finite_memory(2), {}),
    "boosted on histograms": (
        HistGradientBoostingRegressor(max_iter=6, max_leaf_nodes=7, early_stopping=False),
        Memory(2), {"components": 1},
    ),
    "boosted": (GradientBoostingRegressor(n_estimators=5), Memory(1), {"nodes": 2}),
    "boosted from zero": (GradientBoostingRegressor(n_estimators=3, init="zero"), Memory(1), {}),
    "forest": (RandomForestRegressor(4, max_depth=5), Memory(1), {}),
    "a forest for all": (ExtraTreesRegressor(3, max_depth=4), Memory(1), {"joint": True}),
    "trees": (DecisionTreeRegressor(max_depth=6), finite_memory(1), {}),
}  # fmt: skip


@pytest.mark.parametrize("name", IN_C)
def test_c_equals_the_learned_filter(name, quick):
    """Also far beyond what was learned from, and without measurements where they may miss."""
    regressor, memory, options = IN_C[name]
    options = {"nodes": 1, "paths": 200, "seed": 1, "regressor": regressor, **options}
    filter = learn(zoo.van_der_pol(), memory, 0.5 * np.arange(4.0), **options)
    grid = np.union1d(filter.times, np.concatenate([*filter.node_times]))
    y = np.full((len(grid), 2, 40), np.nan)
    at = np.searchsorted(grid, filter.times)
    y[at] = filter.system.simulate(filter.times, 40, 2).measurements
    y[at[1], 0, :4] = 1e6, -1e6, 50.0, -50.0
    if not memory.measurements:
        y[at[2], :, ::5] = np.nan
    twin = compiled(filter)
    found, wanted = (each.run(grid, y, covariances=True) for each in (twin, filter))
    near(found.mean, wanted.mean, 1e-13)
    cov = wanted.cov[..., None] if wanted.cov.ndim < found.cov.ndim else wanted.cov
    np.testing.assert_array_equal(found.cov, np.broadcast_to(cov, found.cov.shape))
    state = twin.initial()
    for k, t in enumerate(filter.times):
        state = twin.step(state, t, y[at[k], :, 1])
        near(state.mean, wanted.mean[at[k], :, 1], 1e-12)
