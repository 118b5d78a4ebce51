import pickle

import numpy as np
import pytest
import sympy as sp

from seedslib.base import Parameter, assigned
from seedslib.filters import assumed_density, cubature_kalman, extended_kalman
from seedslib.models import JumpDiffusion, Noise
from seedslib.models.codegen import _lambdified

x, v = sp.symbols("x v")
SPEED, NOISE, SENSOR = Parameter("a", 1.0), Parameter("q", 0.5, positive=True), Parameter("r", 0.4)
OTHER = {SPEED: 2.0, NOISE: 0.7, SENSOR: 0.3}
TIMES = np.arange(0, 3, 0.5)


def system(a, q, r):
    noise = Noise((v,))
    return JumpDiffusion([x], [-a * x + sp.sin(x)], [[q]], [x + r * v], noise, [0], [[1]])


NAMED, PLAIN = system(SPEED, NOISE, SENSOR), system(*OTHER.values())


def test_a_parameter_is_its_name_value_and_assumptions():
    assert Parameter("q", 0.5, positive=True) == NOISE
    assert Parameter("q", 0.6, positive=True) != NOISE
    assert Parameter("q", 0.5) != NOISE
    again = pickle.loads(pickle.dumps(NOISE))
    assert (again, again.value, again.is_positive) == (NOISE, 0.5, True)
    assert sp.diff(NOISE**2, NOISE) == 2 * NOISE


@pytest.mark.parametrize("filter", [extended_kalman, assumed_density, cubature_kalman])
def test_filters_take_assigned_values(filter):
    y = np.sin(TIMES)[:, None]
    named, wanted = filter(NAMED), filter(PLAIN).run(TIMES, y)
    with assigned(OTHER):
        found = named.run(TIMES, y)
    assert np.allclose(found.mean, wanted.mean, rtol=1e-13)
    assert np.allclose(found.loglik, wanted.loglik, rtol=1e-13)
    assert not np.allclose(named.run(TIMES, y).mean, wanted.mean, rtol=1e-3)


def test_paths_have_their_own_values():
    y = np.sin(TIMES)[:, None, None] * np.ones(3)
    filter = extended_kalman(NAMED)
    values = {SPEED: [1.0, 2.0, 3.0], NOISE: [0.5, 0.7, 0.5], SENSOR: [0.4, 0.3, 0.4]}
    with assigned({p: np.array(row) for p, row in values.items()}):
        found = filter.run(TIMES, y)
    for path in range(3):
        one = extended_kalman(system(*(row[path] for row in values.values())))
        wanted = one.run(TIMES, y[..., path])
        assert np.allclose(found.loglik[:, path], wanted.loglik, rtol=1e-13)


def test_simulation_takes_them_and_they_end_with_the_block():
    with assigned(OTHER):
        found = NAMED.simulate(TIMES, 2, 0).states
    assert np.allclose(found, PLAIN.simulate(TIMES, 2, 0).states, rtol=1e-13)
    inner = []
    with assigned({SPEED: 3.0}), assigned({SPEED: 2.0}):
        inner.append(NAMED.drift(0.0, np.ones(1))[0])
    inner.append(NAMED.drift(0.0, np.ones(1))[0])
    assert inner == pytest.approx([-2 + np.sin(1), -1 + np.sin(1)])


def test_other_values_are_not_compiled_again():
    extended_kalman(system(SPEED, NOISE, SENSOR))
    before = _lambdified.cache_info().misses
    others = (Parameter(p.name, 2.5, positive=p.is_positive) for p in OTHER)
    extended_kalman(system(*others))
    assert _lambdified.cache_info().misses == before
