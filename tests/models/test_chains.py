"""Systems as chains on grids: masses, their motion and likelihoods against distributions that are
known."""

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.stats import multivariate_normal, norm

from seedslib import zoo
from seedslib.base import ELAPSED, Nodes, Parameter
from seedslib.models import (
    DiscreteSystem,
    JumpDiffusion,
    Noise,
    PlaneChain,
    StochasticMap,
    SwitchingSystem,
    grid_chain,
    van_loan,
)

x, y, v, w, z = sympy.symbols("x y v w z", real=True)
t = sympy.Symbol("t")
SHOWN = StochasticMap((x,), [x + w / 2], Noise((w,)))


def masses(mean, deviation, nodes, width):
    return width * norm.pdf(nodes, mean, deviation)


def flow(drift, diffusion, mean0=0.0, var0=0.25, **options):
    return JumpDiffusion(
        (x,), [drift], [[diffusion]], [x + w], Noise((w,)), [mean0], [[var0]], **options
    )


# Jump-diffusions of one component


def test_moments_of_a_feller_chain_whose_rates_depend_on_time():
    """From a late start, with jumps that look at state, mark and time, against Ito's formula."""
    jumps = {"intensity": 1 + t / 2, "jump": [t * (z - x) / 4], "marks": Noise((z,), 0.6, [[0.5]])}
    drift, spread = sympy.cos(3 * t) - t * x / 2, sympy.sqrt(1 + t / 4)
    chain = grid_chain(flow(drift, spread, 0.7, 0.2, step=0.02, **jumps), (-8.0, 8.0, 321))
    start, stop = 1.5, 2.3
    dist, nodes = chain.transition(start, stop) @ chain.initial, chain.values[0]
    np.testing.assert_allclose(chain.distribution(stop, start), dist, rtol=1e-14)
    np.testing.assert_allclose(chain.distribution(start, start), chain.initial)
    shown = np.array([[0.4, -1.0]])
    found = chain.log_likelihood(stop, shown)
    np.testing.assert_allclose(found, norm.logpdf(shown.T, nodes, 1.0), rtol=1e-12)

    def rates(now, moments):
        m, q = moments
        mu, c = 1 + now / 2, now / 4
        mean, square = c * (0.6 - m), c**2 * (0.5 + 0.36 - 1.2 * m + q)
        both = c * (0.6 * m - q)
        return [
            np.cos(3 * now) - now * m / 2 + mu * mean,
            2 * (np.cos(3 * now) * m - now * q / 2) + 1 + now / 4 + mu * (2 * both + square),
        ]

    m, q = solve_ivp(rates, (start, stop), [0.7, 0.69], rtol=1e-9).y[:, -1]
    assert dist.sum() == pytest.approx(1.0, abs=1e-13)
    assert dist @ nodes == pytest.approx(m, abs=3e-4)
    assert dist @ nodes**2 == pytest.approx(q, abs=2e-3)


def test_jumps_without_diffusion_are_counted():
    """Jumps of one with intensity 2, of a known start; a frozen state of intensity x^2."""
    dist = grid_chain(flow(0, 0, 0.0, 0.0, intensity=2, jump=[1]), (0.0, 20.0, 81)).distribution(
        0.6
    )
    expected = [np.exp(-1.2) * 1.2**k / np.prod(np.arange(1.0, k + 1)) for k in range(8)]
    assert dist[::4][:8] == pytest.approx(expected, abs=1e-12)
    chain = grid_chain(flow(0, 0, 0.0, 1.0, intensity=x**2, jump=[40 - x]), (-6.0, 40.0, 921))
    assert chain.distribution(0.5)[chain.values[0] < 20].sum() == pytest.approx(2.0**-0.5, abs=1e-4)
    drifting = grid_chain(flow(1, 0, 1.0, 0.01), (0.0, 4.0, 401))
    assert (drifting.distribution(1.0) >= 0).all()
    assert drifting.distribution(1.0) @ drifting.values[0] == pytest.approx(2.0, abs=1e-9)


def test_a_jump_that_is_not_affine_in_its_mark_is_averaged_over_nodes():
    """z^2 - 1 has mean 0 and second moment 2."""
    system = flow(0, sympy.Rational(1, 2), intensity=3, jump=[z**2 - 1], marks=Noise((z,)))
    chain = grid_chain(system, (-20.0, 40.0, 301))
    dist, nodes = chain.distribution(0.5), chain.values[0]
    assert dist @ nodes == pytest.approx(0.0, abs=1e-6)
    assert dist @ nodes**2 == pytest.approx(0.25 + 0.125 + 3.0, abs=0.03)


def test_rates_that_change_late():
    """dX = dW until time 1, then dX = dt + dW."""
    chain = grid_chain(flow(sympy.Heaviside(t - 1), 1, step=0.05), (-7.0, 9.0, 161))
    early = chain.transition(0.0, 1.0) @ chain.initial
    late = chain.transition(1.0, 2.0) @ early
    assert early @ chain.values[0] == pytest.approx(0.0, abs=1e-9)
    assert late @ chain.values[0] == pytest.approx(1.0, abs=1e-6)


# Systems in discrete time


def test_a_discrete_chain_takes_a_step_as_long_as_it_is():
    """X' = X exp(-a d) + sqrt(1 - exp(-2 a d)) V after the time d, on even and uneven nodes."""
    a = Parameter("a", 1.0)
    fade = sympy.exp(-a * ELAPSED)
    move = StochasticMap((x,), [fade * x + sympy.sqrt(1 - fade**2) * v], Noise((v,)))
    system = DiscreteSystem(move, SHOWN, [0.2], [[1.3]])
    uneven = np.sinh(np.linspace(-2, 2, 91))
    for axis in ((-6.0, 6.0, 121), Nodes(uneven)):
        chain = grid_chain(system, axis)
        nodes, weights = chain.values[0], np.gradient(chain.values[0])
        inside = np.arange(1, len(nodes) - 1)
        wanted = masses(0.2, np.sqrt(1.3), nodes, weights)
        np.testing.assert_allclose(chain.initial[inside], wanted[inside], rtol=1e-11)
        for start, stop, rate in (
            (0.0, 0.5, 1.0),
            (0.5, 2.5, 1.0),
            (1.0, 1.5, 1.0),
            (1.0, 1.5, 2.0),
        ):
            p = system.bind(a=rate).values(dt=stop - start)
            found = chain.transition(start, stop, p)[:, [40, 75]]
            slope = np.exp(-rate * (stop - start))
            wanted = masses(
                slope * nodes[[40, 75]], np.sqrt(1 - slope**2), nodes[:, None], weights[:, None]
            )
            np.testing.assert_allclose(found[inside], wanted[inside], rtol=1e-10, atol=1e-300)
        dist = np.stack([chain.initial] * 2, axis=1)
        moved = chain.move(dist, 0.0, 0.5)
        np.testing.assert_allclose(moved, chain.transition(0.0, 0.5) @ dist)


def test_a_discrete_chain_in_the_plane_and_a_known_start():
    """Densities of the model on the nodes, of correlated noises in two components."""
    cov = np.array([[0.5, 0.2], [0.2, 0.4]])
    p, q, a, b = sympy.symbols("p q a b", real=True)
    move = StochasticMap([a, b], [a / 2 + t * b + p, b - a / 4 + q], Noise([p, q], cov=cov))
    sensor = StochasticMap([a, b], [a * b + w], Noise([w], 0.3, [[0.6]]))
    system = DiscreteSystem(move, sensor, [0.1, -0.2], [[1.0, 0.3], [0.3, 0.8]])
    chain = grid_chain(system, [(-3, 3, 13), (-4, 4, 11)])
    nodes = chain.values
    start = (
        multivariate_normal([0.1, -0.2], system.cov0).pdf(nodes.T)
        * np.outer(*(axis.weights for axis in chain.axes)).ravel()
    )
    np.testing.assert_allclose(chain.initial, start, rtol=1e-12)
    found = chain.transition(0.7, 1.7)[:, 30]
    mean = [nodes[0, 30] / 2 + 0.7 * nodes[1, 30], nodes[1, 30] - nodes[0, 30] / 4]
    wanted = (
        multivariate_normal(mean, cov).pdf(nodes.T)
        * np.outer(*(axis.weights for axis in chain.axes)).ravel()
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-11)
    shown = np.array([[0.4, np.nan, -1.0]])
    likelihood = norm.logpdf(shown.T, nodes[0] * nodes[1] + 0.3, np.sqrt(0.6))
    found = chain.log_likelihood(0.0, shown)
    np.testing.assert_allclose(found, np.where(np.isnan(shown.T), 0.0, likelihood), rtol=1e-12)
    known = grid_chain(
        DiscreteSystem(StochasticMap((x,), [x + v], Noise((v,))), SHOWN, 0.3, 0), (-3, 3, 31)
    )
    assert known.initial @ known.values[0] == pytest.approx(0.3)


# Switching systems


@pytest.mark.parametrize("drives", ["old", "new"])
@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_a_switching_chain_switches_at_the_node_and_moves_as_its_mode(drives, scale):
    """Wide noise: densities on the nodes; narrow noise: the moments. Times are not mixed up."""
    stay = [0.3 + 0.6 * sympy.exp(-(x**2) / 2), 0.9 - 0.5 * sympy.exp(-(x**2) / 8)]
    system = SwitchingSystem(
        (x,),
        [[x / 2 + t / 5 + 0.3 * scale * v], [0.8 * x - scale * v]],
        Noise((v,)),
        [[stay[0], 1 - stay[0]], [1 - stay[1], stay[1]]],
        [[x + w], [x + w / 2]],
        Noise((w,)),
        [(0.2, [1.0], [[1.0]]), (0.8, [-2.0], [[2.0]])],
        time=t,
        drives=drives,
    )
    chain = grid_chain(system, (-9.0, 9.0, 121))
    nodes, size = chain.axes[0].nodes, (0.3 * scale, scale)
    at = [45, 60, 82]
    here = nodes[at]
    chance = [0.3 + 0.6 * np.exp(-(here**2) / 2), 0.9 - 0.5 * np.exp(-(here**2) / 8)]
    for start in (0.0, 1.0, *range(2, 72, 3), 1.0):
        found = chain.transition(start, start + 1.0).reshape(2, 121, 2, 121)[..., at]
        for i, l in np.ndindex(2, 2):
            share = chance[i] if i == l else 1 - chance[i]
            drive = l if drives == "new" else i
            mean = here / 2 + start / 5 if drive == 0 else 0.8 * here
            mass = found[l, :, i]
            if np.abs(mean).max() > 5:
                continue
            np.testing.assert_allclose(mass.sum(axis=0), share, rtol=1e-9)
            if scale == 1.0:
                density = norm.pdf(nodes[:, None], mean, size[drive])
                np.testing.assert_allclose(mass, share * density / density.sum(axis=0), atol=1e-10)
            else:  # a narrow distribution falls into the cell that it is in
                np.testing.assert_allclose(nodes @ mass / share, mean, atol=0.0751)
    wanted = np.concatenate(
        [p * masses(m, np.sqrt(c), nodes, 0.15) for p, m, c in ((0.2, 1.0, 1.0), (0.8, -2.0, 2.0))]
    )
    np.testing.assert_allclose(chain.initial, wanted, atol=1e-6)


def test_cells_too_wide_for_a_mixture_of_noises_are_a_loss():
    """Its deviation of 0.71 is wide, its narrow part of 0.1 is not."""
    mixed = Noise(
        (v,),
        0,
        [[0.505]],
        lambda rng, count: rng.standard_normal((1, count)),
        lambda e: np.log(5 * norm.pdf(10 * e[0]) + 0.5 * norm.pdf(e[0])),
    )
    modes = [[1]], [[x + w]], Noise((w,)), [(1, [0], [[1]])]
    system = SwitchingSystem((x,), [[x + v]], mixed, *modes)
    for count, lost in ((17, 0.5), (25, 0.5), (241, 1e-12)):
        chain = grid_chain(system, (-8.0, 8.0, count))
        density = np.exp(
            system.dynamics[0].log_density(0.0, chain.nodes[:, :, None], np.zeros((1, 1)))
        )
        defect = abs(1 - chain.axes[0].weights @ density[:, 0])
        assert chain.loss(0.0, 1.0)[count // 2] == pytest.approx(defect, abs=1e-4)
        assert defect >= lost or count == 241


def test_likelihoods_of_a_switching_chain_take_in_the_indicator():
    tells = 1 / (1 + x**2)
    system = SwitchingSystem(
        (x,),
        [[x / 2 + v]] * 2,
        Noise((v,)),
        [[0.7, 0.3], [0.4, 0.6]],
        [[x + t + w], [2 * x + w / 2]],
        Noise((w,)),
        [(0.5, [0], [[1]])] * 2,
        indicator=[[tells, 1 - tells], [0.3, 0.7]],
    )
    chain = grid_chain(system, (-3.0, 3.0, 12))
    nodes = chain.axes[0].nodes
    shown = np.array([[0, 1, -1, 1, -1], [0.4, -1.0, 0.7, np.nan, np.nan]])
    found = chain.log_likelihood(1.5, shown).reshape(5, 2, 12)
    chance = np.stack([np.stack([1 / (1 + nodes**2), np.full(12, 0.3)])] * 2)
    chance[1] = 1 - chance[0]
    for row, (told, y) in zip(found, shown.T, strict=True):
        wanted = np.stack([norm.logpdf(y, nodes + 1.5, 1.0), norm.logpdf(y, 2 * nodes, 0.5)])
        wanted = np.where(np.isnan(y), 0.0, wanted)
        wanted = wanted + (np.log(chance[int(told)]) if told >= 0 else 0.0)
        np.testing.assert_allclose(row, wanted, rtol=1e-12, atol=1e-13)
    mean, deviation = chain.measurement_moments(1.5)
    np.testing.assert_allclose(mean[0], [*(nodes + 1.5), *(2 * nodes)])
    np.testing.assert_allclose(deviation[0], [1.0] * 12 + [0.5] * 12)


# The plane


def test_a_plane_chain_moves_a_linear_dist_with_an_error_of_second_order():
    """And `back` is its adjoint: means of functions of the later state."""
    system, drift = zoo.linear_gaussian(), np.array([[0.0, 1.0], [-1.0, -0.4]])
    move, noise = van_loan(drift, np.diag([0.0, 1.0]), 0.5)
    mean, cov = move @ system.mean0, move @ np.eye(2) @ move.T + noise
    missed = []
    for substep in (0.25, 0.125):
        chain = PlaneChain(system, [(-7, 7, 57), (-7, 7, 57)], substep)
        dist = chain.move(chain.initial[:, None], 0.0, 0.5)[:, 0]
        about = chain.values - (chain.values @ dist)[:, None]
        missed.append([*(chain.values @ dist - mean), *((about * dist) @ about.T - cov).ravel()])
        back = chain.back(chain.values, 0.0, 0.5)
        np.testing.assert_allclose(back @ chain.initial, chain.values @ dist, atol=1e-4)
    assert np.abs(missed[1]).max() < 2.5e-3
    assert np.abs(missed[1]).max() < 0.3 * np.abs(missed[0]).max()
    found = chain.log_likelihood(0.0, np.array([[0.4, -1.0]]))
    wanted = norm.logpdf([[0.4], [-1.0]], chain.values[0], 0.5)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


@pytest.mark.parametrize("drives", ["old", "new"])
def test_modes_in_the_plane_move_with_the_moments_of_their_maps(drives):
    a, b, p, q = sympy.symbols("a b p q", real=True)
    stay = 0.4 + 0.5 * sympy.exp(-(a**2))
    system = SwitchingSystem(
        (a, b),
        [[a / 2 + p, b - t * a / 4 + q], [1 - a / 2 + p, b / 2 + q]],
        Noise((p, q), cov=[[0.3, 0.1], [0.1, 0.4]]),
        [[stay, 1 - stay], [0.2, 0.8]],
        [[a + w], [b + w]],
        Noise((w,)),
        [(0.7, [0, 0], np.eye(2)), (0.3, [1, 0], np.eye(2))],
        drives=drives,
        time=t,
    )
    chain = grid_chain(system, [(-5, 5, 31), (-5, 5, 31)])
    count = chain.nodes.shape[1]
    start = chain.initial.reshape(2, -1)
    np.testing.assert_allclose(start.sum(axis=1), [0.7, 0.3])
    np.testing.assert_allclose(chain.nodes @ start[1] / 0.3, [1, 0], atol=1e-4)
    point = int(np.argmin(((chain.nodes - np.array([[1.0], [0.5]])) ** 2).sum(axis=0)))
    dist = np.zeros((2 * count, 1))
    dist[point] = 1.0  # in mode 0
    later = chain.move(dist, 2.0, 3.0).reshape(2, -1)
    here = chain.nodes[:, point]
    chance = 0.4 + 0.5 * np.exp(-(here[0] ** 2))
    np.testing.assert_allclose(later.sum(axis=1), [chance, 1 - chance], rtol=1e-9)
    first = [here[0] / 2, here[1] - here[0] / 2]
    second = [1 - here[0] / 2, here[1] / 2] if drives == "new" else first
    for part, wanted in zip(later, (first, second), strict=True):
        np.testing.assert_allclose(chain.nodes @ part / part.sum(), wanted, atol=1e-6)
    found = chain.log_likelihood(0.0, np.array([[0.4]]))[0].reshape(2, -1)
    np.testing.assert_allclose(found, norm.logpdf(0.4, chain.nodes), rtol=1e-12)


# Exact propagation
