"""Bearings across the cut at pi: as if there were none."""

import numpy as np
import pytest
import sympy as sp

from seedslib.base.circle import as_periods, nearest, wrapped
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter
from seedslib.filters import (
    CovarianceFilter,
    GridBayesFilter,
    KnownModeFilter,
    ParticleFilter,
    RaoBlackwellFilter,
    cubature_kalman,
    extended_kalman,
    smooth,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, SwitchingSystem

TURN = 2 * np.pi
TIMES = np.arange(21.0)
x, y = sp.symbols("x y", real=True)
w, v = sp.symbols("w1 w2"), sp.symbols("v1 v2")
MOVE = StochasticMap([x, y], [x + 0.01 * w[0], y - 0.2 + 0.01 * w[1]], Noise(w))


def radar(start, **options):
    """A target beside the cut (start -10) or on the other side of the world (start 10)."""
    sign = 1 if start > 0 else -1
    seen = [sp.atan2(y, x) + 0.02 * v[0], sp.sqrt(x**2 + y**2) + 0.1 * v[1]]
    sensor = StochasticMap([x, y], seen, Noise(v), **options)
    return DiscreteSystem(MOVE, sensor, [start, -2.0 * sign], 0.1 * np.eye(2))


@pytest.fixture(scope="module")
def paths():
    """Paths that cross the cut, and what a sensor reports of them."""
    system = radar(-10.0, period={0: TURN})
    sim = system.simulate(TIMES, 300, 1)
    return system, np.asarray(sim.states), np.asarray(sim.measurements)


def test_reports_lie_between_minus_and_plus_half_a_turn(paths):
    angle = paths[2][:, 0]
    assert (np.abs(angle) <= np.pi).all()
    assert (angle > 3).any()
    assert (angle < -3).any()


FILTERS = {
    "extended": extended_kalman,
    "unscented": unscented_kalman,
    "cubature": cubature_kalman,
    "Gauss-Hermite": lambda s: CovarianceFilter(s, GaussHermite(3)),
    "particles": lambda s: ParticleFilter(s, 2000),
}


@pytest.mark.parametrize("name", FILTERS)
def test_the_cut_is_not_noticed(paths, name):
    system, states, measured = paths
    error = FILTERS[name](system).run(TIMES, measured).mean - states
    # the same world turned by half a turn, so that its cut is far away
    away = radar(10.0)
    turned = measured.copy()
    turned[:, 0] = np.where(measured[:, 0] > 0, measured[:, 0] - np.pi, measured[:, 0] + np.pi)
    assert np.sqrt((error[-1] ** 2).mean()) < 0.15
    if name != "particles":
        moves = DiscreteSystem(
            StochasticMap([x, y], [x + 0.01 * w[0], y + 0.2 + 0.01 * w[1]], Noise(w)),
            away.sensor, away.mean0, away.cov0,
        )  # fmt: skip
        mirrored = FILTERS[name](moves).run(TIMES, turned).mean
        assert np.allclose(-mirrored, error + states, atol=1e-9)


def test_without_a_period_the_filter_is_thrown_off(paths):
    _, states, measured = paths
    error = extended_kalman(radar(-10.0)).run(TIMES, measured).mean - states
    assert np.sqrt((error[-1] ** 2).mean()) > 0.5


def test_smoothing_gains_across_the_cut(paths):
    system, states, measured = paths
    filter = unscented_kalman(system)
    one, two = filter.run(TIMES, measured), smooth(filter, TIMES, measured)
    errors = [((part.mean - states)[1:-1] ** 2).mean() for part in (one, two)]
    assert errors[1] < errors[0]


def test_a_designed_filter_and_its_memory(paths):
    system, states, measured = paths
    filter = synthesize(system, Memory(1, 1), Taylor(), TIMES, paths=4000, seed=1)
    error = filter.run(TIMES, measured).mean - states
    plain = extended_kalman(system).run(TIMES, measured).mean - states
    assert np.sqrt((error[-1] ** 2).mean()) < 1.1 * np.sqrt((plain[-1] ** 2).mean())


def test_density_is_that_of_the_nearest_turn():
    system = radar(-10.0, period={0: TURN})
    place = np.array([[-10.0], [0.01]])
    at = np.array([[np.pi - 0.02], [10.0]])
    one = system.sensor.log_density(0.0, at, place)
    two = system.sensor.log_density(0.0, at - np.array([[TURN], [0.0]]), place)
    assert one == pytest.approx(two)
    assert one[0] > 0


def test_nearest_and_wrapped():
    turns = as_periods("period", {1: 1.0}, 2)
    near = nearest(np.array([5.0, 0.2]), np.array([0.0, 7.9]), turns)
    assert near == pytest.approx([5.0, 8.2])
    assert np.isnan(nearest(np.array([1.0, np.nan]), np.zeros(2), turns)[1])
    assert wrapped(np.array([3.0, 2.7]), turns) == pytest.approx([3.0, -0.3])


@pytest.mark.parametrize(
    ("period", "message"),
    [({2: 1.0}, "period: wanted components from 0 to 1, got 2"), ({0: 0.0}, "positive period")],
)
def test_what_is_no_circle_is_refused(period, message):
    with pytest.raises(ValueError, match=message):
        radar(-10.0, period=period)


def test_a_mask_is_a_gap_on_a_circle_too(paths):
    filter = extended_kalman(paths[0])
    state = filter.predict(filter.initial(), 0.0)
    masked = filter.correct(state, np.ma.masked_array([3.0, 10.0], [True, False]))
    missing = filter.correct(state, [np.nan, 10.0])
    assert np.array_equal(masked.mean, missing.mean)


def test_filters_of_switching_systems_go_round():
    """Angles near the cut, and the same world turned so that its cut is far away."""
    a, b, c = sp.symbols("a b c", real=True)

    def filters(turn, period):
        see = [[StochasticMap([a], [a + turn + 0.1 * c], Noise((c,)), period=period)]] * 2
        moves = [
            [StochasticMap([a], [a + drift + 0.1 * b], Noise((b,)), odd) for odd in odds]
            for drift, odds in ((0.05, (0.9, 0.1)), (-0.05, (0.1, 0.9)))
        ]
        system = SwitchingSystem.from_maps(moves, see, [(0.5, [3.1], [[0.1]])] * 2)
        return (
            KnownModeFilter(system, Taylor()), RaoBlackwellFilter(system, 30),
            SwitchingFilter(system, Taylor()), GridBayesFilter(system, (1.0, 5.0, 81)),
        )  # fmt: skip

    shown = 3.1 + 0.2 * np.sin(np.arange(6.0))[:, None]
    report = np.where(shown > np.pi, shown - TURN, shown)
    assert (report < 0).any()
    for near, away in zip(filters(0.0, {0: TURN}), filters(-3.0, None), strict=True):
        options = {"modes": np.zeros(6, int)} if "modes" in near.takes else {}
        one = near.run(np.arange(6.0), report, **options)
        two = away.run(np.arange(6.0), shown - 3.0, **options)
        assert np.allclose(one.mean, two.mean, atol=1e-9), near
        assert np.allclose(one.loglik, two.loglik, atol=1e-9), near
