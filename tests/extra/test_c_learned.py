"""Learned designs in C: networks and trees against scikit-learn's own predictions."""

import copy
import warnings
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from sklearn.ensemble import (
    AdaBoostRegressor,
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.linear_model import LinearRegression
from sklearn.neural_network import MLPRegressor
from sklearn.tree import DecisionTreeRegressor, ExtraTreeRegressor

from seedslib import zoo
from seedslib.design import stationary
from seedslib.designed import Memory, finite_memory
from seedslib.extra import compiled as behind_its_verbs
from seedslib.extra import learn, to_c
from seedslib.extra.c import build
from seedslib.extra.c.learned.trees import single_bound

TIMES = 0.5 * np.arange(4.0)


def network(layers, activation, **options):
    options = {"max_iter": 3, "tol": 0.0, "batch_size": 100, **options}
    return MLPRegressor(hidden_layer_sizes=layers, activation=activation, **options)


REGRESSORS = {
    "network": (network((6, 4), "relu"), {}),
    "network, all outputs": (network((5,), "tanh"), {"joint": True}),
    "network, logistic": (network((4,), "logistic"), {"memory": finite_memory(2)}),
    "network, identity": (network((3,), "identity"), {"memory": Memory(2), "components": 1}),
    "boosting on histograms": (
        HistGradientBoostingRegressor(max_iter=6, max_leaf_nodes=7, early_stopping=False), {},
    ),
    "boosting": (GradientBoostingRegressor(n_estimators=5), {"nodes": 2}),
    "boosting from zero": (GradientBoostingRegressor(n_estimators=3, init="zero"), {}),
    "forest": (RandomForestRegressor(4, max_depth=5), {"memory": Memory(2)}),
    "forest, all outputs": (ExtraTreesRegressor(3, max_depth=4), {"joint": True}),
    "tree": (DecisionTreeRegressor(max_depth=6), {"memory": finite_memory(1)}),
    "tree, all outputs": (ExtraTreeRegressor(max_depth=3), {"joint": True}),
}  # fmt: skip


@lru_cache
def learned(name):
    regressor, options = REGRESSORS[name]
    options = {"memory": Memory(1), "nodes": 1, "paths": 200, "seed": 1, **options}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return learn(
            zoo.van_der_pol(), options.pop("memory"), TIMES, regressor=regressor, **options
        )


def record(filter, paths=60):
    """Measurements, some far beyond what was learned from, some missing where they may be."""
    y = filter.system.simulate(TIMES, paths, 2).measurements.copy()
    y[1, 0, :4] = 1e6, -1e6, 50.0, -50.0
    if not filter.memory.measurements:
        y[2, :, ::5] = np.nan
        y[0, :, 1::9] = np.nan
    return y


@pytest.mark.parametrize("name", REGRESSORS)
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_they_are_the_filters_of_python(name, compiled):
    filter = learned(name)
    y = record(filter)
    nodes = np.concatenate([*filter.node_times])
    grid = np.union1d(TIMES, nodes)
    whole = np.full((len(grid), *y.shape[1:]), np.nan)
    at = np.searchsorted(grid, TIMES)
    whole[at] = y
    wanted = filter.run(grid, whole, covariances=True)
    mean, cov, loglik, ahead = compiled(filter).run(TIMES, y)
    size = np.abs(wanted.mean).max()
    np.testing.assert_allclose(mean, wanted.mean[at], rtol=1e-13, atol=1e-13 * size)
    between = wanted.mean[np.searchsorted(grid, nodes)]
    np.testing.assert_allclose(ahead, between, rtol=1e-13, atol=1e-13 * size)
    right = wanted.cov[at]
    np.testing.assert_array_equal(cov, right if right.ndim == 4 else right[..., None] + 0 * cov)
    assert np.isnan(loglik).all()
    assert np.isnan(cov).any() == (not filter.memory.measurements)


def test_behind_the_verbs_and_for_ever(compiled):
    if build.compiler() is None:
        pytest.skip("no C compiler")
    filter = stationary(learned("network"), tolerance=50.0, paths=50)
    assert filter.cycle
    times = 0.5 * np.arange(30.0)
    y = filter.system.simulate(times, 5, 4).measurements
    wanted, twin = filter.run(times, y), behind_its_verbs(filter)
    np.testing.assert_allclose(twin.run(times, y).mean, wanted.mean, rtol=1e-11, atol=1e-11)
    state, other = filter.initial(), twin.initial()
    for k, t in enumerate(times[:6]):
        state, other = filter.step(state, t, y[k, :, 0]), twin.step(other, t, y[k, :, 0])
        np.testing.assert_allclose(other.mean, state.mean, rtol=1e-12)
    ahead = [each.forecast(s, times[5] + 0.3).mean for each, s in ((filter, state), (twin, other))]
    np.testing.assert_allclose(*ahead, rtol=1e-12)


def test_a_small_network_by_hand(build, tmp_path):
    """The header says the bytes of its tables, weights among them."""
    text = to_c(learned("network"), name="made").replace("\n * ", " ")
    fit = learned("network").steps[0].shown.models[0]
    assert fit.coefs_[0].shape == (2, 6)  # one measurement of two, nothing remembered yet
    weights = 4 * 2 * ((4 + 1) * 6 + (6 + 1) * 4 + 4 + 1)
    told = int(text.split("Bytes: ")[1].split()[0])
    code = text[text.index("#ifndef") :]
    assert f"made_weight[4][2][{weights // 8}]" in code
    assert 8 * weights < told < 8 * weights + 6000


def test_bounds_of_single_precision():
    """x rounded to single precision is at most b exactly where x is at most the bound."""
    rng = np.random.default_rng(0)
    bounds = np.concatenate([rng.normal(size=200), rng.normal(size=200).astype(np.float32), [0.0]])
    found = single_bound(bounds)
    for step in (-np.inf, np.inf):
        for x in (found, np.nextafter(found, step), np.nextafter(bounds, step), bounds):
            assert np.array_equal(x.astype(np.float32) <= bounds, x <= found)
    over = np.nextafter(found, np.inf)
    assert (over.astype(np.float32) > bounds).all()
    assert (found.astype(np.float32) <= bounds).all()


def test_refused():
    for regressor in (
        LinearRegression(),
        AdaBoostRegressor(DecisionTreeRegressor(max_depth=1), n_estimators=2),
    ):
        filter = learn(
            zoo.flip_process(), Memory(1), TIMES[:2], paths=60, seed=1, nodes=0, regressor=regressor
        )
        name = type(regressor).__name__
        with pytest.raises(TypeError, match=f"regressor: .* got {name}; read it off as tables"):
            to_c(filter)
    begun = learn(
        zoo.flip_process(), Memory(1), TIMES[:2], paths=60, seed=1, nodes=0,
        regressor=GradientBoostingRegressor(n_estimators=2, init=LinearRegression()),
    )  # fmt: skip
    with pytest.raises(ValueError, match="init: wanted a constant for C, got LinearRegression"):
        to_c(begun)
    for model in (
        HistGradientBoostingRegressor(loss="poisson", max_iter=2, early_stopping=False),
        network((2,), "tanh", loss="poisson"),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(np.arange(200.0)[:, None], np.arange(200.0))
        output = copy.copy(begun.steps[0].shown)
        output.models = [model]
        first = begun.steps[0]._replace(shown=output)
        with pytest.raises(ValueError, match="loss: wanted a loss of means for C, got"):
            to_c(replace(begun, steps=(first, *begun.steps[1:])))
    one = learn(
        zoo.flip_process(), Memory(1), TIMES[:1], paths=60, seed=1, nodes=0,
        regressor=DecisionTreeRegressor(max_depth=2),
    )  # fmt: skip
    with pytest.raises(ValueError, match="times: wanted at least two for C, got 1"):
        to_c(one)
