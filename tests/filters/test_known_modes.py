"""The filter with known modes where switch or indicator depend on the state.

Jump-linear systems, with inputs and gaps, are in test_filter.py and test_smoothing.py.
"""

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib.filters import KnownModeFilter
from seedslib.linearization import GaussHermite, Taylor
from seedslib.models import Noise, SwitchingSystem

x, v, w = sympy.symbols("x v w", real=True)
t = sympy.Symbol("t")
NODES = np.linspace(-10.0, 10.0, 2001)
PUSH = np.linspace(-5.0, 5.0, 101)
START = [(0.6, 0.0, 1.0), (0.4, 0.5, 0.5)]


def chance(m=np):
    """Probability of mode 1 next, from each mode, as functions of time and state."""
    return [
        lambda t, x: 0.2 + 0.6 * m.exp(-((x - t / 4) ** 2) / 4),
        lambda t, x: 0.3 + 0.4 / (1 + x**2),
    ]


def system(drives):
    moves = [[x / 2 + sympy.sin(x) + v / 2], [0.6 * x - 1 + v]]
    up = [f(t, x) for f in chance(sympy)]
    tell = [[0.5 * sympy.exp(-(x**2)), 1 - 0.5 * sympy.exp(-(x**2))], [0.3, 0.7]]
    return SwitchingSystem(
        (x,),
        moves,
        Noise((v,)),
        [[1 - p, p] for p in up],
        [[x + w], [x + 2 + w / 2]],
        Noise((w,)),
        [(p, [m], [[c]]) for p, m, c in START],
        indicator=tell,
        drives=drives,
    )


def moments(weight, *parts):
    """Mean and covariance of some quantities under a weight."""
    weight = (weight / weight.sum()).ravel()
    parts = np.stack([np.broadcast_to(part, weight.shape) for part in parts])
    mean = parts @ weight
    apart = parts - mean[:, None]
    return mean, (apart * weight) @ apart.T


@pytest.mark.parametrize("drives", ["old", "new"])
def test_switch_and_indicator_that_are_seen_tell_of_the_state(drives):
    """Moments in the branch that was taken, by sums."""
    filter = KnownModeFilter(system(drives), GaussHermite(25))
    old, new = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
    y, shown = np.zeros((2, 1, 4)), np.array([[-1] * 4, [0, 0, 1, -1]])
    y[0], y[1] = np.nan, np.array([[0.4, 1.5, -0.3, 1.0]])
    times = [2.0, 3.0]
    given = {"modes": np.stack([old, new]), "indicators": shown}
    estimates = filter.run(times, y, **given)
    state = filter.predict(filter.initial((4,), mode=old), 2.0)
    later = filter.predict(filter.correct(state, y[0], shown[0]), 3.0, new)
    for i, (a, b) in enumerate(zip(old, new, strict=True)):
        weight = norm.pdf(NODES, START[a][1], np.sqrt(START[a][2]))
        up = chance()[a](2.0, NODES)
        weight = weight * (up if b else 1 - up)
        before, noise = np.repeat(NODES, 101), np.tile(PUSH, 2001)
        moved = [before / 2 + np.sin(before) + noise / 2, 0.6 * before - 1 + noise]
        moved = moved[b if drives == "new" else a]
        if drives == "new":  # the filter moves a Gaussian distribution
            (m,), ((p,),) = moments(weight, NODES)
            weight = norm.pdf(NODES, m, np.sqrt(p))
        mean, cov = moments(np.outer(weight, norm.pdf(PUSH)), before, moved)
        assert later.mean[0, i] == pytest.approx(mean[1], rel=1e-4)
        assert later.cov[0, 0, i] == pytest.approx(cov[1, 1], rel=1e-3)
        # the indicator weights the distribution of the new state
        m, p = later.mean[0, i], later.cov[0, 0, i]
        if shown[1, i] >= 0 and b == 0:
            dist = norm.pdf(NODES, m, np.sqrt(p))
            told = 0.5 * np.exp(-(NODES**2))
            (m,), ((p,),) = moments(dist * (told if shown[1, i] == 0 else 1 - told), NODES)
        spread = p + (1.0, 0.25)[b]
        error = y[1, 0, i] - m - 2 * b
        assert estimates.mean[1, 0, i] == pytest.approx(m + p / spread * error, rel=1e-3)
        assert estimates.cov[1, 0, 0, i] == pytest.approx(p - p**2 / spread, rel=1e-3)
        assert estimates.loglik[1, i] == pytest.approx(
            norm.logpdf(error, 0, np.sqrt(spread)), abs=1e-3
        )


def test_modes_are_reported_with_certainty():
    modes = np.array([[0, 1], [1, 1], [0, 0]])
    filter = KnownModeFilter(system("old"), Taylor())
    y, shown = np.zeros((3, 1, 2)), np.full((3, 2), -1)
    estimates = filter.run(range(3), y, modes=modes, indicators=shown)
    np.testing.assert_array_equal(estimates.modes, modes)
    np.testing.assert_array_equal(estimates.mode_prob[:, 1], modes)
    np.testing.assert_array_equal(estimates.mode_prob[:, 0], 1 - modes)
    state = filter.initial((2,), mode=modes[0])
    np.testing.assert_array_equal(filter.report(state).mode_prob, [[1, 0], [0, 1]])
    np.testing.assert_array_equal(state.mean[0], [0.0, 0.5])
    assert filter.initial((3,)).mode.tolist() == [0, 0, 0]


def test_switch_that_never_happens_is_refused():
    absorbing = SwitchingSystem(
        (x,),
        [[x + v]] * 2,
        Noise((v,)),
        [[1, 0], [0.5, 0.5]],
        [[x + w]] * 2,
        Noise((w,)),
        [(0.5, [0], [[1]])] * 2,
    )
    filter, y = KnownModeFilter(absorbing), np.zeros((3, 1, 2))
    assert np.isfinite(filter.run(range(3), y, modes=[[1, 0], [0, 0], [0, 0]]).mean).all()
    with pytest.raises(ValueError, match=r"^mode: "):
        filter.run(range(3), y, modes=[[0, 0], [0, 1], [0, 1]])
