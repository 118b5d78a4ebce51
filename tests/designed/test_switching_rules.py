"""Steps of a switching filter where the state moves the modes, the indicator or the noise."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose

from seedslib.designed import SwitchingRules, lemmas
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import Noise, SwitchingSystem

x, y, v, w = sympy.symbols("x y v w", real=True)
t = sympy.Symbol("t")
ModeDistribution = lemmas.ModeDistribution
NOW = 1.5
LEAVE = 1 / (2 + t)
MOVES = [[0.9 * x + t + 0.3 * v], [(0.5 - t / 10) * x + 0.8 * v]]
SLOPES, PUSHES, NOISES = (0.9, 0.35), (1.5, 0.0), (0.09, 0.64)
CHAIN_NOW = np.array([[1 - 1 / 3.5, 1 / 3.5], [0.3, 0.7]])
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
WEIGHTS = WEIGHTS / WEIGHTS.sum()


def system(chain=None, **options):
    return SwitchingSystem(
        (x,),
        MOVES,
        Noise((v,)),
        chain or [[1 - LEAVE, LEAVE], [0.3, 0.7]],
        [[x + t + 0.5 * w], [2 * x - 1 + (1 + x / 2) * w]],
        Noise((w,)),
        [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])],
        time=t,
        **options,
    )


def dist(*batch):
    rng = np.random.default_rng(4)
    prob = rng.uniform(0.2, 0.8, batch)
    prob = np.stack([prob, 1 - prob])
    return ModeDistribution.of(
        prob, rng.normal(size=(1, 2, *batch)), rng.uniform(0.3, 2, (1, 1, 2, *batch))
    )


def mixed(weights, means, variances):
    """Along the first axis."""
    share = weights / weights.sum(axis=0)
    mean = (share * means).sum(axis=0)
    return weights.sum(axis=0), mean, (share * (variances + (means - mean) ** 2)).sum(axis=0)


def parts(dist):
    return dist.prob, dist.mean[0], dist.cov[0, 0]


def test_state_that_moves_the_mode_before_the_new_mode_moves_the_state():
    """Moments of the state weighed by the chance of each switch, at its time; then the move."""
    far = x**2 / (1 + x**2) / (1 + t)
    rules = SwitchingRules(system([[1 - far, far], [0.3, 0.7]], drives="new"), GaussHermite(5))
    before = dist(3)
    prob, mean, var = parts(before)
    switched, found = parts(rules.switched(NOW, before)), parts(rules.predict(NOW, before))
    place = mean[0] + np.sqrt(var[0]) * NODES[:, None]
    away = place**2 / (1 + place**2) / 2.5
    for l, share in ((0, 1 - away), (1, away)):
        mass, first, spread = mixed(share * WEIGHTS[:, None], place, 0.0)
        chance = np.stack([mass, np.full(3, CHAIN_NOW[1, l])]) * prob
        wanted = mixed(chance, np.stack([first, mean[1]]), np.stack([spread, var[1]]))
        for part, value in zip(switched, wanted, strict=True):
            assert_allclose(part[l], value, rtol=1e-9)
        moved = wanted[0], SLOPES[l] * wanted[1] + PUSHES[l], SLOPES[l] ** 2 * wanted[2] + NOISES[l]
        for part, value in zip(found, moved, strict=True):
            assert_allclose(part[l, 0], value, rtol=1e-9)
    old = SwitchingRules(system(), Taylor())
    assert old.switch is None
    assert old.switched(NOW, before) is before


@pytest.mark.parametrize("batch", [(), (3,)])
def test_forecast_is_split_by_the_indicator_that_will_be_seen(batch):
    """A probability of the next state, by nodes of the state and of the noise."""
    seen = 1 / (2 + x**2)
    rules = SwitchingRules(system(indicator=[[seen, 1 - seen], [0.5, 0.5]]), GaussHermite(5))
    assert rules.split is True
    before = dist(*batch)
    found = rules.predict(NOW, before)
    assert found.log_prob.shape == (2, 2, *batch)
    for path in np.ndindex(*batch):
        inside = []
        for i in range(2):
            place = before.mean[(0, i, *path)] + np.sqrt(before.cov[(0, 0, i, *path)]) * NODES
            inside.append(SLOPES[i] * place[:, None] + PUSHES[i] + np.sqrt(NOISES[i]) * NODES)
        for l, g in np.ndindex(2, 2):
            tell = [1 / (2 + at**2) if l == 0 else np.full_like(at, 0.5) for at in inside]
            mass = [
                before.prob[(i, *path)]
                * CHAIN_NOW[i, l]
                * np.outer(WEIGHTS, WEIGHTS)
                * (1 - tell[i] if g else tell[i])
                for i in range(2)
            ]
            wanted = mixed(np.ravel(mass), np.ravel(inside), 0.0)
            for part, value in zip(parts(found), wanted, strict=True):
                assert_allclose(part[(l, g, *path)], value, rtol=1e-9)
    # without formulas for a part there is one
    whole = SwitchingRules(rules.system, Taylor())
    assert whole.split is False
    assert whole.predict(NOW, before).prob.shape == (2, 1, *batch)


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian(), GaussHermite(3)])
def test_noise_that_depends_on_the_state_and_an_indicator_of_time(rule):
    """The sensor and the chances of the indicator at the time of the measurement."""
    told = 0.5 / (1 + t)
    rules = SwitchingRules(system(indicator=[[told, 1 - told], [0.9, 0.1]]), rule)
    assert rules.split is False
    before = dist(3)
    ahead = ModeDistribution(*(part[..., None, :] for part in before))
    prob, mean, var = parts(before)
    chances = np.array([[0.2, 0.8, 1.0], [0.9, 0.1, 1.0]])
    noise = (1 + mean[1] / 2) ** 2 + (0 if rule == Taylor() else var[1] / 4)
    for shown in (0, 1, -1):
        found = rules.sense(NOW, ahead, np.full(3, shown))
        assert_allclose(found.prob, prob * chances[:, shown, None], rtol=1e-12)
        assert_allclose(found.moments.mean[0], [mean[0] + NOW, 2 * mean[1] - 1], rtol=1e-12)
        spread = [var[0] + 0.25, 4 * var[1] + noise]
        assert_allclose(found.moments.cov[0, 0], spread, rtol=1e-12)
        assert_allclose(found.moments.cross[0, 0], [var[0], 2 * var[1]], rtol=1e-12)
    # beside a wide distribution the noise of a known state is what is left
    wide = ahead._replace(cov=np.full((1, 1, 2, 1, 3), 1e14))
    state = rules.start((3,))._replace(index=0, time=NOW, dist=wide)
    y = np.array([[0.4, -1.0, 7.0]])
    after = rules.correct(state, y, None, None).dist
    expected = 0.25, (1 + before.mean[0, 1] / 2) ** 2 / 4
    assert_allclose(after.cov[0, 0, 0], expected[0], rtol=1e-6)
    if rule == Taylor():
        assert_allclose(after.cov[0, 0, 1], expected[1], rtol=1e-6)


def test_rules_of_points_mend_probabilities_and_variances():
    """Negative weights may leave a sum that is not one and a variance below zero; it is counted."""
    record = np.array([[0.4, -2.0, np.nan]])
    rules = SwitchingRules(system(), GaussHermite(3))
    state = rules.start((3,))._replace(index=0, time=0.0)
    whole = rules.correct(state, record, None, None)
    scaled = state.dist.log_prob + np.array([0.5, -0.7, 0.2])
    found = rules.correct(
        state._replace(dist=state.dist._replace(log_prob=scaled)), record, None, None
    )
    assert_allclose(found.dist.prob, whole.dist.prob, rtol=1e-12)
    assert_allclose(found.loglik, whole.loglik, atol=1e-12)
    assert found.repaired == whole.repaired == 0
    bad, tiny = state.dist.cov.copy(), state.dist.cov.copy()
    bad[0, 0, 1, 0, 0], tiny[0, 0, 1, 0, 0] = -0.2, 1e-14
    found, wanted = (
        rules.correct(
            state._replace(dist=state.dist._replace(cov=cov), repaired=5), record, None, None
        )
        for cov in (bad, tiny)
    )
    assert found.repaired == 6
    assert wanted.repaired == 5
    assert_allclose(found.mean, wanted.mean, rtol=1e-9)
