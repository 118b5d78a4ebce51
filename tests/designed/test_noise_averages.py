"""Corollaries 1 and 2 of the switching paper: averages at a fixed state, (6.24) and (6.28)."""

import numpy as np
import pytest
import sympy

from seedslib.designed.switching.lemmas import ModeLaw
from seedslib.designed.switching.rules import SwitchingRules
from seedslib.linearization import ExactGaussian
from seedslib.models import Noise, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)
PUSH, SHIFT = 0.4, -0.3
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(60)
WEIGHTS = WEIGHTS / WEIGHTS.sum()


def bump(x, centre, low, high):
    """Low plus high times a bell about the centre, of numbers or symbols."""
    square = -((x - centre) ** 2) / 2
    return low + high * (sympy.exp(square) if isinstance(x, sympy.Expr) else np.exp(square))


LEAVE = ((0.5, 0.1, 0.6), (-0.5, 0.2, 0.5))
TOLD = ((0.0, 0.1, 0.7), (1.0, 0.3, 0.4))
SYSTEM = SwitchingSystem(
    (x,), [[0.8 * x + 0.5 * v], [0.3 * x + 1 - v]], Noise((v,), mean=PUSH, cov=[[0.7]]),
    [[1 - bump(x, *LEAVE[0]), bump(x, *LEAVE[0])], [bump(x, *LEAVE[1]), 1 - bump(x, *LEAVE[1])]],
    [[x + 2 * w], [x**2 - w]], Noise((w,), mean=SHIFT, cov=[[0.6]]),
    [(0.5, [0], [[1]])] * 2, indicator=[[1 - bump(x, *TOLD[i]), bump(x, *TOLD[i])] for i in (0, 1)],
)  # fmt: skip
AT = np.array([-0.8, 0.3, 1.7])


@pytest.fixture(scope="module")
def rules():
    return SwitchingRules(SYSTEM, ExactGaussian())


def known(mode, states):
    """Law of a known mode and state, on a batch of states."""
    prob = np.zeros((2, len(states)))
    prob[mode] = 1.0
    mean = np.broadcast_to(states, (1, 2, len(states))).copy()
    return ModeLaw(np.log(np.maximum(prob, 1e-300)), mean, np.full((1, 1, 2, len(states)), 1e-12))


def test_forecast_from_a_known_state(rules):
    """(6.28): A(x) E B(a), A(x) E[a B(a)], A(x) E[aa' B(a)], for every next mode and indicator."""
    noise = PUSH + np.sqrt(0.7) * NODES
    for i, move in enumerate((lambda s, n: 0.8 * s + 0.5 * n, lambda s, n: 0.3 * s + 1 - n)):
        law = rules.predict(0.0, known(i, AT))
        away = bump(AT, *LEAVE[i])
        there = move(AT, noise[:, None])
        for l in (0, 1):
            switch = away if l != i else 1 - away
            for f in (0, 1):
                share = bump(there, *TOLD[l])
                share = share if f else 1 - share
                zero, one, two = (switch * (WEIGHTS @ (share * there**p)) for p in (0, 1, 2))
                prob = np.exp(law.log_prob[l, f])
                mean, cov = law.mean[0, l, f], law.cov[0, 0, l, f]
                np.testing.assert_allclose(prob, zero, rtol=1e-6)
                np.testing.assert_allclose(prob * mean, one, rtol=1e-6, atol=1e-7)
                np.testing.assert_allclose(prob * (cov + mean**2), two, rtol=1e-6)


def test_measurement_of_a_known_state(rules):
    """(6.24): nu = B(x) E b and H = B(x) E bb'."""
    noise = SHIFT + np.sqrt(0.6) * NODES
    for i, sensor in enumerate((lambda s, n: s + 2 * n, lambda s, n: s**2 - n)):
        start = known(i, AT)
        law = ModeLaw(start.log_prob[:, None], start.mean[:, :, None], start.cov[:, :, :, None])
        for j in (0, 1):
            seen = rules.sense(0.0, law, np.full(len(AT), j))
            share = bump(AT, *TOLD[i])
            share = share if j else 1 - share
            prob, value = np.exp(seen.log_prob[i]), sensor(AT, noise[:, None])
            np.testing.assert_allclose(prob, share, rtol=1e-6)
            mean, cov = seen.moments.mean[0, i], seen.moments.cov[0, 0, i]
            np.testing.assert_allclose(prob * mean, share * (WEIGHTS @ value), rtol=1e-6)
            np.testing.assert_allclose(
                prob * (cov + mean**2), share * (WEIGHTS @ value**2), rtol=1e-6
            )
