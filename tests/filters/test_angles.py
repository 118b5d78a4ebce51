"""Angles across the cut of the circle: as if there were none."""

import numpy as np
import pytest
import sympy as sp

from seedslib.filters import (
    GridBayesFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    cubature_kalman,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.models import (
    DiscreteSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
)

TURN = 2 * np.pi
TIMES = 2.0 + np.arange(16.0)
a, rate, c = sp.symbols("a rate c", real=True)
v, w = sp.symbols("v1 v2", real=True), sp.symbols("w1 w2", real=True)


def walk(period):
    """An angle that turns, beside a second measurement that is no angle."""
    noise = Noise(v, cov=[[0.05, 0], [0, 0.01]])
    around = {0: TURN} if period else None
    dynamics = StochasticMap((a, rate), [a + rate + v[0], rate + v[1]], noise, period=around)
    shown = [a + 0.3 * w[0], rate + 0.2 * w[1]]
    sensor = StochasticMap((a, rate), shown, Noise(w), period=around)
    return DiscreteSystem(dynamics, sensor, [3, 0.3], 0.1 * np.eye(2))


@pytest.fixture(scope="module")
def records():
    """With gaps, on the line and on the circle."""
    y = np.array(walk(False).simulate(TIMES, 5, 1).measurements)
    y[7:9], y[3, 0], y[11, 1, 2:] = np.nan, np.nan, np.nan
    angles = y.copy()
    angles[:, 0] = np.angle(np.exp(1j * y[:, 0]))
    assert np.nanmax(y[:, 0]) > TURN
    return y, angles


def same_but_for_turns(one, two):
    turns = (one.mean[:, 0] - two.mean[:, 0]) / TURN
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-11)
    np.testing.assert_allclose(one.mean[:, 1], two.mean[:, 1], atol=1e-11)
    np.testing.assert_allclose(one.cov, two.cov, atol=1e-11)
    np.testing.assert_allclose(one.loglik, two.loglik, atol=1e-10)


@pytest.mark.parametrize("make", [extended_kalman, unscented_kalman, cubature_kalman])
def test_filtering_and_smoothing_of_angles_equal_those_on_the_line(records, make):
    for y in (records, tuple(part[..., 0] for part in records)):
        line, circle = make(walk(False)), make(walk(True))
        same_but_for_turns(line.run(TIMES, y[0]), circle.run(TIMES, y[1]))
        same_but_for_turns(smooth(line, TIMES, y[0]), smooth(circle, TIMES, y[1]))


def test_particles_of_angles_equal_those_on_the_line(records):
    runs = 20
    line, circle = (np.repeat(part[:6, :, :1], runs, axis=-1) for part in records)
    times, means = TIMES[:6], []
    for period, y in ((False, line), (True, circle)):
        filter = ParticleFilter(walk(period), 400)
        found = filter.run(times, y, seed=1)
        assert (found.cov[:, 0, 0] < 0.3).all()
        means.append(found.mean[:, 0])
    one, two = means
    assert np.abs(two).max() <= np.pi
    gap = np.angle(np.exp(1j * (one - two)))
    error = gap.std(axis=-1, ddof=1) / np.sqrt(runs)
    assert (np.abs(gap.mean(axis=-1)) < 4.5 * error + 1e-3).all()
    assert np.abs(gap).max() < 0.3


def test_filters_of_modes_with_angles_equal_those_of_a_turned_world():
    """Angles near the cut, and the same world turned so that its cut is far away."""

    def filters(turn, period):
        noise = Noise((w[0],))
        see = [StochasticMap([a], [a + turn + w[0] / 10], noise, period=period)] * 2
        moves = [
            StochasticMap([a], [a + drift + v[0] / 10], Noise((v[0],))) for drift in (0.05, -0.05)
        ]
        switching, start = [[0.9, 0.1], [0.1, 0.9]], [(0.5, [3.1], [[0.1]])] * 2
        system = SwitchingSystem.from_maps(moves, switching, see, start)
        yield KnownModeFilter(system)
        yield RaoBlackwellFilter(system, 30)
        yield GridBayesFilter(system, (1.0, 5.0, 81))

    y = 3.1 + 0.2 * np.sin(np.arange(6.0))[:, None]
    angles = np.where(y > np.pi, y - TURN, y)
    assert (angles < 0).any()
    for near, away in zip(filters(0.0, {0: TURN}), filters(-3.0, None), strict=True):
        options = {"modes": np.zeros(6, int)} if "modes" in near.takes else {}
        one = near.run(np.arange(6.0), angles, **options)
        two = away.run(np.arange(6.0), y - 3.0, **options)
        np.testing.assert_allclose(one.mean, two.mean, atol=1e-9)
        np.testing.assert_allclose(one.loglik, two.loglik, atol=1e-9)
