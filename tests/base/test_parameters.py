"""Parameters and inputs: names with values, of a block of code, of paths and of processes."""

import pickle

import numpy as np
import pytest
import sympy as sp

from seedslib.base import ELAPSED, Input, Parameter, assigned
from seedslib.filters import KalmanFilter, assumed_density, cubature_kalman, extended_kalman
from seedslib.models import JumpDiffusion, LinearSystem, Noise

x, v = sp.symbols("x v")
SPEED, NOISE, SENSOR = Parameter("a", 1.0), Parameter("q", 0.5, positive=True), Parameter("r", 0.4)
OTHER = {SPEED: 2.0, NOISE: 0.7, SENSOR: 0.3}
TIMES = np.arange(0, 3, 0.5)
Y = np.sin(TIMES)[:, None]


def flow(a=SPEED, q=NOISE, r=SENSOR):
    noise = Noise((v,))
    return JumpDiffusion([x], [-a * x + sp.sin(x)], [[q]], [x + r * v], noise, [0], [[1]])


def line(a=SPEED, q=NOISE, r=SENSOR):
    return LinearSystem(
        [[0.9, a / 5], [0, 0.5]], [[q, 0], [0, 1]], [[1, a]], [[r]], [0, 1], np.eye(2)
    )


FILTERS = {
    "extended": lambda *a: extended_kalman(flow(*a)),
    "assumed density": lambda *a: assumed_density(flow(*a)),
    "cubature": lambda *a: cubature_kalman(flow(*a)),
    "Kalman": lambda *a: KalmanFilter(line(*a)),
}


def test_names_values_and_assumptions_make_a_parameter():
    assert Parameter("q", 0.5, positive=True) == NOISE
    for other in (
        Parameter("q", 0.6, positive=True),
        Parameter("q", 0.5),
        Input("q", positive=True),
    ):
        assert other != NOISE
    for one in (NOISE, Parameter("s", 2.0, negative=True), Input("q", positive=True), ELAPSED):
        again = pickle.loads(pickle.dumps(one))
        assert (again, again.value, again.is_positive) == (one, one.value, one.is_positive)
    assert sp.diff(NOISE**2, NOISE) == 2 * NOISE
    assert Input("dt", positive=True) != ELAPSED
    with pytest.raises(TypeError, match="value"):
        Parameter("a", "1")


@pytest.mark.parametrize("name", FILTERS)
def test_assigned_values_are_those_of_numbers_and_paths_may_have_their_own(name):
    """And the values end with the block of code; blocks may lie in one another."""
    named, plain = FILTERS[name](), FILTERS[name](*OTHER.values())
    before, wanted = named.run(TIMES, Y), plain.run(TIMES, Y)
    with assigned({SPEED: 9.0, NOISE: 0.7}), assigned({SPEED: 2.0, SENSOR: 0.3}):
        found = named.run(TIMES, Y)
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-12)
    np.testing.assert_allclose(found.loglik, wanted.loglik, rtol=1e-12)
    np.testing.assert_array_equal(named.run(TIMES, Y).mean, before.mean)
    values = {SPEED: [1.0, 2.0, 3.0], NOISE: [0.5, 0.7, 0.5], SENSOR: [0.4, 0.3, 0.4]}
    with assigned({p: np.array(row) for p, row in values.items()}):
        found = named.run(TIMES, np.repeat(Y[..., None], 3, axis=2))
    for path in range(3):
        wanted = FILTERS[name](*(row[path] for row in values.values())).run(TIMES, Y)
        np.testing.assert_allclose(found.loglik[:, path], wanted.loglik, rtol=1e-12)
        np.testing.assert_allclose(found.mean[..., path], wanted.mean, rtol=1e-11)


def test_simulation_takes_assigned_values_on_threads_too():
    values = np.linspace(0.5, 2.0, 9000)
    with assigned({SPEED: values}):
        one, two = (flow().simulate([0, 0.2], 9000, 0, workers=w, step=0.1).states for w in (1, 2))
    np.testing.assert_array_equal(one, two)
    for path in (0, 8999):
        with assigned({SPEED: values[path]}):
            alone = flow().simulate([0, 0.2], 9000, 0, step=0.1).states
        np.testing.assert_allclose(one[..., path], alone[..., path], rtol=1e-13)


def test_an_input_has_no_value_of_its_own():
    system = flow(a=Input("u"))
    with pytest.raises(ValueError, match="inputs"):
        system.simulate(TIMES, 1, 0)
    with pytest.raises(ValueError, match="u"):
        system.drift(0.0, np.ones((1, 1)))
    with assigned({Input("u"): 2.0}):
        assert system.drift(0.0, np.ones((1, 1)))[0, 0] == pytest.approx(-2 + np.sin(1))
