"""Parameters and inputs: names with numbers, which models and filters are bound to."""

import pickle

import numpy as np
import pytest
import sympy as sp

from seedslib.base import ELAPSED, Input, Parameter
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
def test_bound_filters_are_those_of_numbers_and_paths_may_have_their_own(name):
    """The filter that was bound stays as it was; a pickled one keeps its numbers."""
    named, plain = FILTERS[name](), FILTERS[name](*OTHER.values())
    before, wanted = named.run(TIMES, Y), plain.run(TIMES, Y)
    bound = named.bind(a=9.0, q=0.7).bind({SPEED: 2.0}, r=0.3)
    for filter in (bound, pickle.loads(pickle.dumps(bound))):
        found = filter.run(TIMES, Y)
        np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-12)
        np.testing.assert_allclose(found.loglik, wanted.loglik, rtol=1e-12)
    np.testing.assert_array_equal(named.run(TIMES, Y).mean, before.mean)
    values = {SPEED: [1.0, 2.0, 3.0], NOISE: [0.5, 0.7, 0.5], SENSOR: [0.4, 0.3, 0.4]}
    found = named.bind(values).run(TIMES, np.repeat(Y[..., None], 3, axis=2))
    for path in range(3):
        wanted = FILTERS[name](*(row[path] for row in values.values())).run(TIMES, Y)
        np.testing.assert_allclose(found.loglik[:, path], wanted.loglik, rtol=1e-12)
        np.testing.assert_allclose(found.mean[..., path], wanted.mean, rtol=1e-11)


def test_one_noise_for_each_path_beside_a_common_covariance():
    """The first covariance is common to all paths, that of the noise is not."""
    filter = KalmanFilter(line()).bind(r=[0.4, 0.3])
    found = filter.run(TIMES, np.repeat(Y[..., None], 2, axis=2))
    for path, r in enumerate((0.4, 0.3)):
        wanted = KalmanFilter(line(r=r)).run(TIMES, Y)
        np.testing.assert_allclose(found.cov[..., path], wanted.cov, rtol=1e-12)


def test_simulation_takes_numbers_of_paths_on_threads_too():
    values = np.linspace(0.5, 2.0, 9000)
    system = flow().bind(a=values)
    one, two = (system.simulate([0, 0.2], 9000, 0, workers=w, step=0.1).states for w in (1, 2))
    np.testing.assert_array_equal(one, two)
    for path in (0, 8999):
        alone = flow().bind(a=values[path]).simulate([0, 0.2], 9000, 0, step=0.1).states
        np.testing.assert_allclose(one[..., path], alone[..., path], rtol=1e-13)


def test_an_input_has_no_value_of_its_own():
    system = flow(a=Input("u"))
    with pytest.raises(ValueError, match="inputs"):
        system.simulate(TIMES, 1, 0)
    with pytest.raises(ValueError, match="u"):
        system.drift(0.0, np.ones((1, 1)))
    assert system.bind(u=2.0).drift(0.0, np.ones((1, 1)))[0, 0] == pytest.approx(-2 + np.sin(1))


def test_numbers_come_in_the_order_of_parameters_inputs_and_the_step():
    u = Input("b")
    system = LinearSystem(
        [[SPEED * sp.exp(-ELAPSED)]], [[NOISE]], [[1]], [[u**2]], [0], [[1]]
    ).bind(q=0.25)
    assert system.parameters == (SPEED, NOISE, u, ELAPSED)
    assert system.dynamics.parameters == system.sensor.parameters == system.parameters
    assert system.values({u: 3.0}, 0.5) == (1.0, 0.25, 3.0, 0.5)
    assert np.isnan(system.values({u: 3.0})[-1])


@pytest.mark.parametrize(
    ("call", "error", "name"),
    [
        (lambda s: s.bind(z=1.0), ValueError, "z"),
        (lambda s: s.bind({Parameter("z", 1.0): 1.0}), ValueError, "z"),
        (lambda s: s.bind(a="1"), TypeError, "a"),
        (lambda s: s.bind({"a": 1.0}), ValueError, "a: .* another key"),
        (lambda s: s.bind({3.14: 1.0}), ValueError, "3.14: .* another key"),
        (lambda s: s.bind({Parameter("a", 7.0): 1.0}), ValueError, "a: .* another key"),
        (lambda s: s.bind("a"), TypeError, "values: .* got 'a'"),
        (lambda s: flow(SPEED, Parameter("a", 7.0)), ValueError, "parameters: .* two a"),
        (lambda s: s.bind(a=[1.0, 2.0]).simulate(TIMES, 3, 0), ValueError, "a"),
        (lambda s: s.values({Input("u"): 1.0}), ValueError, "inputs"),
        (lambda s: extended_kalman(s).bind(z=1.0), ValueError, "z"),
    ],
)
def test_numbers_that_do_not_fit_are_refused_by_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call(flow())
