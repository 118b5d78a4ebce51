"""Exact designs on grids: against Kalman, quadrature, simulation, and other designs."""

import warnings

import numpy as np
import pytest
import sympy

from oracles.linear import Linear, kalman
from seedslib import zoo
from seedslib.base import Input, Nodes
from seedslib.design import (
    GridRisk,
    Polynomial,
    affine_synthesis,
    grid_risk,
    grid_synthesis,
    optimal_risk,
    synthesize,
)
from seedslib.designed import Memory, finite_memory, large_order
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    Noise,
    StochasticMap,
    grid_chain,
)

x, v, w, t = sympy.symbols("x v w t")
u = Input("u")
TIMES = 0.25 * np.arange(5)
GRID = {"x": (-3.5, 3.5, 141), "z": (-3.0, 3.0, 121), "y": (-8.0, 8.0, 97)}


@pytest.fixture(scope="module")
def flip():
    return zoo.flip_process()


@pytest.fixture(scope="module")
def exact(flip):
    return grid_synthesis(flip, large_order(1), TIMES, **GRID)


@pytest.fixture(scope="module")
def gaussian(flip):
    return affine_synthesis(flip, large_order(1), ExactGaussian(), TIMES, **GRID)


@pytest.fixture(scope="module")
def data(flip):
    """Paths at the measurements and in the middle between them, where nothing is measured."""
    return flip.simulate(0.125 * np.arange(9), 20_000, 98, measured=np.arange(0, 9, 2))


def mse(filter):
    return filter.predicted.rms[:, 0] ** 2


def within(squares, wanted, slack=0.0):
    """Whether means of squares over the last axis are the wanted ones, by 4 standard errors."""
    error = squares.std(axis=-1) / np.sqrt(squares.shape[-1])
    return (np.abs(squares.mean(axis=-1) - wanted) < 4 * error + slack).all()


def test_exact_filter_of_the_flip_process_has_the_errors_of_the_paper(flip, exact):
    wanted = [0.14782, 0.13492, 0.13355, 0.13374, 0.13411]
    np.testing.assert_allclose(mse(exact), wanted, rtol=2e-3)
    risk = grid_risk(exact, **GRID)
    assert isinstance(risk, GridRisk)
    np.testing.assert_allclose(risk.mse, mse(exact), rtol=1e-9)
    assert np.abs(risk.bias).max() < 1e-13
    np.testing.assert_allclose(exact.covariances[:, 0, 0], risk.mse, rtol=1e-12)
    default = grid_synthesis(flip, large_order(1), TIMES[:3], x=GRID["x"])
    np.testing.assert_allclose(mse(default), wanted[:3], rtol=3e-3)


def test_predicted_errors_are_those_of_simulated_paths(exact, data):
    found = exact.run(data.times[::2], data.measurements[::2])
    squares = (found.mean - data.states[::2])[:, 0] ** 2
    assert within(squares, exact.predicted.rms[:, 0] ** 2)


def test_changes_are_those_of_arguments_rounded_to_the_nodes_at_random(flip, exact):
    """Which a run that interpolates stays below, since squares are convex."""
    data, rng = flip.simulate(TIMES, 100_000, 98), np.random.default_rng(1)
    found = exact.run(TIMES, data.measurements).mean

    def rounded(values, low, high, count):
        place = (np.clip(values, low, high) - low) * ((count - 1) / (high - low))
        up = rng.random(values.shape) < place % 1
        return low + (np.floor(place) + up) * ((high - low) / (count - 1))

    def square(k, *arguments):
        return (exact.output(k, *arguments).mean - exact.output(k - 1, *arguments).mean)[0] ** 2

    z = ()
    for k, y in enumerate(data.measurements):
        nodes = rounded(y, *GRID["y"])
        if k >= 2:
            assert within(square(k, nodes, z), exact.changes[0, k] ** 2)
            assert square(k, y, found[k - 1]).mean() < exact.changes[0, k] ** 2
        z = rounded(exact.output(k, nodes, z).mean, *GRID["z"])
    assert np.isnan(exact.changes[0, :2]).all()
    assert (exact.changes[1, 2:] == 0.0).all()


def test_filter_of_theorem_2_on_the_grid_has_the_parameters_of_simulated_ones(flip, gaussian, data):
    """Gamma, kappa, T at all measurements: mean and standard error of independent designs."""
    made, risk = gaussian
    wanted = np.array([[p.item() for p in fit] for fit in made.fits])
    np.testing.assert_allclose(wanted[0], [0.42102, 0.26389, 0.49577], atol=2e-3)
    found = np.array(
        [
            [
                [p.item() for p in fit]
                for fit in synthesize(
                    flip, large_order(1), ExactGaussian(), TIMES, nodes=0, paths=1500, seed=seed
                ).fits
            ]
            for seed in range(12)
        ]
    )
    error = found.std(axis=0, ddof=1) / np.sqrt(12)
    assert (np.abs(found.mean(axis=0) - wanted) < 4.5 * error).all()
    squares = (made.run(TIMES, data.measurements[::2]).mean - data.states[::2])[:, 0] ** 2
    assert within(squares, risk.mse)
    assert risk.bias[2] == pytest.approx(0.0019, abs=2e-4)
    np.testing.assert_allclose(grid_risk(made, **GRID).mse, risk.mse, rtol=1e-9)
    linearised = affine_synthesis(flip, large_order(1), Taylor(), TIMES[:3], **GRID)[1]
    np.testing.assert_allclose(linearised.mse, [0.14796, 0.20319, 0.20266], rtol=2e-3)


def test_affine_design_of_a_sensor_that_changes_with_time_is_the_kalman_filter():
    """With one estimate remembered, and to the error of the grid."""
    dynamics = StochasticMap([x], [0.9 * x + v], Noise((v,), cov=[[0.4]]), time=t)
    sensor = StochasticMap([x], [(1 + t) * x + w], Noise((w,), cov=[[0.5]]), time=t)
    system, times = DiscreteSystem(dynamics, sensor, [0.3], [[1.0]]), np.arange(4.0)
    axes = {"x": (-7.0, 7.0, 113), "z": (-6.0, 6.0, 97), "y": (-26.0, 26.0, 209)}
    made, _ = affine_synthesis(system, large_order(1), ExactGaussian(), times, **axes)
    y = system.simulate(times, 50, 3).measurements
    wanted, found = extended_kalman(system).run(times, y), made.run(times, y)
    np.testing.assert_allclose(made.predicted.rms[:, 0] ** 2, wanted.cov[:, 0, 0], rtol=1e-2)
    np.testing.assert_allclose(found.mean, wanted.mean, atol=2e-2)


@pytest.mark.parametrize(
    ("memory", "predictor"), [(large_order(1), Polynomial(3, 2)), (finite_memory(1), None)]
)
def test_risk_of_a_simulated_design_is_its_held_out_error_and_above_the_optimum(
    flip, exact, memory, predictor
):
    options = {"predictor": predictor} if predictor else {}
    made = synthesize(
        flip, memory, ExactGaussian(), TIMES, nodes=0, paths=12_000, seed=6, step=0.025, **options
    )
    risk, held = grid_risk(made, **GRID), made.held_out
    assert (np.abs(np.sqrt(risk.mse) - held.rms[:, 0]) < 4 * held.error[:, 0]).all()
    best = mse(exact) if memory.estimates else optimal_risk(flip, memory, TIMES, **GRID).mse
    assert (best <= risk.mse + 1e-12).all()
    assert (best[1:] < 0.8 * risk.mse[1:]).all()


def scalar(cls):
    """A decaying scalar with a sensor of gain two, in continuous or discrete time."""
    noise = Noise((w,), cov=[[0.8]])
    if cls is JumpDiffusion:
        return JumpDiffusion((x,), [-x / 2], [[1]], [2 * x + w], noise, [0.4], [[0.5]])
    decay = np.exp(-0.2)
    move = StochasticMap((x,), [decay * x + v], Noise((v,), cov=[[1 - decay**2]]))
    return DiscreteSystem(move, StochasticMap((x,), [2 * x + w], noise), [0.4], [[0.5]])


@pytest.mark.parametrize("cls", [JumpDiffusion, DiscreteSystem])
def test_linear_gaussian_limit_is_the_kalman_filter(cls):
    """Excess errors fall with the square of the step of the memory; estimates are Kalman's."""
    system, steps = scalar(cls), 5
    times = (0.4 if cls is JumpDiffusion else 1.0) * np.arange(steps)
    one, decay = np.ones((steps, 1, 1)), np.exp(-0.2)
    model = Linear(
        decay * one[1:],
        0 * one[1:, 0],
        (1 - decay**2) * one[1:],
        2 * one,
        0 * one[:, 0],
        0.8 * one,
        np.array([0.4]),
        np.array([[0.5]]),
    )
    data, excess = system.simulate(times, 20, 3), []
    wanted = [kalman(model, record) for record in data.measurements[..., :20].T.swapaxes(1, 2)]
    for count in (41, 81):
        axes = {"x": (-5, 5, 241), "z": (-4, 4, count), "y": (-14, 14, 141)}
        found = grid_synthesis(system, large_order(1), times, **axes)
        excess.append(mse(found) - wanted[0].cov[:, 0, 0])
    assert (excess[0][1:] > 0).all()
    np.testing.assert_allclose(excess[0][2:] / excess[1][2:], 4.0, rtol=0.3)
    np.testing.assert_allclose(excess[1], 0.0, atol=1.5e-3)
    means = np.stack([row.mean[:, 0] for row in wanted], axis=-1)
    assert np.abs(found.run(times, data.measurements).mean[:, 0] - means).max() < 0.02


def test_nodes_of_the_state_design_as_an_axis_does_where_they_are_even():
    axes = {"z": (-4, 4, 41), "y": (-14, 14, 71)}
    risk = [
        optimal_risk(scalar(DiscreteSystem), Memory(1), range(4), x=nodes, **axes).mse
        for nodes in (
            (-5, 5, 61),
            Nodes(np.linspace(-5, 5, 61)),
            Nodes(5 * np.sinh(np.linspace(-1.5, 1.5, 61)) / np.sinh(1.5)),
        )
    ]
    np.testing.assert_allclose(risk[1], risk[0], rtol=1e-12)
    np.testing.assert_allclose(risk[2], risk[0], rtol=1e-3)


def test_probability_beyond_an_axis_is_warned_of_by_name(flip):
    few = {"x": (-3.5, 3.5, 71)}
    for name, change in (("z", (-0.5, 0.5, 31)), ("y", (-2.0, 2.0, 41)), ("x", (-1.5, 1.5, 71))):
        with pytest.warns(UserWarning, match=f"{name}: "):
            grid_synthesis(flip, large_order(1), TIMES[:3], **{**few, name: change})


def test_a_design_warns_once_of_each_axis_with_the_worst_figure(flip):
    """Of an axis of the state that is short at every time, and worst at the last."""
    with pytest.warns(UserWarning, match="too short|outside") as caught:
        grid_synthesis(flip, large_order(1), TIMES, x=(-1.5, 1.5, 71), z=(-0.5, 0.5, 31))
    messages = [str(one.message) for one in caught]
    assert sorted(text[:2] for text in messages) == ["x:", "z:"]
    chain = grid_chain(flip, (-1.5, 1.5, 71))
    shares = [chain.missed, *(chain.distribution(t)[[0, -1]].max() for t in TIMES)]
    (text,) = [text for text in messages if text.startswith("x:")]
    assert f"probability {max(shares):.2g} in an outermost cell, or beyond it" in text


def test_a_design_of_modes_on_few_nodes_warns_of_them():
    """A step of two deviations of the noise, and one of half of them."""
    system = zoo.scalar_switching()
    deviation = np.sqrt(system.dynamics[0].conditional_moments(0.0, np.zeros((1, 1)))[1].max())
    for step, count in ((2.0, 1), (0.5, 0)):
        nodes = int(16 / (step * deviation)) + 1
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            optimal_risk(system, Memory(1), range(3), x=(-8, 8, nodes))
        assert sum("too coarse for the noise" in str(one.message) for one in caught) == count
