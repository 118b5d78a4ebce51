"""Smoothing with a switching filter: all histories of modes, chains, grids, and limits."""

from itertools import pairwise, product

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose

from seedslib.designed import SwitchingFilter
from seedslib.filters import GridBayesFilter, KalmanFilter, smooth
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import LinearSystem, Noise, SwitchingSystem
from seedslib.zoo import manoeuvring_target

MOVES = [np.array([[1, 1], [0, 0.98]]), np.array([[1, 1], [0, 0.7]])]
PUSHES = [np.zeros(2), np.array([0.5, 1.0])]
NOISES = [s**2 * np.outer([0.5, 1.0], [0.5, 1.0]) + 0.01 * np.eye(2) for s in (0.1, 0.6)]
SENSORS, SWITCH, FIRST = [1.0, 2.0], np.array([[0.9, 0.1], [0.2, 0.8]]), [0.7, 0.3]
COV0, TIMES = np.array([[2.0, 0.3], [0.3, 1.0]]), np.arange(7.0)
STATE = sympy.symbols("x1 x2")


def target(switch=SWITCH, alike=False, **options):
    v, w, rows, sees = sympy.symbols("v1 v2"), sympy.Symbol("w"), [], []
    for i in (0, 0) if alike else (0, 1):
        spread = sympy.Matrix(np.linalg.cholesky(NOISES[i])) * sympy.Matrix(v)
        rows.append(
            list(sympy.Matrix(MOVES[i]) * sympy.Matrix(STATE) + sympy.Matrix(PUSHES[i]) + spread)
        )
        sees.append([STATE[0] + np.sqrt(SENSORS[i]) * w])
    initial = [(p, np.zeros(2), COV0) for p in FIRST]
    return SwitchingSystem(
        STATE, rows, Noise(v), switch.tolist(), sees, Noise((w,)), initial, **options
    )


def given_modes(modes, y):
    """Density of a record, and means and covariances given it: one large Gaussian law."""
    count, n = len(y), 2
    mean, cov = np.zeros(count * n), np.zeros((count * n, count * n))
    cov[:n, :n] = COV0
    for k in range(1, count):
        i, now, old = modes[k - 1], slice(k * n, k * n + n), slice(k * n - n, k * n)
        mean[now] = MOVES[i] @ mean[old] + PUSHES[i]
        cov[now, : k * n] = MOVES[i] @ cov[old, : k * n]
        cov[: k * n, now] = cov[now, : k * n].T
        cov[now, now] = MOVES[i] @ cov[old, old] @ MOVES[i].T + NOISES[i]
    seen = np.isfinite(y)
    rows = n * np.flatnonzero(seen)
    square = cov[np.ix_(rows, rows)] + np.diag(np.array(SENSORS)[list(modes)][seen])
    error, gain = y[seen] - mean[rows], np.linalg.solve(square, cov[rows]).T
    density = np.exp(-0.5 * error @ np.linalg.solve(square, error))
    density /= np.sqrt(np.linalg.det(2 * np.pi * square))
    cov = cov - gain @ cov[rows]
    blocks = [cov[k * n : k * n + n, k * n : k * n + n] for k in range(count)]
    return density, (mean + gain @ error).reshape(count, n), np.array(blocks)


def enumerated(y):
    """Probabilities, means and covariances from all histories of modes."""
    count, total = len(y), 0.0
    prob, mean, square = np.zeros((count, 2)), np.zeros((count, 2)), np.zeros((count, 2, 2))
    for modes in product(range(2), repeat=count):
        weight, m, p = given_modes(modes, y)
        weight *= FIRST[modes[0]] * np.prod([SWITCH[i, j] for i, j in pairwise(modes)])
        total += weight
        prob[range(count), modes] += weight
        mean += weight * m
        square += weight * (p + np.einsum("ki,kj->kij", m, m))
    mean /= total
    return prob / total, mean, square / total - np.einsum("ki,kj->kij", mean, mean)


@pytest.fixture(scope="module")
def tracked():
    system = target()
    y = np.array(system.simulate(TIMES, 8, 3).measurements)
    y[2, 0, 1], y[5:, 0, 2] = np.nan, np.nan
    exact = [np.stack(part, axis=-1) for part in zip(*map(enumerated, y[:, 0].T), strict=True)]
    return SwitchingFilter(system, Taylor()), y, exact


def distance(found, exact):
    """Root mean squares: of probabilities, and of means in units of the exact deviation."""
    prob, mean, cov = exact
    scaled = (found.mean - mean) ** 2 / np.einsum("kii...->ki...", cov)
    return np.sqrt(np.mean((found.mode_prob - prob) ** 2)), np.sqrt(np.mean(scaled))


def test_smoother_is_near_the_law_of_all_histories(tracked):
    filter, y, exact = tracked
    found = smooth(filter, TIMES, y)
    prob, mean = distance(found, exact)
    assert prob < 0.02
    assert mean < 0.2
    ratio = np.einsum("kii...->ki...", found.cov) / np.einsum("kii...->ki...", exact[2])
    assert np.abs(np.log(ratio)).mean() < 0.15
    prob, mean = distance(filter.run(TIMES, y), exact)
    assert prob > 0.1
    assert mean > 0.5


def test_times_without_later_measurements_keep_the_law_of_the_filter(tracked):
    filter, y, _ = tracked
    blind = y.copy()
    blind[4:] = np.nan
    one, two = filter.run(TIMES, blind, covariances=True), smooth(filter, TIMES, blind)
    for k in (3, 4, 5, 6):
        for name in ("mode_prob", "mean", "cov"):
            assert_allclose(getattr(one, name)[k], getattr(two, name)[k], atol=1e-12)


def test_fixed_lag_is_the_end_of_shorter_records_and_axes_of_records_are_only_shape(tracked):
    filter, y, _ = tracked
    lagged, whole = smooth(filter, TIMES, y, lag=2), smooth(filter, TIMES, y)
    for k in range(7):
        end = min(k + 3, 7)
        short = smooth(filter, TIMES[:end], y[:end])
        for name in ("mean", "cov", "mode_prob"):
            assert_allclose(getattr(lagged, name)[k], getattr(short, name)[k], atol=1e-12)
    plane, one = smooth(filter, TIMES, y.reshape(7, 1, 2, 4)), smooth(filter, TIMES, y[..., 5])
    for name in ("mean", "cov", "mode_prob", "modes"):
        part = getattr(whole, name)
        assert_allclose(getattr(plane, name).reshape(part.shape), part, atol=1e-13)
        assert_allclose(getattr(one, name), part[..., 5], atol=1e-13)


def test_modes_that_move_alike_are_a_chain_and_a_kalman_smoother(tracked):
    """Only the indicator tells them apart: all histories of the chain, and one linear system."""
    _, y, _ = tracked
    tells = np.array([[0.9, 0.1], [0.2, 0.8]])
    system = target(alike=True, indicator=tells.tolist())
    shown = np.array(system.simulate(TIMES, 8, 5).indicators)
    shown[3, 1] = -1
    found = smooth(SwitchingFilter(system, Taylor()), TIMES, y, indicators=shown)
    exact = LinearSystem(MOVES[0], NOISES[0], [[1, 0]], [[1.0]], np.zeros(2), COV0)
    wanted = smooth(KalmanFilter(exact), TIMES, y)
    assert_allclose(found.mean, wanted.mean, atol=1e-12)
    assert_allclose(found.cov, np.broadcast_to(wanted.cov, found.cov.shape), atol=1e-12)
    for path in range(8):
        total = np.zeros((7, 2))
        for modes in product(range(2), repeat=7):
            weight = FIRST[modes[0]] * np.prod([SWITCH[i, j] for i, j in pairwise(modes)])
            for i, j in zip(modes, shown[:, path], strict=True):
                weight *= tells[i, j] if j >= 0 else 1.0
            total[range(7), modes] += weight
        assert_allclose(found.mode_prob[..., path], total / total[0].sum(), atol=1e-12)
        assert_allclose(found.modes[:, path], total.argmax(axis=1))


@pytest.mark.parametrize("drives", ["old", "new"])
def test_modes_that_never_switch_are_a_mixture(tracked, drives):
    _, y, _ = tracked
    found = smooth(SwitchingFilter(target(np.eye(2), drives=drives), Taylor()), TIMES, y)
    for path in range(8):
        alone = [given_modes((i,) * 7, y[:, 0, path]) for i in range(2)]
        prob = np.array([p * part[0] for p, part in zip(FIRST, alone, strict=True)])
        prob /= prob.sum()
        mean = sum(p * part[1] for p, part in zip(prob, alone, strict=True))
        assert_allclose(found.mode_prob[..., path], np.tile(prob, (7, 1)), atol=1e-11)
        assert_allclose(found.mean[..., path], mean, atol=1e-11)


def test_rounding_of_the_measurements_is_all_that_it_moves():
    """Where nothing is measured, later measurements tell of one direction of the state only.

    What they tell of the other is rounding, which counts as none up to 1e-12.
    """
    system, times = manoeuvring_target(), np.arange(9.0)
    data = system.simulate(times, 6, 6)
    y = data.measurements.copy()
    y[4, :, 2] = y[5] = np.nan
    filter = SwitchingFilter(system, Taylor())
    one, two = (
        smooth(filter, times, factor * y, indicators=data.indicators) for factor in (1.0, 1 + 1e-14)
    )
    for name in ("mean", "cov", "mode_prob"):
        assert_allclose(getattr(one, name), getattr(two, name), atol=1e-10)


@pytest.mark.parametrize("blind", [True, False])
def test_state_that_moves_its_modes_and_the_indicator_is_near_the_law_on_a_grid(blind):
    x, v, w = sympy.symbols("x v w")
    up, far = 0.05 + 0.9 * (1 + sympy.erf(x)) / 2, 0.5 + 0.45 * x / sympy.sqrt(0.2 + x**2)
    system = SwitchingSystem(
        (x,),
        [[0.8 * x + 0.5 + 0.4 * v], [0.8 * x - 0.5 + 0.6 * v]],
        Noise((v,)),
        [[1 - up, up], [1 - up, up]],
        [[x + 0.7 * w]] * 2,
        Noise((w,)),
        [(0.5, [0], [[1]])] * 2,
        indicator=[[0.8, 0.2], [0.3, 0.7] if blind else [far, 1 - far]],
    )
    times = np.arange(8.0)
    data = system.simulate(times, 40, 2)
    y, shown = np.array(data.measurements), np.array(data.indicators)
    shown[4] = -1
    law = smooth(GridBayesFilter(system, (-6.5, 6.5, 301)), times, y, indicators=shown)
    exact = law.mode_prob, law.mean, law.cov
    filter = SwitchingFilter(system, ExactGaussian() if blind else GaussHermite(9))
    prob, error = distance(smooth(filter, times, y, indicators=shown), exact)
    assert prob < (0.01 if blind else 0.0135)
    assert error < 0.09
    before = distance(filter.run(times, y, indicators=shown), exact)
    assert before[0] > 4 * prob
    assert before[1] > 4 * error


X, V, W = sympy.symbols("x v w", real=True)
SCALAR = [[0.9 * X + 0.4 + 0.3 * V], [0.5 * X - 0.7 + 0.8 * V], [1.2 * X + 2 * V]]
SEES = [[X + 0.5 * W], [1.3 * X + 0.7 * W], [X + W]]
LAWS = [(0.6, [0.3], [[1.2]]), (0.4, [-0.5], [[0.7]])]
STAY = [[0.85, 0.15], [0.3, 0.7]]
RECORD = np.random.default_rng(4).normal(size=(5, 1, 6))


def scalar(switch=STAY, laws=LAWS, moves=SCALAR, sees=SEES, **options):
    count = len(laws)
    return SwitchingSystem(
        (X,), moves[:count], Noise((V,)), switch, sees[:count], Noise((W,)), laws, **options
    )


def test_smoother_with_the_new_mode_is_that_of_pairs_of_modes():
    """(old, new) with the old one driving is new with the new driving: exactly, at a first step."""
    start, chain = np.array([0.6, 0.4]), np.array(STAY)
    law, alike = [(p, [0.3], [[1.2]]) for p in start], [SEES[0]] * 4
    single = scalar(laws=law, sees=alike, drives="new")
    ahead = [np.kron(np.eye(2)[j], chain[j]).tolist() for _ in (0, 1) for j in (0, 1)]
    laws = [(p, [0.3], [[1.2]]) for p in (start[:, None] * chain).ravel()]
    pairs = scalar(ahead, laws, moves=[SCALAR[j] for _ in (0, 1) for j in (0, 1)], sees=alike)
    one, two = (
        smooth(SwitchingFilter(s, Taylor()), TIMES[:2], RECORD[:2]) for s in (single, pairs)
    )
    assert_allclose(one.mean, two.mean, rtol=1e-9, atol=1e-12)
    assert_allclose(one.cov, two.cov, rtol=1e-9, atol=1e-12)
    by_old = two.mode_prob.reshape(2, 2, 2, -1).sum(axis=2)
    assert_allclose(one.mode_prob[0], by_old[0], rtol=1e-9, atol=1e-12)


def test_indicator_that_hardly_sees_the_state_is_one_that_does_not():
    """Forecasts are split by its value, and put together again, also where it is missing."""
    faint = 1e-11 * X / (1 + X**2)
    one, two = (
        SwitchingFilter(scalar(indicator=[told, [0, 1]]), GaussHermite(3))
        for told in ([0.8 + faint, 0.2 - faint], [0.8, 0.2])
    )
    assert (one.rules.split, two.rules.split) == (True, False)
    rng, y = np.random.default_rng(6), RECORD.copy()
    shown = rng.integers(0, 2, size=(5, 6))
    shown[1, 2] = shown[3, 4] = -1
    y[2, 0, 1] = np.nan
    for run in (
        lambda f: f.run(TIMES[:5], y, indicators=shown, covariances=True),
        lambda f: smooth(f, TIMES[:5], y, indicators=shown),
        lambda f: smooth(f, TIMES[:5], y, indicators=shown, lag=1),
    ):
        found, wanted = run(one), run(two)
        for name in ("mean", "cov", "mode_prob", "loglik"):
            assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-8, atol=1e-9)


def test_records_that_no_mode_explains_are_marked():
    system = scalar(np.eye(2).tolist(), indicator=[[1, 0], [0, 1]])
    shown = np.array([[0, 0], [0, 1], [0, 1]])
    found = smooth(
        SwitchingFilter(system, Taylor()), TIMES[:3], np.zeros((3, 1, 2)), indicators=shown
    )
    assert found.diverged.tolist() == [False, True]
    assert np.isfinite(found.mean).all()
    assert (found.modes[:, 0] == 0).all()
