"""Moments of equal maps are derived once, those of any other map are its own."""

from dataclasses import dataclass

import numpy as np
import pytest
import sympy

from seedslib.base import Parameter, assigned
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.linearization.formulas import Formulas
from seedslib.models import Noise, StochasticMap

MEAN, COV = np.array([0.4]), np.array([[0.3]])


def square(a=2.0, name="x", mean=0.5, cov=0.7, weight=1, extra=0):
    """Map a x² + v of a state by its name."""
    x, v = sympy.symbols(f"{name} v", real=True)
    return StochasticMap((x,), [a * x**2 + extra + v], Noise((v,), mean=mean, cov=[[cov]]), weight)


@pytest.fixture
def derived(monkeypatch):
    """Maps that formulas were derived of."""
    found, formulas = [], ExactGaussian.formulas

    def noted(self, map, *rest):
        found.append(map)
        return formulas(self, map, *rest)

    monkeypatch.setattr(ExactGaussian, "formulas", noted)
    return found


def test_a_map_that_is_made_again_is_not_derived_again(derived):
    one = ExactGaussian().moments(square(a=1.25))
    assert ExactGaussian().moments(square(a=1.25)) is one
    assert ExactGaussian().transition(square(a=1.25)) is not one
    assert len(derived) == 2
    branch = square(a=1.25, weight=sympy.exp(-(sympy.Symbol("x", real=True) ** 2)))
    again = square(a=1.25, weight=sympy.exp(-(sympy.Symbol("x", real=True) ** 2)))
    assert ExactGaussian().row([branch, branch]) is ExactGaussian().row([again, again])
    assert ExactGaussian().row([branch]) is not ExactGaussian().row([again, again])


@pytest.mark.parametrize(
    "change", [{"a": 3.0}, {"name": "z"}, {"mean": -0.5}, {"cov": 0.2}, {"extra": 1}]
)
def test_another_map_has_moments_of_its_own(derived, change):
    """E y = a (m² + P) + E v + extra and var y = a² (4 m² P + 2 P²) + var v, by hand."""
    for given in ({}, change):
        law = {"a": 2.0, "mean": 0.5, "cov": 0.7, "extra": 0} | given
        law.pop("name", None)
        found = ExactGaussian().moments(square(**given))(0.0, MEAN, COV)
        m, p = 0.4, 0.3
        mean = law["a"] * (m**2 + p) + law["mean"] + law["extra"]
        cov = law["a"] ** 2 * (4 * m**2 * p + 2 * p**2) + law["cov"]
        np.testing.assert_allclose(found.mean, [mean], rtol=1e-13)
        np.testing.assert_allclose(found.cov, [[cov]], rtol=1e-13)
    assert derived[-1].state[0].name == change.get("name", "x")


def test_the_order_of_the_state_and_the_weight_are_told_apart():
    x, y = sympy.symbols("x y", real=True)
    mean, cov = np.array([1.0, 5.0]), np.eye(2)
    for state, wanted in (((x, y), 3.0), ((y, x), 15.0)):
        found = Taylor().moments(StochasticMap(state, [3 * x]))(0.0, mean, cov)
        np.testing.assert_allclose(found.mean, [wanted])
    for weight in (0.25, 0.75):
        (found,) = ExactGaussian().row([square(weight=weight)])(0.0, MEAN, COV)
        np.testing.assert_allclose(found.mass, weight)


def test_rules_and_parameters_are_told_apart():
    exact, linear = (r.moments(square())(0.0, MEAN, COV).mean for r in (ExactGaussian(), Taylor()))
    np.testing.assert_allclose(exact - linear, 2.0 * 0.3, rtol=1e-13)
    few, many = Parameter("a", 2.0), Parameter("a", 5.0)
    for value in (few, many):
        found = Taylor().moments(square(a=value))
        np.testing.assert_allclose(
            found(0.0, MEAN, COV).mean, [value.value * 0.16 + 0.5], rtol=1e-13
        )
    with assigned({many: 7.0}):
        np.testing.assert_allclose(found(0.0, MEAN, COV).mean, [7.0 * 0.16 + 0.5], rtol=1e-13)


class Scaled(Taylor):
    """A subclass that says nothing of being frozen."""

    factor = 1.0

    def formulas(self, map, mean, cov, spread=True):
        y, cross, rest = super().formulas(map, mean, cov, spread)
        return self.factor * y, cross, rest


@dataclass
class Loose(Formulas):
    """A dataclass whose field may be given anew."""

    factor: float = 1.0

    def formulas(self, map, mean, cov, spread=True):
        y, cross, rest = Taylor().formulas(map, mean, cov, spread)
        return self.factor * y, cross, rest


@pytest.mark.parametrize("rule", [Scaled(), Loose()])
def test_a_rule_that_can_change_derives_whenever_it_is_asked(rule):
    for factor in (1.0, 2.0):
        object.__setattr__(rule, "factor", factor)
        found = rule.moments(square())(0.0, MEAN, COV)
        np.testing.assert_allclose(found.mean, [factor * (2.0 * 0.16 + 0.5)], rtol=1e-13)
