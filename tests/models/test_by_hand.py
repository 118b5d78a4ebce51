"""Small rules of models, each by itself."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib.base import ELAPSED, Parameter, assigned
from seedslib.models import (
    DiscreteChain,
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingChain,
    SwitchingSystem,
)
from seedslib.models.branches import Branch
from seedslib.models.chains import switching
from seedslib.models.codegen import compile_components, fold
from seedslib.models.derived import doubled, products
from seedslib.models.kinds import MOST, SIZES, UnknownModel
from seedslib.models.sinc import sinc_ratio
from seedslib.models.words import model_text

x, y, v, w, t = sympy.symbols("x y v w t", real=True)
SENSOR = StochasticMap((x,), [x + w / 2], Noise((w,)))


def masses(mean, deviation, nodes, width):
    return width * norm.pdf(nodes, mean, deviation)


def test_a_chain_takes_a_step_as_long_as_it_is():
    """X' = X exp(-d) + sqrt(1 - exp(-2 d)) V after the time d."""
    fade = sympy.exp(-ELAPSED)
    move = StochasticMap((x,), [fade * x + sympy.sqrt(1 - fade**2) * v], Noise((v,)))
    chain = DiscreteChain(DiscreteSystem(move, SENSOR, [0], [[1]]), (-6.0, 6.0, 121))
    nodes = chain.values[0]
    for start, stop in ((0.0, 0.5), (0.5, 2.5), (1.0, 1.5)):
        fade = np.exp(-(stop - start))
        found = chain.transition(start, stop)[:, [40, 75]]
        want = masses(fade * nodes[[40, 75]], np.sqrt(1 - fade**2), nodes[:, None], 0.1)
        np.testing.assert_allclose(found[1:-1], want[1:-1], rtol=1e-11)


def modes(**change):
    given = {
        "state": (x,), "dynamics": [[x / 2 + v + t / 5], [x - v / 2]], "noise": Noise((v,)),
        "switching": [[0.7, 0.3], [0.4, 0.6]], "sensor": [[x + w], [x + w / 2]],
        "sensor_noise": Noise((w,)), "time": t,
        "initial": [(0.2, [3.0], [[1.0]]), (0.8, [-5.0], [[2.0]])],
    }  # fmt: skip
    return SwitchingSystem(**given | change)


def test_a_chain_of_modes_keeps_a_few_of_its_steps(monkeypatch):
    """Each step of a system that changes in time is its own; those kept are not mixed up."""
    monkeypatch.setattr(switching, "KEPT", 3)
    chain = SwitchingChain(modes(), (-9.0, 9.0, 61))
    nodes, at = chain.values[0, :61], [20, 33]
    for start in (0.0, 1.0, 2.0, 3.0, 4.0, 0.0, 1.0):
        found = chain.transition(start, start + 1.0)[:, at]
        apart = masses(nodes[at] / 2 + start / 5, 1.0, nodes[:, None], 0.3)
        np.testing.assert_allclose(found[:61], 0.7 * apart, atol=1e-9)
        np.testing.assert_allclose(found[61:], 0.3 * apart, atol=1e-9)
        assert chain.transition(start, start + 1.0) is chain.transition(start, start + 1.0)
        assert len(chain._known) <= 3


def test_the_likely_mode_stands_in_for_lost_paths():
    hybrid = modes().hybrid
    np.testing.assert_array_equal(hybrid.mean0, [-5.0, 1.0])
    told = np.array([0, 1, 1, 0] * 400)
    drawn = hybrid.initial_sample(np.random.default_rng(0), 1600, told)
    np.testing.assert_array_equal(drawn[-1], told)
    assert abs(drawn[0, told == 0].mean() - 3.0) < 0.15
    assert abs(drawn[0, told == 1].std() - np.sqrt(2.0)) < 0.15
    free = hybrid.initial_sample(np.random.default_rng(0), 4000)
    assert abs((free[-1] == 1).mean() - 0.8) < 0.03


def test_density_of_a_measurement_with_its_indicator():
    """Modes, times and parameters of each path; a missing indicator says nothing."""
    a, tells = Parameter("a", 9.0), 1 / (1 + x**2)
    system = modes(
        sensor=[[x + a * t + w], [2 * x + w / 2]], indicator=[[tells, 1 - tells], [0.3, 0.7]]
    )
    state = np.array([[0.4, 0.4, -0.2, 1.1, 0.7], [0, 0, 0, 1, 1]])
    shown = np.array([[1.3, 1.3, 0.2, 1.9, 2.2], [0, np.nan, 1, 1, np.nan]])
    own = np.array([0.5, -0.3, 0.2, 5.0, 5.0])
    x0, first = state[0], state[1] == 0
    law = np.where(first, norm.logpdf(shown[0], x0 + own * 1.5, 1.0),
                   norm.logpdf(shown[0], 2 * x0, 0.5))  # fmt: skip
    chance = np.where(first, 1 / (1 + x0**2), 0.3)
    told = np.where(shown[1] == 0, np.log(chance), np.log(1 - chance))
    told[np.isnan(shown[1])] = 0.0
    sensor = system.hybrid.sensor
    with assigned({a: own}):
        np.testing.assert_allclose(sensor.log_density(1.5, shown, state), law + told, rtol=1e-12)
        many = np.repeat(state[:, None], 4000, axis=1)
        near = sensor.sample(1.5, many, np.random.default_rng(4))
    middle = np.where(first, x0 + own * 1.5, 2 * x0)
    assert np.abs(near[0].mean(axis=0) - middle).max() < 0.07
    assert np.abs((near[1] == 0).mean(axis=0) - chance).max() < 0.035


# Sizes of a model that is not known


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ((0, 1), "state_size: wanted 1 to 128, got 0"),
        ((1, 0), "measurement_size: wanted 1 to 128, got 0"),
        ((MOST + 1, 1), "state_size: wanted 1 to 128, got 129"),
        ((1, 1, MOST + 1), "modes: wanted 0 to 128, got 129"),
        ((1, 1, 0, -1), "indicators: wanted 0 to 128, got -1"),
        ((1, 1.5), "measurement_size: wanted 1 to 128, got 1.5"),
    ],
)
def test_sizes_that_no_table_can_have(sizes, message):
    with pytest.raises((TypeError, ValueError), match=message):
        UnknownModel(*sizes).bounded()


def test_sizes_of_a_model():
    most = UnknownModel(MOST, MOST, MOST, MOST)
    assert most.bounded() is most
    assert UnknownModel(2, 3).bounded() == UnknownModel(2, 3, 0, 0)
    assert UnknownModel(2, 3).sensor.size == 3
    assert UnknownModel.of(modes()) == UnknownModel(1, 1, 2, 0)
    line = LinearSystem(np.eye(2), np.eye(2), np.ones((3, 2)), np.eye(3), [0, 0], np.eye(2))
    assert UnknownModel.of(line) == UnknownModel(2, 3)
    assert UnknownModel(1, 2).apart(UnknownModel(1, 2)) is None
    for name in SIZES:
        one = UnknownModel(5, 6, 7, 8)
        found = one.apart(replace(one, **{name: 9}))
        assert found == (SIZES[name], getattr(one, name), 9)
    with pytest.raises(AttributeError):
        replace(most, modes=1).modes = 2


# Maps made of maps


def functions(map, conditional=True):
    """The same map as array functions."""
    given = map.conditional
    known = {"mean": given.mean, "cov": given.cov} if conditional else {}
    return StochasticMap.from_functions(map.state_size, map.size, map.value, map.noise, **known)


@pytest.mark.parametrize("kind", ["formulas", "functions", "functions without moments"])
def test_a_map_of_two_states_sees_the_second(kind):
    map = StochasticMap((x, y), [x * y + v, 3 * x - y, v * y], Noise((v,), [0.2], [[0.7]]))
    if kind != "formulas":
        map = functions(map, kind == "functions")
    both = doubled(map)
    assert both.state_size == 4
    assert both.size == 3
    rng = np.random.default_rng(3)
    states, noise = rng.standard_normal((4, 5)), rng.standard_normal((1, 5))
    a, b = states[2:]
    want = [a * b + noise[0], 3 * a - b, noise[0] * b]
    np.testing.assert_allclose(both.value(0.0, states, noise), want, rtol=1e-14)
    if kind != "functions without moments":
        np.testing.assert_allclose(
            both.conditional.mean(0.0, states), [a * b + 0.2, 3 * a - b, 0.2 * b]
        )
        cov = both.conditional.cov(0.0, states)
        np.testing.assert_allclose(cov[0, 2], 0.7 * b, rtol=1e-13)


@pytest.mark.parametrize("kind", ["formulas", "functions"])
def test_products_whose_means_are_moments(kind):
    map = StochasticMap((x, y), [x * y + v, 3 * x - y], Noise((v,)), weight=1 / (2 + x**2))
    if kind == "functions":
        map = StochasticMap.from_functions(2, 2, map.value, map.noise, weight=map.weight)
    rng = np.random.default_rng(5)
    (a, b), noise = states, _ = rng.standard_normal((2, 4)), rng.standard_normal((1, 4))
    c, d, p = a * b + noise[0], 3 * a - b, 1 / (2 + a**2)
    want = [1, a, b, c, d, a * a, b * a, b * b, a * c, a * d, b * c, b * d, c * c, d * c, d * d]
    made = products(map)
    assert made.size == len(want)
    np.testing.assert_allclose(made.value(0.0, states, noise), [p * part for part in want])


# Densities of branches


def test_a_density_needs_a_noise_that_the_value_determines():
    """Where the probability looks at the noise; any density will do where it does not."""
    step = (1 + sympy.erf(v)) / 2
    clear = Branch(StochasticMap((x,), [x + v / 2], Noise((v,)), weight=step))
    assert clear.has_log_density
    here, there = np.array([[0.3, -0.4]]), np.array([[0.9, np.nan]])
    noise = 2 * (0.9 - 0.3)
    want = norm.logpdf(0.9, 0.3, 0.5) + np.log(norm.cdf(noise * np.sqrt(2)))
    found = clear.log_density(0.0, there, here)
    np.testing.assert_allclose(found, [want, np.log(0.5)], rtol=1e-12)
    two = Branch(StochasticMap((x,), [x + v + w], Noise((v, w)), weight=step))
    for branch in (two, Branch(StochasticMap((x,), [x + v**2], Noise((v,)), weight=step))):
        assert not branch.has_log_density
    with pytest.raises(ValueError, match="wanted noise that the value determines"):
        two.log_density(0.0, there, here)
    plain = Branch(StochasticMap((x,), [x + v + w], Noise((v, w)), weight=1 / (1 + x**2)))
    want = norm.logpdf(0.9, 0.3, np.sqrt(2)) - np.log(1.09)
    np.testing.assert_allclose(
        plain.log_density(0.0, there, here), [want, -np.log(1.16)], rtol=1e-12
    )


# Formulas


def test_numbers_of_a_formula_are_one_constant():
    found = fold(sympy.pi**2 * x / 100 + sympy.sqrt(2) * x**2 + 3 * x)
    assert not found.has(sympy.pi)
    assert sympy.Rational(1, 100) not in found.atoms()
    np.testing.assert_allclose(
        float(found.subs(x, 0.7)), np.pi**2 * 0.007 + np.sqrt(2) * 0.49 + 2.1, rtol=1e-15
    )
    for large in (sympy.exp(1000), sympy.pi * 10**400, sympy.Integer(10) ** 400):
        with pytest.raises(ValueError, match="expressions: wanted numbers in the range of float"):
            compile_components([x], [large * x])


def test_ratios_of_a_sine_about_the_change_of_formula():
    """sin(x) / x and its derivatives by x²/2, both formulas of which hold at two."""
    for k, want in (
        (0, lambda z: sympy.sin(z) / z),
        (1, lambda z: (sympy.sin(z) - z * sympy.cos(z)) / z**3),
        (2, lambda z: ((3 - z**2) * sympy.sin(z) - 3 * z * sympy.cos(z)) / z**5),
    ):
        at = np.array([0.5, 1.999999, 2.0, 2.000001, -2.0, 7.5])
        exact = [float(want(sympy.Rational(str(z))).evalf(30)) for z in at]
        np.testing.assert_allclose(sinc_ratio(k, at), exact, rtol=1e-14)


def test_matrices_in_formulas_travel():
    t = sympy.Symbol("t")
    system = LinearSystem([[1 + t / 10, 0.2], [0, 0.7]], np.eye(2), [[1, t]], 1, [0, 0], np.eye(2))
    again = pickle.loads(pickle.dumps(system))
    for at in (0.0, 2.5):
        np.testing.assert_array_equal(again.dynamics.slope_at(at), [[1 + at / 10, 0.2], [0.0, 0.7]])
        np.testing.assert_array_equal(again.sensor.slope_at(at), [[1.0, at]])


def test_a_motion_without_noise_is_its_equation():
    system = JumpDiffusion((x,), [-x], np.zeros((1, 0)), [x + w], Noise((w,)), [2.0], [[0.0]],
                           step=0.001)  # fmt: skip
    found = system.simulate([0.0, 0.5, 1.0], 3, 1).states[:, 0]
    np.testing.assert_allclose(found, 2 * np.exp([[0.0], [-0.5], [-1.0]]) * np.ones(3), rtol=1e-3)


def test_array_functions_have_no_formulas_to_show():
    flow = JumpDiffusion.from_functions(
        lambda t, x: -x, lambda t, x: np.ones((1, 1, *x.shape[1:])), SENSOR, [0.0], [[1.0]]
    )
    assert model_text(flow) == {"model": "array functions"}
    still = DiscreteSystem(functions(StochasticMap((x,), [x + v], Noise((v,)))), SENSOR, [0], [[1]])
    assert model_text(still)["dynamics"] == "array functions"
    assert "x" in model_text(still)["sensor"]
