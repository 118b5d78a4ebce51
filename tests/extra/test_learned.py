import sys

import numpy as np
import pytest
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.linear_model import LinearRegression
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures

from seedslib import zoo
from seedslib.design import grid_risk, synthesize
from seedslib.designed import Memory, TableFilter, finite_memory, large_order, load, save
from seedslib.extra import learn
from seedslib.linearization import ExactGaussian

TIMES = 0.25 * np.arange(4)
GRID = {"x": (-3.5, 3.5, 141), "z": (-3.0, 3.0, 121), "y": (-8.0, 8.0, 97)}
EXACT = np.array([0.14782, 0.13492, 0.13355, 0.13374])


@pytest.fixture(scope="module")
def flip():
    return zoo.flip_process()


@pytest.fixture(scope="module")
def linear():
    return zoo.linear_gaussian()


@pytest.fixture(scope="module")
def network(flip):
    regressor = MLPRegressor(
        hidden_layer_sizes=(16, 16), max_iter=25, learning_rate_init=5e-3, batch_size=500, tol=0.0
    )
    with pytest.warns(UserWarning, match="Maximum iterations"):
        return learn(
            flip, large_order(1), TIMES, paths=8000, seed=3, regressor=regressor, draws=3, nodes=1
        )


def test_learned_filter_comes_close_to_the_exact_one(network):
    """Its true risk by the grid: a few per cent above the exact filter, far below theorem 2."""
    risk = grid_risk(network, **GRID).mse
    assert (risk >= EXACT - 2e-4).all()
    assert (risk[1:] < 1.05 * EXACT[1:]).all()
    says, error = network.predicted.rms[::2, 0], network.predicted.error[::2, 0]
    assert (np.abs(says - np.sqrt(risk)) < 4 * error + 0.01 * says).all()


def test_gradient_boosting_is_the_default(flip):
    found = learn(flip, large_order(1), TIMES[:2], paths=3000, seed=1, draws=2, nodes=0)
    assert "HistGradientBoostingRegressor on 2 measurements of each path" in str(found)
    risk = grid_risk(found, **GRID).mse
    assert (risk < 1.12 * EXACT[:2]).all()
    assert isinstance(found.steps[0].shown.models[0], HistGradientBoostingRegressor)


def test_linear_regression_gives_the_affine_filter_of_a_linear_system(linear):
    """Linear and Gaussian: the regression of theorem 1 is the filter of theorem 2."""
    times = 0.5 * np.arange(4)
    learned = learn(
        linear, large_order(1), times, paths=40_000, seed=2, regressor=LinearRegression(), nodes=0
    )
    exact = synthesize(linear, large_order(1), ExactGaussian(), times, exact_moments=True)
    data = linear.simulate(times, 500, 9)
    apart = learned.run(times, data.measurements).mean - exact.run(times, data.measurements).mean
    assert np.sqrt((apart**2).mean(axis=2)).max() < 0.02
    assert learned.order == 2
    joint = learn(
        linear, large_order(1), times, paths=40_000, seed=2, regressor=LinearRegression(),
        joint=True, nodes=0,
    )  # fmt: skip
    assert np.allclose(
        joint.run(times, data.measurements).mean, learned.run(times, data.measurements).mean
    )


def test_predicted_errors_are_honest_where_those_in_sample_are_not(flip):
    """A regressor that remembers its data claims no error on it, and a large one elsewhere."""
    from sklearn.neighbors import KNeighborsRegressor

    found = learn(
        flip, large_order(1), TIMES[:2], paths=1500, seed=1, nodes=0,
        regressor=KNeighborsRegressor(n_neighbors=1),
    )  # fmt: skip
    # the function jumps from datum to datum: fine axes for its risk
    risk = grid_risk(found, **{**GRID, "y": (-8.0, 8.0, 2401)}).mse
    says, error = found.predicted.rms[:, 0], found.predicted.error[:, 0]
    assert risk[1] > 1.5 * EXACT[1]
    assert (np.abs(says - np.sqrt(risk)) < 4 * error).all()


@pytest.mark.filterwarnings("ignore:held out:UserWarning")
def test_equal_seeds_give_equal_filters_and_the_caller_s_regressor_is_left_alone(flip):
    data = flip.simulate(TIMES[:2], 50, 1)
    regressor = make_pipeline(
        PolynomialFeatures(2),
        MLPRegressor(hidden_layer_sizes=(4,), max_iter=3, tol=0.0, batch_size=200),
    )
    found = []
    for seed in (1, 1, 2):
        with pytest.warns(UserWarning, match="Maximum iterations"):
            each = learn(
                flip, large_order(1), TIMES[:2], paths=400, seed=seed, regressor=regressor, nodes=0
            )
        found.append(each.run(TIMES[:2], data.measurements).mean)
    assert np.array_equal(found[0], found[1])
    assert not np.array_equal(found[0], found[2])
    assert regressor.get_params()["mlpregressor__random_state"] is None
    assert not hasattr(regressor[-1], "coefs_")


def test_read_off_on_axes_it_is_a_table_filter_that_goes_to_files(flip, network, tmp_path):
    table = network.tabulated(y=(-8, 8, 161), z=(-3, 3, 121))
    assert isinstance(table, TableFilter)
    data = flip.simulate(TIMES, 2000, 1)
    apart = table.run(TIMES, data.measurements).mean - network.run(TIMES, data.measurements).mean
    assert np.sqrt((apart**2).mean()) < 5e-3
    state = network.step(network.initial(), 0.0, np.array([1.0]))
    assert table.forecast(state, 0.1).mean == pytest.approx(
        network.forecast(state, 0.1).mean, abs=1e-3
    )
    save(table, tmp_path / "a.npz")
    back = load(tmp_path / "a.npz", flip)
    assert np.array_equal(
        back.run(TIMES, data.measurements).mean, table.run(TIMES, data.measurements).mean
    )
    with pytest.raises(TypeError, match="wanted a FiniteOrderFilter, got LearnedFilter"):
        save(network, tmp_path / "b.npz")


def test_beyond_what_was_learned_the_estimate_is_constant(flip, network):
    y = np.array([[50.0, 1e6, np.float64(1e300)], [-50.0, -1e6, -1e300]])
    mean = network.run(TIMES[:1], y.reshape(1, 1, 6)).mean[0, 0]
    assert np.allclose(mean[:3], mean[0])
    assert np.allclose(mean[3:], mean[3])
    assert np.abs(mean).max() < 4.0


def test_missing_measurement_leaves_the_cubic_forecast(flip, network):
    y = flip.simulate(TIMES, 30, 1).measurements.copy()
    y[1] = np.nan
    mean = network.run(TIMES, y).mean
    assert np.array_equal(mean[1], network.steps[1].blind([*mean[0]]).mean)


def test_memory_of_measurements(flip):
    found = learn(
        flip, finite_memory(2), TIMES, paths=2000, seed=1, nodes=0,
        regressor=make_pipeline(PolynomialFeatures(3), LinearRegression()),
    )  # fmt: skip
    data = flip.simulate(TIMES, 2000, 4)
    error = found.run(TIMES, data.measurements).mean - data.states
    assert np.sqrt((error**2).mean(axis=2)).max() < 0.5


def test_without_scikit_learn_the_message_says_so(flip, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    with pytest.raises(ImportError, match=r'pip install "seedslib\[learn\]"'):
        learn(flip, large_order(1), TIMES[:2], paths=100, seed=1)

    # any object with fit and predict serves
    class Mean:
        def fit(self, given, wanted):
            self.mean = wanted.mean()
            return self

        def predict(self, given):
            return np.full(len(given), self.mean)

    found = learn(flip, large_order(1), TIMES[:2], paths=100, seed=1, regressor=Mean())
    assert found.predicted.rms.shape[1] == 1


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"regressor": 3}, TypeError, "regressor: wanted something with fit and predict"),
        ({"draws": 0}, ValueError, "draws: wanted at least 1"),
        ({"sets": 1}, ValueError, "sets: wanted at least 2"),
        ({"components": 3}, ValueError, "components: wanted 1 to 1"),
        ({"memory": Memory(1, indicators=1)}, ValueError, "memory: wanted estimates"),
        ({"seed": 1.5}, TypeError, "seed: wanted"),
    ],
)
def test_bad_input(flip, options, kind, message):
    given = {"memory": large_order(1), "times": TIMES[:2], "paths": 100, "seed": 1, **options}
    with pytest.raises(kind, match=message):
        learn(flip, **given)
