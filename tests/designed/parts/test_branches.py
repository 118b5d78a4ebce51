"""Branches of switching systems as a filter takes them: times, timings, indicators that move."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose

from seedslib.base import Input
from seedslib.designed import SwitchingFilter
from seedslib.designed.switching.lemmas import ModeLaw
from seedslib.designed.switching.rules import SwitchingRules
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import Noise, StochasticMap, SwitchingSystem

x, v, w, t = sympy.symbols("x v w t", real=True)
LEAVE = 1 / (2 + t)
CHAIN = [[1 - LEAVE, LEAVE], [0.3, 0.7]]
MOVES = [[0.9 * x + t + 0.3 * v], [(0.5 - t / 10) * x + 0.8 * v]]
SLOPES, PUSHES, NOISES = (0.9, 0.35), (1.5, 0.0), (0.09, 0.64)
"""Those of the moves at the time 1.5."""
NOW = 1.5


def system(chain=None, **more):
    return SwitchingSystem(
        (x,), MOVES, Noise((v,)), chain or CHAIN, [[x + t + 0.5 * w], [2 * x + w]], Noise((w,)),
        [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])], time=t, **more,
    )  # fmt: skip


def before(*batch):
    rng = np.random.default_rng(4)
    prob = np.stack([rng.uniform(0.2, 0.8, batch)] * 2)
    prob[1] = 1 - prob[0]
    return ModeLaw.of(prob, rng.normal(size=(1, 2, *batch)), rng.uniform(0.3, 2, (1, 1, 2, *batch)))


def chain_now():
    leave = 1 / 3.5
    return np.array([[1 - leave, leave], [0.3, 0.7]])


def mixed(weights, means, variances):
    """Along the first axis."""
    share = weights / weights.sum(axis=0)
    mean = (share * means).sum(axis=0)
    return weights.sum(axis=0), mean, (share * (variances + (means - mean) ** 2)).sum(axis=0)


def told(law):
    """Probabilities, means and variances of modes, without axes of one."""
    return law.prob, law.mean[0], law.cov[0, 0]


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), GaussHermite(3)])
@pytest.mark.parametrize("batch", [(), (3,)])
def test_the_old_mode_moves_and_switches_at_its_time(rule, batch):
    law, rules = before(*batch), SwitchingRules(system(), rule)
    prob, mean, var = told(law)
    assert rules.switch is None
    assert rules.switched(NOW, law) is law
    found = rules.predict(NOW, law)
    turn = [np.array(part).reshape(2, *(1,) * len(batch)) for part in (SLOPES, PUSHES, NOISES)]
    moved = turn[0] * mean + turn[1], turn[0] ** 2 * var + turn[2]
    for l in range(2):
        chance = chain_now()[:, l].reshape(2, *(1,) * len(batch))
        wanted = mixed(chance * prob, *moved)
        for part, value in zip(told(ModeLaw(*found)), wanted, strict=True):
            assert_allclose(part[l, 0], value, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), GaussHermite(3)])
@pytest.mark.parametrize("batch", [(), (3,)])
def test_the_new_mode_moves_what_has_been_mixed(rule, batch):
    """The state stands still while the mode switches, and is moved in the new one."""
    law, rules = before(*batch), SwitchingRules(system(drives="new"), rule)
    prob, mean, var = told(law)
    still, found = rules.switched(NOW, law), rules.predict(NOW, law)
    for l in range(2):
        chance = chain_now()[:, l].reshape(2, *(1,) * len(batch))
        p, m, s = mixed(chance * prob, mean, var)
        for part, value in zip(told(still), (p, m, s), strict=True):
            assert_allclose(part[l], value, rtol=1e-11)
        moved = p, SLOPES[l] * m + PUSHES[l], SLOPES[l] ** 2 * s + NOISES[l]
        for part, value in zip(told(found), moved, strict=True):
            assert_allclose(part[l, 0], value, rtol=1e-11, atol=1e-12)


def test_a_state_that_moves_the_mode_is_told_by_it():
    """With the new mode driving: moments of the state weighed by the chance of each switch."""
    far = x**2 / (1 + x**2) / (1 + t)
    nodes, weights = np.polynomial.hermite_e.hermegauss(5)
    weights = weights / weights.sum()
    rules = SwitchingRules(system([[1 - far, far], [0.3, 0.7]], drives="new"), GaussHermite(5))
    law = before(3)
    prob, mean, var = told(law)
    found = told(rules.switched(NOW, law))
    at = mean[0] + np.sqrt(var[0]) * nodes[:, None]
    away = at**2 / (1 + at**2) / 2.5
    for l, share in ((0, 1 - away), (1, away)):
        share = share * weights[:, None]
        mass, first, spread = mixed(share, at, 0.0)
        chance = np.stack([mass, np.full(3, chain_now()[1, l])]) * prob
        wanted = mixed(chance, np.stack([first, mean[1]]), np.stack([spread, var[1]]))
        for part, value in zip(found, wanted, strict=True):
            assert_allclose(part[l], value, rtol=1e-9)


def test_an_indicator_that_changes_with_time_alone():
    """Its probabilities at the time of the measurement, beside a sensor of that time."""
    rule, tell = Taylor(), 0.5 / (1 + t)
    rules = SwitchingRules(system(indicator=[[tell, 1 - tell], [0.9, 0.1]]), rule)
    assert rules.split is False
    law = before(3)
    ahead = ModeLaw(*(part[..., None, :] for part in law))
    chances = np.array([[0.2, 0.8], [0.9, 0.1]])
    for shown in (0, 1, -1):
        found = rules.sense(NOW, ahead, np.full(3, shown))
        wanted = law.prob * (chances[:, shown, None] if shown >= 0 else 1.0)
        assert_allclose(found.prob, wanted, rtol=1e-12)
        assert_allclose(found.moments.mean[0], [law.mean[0, 0] + NOW, 2 * law.mean[0, 1]])
        spread = [law.cov[0, 0, 0] + 0.25, 4 * law.cov[0, 0, 1] + 1]
        assert_allclose(found.moments.cov[0, 0], spread, rtol=1e-12)
        assert_allclose(found.moments.cross[0, 0], [law.cov[0, 0, 0], 2 * law.cov[0, 0, 1]])


def test_parts_of_a_forecast_are_those_of_the_indicator_there():
    """A probability of the next state, by nodes of the state and of the noise."""
    seen = 1 / (2 + x**2)
    rules = SwitchingRules(system(indicator=[[seen, 1 - seen], [0.5, 0.5]]), GaussHermite(5))
    assert rules.split is True
    nodes, weights = np.polynomial.hermite_e.hermegauss(5)
    weights = weights / weights.sum()
    law = before()
    found = rules.predict(NOW, law)
    assert found.log_prob.shape == (2, 2)
    both = np.outer(weights, weights)
    parts = []
    for i in range(2):
        at = law.mean[0, i] + np.sqrt(law.cov[0, 0, i]) * nodes
        parts.append(SLOPES[i] * at[:, None] + PUSHES[i] + np.sqrt(NOISES[i]) * nodes)
    for l, g in np.ndindex(2, 2):
        tell = [1 / (2 + at**2) if l == 0 else np.full_like(at, 0.5) for at in parts]
        tell = [1 - each if g else each for each in tell]
        mass = np.concatenate([
            (law.prob[i] * chain_now()[i, l] * both * tell[i]).ravel() for i in range(2)
        ])  # fmt: skip
        wanted = mixed(mass, np.concatenate([at.ravel() for at in parts]), 0.0)
        for part, value in zip(told(found), wanted, strict=True):
            assert_allclose(part[l, g], value, rtol=1e-9)


def test_indicators_that_cannot_split_a_forecast():
    """The forecast is told the time, and the input, of the step before."""
    u = Input("u")
    for tell, message in (
        (1 / (2 + x**2 + t), "split: an indicator whose probability depends on state and time"),
        (1 / (2 + x**2 + u**2), "split: an indicator whose probability depends on an input"),
    ):
        moving = system(indicator=[[tell, 1 - tell], [0.5, 0.5]])
        with pytest.raises(ValueError, match=f"^{message} cannot split"):
            SwitchingFilter(moving, GaussHermite(3))
        assert SwitchingFilter(moving, GaussHermite(3), split=False).rules.split is False


def test_array_functions_whose_probability_changes_with_time_cannot_split_a_forecast():
    """They would be asked at the time that the step leaves."""

    def shown(more):
        return [
            StochasticMap.from_functions(
                1, 1, lambda t, x, w: x + w, Noise((w,)),
                weight=lambda t, x, w, k=k: abs(k - 1 / (2 + x[0] ** 2 + more(t))),
            )
            for k in (0, 1)
        ]  # fmt: skip

    move = StochasticMap((x,), [x / 2 + v], Noise((v,)), sympy.Integer(1))
    still, *moving = (
        SwitchingSystem.from_maps([[move]], [shown(more)], [(1, [0.3], [[1.0]])], indicator=True)
        for more in (lambda t: 0.0, lambda t: 1e-9 * t, lambda t: (0.0, 1.0)[int(t)])
    )
    assert SwitchingFilter(still, GaussHermite(3)).rules.split is True
    for system in moving:
        with pytest.raises(ValueError, match=r"^split: .* depends on state and time cannot split"):
            SwitchingFilter(system, GaussHermite(3))
        assert SwitchingFilter(system, GaussHermite(3), split=False).rules.split is False


def test_moves_of_array_functions_split_a_forecast_alike():
    """As written out; what cannot be a formula is a function."""
    even, tell = Noise((v,)), 1 / (2 + x**2)
    shows = [StochasticMap((x,), [x + w], Noise((w,)), share) for share in (tell, 1 - tell)]
    start = [(1, [0.3], [[1.0]])]
    written = StochasticMap((x,), [x / 2 + v], even, sympy.Integer(1))
    plain = StochasticMap.from_functions(
        1, 1, lambda t, x, v: x / 2 + v, even, weight=lambda t, x, v: np.ones(x.shape[1:])
    )
    shown = [
        StochasticMap.from_functions(1, 1, lambda t, x, w: x + w, Noise((w,)),
                                     weight=lambda t, x, w, k=k: abs(k - 1 / (2 + x[0] ** 2)))
        for k in (0, 1)
    ]  # fmt: skip
    laws = [
        SwitchingRules(
            SwitchingSystem.from_maps([[move]], [readings], start, indicator=True), GaussHermite(5)
        ).predict(0.0, ModeLaw(np.zeros((1, 2)), np.array([[[0.3, -1.0]]]), np.ones((1, 1, 1, 2))))
        for move, readings in ((written, shows), (plain, shown))
    ]
    for one, two in zip(*laws, strict=True):
        assert one.shape[-3:] == two.shape[-3:]
        assert_allclose(one, two, rtol=1e-11, atol=1e-12)
