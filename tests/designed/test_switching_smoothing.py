"""The smoother of switching systems against all histories of modes, chains, grids and limits."""

from itertools import pairwise, product

import numpy as np
import pytest
import sympy as sp
from scipy.stats import norm

from seedslib.designed import Memory, SwitchingFilter
from seedslib.filters import (
    KalmanFilter,
    KnownModeFilter,
    RaoBlackwellFilter,
    draw_trajectories,
    smooth,
)
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import LinearSystem, Noise, SwitchingSystem

MOVES = [np.array([[1, 1], [0, 0.98]]), np.array([[1, 1], [0, 0.7]])]
PUSHES = [np.zeros(2), np.array([0.5, 1.0])]
ALONG = np.array([0.5, 1.0])
NOISES = [s**2 * np.outer(ALONG, ALONG) + 0.01 * np.eye(2) for s in (0.1, 0.6)]
SENSORS = [1.0, 2.0]
SWITCH = np.array([[0.9, 0.1], [0.2, 0.8]])
FIRST = [0.7, 0.3]
COV0 = np.diag([2.0, 1.0])
TIMES = np.arange(7.0)
X = sp.symbols("x1 x2")


def target(switch=SWITCH, moves=MOVES, pushes=PUSHES, noises=NOISES, sensors=SENSORS, **more):
    v, w = sp.symbols("v1 v2"), sp.Symbol("w")
    rows = [
        list(sp.Matrix(a) * sp.Matrix(X) + sp.Matrix(b)
             + sp.Matrix(np.linalg.cholesky(q)) * sp.Matrix(v))
        for a, b, q in zip(moves, pushes, noises, strict=True)
    ]  # fmt: skip
    sees = [[X[0] + np.sqrt(r) * w] for r in sensors]
    initial = [(p, np.zeros(2), COV0) for p in FIRST]
    return SwitchingSystem(X, rows, Noise(v), switch.tolist(), sees, Noise((w,)), initial, **more)


def given_modes(modes, y):
    """Density of a record, and means and covariances given it, all at once: one large Gaussian."""
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


def enumerated(y, until=None):
    """Probabilities, means and covariances from all histories of modes."""
    count, y = len(y), y.copy()
    y[len(y) if until is None else until + 1 :] = np.nan
    total, prob = 0.0, np.zeros((count, 2))
    mean, square = np.zeros((count, 2)), np.zeros((count, 2, 2))
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
    sim = system.simulate(TIMES, 12, 3)
    y = np.array(sim.measurements)
    y[2, 0, 1], y[5:, 0, 2] = np.nan, np.nan
    exact = [np.stack(part, axis=-1) for part in zip(*map(enumerated, y[:, 0].T), strict=True)]
    return system, y, sim, exact


def distance(found, exact):
    """Root mean squares: of probabilities, and of means in units of the exact deviation."""
    prob, mean, cov = exact
    scaled = (found.mean - mean) ** 2 / np.einsum("kii...->ki...", cov)
    return np.sqrt(np.mean((found.mode_prob - prob) ** 2)), np.sqrt(np.mean(scaled))


def test_near_all_histories(tracked):
    system, y, _, exact = tracked
    filter = SwitchingFilter(system, Taylor())
    prob, mean = distance(smooth(filter, TIMES, y), exact)
    assert prob < 0.02
    assert mean < 0.2
    prob, mean = distance(filter.run(TIMES, y), exact)
    assert prob > 0.15
    assert mean > 1


def test_the_oracle_is_the_exact_filter_at_the_last_time(tracked):
    system, y, _, exact = tracked
    found = RaoBlackwellFilter(system, 2 ** len(TIMES)).run(TIMES, y)
    assert np.allclose(found.mode_prob[-1], exact[0][-1], atol=1e-12)
    assert np.allclose(found.mean[-1], exact[1][-1], atol=1e-10)


def test_later_times_without_measurements_change_nothing(tracked):
    system, y, _, _ = tracked
    blind = y.copy()
    blind[4:] = np.nan
    filter = SwitchingFilter(system, Taylor())
    one, two = filter.run(TIMES, blind, covariances=True), smooth(filter, TIMES, blind)
    for k in (3, 4, 5, 6):
        assert np.allclose(one.mode_prob[k], two.mode_prob[k], atol=1e-13)
        assert np.allclose(one.mean[k], two.mean[k], atol=1e-12)
        assert np.allclose(one.cov[k], two.cov[k], atol=1e-12)


def test_fixed_lag_is_the_end_of_shorter_records(tracked):
    system, y, _, _ = tracked
    filter = SwitchingFilter(system, Taylor())
    lagged = smooth(filter, TIMES, y, lag=2)
    for k in range(7):
        end = min(k + 3, 7)
        short = smooth(filter, TIMES[:end], y[:end])
        for a, b in zip(lagged[:3], short[:3], strict=True):
            assert np.allclose(a[k], b[k], atol=1e-13)
    assert np.array_equal(lagged.loglik, filter.run(TIMES, y).loglik)


def test_axes_of_records_may_be_none_or_several(tracked):
    system, y, sim, _ = tracked
    modes = np.asarray(sim.modes)
    for filter, told in (
        (SwitchingFilter(system, Taylor()), {}),
        (KnownModeFilter(system), {"modes": modes}),
    ):
        whole = smooth(filter, TIMES, y, **told)
        plane = {name: part.reshape(7, 3, 4) for name, part in told.items()}
        several = smooth(filter, TIMES, y.reshape(7, 1, 3, 4), **plane)
        one = smooth(filter, TIMES, y[..., 5], **{n: part[:, 5] for n, part in told.items()})
        for a, b, c in zip(whole[:6], several, one, strict=False):
            assert np.allclose(a.reshape(b.shape), b, atol=1e-14)
            assert np.allclose(a[..., 5], c, atol=1e-14)
        assert several.mean.shape == (7, 2, 3, 4)
        assert one.cov.shape == (7, 2, 2)


def test_given_the_modes_it_is_one_large_gaussian(tracked):
    system, y, sim, _ = tracked
    modes = np.asarray(sim.modes)
    for lag in (None, 2):
        found = smooth(KnownModeFilter(system), TIMES, y, modes=modes, lag=lag)
        for path in range(12):
            for k in (0, 2, 5):
                row = y[:, 0, path].copy()
                row[len(row) if lag is None else k + lag + 1 :] = np.nan
                _, mean, cov = given_modes(modes[:, path], row)
                assert np.allclose(found.mean[k, :, path], mean[k], atol=1e-12)
                assert np.allclose(found.cov[k, ..., path], cov[k], atol=1e-12)
    assert np.array_equal(found.modes, modes)
    with pytest.raises(ValueError, match="modes: wanted none"):
        smooth(SwitchingFilter(system, Taylor()), TIMES, y, modes=modes)


def test_one_mode_is_the_smoother_of_rauch(tracked):
    _, y, _, _ = tracked
    v, w = sp.symbols("v1 v2"), sp.Symbol("w")
    q = sp.Matrix(np.linalg.cholesky(NOISES[0]))
    row = list(sp.Matrix(MOVES[0]) * sp.Matrix(X) + q * sp.Matrix(v))
    system = SwitchingSystem(
        X, [row], Noise(v), [[1]], [[X[0] + w]], Noise((w,)), [(1, np.zeros(2), COV0)]
    )
    exact = LinearSystem(MOVES[0], NOISES[0], [[1, 0]], [[1.0]], np.zeros(2), COV0)
    one = smooth(SwitchingFilter(system, Taylor()), TIMES, y)
    two = smooth(KalmanFilter(exact), TIMES, y)
    assert np.allclose(one.mean, two.mean, atol=1e-12)
    assert np.allclose(one.cov, two.cov, atol=1e-12)


def test_modes_that_move_alike_are_a_chain(tracked):
    """Only the indicator tells them apart: forward and backward on the chain, by hand."""
    _, y, _, _ = tracked
    tells = np.array([[0.9, 0.1], [0.2, 0.8]])
    alike = ([part[0]] * 2 for part in (MOVES, PUSHES, NOISES, SENSORS))
    system = target(SWITCH, *alike, indicator=tells.tolist())
    shown = np.asarray(system.simulate(TIMES, 12, 5).indicators).copy()
    shown[3, 1] = -1
    found = smooth(SwitchingFilter(system, Taylor()), TIMES, y, indicators=shown)
    exact = LinearSystem(MOVES[0], NOISES[0], [[1, 0]], [[1.0]], np.zeros(2), COV0)
    assert np.allclose(found.mean, smooth(KalmanFilter(exact), TIMES, y).mean, atol=1e-12)
    for path in range(12):
        total = np.zeros((7, 2))
        for modes in product(range(2), repeat=7):
            weight = FIRST[modes[0]] * np.prod([SWITCH[i, j] for i, j in pairwise(modes)])
            for i, j in zip(modes, shown[:, path], strict=True):
                weight *= tells[i, j] if j >= 0 else 1.0
            total[range(7), modes] += weight
        assert np.allclose(found.mode_prob[..., path], total / total[0].sum(), atol=1e-12)


def test_modes_that_never_switch_are_a_mixture(tracked):
    _, y, _, _ = tracked
    system = target(np.eye(2))
    found = smooth(SwitchingFilter(system, Taylor()), TIMES, y)
    for path in range(12):
        alone = [given_modes((i,) * 7, y[:, 0, path]) for i in range(2)]
        prob = np.array([p * part[0] for p, part in zip(FIRST, alone, strict=True)])
        prob /= prob.sum()
        mean = sum(p * part[1] for p, part in zip(prob, alone, strict=True))
        assert np.allclose(found.mode_prob[..., path], prob, atol=1e-11)
        assert np.allclose(found.mean[..., path], mean, atol=1e-11)


@pytest.fixture(scope="module", params=[False, True])
def moved_by_state(request):
    """A scalar system whose state moves its modes, and maybe the indicator; its law on a grid."""
    x, v, w = sp.symbols("x v w")
    up = 0.05 + 0.9 * (1 + sp.erf(x)) / 2
    far = 0.5 + 0.45 * x / sp.sqrt(0.2 + x**2)
    tells = [[0.8, 0.2], [far, 1 - far] if request.param else [0.3, 0.7]]
    system = SwitchingSystem(
        (x,), [[0.8 * x + 0.5 + 0.4 * v], [0.8 * x - 0.5 + 0.6 * v]], Noise((v,)),
        [[1 - up, up], [1 - up, up]], [[x + 0.7 * w]] * 2, Noise((w,)),
        [(0.5, [0], [[1]])] * 2, indicator=tells,
    )  # fmt: skip
    times = np.arange(8.0)
    sim = system.simulate(times, 40, 2)
    y, shown = np.array(sim.measurements), np.array(sim.indicators)
    shown[4] = -1
    grid = np.linspace(-5, 5, 301)
    one = np.ones_like(grid)
    chance = 0.05 + 0.9 * norm.cdf(grid * np.sqrt(2))
    moves = [norm.pdf(grid, 0.8 * grid[:, None] + b, s) for b, s in ((0.5, 0.4), (-0.5, 0.6))]
    move = np.array([[d * c[:, None] for c in (1 - chance, chance)] for d in moves])
    # rows of values shown, the last one for none: modes, grid
    far = 0.5 + 0.45 * grid / np.sqrt(0.2 + grid**2)
    second = [far, 1 - far] if request.param else [0.3 * one, 0.7 * one]
    told = np.array([[0.8 * one, second[0]], [0.2 * one, second[1]], [one, one]])
    like = (
        np.moveaxis(told[shown], 1, -1)
        * norm.pdf(y[:, 0], grid[:, None, None], 0.7).transpose(1, 0, 2)[:, None]
    )
    ahead = [norm.pdf(grid)[None, :, None] * like[0]]
    for k in range(1, 8):
        ahead.append(np.einsum("iap,ilab->lbp", ahead[-1], move, optimize=True) * like[k])
        ahead[-1] /= ahead[-1].sum(axis=(0, 1))
    behind = [np.ones_like(ahead[0])]
    for k in range(7, 0, -1):
        behind.append(np.einsum("ilab,lbp->iap", move, behind[-1] * like[k], optimize=True))
        behind[-1] /= behind[-1].max(axis=(0, 1))
    laws = np.array([a * b for a, b in zip(ahead, behind[::-1], strict=True)])
    laws /= laws.sum(axis=(1, 2), keepdims=True)
    mean = np.einsum("kiap,a->kp", laws, grid)[:, None]
    square = np.einsum("kiap,a->kp", laws, grid**2)[:, None, None]
    exact = laws.sum(axis=2), mean, square - mean[:, None] ** 2
    return system, times, y, shown, exact, (np.asarray(sim.modes), grid, move, like)


@pytest.mark.parametrize("split", [True, False])
def test_a_state_that_moves_its_modes_is_near_the_exact_law_on_a_grid(moved_by_state, split):
    system, times, y, shown, exact, _ = moved_by_state
    taken = ExactGaussian() if system.indicator_is_blind else GaussHermite(9)
    filter = SwitchingFilter(system, taken, split=split)
    found = smooth(filter, times, y, indicators=shown)
    prob, mean = distance(found, exact)
    assert prob < (0.01 if system.indicator_is_blind else 0.0135 if split else 0.016)
    assert mean < 0.09
    before = distance(filter.run(times, y, indicators=shown), exact)
    assert before[0] > 4 * prob
    assert before[1] > 4 * mean


def test_given_the_modes_switches_tell_of_the_state(moved_by_state):
    """Against the exact law on a grid given all modes."""
    system, times, y, shown, _, (modes, grid, move, like) = moved_by_state
    exact = []
    for path in range(40):
        told = modes[:, path]
        ahead, behind = [norm.pdf(grid) * like[0, told[0], :, path]], [np.ones_like(grid)]
        for k in range(1, 8):
            ahead.append(ahead[-1] @ move[told[k - 1], told[k]] * like[k, told[k], :, path])
        for k in range(7, 0, -1):
            later = behind[-1] * like[k, told[k], :, path]
            behind.append(move[told[k - 1], told[k]] @ later)
        laws = np.array(ahead) * behind[::-1]
        laws /= laws.sum(axis=1, keepdims=True)
        exact.append(np.stack([laws @ grid, laws @ grid**2 - (laws @ grid) ** 2]))
    mean, variance = np.moveaxis(exact, 0, -1)
    taken = ExactGaussian() if system.indicator_is_blind else GaussHermite(9)
    found = smooth(KnownModeFilter(system, taken), times, y, modes=modes, indicators=shown)
    error = np.sqrt(np.mean((found.mean[:, 0] - mean) ** 2 / variance))
    blind = system.indicator_is_blind
    assert error < (0.012 if blind else 0.08)
    apart = np.abs(np.log(found.cov[:, 0, 0] / variance)).mean()
    assert apart < (0.02 if blind else 0.06)
    plain = KnownModeFilter(system, taken).run(times, y, modes=modes, indicators=shown)
    assert np.sqrt(np.mean((plain.mean[:, 0] - mean) ** 2 / variance)) > 4 * error


def test_a_filter_with_a_memory_is_refused(tracked):
    system, y, _, _ = tracked
    designed = SwitchingFilter.__new__(SwitchingFilter)
    object.__setattr__(designed, "memory", Memory(estimates=1))
    with pytest.raises(TypeError, match="SwitchingFilter without a memory"):
        smooth(designed, TIMES, y)
    with pytest.raises(TypeError, match="got RaoBlackwellFilter"):
        smooth(RaoBlackwellFilter(system), TIMES, y)
    with pytest.raises(TypeError, match="wanted a ParticleFilter, got SwitchingFilter"):
        draw_trajectories(SwitchingFilter(system, Taylor()), TIMES, y, 10)
