"""The remarks of the jump-diffusion paper and its corollary, each by a second route."""

import sys
from pathlib import Path

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import finite_memory, large_order, small_order
from seedslib.linearization import Taylor

TACTS = np.arange(7) * 0.5
BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def chain():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        from jump_diffusion_exact import flip_chain

        return flip_chain
    finally:
        sys.path.remove(str(BENCHMARKS))


def test_remark_one_exact_functions_on_a_grid(chain):
    """M[X | Y_1, Y_0] half an interval later, by hand, against the forecast from Z_1."""
    x, law, move = chain(141)
    half = chain(141, 0.125)[2]
    ahead = half.T @ x
    y = np.linspace(-8, 8, 161)
    spread = 0.25 + 0.09 * x**2
    likely = np.exp(-0.5 * (y[:, None] - x) ** 2 / spread) / np.sqrt(2 * np.pi * spread) * 0.1
    before = (likely * law) @ move.T  # (first measurement, states)
    joint = np.einsum("as,bs->bas", before, likely)  # second, first, states
    mass = np.maximum(joint.sum(axis=2), 1e-300)
    both, alone = (joint @ ahead) / mass, (joint @ ahead).sum(axis=1) / mass.sum(axis=1)
    explained = [(mass * both**2).sum(), (mass.sum(axis=1) * alone**2).sum()]
    system, times = zoo.flip_process(), np.array([0.0, 0.25, 0.5])
    made = grid_synthesis(
        system, large_order(1), times, x=(-3.5, 3.5, 141), z=(-3, 3, 281), y=(-8, 8, 385), nodes=1
    )
    node = np.flatnonzero(np.isclose(made.predicted.times, 0.375))[0]
    error = made.predicted.rms[node, 0] ** 2
    total = (law @ move.T @ half.T) @ x**2
    gain = explained[0] - (total - error)
    assert 0 < gain < 2e-4  # what the estimate has thrown away is little
    assert explained[1] - (total - error) < -0.01  # the measurement without the memory
    data = system.simulate([0.0, 0.25, 0.375], 40_000, 5, measured=[True, True, False])
    truth = data.states[2, 0]
    given = made.run([0.0, 0.25, 0.375], data.measurements).mean[2, 0]
    cells = [np.clip((data.measurements[k, 0] + 8) / 0.1, 0, 159.999) for k in (1, 0)]
    (i, a), (j, b) = ((c.astype(int), c % 1) for c in cells)
    found = (
        (1 - a) * (1 - b) * both[i, j] + a * (1 - b) * both[i + 1, j]
        + (1 - a) * b * both[i, j + 1] + a * b * both[i + 1, j + 1]
    )  # fmt: skip
    apart = (given - truth) ** 2 - (found - truth) ** 2
    assert abs(apart.mean() - gain) < 4 * apart.std() / 200


def test_first_interval_has_estimates_of_its_own():
    """Regression on Z_0 against Z_0 itself, 0.4 after the first measurement; none without (3.4)."""
    system = zoo.van_der_pol()
    made = synthesize(system, large_order(1), Taylor(), TACTS[:2], nodes=4, paths=8192, seed=1)
    assert len(made.node_fits[0]) == 4
    fit, drawn = made.node_fits[0][3], system.simulate([0.0, 0.4], 16_384, 2, measured=[0])
    z = made.run([0.0], drawn.measurements[:1]).mean[0]
    square = (fit.gain @ z + fit.offset[:, None] - drawn.states[1]) ** 2
    apart = (square - (z - drawn.states[1]) ** 2)[1]
    assert apart.mean() < -4 * apart.std() / 128


def test_letter_of_remark_one_as_an_affine_fit_is_worse():
    """.414 to .434 at t_2 + .4 and .479 to .568 at t_3 + .4; added to the memory .395, .453."""
    system, clock = zoo.van_der_pol(), np.array([0, 0.5, 1, 1.4, 1.5, 1.9])
    marks = np.array([0, 1, 2, 4])
    made = synthesize(system, large_order(1), Taylor(), TACTS[:4], nodes=0, paths=16_384, seed=4)
    halves = []
    for seed in (5, 6):
        drawn = system.simulate(clock, 20_000, seed, measured=marks)
        y = drawn.measurements[marks]
        halves.append((drawn.states[:, 0], y, made.run(clock[marks], y).mean))
    wanted = {2: (3, 0.414, 0.434, 0.395), 3: (5, 0.479, 0.568, 0.453)}
    for k, (at, *printed) in wanted.items():
        squares = []
        for blocks in (
            lambda y, z, k=k: (z[k],),
            lambda y, z, k=k: (y[k], z[k - 1]),
            lambda y, z, k=k: (y[k], z[k]),
        ):
            (fit, score) = (
                np.concatenate([*blocks(y, z), np.ones((1, 20_000))]) for _, y, z in halves
            )
            gain, *_ = np.linalg.lstsq(fit.T, halves[0][0][at], rcond=None)
            squares.append((gain @ score - halves[1][0][at]) ** 2)
        for square, value in zip(squares, printed, strict=True):
            rms = np.sqrt(square.mean())
            assert abs(rms - value) < 4 * np.sqrt(3) * square.std() / np.sqrt(20_000) / (2 * rms)
        for apart in (squares[1] - squares[0], squares[0] - squares[2]):
            assert apart.mean() > 4 * apart.std() / np.sqrt(20_000)


def written_out(fit, u, y):
    """(6.2) with the linearised moments of the Van der Pol sensor, path by path."""
    found = np.empty_like(y)
    for p in range(y.shape[1]):
        m = fit.gain @ u[:, p] + fit.offset
        slope = np.diag([2 * m[0], 1.0])
        spread = slope @ fit.cov @ slope.T + np.eye(2)
        rest = y[:, p] - np.array([m[0] ** 2, m[1]])
        found[:, p] = m + fit.cov @ slope.T @ np.linalg.solve(spread, rest)
    return found


@pytest.mark.parametrize(
    ("memory", "remembered", "other"),
    [
        (small_order(), lambda z, y: z[-1], lambda z, y: z[0]),
        (
            finite_memory(2),
            lambda z, y: np.concatenate(y[-1:-3:-1]),
            lambda z, y: np.concatenate(y[-2:]),
        ),
    ],
)
def test_remark_two_by_hand(memory, remembered, other):
    """Small order Z_k = f_k(Y_k, Z_{k-1}); finite memory f_k(Y_k, Y_{k-1}, Y_{k-2})."""
    system = zoo.van_der_pol()
    made = synthesize(system, memory, Taylor(), TACTS, nodes=0, paths=2000, seed=1, step=0.05)
    y = system.simulate(TACTS, 5, 2).measurements
    wanted = made.run(TACTS, y).mean

    def course(remember):
        z = [wanted[0]]
        for k in range(1, 7):
            z.append(written_out(made.fits[k - 1], remember(z, y[:k]), y[k]))
        return np.array(z)

    np.testing.assert_allclose(course(remembered), wanted, rtol=1e-9, atol=1e-9)
    assert not np.allclose(course(other), wanted, atol=0.01)


def test_linearised_moments_by_hand():
    """(7.1) for Y = (X1² + V1, X2 + V2): h, D Gᵀ and F at a forecast."""
    h, cross, cov = Taylor().moments(zoo.van_der_pol().sensor)(
        0.0, np.array([1.5, -0.3]), np.array([[0.4, 0.1], [0.1, 0.2]])
    )
    np.testing.assert_allclose(h, [2.25, -0.3], rtol=1e-14)
    np.testing.assert_allclose(cross, [[1.2, 0.1], [0.3, 0.2]], rtol=1e-14)
    np.testing.assert_allclose(cov, [[4.6, 0.3], [0.3, 1.2]], rtol=1e-14)
