"""Backward simulation against exact smoothers: of Kalman, on grids, of all histories of modes."""

from itertools import pairwise, product

import numpy as np
import pytest
import sympy as sp
from scipy.stats import norm

from seedslib.filters import KalmanFilter, ParticleFilter, draw_trajectories, smooth
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    LinearSystem,
    Noise,
    StochasticMap,
    SwitchingSystem,
)

MOVE, NOISE = [[0.9, 0.3], [-0.2, 0.8]], [[0.3, 0.1], [0.1, 0.2]]
TIMES = np.arange(6.0)
RUNS = 20


@pytest.fixture(scope="module")
def linear():
    system = LinearSystem(MOVE, NOISE, [[1, 0]], [[0.4]], [1, 0], [[1, 0.2], [0.2, 0.5]])
    y = np.array(system.simulate(TIMES, 1, 0).measurements)[..., 0]
    y[2] = np.nan
    return system, np.repeat(y[..., None], RUNS, axis=-1)


def within(found, exact, count=4.5):
    """Independent runs, last axis, have the exact mean within so many of its standard errors."""
    error = found.std(axis=-1, ddof=1) / np.sqrt(found.shape[-1])
    return (np.abs(found.mean(axis=-1) - exact) < count * error + 1e-3).all()


@pytest.mark.parametrize("lag", [None, 1])
def test_of_a_linear_system_it_is_the_smoother_of_rauch(linear, lag):
    system, y = linear
    found = smooth(ParticleFilter(system, 300), TIMES, y, trajectories=150, lag=lag, seed=3)
    exact = smooth(KalmanFilter(system), TIMES, y[..., 0], lag=lag)
    assert within(found.mean, exact.mean)
    assert within(found.cov, exact.cov * 149 / 150, count=6)
    plain = ParticleFilter(system, 300).run(TIMES, y, seed=3)
    assert np.array_equal(found.loglik, plain.loglik)
    assert not within(plain.mean[:3], exact.mean[:3])


def test_neighbouring_times_of_trajectories_belong_together(linear):
    """Their covariance over one step is that of the joint law, G P' of the smoother."""
    system, y = linear
    x = draw_trajectories(ParticleFilter(system, 300), TIMES, y, 150, seed=5)
    apart = x - x.mean(axis=2, keepdims=True)
    across = np.einsum("kitb,kjtb->kijb", apart[:-1], apart[1:]) / 149
    whole = np.block([[np.linalg.matrix_power(MOVE, max(i - j, 0)) * (i >= j) for j in range(6)]
                      for i in range(6)])  # fmt: skip
    spread = np.kron(np.eye(6), NOISE)
    spread[:2, :2] = system.cov0
    cov = whole @ spread @ whole.T
    seen = 2 * np.flatnonzero(np.isfinite(y[:, 0, 0]))
    square = cov[np.ix_(seen, seen)] + 0.4 * np.eye(len(seen))
    cov = cov - cov[:, seen] @ np.linalg.solve(square, cov[seen])
    wanted = [cov[2 * k : 2 * k + 2, 2 * k + 2 : 2 * k + 4] for k in range(5)]
    assert within(across, np.array(wanted), count=6)


def test_trajectory_i_of_a_few_is_trajectory_i_of_many(linear):
    system, y = linear
    filter = ParticleFilter(system, 50)
    many, few = (draw_trajectories(filter, TIMES, y, count, seed=2) for count in (9, 4))
    assert many.shape == (6, 2, 9, RUNS)
    assert np.array_equal(many[:, :, :4], few)
    assert not np.array_equal(few, draw_trajectories(filter, TIMES, y, 4, seed=3))
    found = smooth(filter, TIMES, y, trajectories=9, seed=2)
    assert np.allclose(found.mean, many.mean(axis=2), atol=1e-13)


def test_one_record_has_no_axis_of_records(linear):
    system, y = linear
    filter = ParticleFilter(system, 50)
    one = smooth(filter, TIMES, y[..., 0], trajectories=20, seed=2)
    same = smooth(filter, TIMES, y[..., :1], trajectories=20, seed=2)
    assert one.mean.shape == (6, 2)
    assert one.cov.shape == (6, 2, 2)
    assert np.array_equal(one.mean, same.mean[..., 0])
    assert draw_trajectories(filter, TIMES, y[..., 0], 20, seed=2).shape == (6, 2, 20)


def test_of_a_nonlinear_system_it_is_forward_and_backward_on_a_grid():
    x, v, w = sp.symbols("x v w")
    step = 0.5 * x + 3 * x / (1 + x**2)
    system = DiscreteSystem(
        StochasticMap((x,), [step + 0.7 * v], Noise((v,))),
        StochasticMap((x,), [x**2 / 5 + 0.4 * w], Noise((w,))), [0.5], [[2.0]],
    )  # fmt: skip
    y = np.array(system.simulate(TIMES, 1, 4).measurements)[:, 0, 0]
    grid = np.linspace(-9, 9, 601)
    move = norm.pdf(grid, (0.5 * grid + 3 * grid / (1 + grid**2))[:, None], 0.7)
    like = norm.pdf(y[:, None], grid**2 / 5, 0.4)
    ahead, behind = [norm.pdf(grid, 0.5, np.sqrt(2)) * like[0]], [np.ones_like(grid)]
    for k in range(1, 6):
        ahead.append(ahead[-1] @ move * like[k])
        behind.append(move @ (behind[-1] * like[6 - k]))
    laws = np.array(ahead) * behind[::-1]
    laws /= laws.sum(axis=1, keepdims=True)
    found = draw_trajectories(
        ParticleFilter(system, 400), TIMES, np.tile(y[:, None, None], RUNS), 200, seed=1
    )[:, 0]
    for f in (lambda x: x, np.square, np.sign):
        assert within(f(found).mean(axis=1), laws @ f(grid))


def test_of_a_switching_system_it_is_the_sum_over_histories():
    """A chain seen through the state: the old mode moves the state, and the state switches it."""
    x, v, w = sp.symbols("x v w")
    up = 0.1 + 0.4 * (1 + sp.erf(x / sp.sqrt(2)))
    moves, noises = [(0.9, 0.4), (0.2, -0.6)], (0.5, 0.8)
    system = SwitchingSystem(
        (x,), [[a * x + b + s * v] for (a, b), s in zip(moves, noises, strict=True)], Noise((v,)),
        [[1 - up, up], [1 - up, up]], [[x + 0.6 * w]] * 2, Noise((w,)), [(0.5, [0], [[1]])] * 2,
    )  # fmt: skip
    times = TIMES[:4]
    y = np.array(system.simulate(times, 1, 2).measurements)[:, 0, 0]
    grid = np.linspace(-6, 6, 301)
    one = 0.1 + 0.8 * norm.cdf(grid)
    chance = np.array([1 - one, one])
    go = [norm.pdf(grid, a * grid[:, None] + b, s)
          for (a, b), s in zip(moves, noises, strict=True)]  # fmt: skip
    like = norm.pdf(y[:, None], grid, 0.6)
    prob, mean, total = np.zeros((4, 2)), np.zeros(4), 0.0
    for modes in product(range(2), repeat=4):
        ahead, behind = [0.5 * norm.pdf(grid) * like[0]], [np.ones_like(grid)]
        for k, (i, j) in enumerate(pairwise(modes), start=1):
            ahead.append((ahead[-1] * chance[j]) @ go[i] * like[k])
        for k in range(3, 0, -1):
            behind.append(chance[modes[k]] * (go[modes[k - 1]] @ (behind[-1] * like[k])))
        laws = np.array(ahead) * behind[::-1]
        weight = laws.sum(axis=1)
        total += weight[0]
        prob[range(4), modes] += weight
        mean += laws @ grid
    filter = ParticleFilter(system, 400)
    record = np.tile(y[:, None, None], RUNS)
    found = smooth(filter, times, record, trajectories=200, seed=4)
    assert within(found.mode_prob, prob / total)
    assert within(found.mean[:, 0], mean / total)
    drawn = draw_trajectories(filter, times, record, 200, seed=4)
    assert np.allclose((drawn[:, 1] == 1).mean(axis=1), found.mode_prob[:, 1])


def test_angles_are_averaged_on_the_circle():
    """A walk on the circle across the cut, against the same on the line."""
    x, v, w = sp.symbols("x v w")
    times = TIMES[:5]
    means = []
    for around in (None, {0: 2 * np.pi}):
        system = DiscreteSystem(
            StochasticMap((x,), [x + 0.3 * v], Noise((v,)), period=around),
            StochasticMap((x,), [x + 0.3 * w], Noise((w,)), period=around), [np.pi], [[0.1]],
        )  # fmt: skip
        if around is None:
            y = np.repeat(np.array(system.simulate(times, 1, 3).measurements), RUNS, axis=-1)
        else:
            y = np.angle(np.exp(1j * y))
        filter = ParticleFilter(system, 300)
        for found in (filter.run(times, y, seed=1), smooth(filter, times, y, seed=1)):
            assert (found.cov < 0.2).all()
            means.append(found.mean)
    for line, circle in zip(means[:2], means[2:], strict=True):
        assert np.abs(circle).max() <= np.pi
        gap = np.angle(np.exp(1j * (line - circle)))
        assert within(gap, 0.0)
        assert np.abs(gap).max() < 0.2


def test_systems_without_a_density_of_moves_are_refused():
    x, y, v, w = sp.symbols("x y v w")
    noise, see = Noise((v,)), StochasticMap((x,), [x + w], Noise((w,)))
    jumps = JumpDiffusion((x,), [-x], [[1]], [x + w], Noise((w,)), [0], [[1]])
    with pytest.raises(ValueError, match=r"got a JumpDiffusion, .* smooth with assumed_density"):
        smooth(ParticleFilter(jumps, 10), TIMES, np.zeros((6, 1)))
    curved = DiscreteSystem(StochasticMap((x,), [x + v**2], noise), see, [0], [[1]])
    with pytest.raises(ValueError, match=r"moves with a log-density .* smooth with unscented"):
        smooth(ParticleFilter(curved, 10), TIMES, np.zeros((6, 1)))
    plane = StochasticMap((x, y), [x + w], Noise((w,)))
    still = DiscreteSystem(
        StochasticMap((x, y), [x + y, y + v], noise), plane, [0, 0], [[1, 0], [0, 1]]
    )
    with pytest.raises(ValueError, match="noise moves every direction of the state"):
        smooth(ParticleFilter(still, 10), TIMES, np.zeros((6, 1)))
