import math
from dataclasses import replace

import numpy as np
import pytest
import sympy
from scipy.optimize import minimize

from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import (
    Continuous,
    Polynomial,
    affine_synthesis,
    grid_risk,
    grid_synthesis,
    synthesize,
)
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.designed.outputs.lookup import Output
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import FellerChain, JumpDiffusion, Noise

TIMES = 0.25 * np.arange(13)
STEPS = [0, 1, 2, 4, 6, 8, 12]
GRID = {"x": (-3.5, 3.5, 281), "z": (-3.0, 3.0, 601), "y": (-8.0, 8.0, 241)}
COARSE = {"x": (-3.5, 3.5, 141), "z": (-3.0, 3.0, 121), "y": (-8.0, 8.0, 97)}


@pytest.fixture(scope="module")
def flip():
    return zoo.flip_process()


@pytest.fixture(scope="module")
def exact(flip):
    return grid_synthesis(flip, large_order(1), TIMES, **GRID, nodes=1)


@pytest.fixture(scope="module")
def second(flip):
    """The exact filter of order two, on coarse axes: it takes as long as all others."""
    return grid_synthesis(flip, large_order(2), TIMES, **COARSE, nodes=0)


@pytest.fixture(scope="module")
def gaussian(flip):
    return affine_synthesis(flip, large_order(1), ExactGaussian(), TIMES, **GRID)


@pytest.fixture(scope="module")
def simulated(flip):
    return synthesize(flip, large_order(1), ExactGaussian(), TIMES, nodes=0, paths=40_000, seed=5)


def mse(filter):
    at = np.isin(filter.predicted.times, filter.times)
    return filter.predicted.rms[at, 0] ** 2


def test_exact_filter_of_order_one(exact):
    wanted = [0.14782, 0.13492, 0.13355, 0.13411, 0.13463, 0.13487, 0.13506]
    assert mse(exact)[STEPS] == pytest.approx(wanted, rel=1e-4)


def test_exact_filter_of_order_two(second):
    wanted = [0.1478, 0.1352, 0.1323, 0.1324, 0.1330, 0.1333, 0.1335]
    assert mse(second)[STEPS] == pytest.approx(wanted, rel=5e-4)
    assert second.order == 2


def test_exact_filters_are_without_bias(exact):
    assert np.abs(grid_risk(exact, **GRID).bias).max() < 1e-13


def test_filters_of_theorem_2_on_the_grid(flip, gaussian):
    found, risk = gaussian
    wanted = [0.14796, 0.20224, 0.20157, 0.19719, 0.19556, 0.19486, 0.19432]
    assert risk.mse[STEPS] == pytest.approx(wanted, rel=1e-4)
    first, last = found.fits[0], found.fits[11]
    parameters = [first.gain, first.offset, first.cov, last.gain, last.offset, last.cov]
    wanted = [0.42102, 0.26389, 0.49577, 0.74689, 0.00141, 0.47747]
    assert [float(p.item()) for p in parameters] == pytest.approx(wanted, abs=1e-5)
    assert risk.bias[2] == pytest.approx(0.0019, abs=5e-5)
    linearised = affine_synthesis(flip, large_order(1), Taylor(), TIMES, **GRID)[1]
    wanted = [0.14796, 0.20319, 0.20266, 0.19834, 0.19673, 0.19604, 0.19549]
    assert linearised.mse[STEPS] == pytest.approx(wanted, rel=1e-4)


def test_parameters_of_theorem_2_are_those_of_simulated_paths(flip, gaussian):
    """Gamma, kappa, T at all measurements: mean and standard error of 16 independent designs."""
    found = []
    for seed in range(16):
        design = synthesize(
            flip, large_order(1), ExactGaussian(), TIMES, nodes=0, paths=4000, seed=seed
        )
        found.append([[p.item() for p in fit] for fit in design.fits])
    mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / 4
    wanted = np.array([[p.item() for p in fit] for fit in gaussian[0].fits])
    assert mean.shape == wanted.shape == (12, 3)
    assert (np.abs(mean - wanted) < 4 * error).all()


def test_risk_of_a_designed_filter_is_that_of_its_simulation(flip, simulated):
    risk = grid_risk(simulated, **GRID)
    data = flip.simulate(TIMES, 20_000, 99)
    squares = (simulated.run(TIMES, data.measurements).mean - data.states)[:, 0] ** 2
    error = squares.std(axis=1) / np.sqrt(squares.shape[1])
    assert (np.abs(squares.mean(axis=1) - risk.mse) < 4 * error).all()


def test_risk_of_the_exact_filter_is_that_of_its_simulation(flip, exact):
    data = flip.simulate(TIMES, 20_000, 98)
    squares = (exact.run(TIMES, data.measurements).mean - data.states)[:, 0] ** 2
    error = squares.std(axis=1) / np.sqrt(squares.shape[1])
    assert (np.abs(squares.mean(axis=1) - mse(exact)) < 4 * error).all()


def test_exact_filter_is_better_than_every_other_of_its_memory(flip, exact, gaussian):
    best = mse(exact)
    others = [gaussian[0]]
    for predictor in (Polynomial(3, 2), Continuous()):
        others.append(
            synthesize(
                flip, large_order(1), ExactGaussian(), TIMES, predictor=predictor, nodes=0,
                paths=4000, seed=6, step=0.025,
            )
        )  # fmt: skip
    for other in others:
        found = grid_risk(other, **GRID).mse
        assert (best <= found + 1e-12).all()
        assert (best[1:] < 0.75 * found[1:]).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda y, u: 1.0 + 0.0 * (y + u),
        lambda y, u: y + 0.0 * u,
        lambda y, u: np.sin(3.0 * y * u),
        lambda y, u: np.tanh(2.0 * (y - u)),
    ],
)
def test_every_change_of_the_optimal_function_costs_its_mean_square(flip, change):
    """M(X - f - e h)² = M(X - f)² + e² M h²: orthogonality, by simulation and by the grid."""
    table = grid_synthesis(flip, large_order(1), TIMES[:4], **COARSE, nodes=0)
    last = table.steps[-1]

    def risk(amount):
        def shown(points):
            return Output(last.shown(points).mean + amount * change(*points))

        steps = (*table.steps[:-1], last._replace(shown=shown))
        return grid_risk(replace(table, steps=steps), **COARSE)

    base = risk(0.0).mse[-1]
    growth = [risk(amount).mse[-1] - base for amount in (0.1, -0.1, 0.3)]
    assert growth[0] > 0.0
    assert growth[1] == pytest.approx(growth[0], rel=1e-9)
    assert growth[2] == pytest.approx(9.0 * growth[0], rel=1e-9)
    data = flip.simulate(TIMES[:4], 20_000, 96)
    memory = table.run(TIMES[:3], data.measurements[:3]).mean[-1]
    squares = change(data.measurements[3], memory)[0] ** 2
    error = max(squares.std() / np.sqrt(len(squares)), 1e-12)
    assert abs(growth[0] / 0.01 - squares.mean()) < 4 * error


def quadratic_loss(point, weight, vector, law):
    apart = vector - point[:, None]
    return np.einsum("is,ij,js,s->", apart, weight, apart, law)


def test_posterior_mean_of_two_measurements_by_hand(flip):
    """With one remembered measurement the second estimate is the absolutely optimal one.

    It minimises the mean of any quadratic form of the error, here of (x, x²).
    """
    table = grid_synthesis(flip, finite_memory(1), TIMES[:2], **COARSE, nodes=0)
    chain = FellerChain(flip, Axis(*COARSE["x"]))
    x, axis = chain.axis.nodes, Axis(*COARSE["y"])
    early, late = 30, 61
    for first, second in ((early, late), (late, early), (48, 48)):
        y = axis.nodes[[first, second]]
        likely = np.exp(-0.5 * (y[:, None] - x) ** 2 / (0.25 + 0.09 * x**2))
        likely /= np.sqrt(0.25 + 0.09 * x**2)
        posterior = likely[1] * (chain.transition(0.0, 0.25) @ (likely[0] * chain.start()))
        posterior /= posterior.sum()
        assert table.steps[1].shown.estimate[0, second, first] == pytest.approx(posterior @ x)
        vector = np.array([x, x**2])
        best = vector @ posterior
        for weight in ([[1.0, 0.3], [0.3, 2.0]], [[5.0, -2.0], [-2.0, 1.0]]):
            found = minimize(
                quadratic_loss, [0.0, 0.0], (np.array(weight), vector, posterior), method="BFGS",
                options={"gtol": 1e-10},
            ).x  # fmt: skip
            assert found == pytest.approx(best, abs=1e-6)
    assert np.abs(grid_risk(table, **COARSE).bias).max() < 1e-13


def test_two_estimates_are_better_than_one_and_estimates_better_than_measurements(flip, second):
    one = grid_synthesis(flip, large_order(1), TIMES, **COARSE, nodes=0)
    same, later = slice(0, 2), slice(2, None)
    assert mse(one)[same] == pytest.approx(mse(second)[same], rel=1e-12)
    assert (mse(second)[later] < mse(one)[later]).all()
    past = grid_synthesis(flip, finite_memory(1), TIMES, **COARSE, nodes=0)
    assert (mse(past)[2:] > mse(one)[2:]).all()
    # after one step both remember the first measurement, one of them rounded
    assert mse(past)[1] == pytest.approx(mse(one)[1], rel=1e-3)


def kalman(a, q, c, r, mean, var, dt, count):
    """Variances of a scalar Kalman filter, after each measurement."""
    phi, added = math.exp(a * dt), q * (math.exp(2 * a * dt) - 1) / (2 * a)
    found = []
    for k in range(count):
        if k:
            var = phi**2 * var + added
        var -= var**2 * c**2 / (c**2 * var + r)
        found.append(var)
    return np.array(found)


@pytest.fixture(scope="module")
def linear():
    x, v = sympy.symbols("x v")
    return JumpDiffusion(
        (x,), [-x / 2], [[1]], [2 * x + v], Noise((v,), cov=[[0.8]]), [0.4], [[0.5]]
    )


@pytest.mark.parametrize("memory", [large_order(1), large_order(2)])
def test_linear_gaussian_limit_is_the_kalman_filter(linear, memory):
    """The excess falls with the square of the steps."""
    times, wanted = 0.4 * np.arange(6), kalman(-0.5, 1.0, 2.0, 0.8, 0.4, 0.5, 0.4, 6)
    excess = []
    for count in (61, 121):
        found = grid_synthesis(
            linear, memory, times, x=(-5, 5, count), z=(-4, 4, count), y=(-14, 14, 141), nodes=0
        )
        excess.append(mse(found) - wanted)
    assert np.abs(excess[1] / wanted).max() < 2e-3
    assert np.abs(excess[1][2:] / excess[0][2:]).max() < 0.3


def test_linear_gaussian_tables_are_kalman_estimates(linear):
    times = 0.4 * np.arange(6)
    found = grid_synthesis(
        linear, large_order(1), times, x=(-5, 5, 201), z=(-4, 4, 321), y=(-14, 14, 281), nodes=1
    )
    data = linear.simulate(times, 200, 3)
    mean, var = np.full(200, 0.4), 0.5
    estimates = found.run(times, data.measurements).mean[:, 0]
    phi, added = math.exp(-0.2), 1 - math.exp(-0.4)
    for k in range(6):
        if k:
            mean, var = phi * mean, phi**2 * var + added
        gain = 2 * var / (4 * var + 0.8)
        mean, var = mean + gain * (data.measurements[k, 0] - 2 * mean), var - gain * 2 * var
        assert np.abs(estimates[k] - mean).max() < 4e-3


def test_default_axes_serve(flip, exact):
    found = grid_synthesis(flip, large_order(1), TIMES[:4], x=(-3.5, 3.5, 141), nodes=0)
    assert mse(found) == pytest.approx(mse(exact)[:4], rel=3e-3)


def test_forecasts_at_nodes_are_conditional_means(flip, exact):
    """Error of the forecast at a node against that of simulated paths."""
    node = np.flatnonzero(np.isclose(exact.predicted.times, 0.625))[0]
    times = np.sort(np.append(TIMES[:4], 0.625))
    data = flip.simulate(times, 20_000, 97, measured=~np.isclose(times, 0.625))
    estimate = exact.run(times, data.measurements).mean[3, 0]
    squares = (estimate - data.states[3, 0]) ** 2
    error = squares.std() / np.sqrt(len(squares))
    assert abs(squares.mean() - exact.predicted.rms[node, 0] ** 2) < 4 * error


def test_bad_input(flip):
    for memory in (Memory(1, 1), Memory(1, indicators=1)):
        with pytest.raises(ValueError, match="wanted estimates or measurements alone"):
            grid_synthesis(flip, memory, TIMES, x=(-3.5, 3.5, 41))
    with pytest.raises(TypeError, match="memory: wanted a Memory"):
        grid_synthesis(flip, 1, TIMES, x=(-3.5, 3.5, 41))
    with pytest.raises(ValueError, match="one state component for a grid, got 2"):
        grid_synthesis(zoo.van_der_pol(), large_order(1), TIMES, x=(-3.5, 3.5, 41))
    with pytest.raises(ValueError, match=r"memory: wanted at most .* numbers on the grid"):
        grid_synthesis(flip, large_order(3), TIMES, **GRID)
    with pytest.raises(TypeError, match="x: wanted an Axis"):
        grid_synthesis(flip, large_order(1), TIMES, x=3.5)
    with pytest.raises(ValueError, match="y: wanted 1 axes, got 2"):
        grid_synthesis(flip, large_order(1), TIMES, x=(-3.5, 3.5, 41), y=[(-8, 8, 9)] * 2)
    with pytest.raises(ValueError, match="strictly increasing times"):
        grid_synthesis(flip, large_order(1), [0.0, 0.0], x=(-3.5, 3.5, 41))
    with pytest.raises(TypeError, match="linearization: wanted a Linearization"):
        affine_synthesis(flip, large_order(1), None, TIMES, x=(-3.5, 3.5, 41))
    with pytest.raises(ValueError, match="nodes: wanted at least 1, got -1"):
        grid_synthesis(flip, large_order(1), TIMES, x=(-3.5, 3.5, 41), nodes=-1)


def test_short_axes_are_reported(flip):
    with pytest.warns(UserWarning, match="z: probability .* outside of the axis"):
        grid_synthesis(
            flip, large_order(1), TIMES[:3], x=(-3.5, 3.5, 71), z=(-0.5, 0.5, 31), nodes=0
        )
    with pytest.warns(UserWarning, match="y: the axes miss .* of a measurement"):
        grid_synthesis(
            flip, large_order(1), TIMES[:3], x=(-3.5, 3.5, 71), y=(-2.0, 2.0, 41), nodes=0
        )
    with pytest.warns(UserWarning, match="x: probability .* too short"):
        grid_synthesis(flip, large_order(1), TIMES[:3], x=(-1.5, 1.5, 71), nodes=0)
