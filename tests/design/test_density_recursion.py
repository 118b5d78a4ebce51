"""Theorems 1 and 2 for a state of two components: the density recursion on a grid of the plane."""

import csv
from pathlib import Path

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import Axis
from seedslib.base.tables import mesh
from seedslib.design import plane_steps
from seedslib.models import JumpDiffusion, Noise, PlaneChain, PlaneModes, SwitchingSystem
from seedslib.models.chains.plane import shared

x1, x2, v1, v2, w = sympy.symbols("x1 x2 v1 v2 w", real=True)
TABLE = Path(__file__).parents[2] / "benchmarks" / "density_recursion.csv"
TURN = np.array([[0.8, 0.4], [-0.4, 0.8]])


def switching(modes=2):
    """A turn, or a turn and a pull to the side, that switch with the second component."""
    turn = [sum(TURN[i, j] * x for j, x in enumerate((x1, x2))) for i in (0, 1)]
    moves = [[turn[0] + v1, turn[1] + v2], [x1 / 2 - 1 + v1, x2 / 2 + 1 + v2]][:modes]
    leave = 2 / (5 * (1 + sympy.exp(1 - x2)))
    return SwitchingSystem(
        (x1, x2), moves, Noise((v1, v2), cov=np.eye(2) / 4),
        [[1 - leave, leave], [0.3, 0.7]] if modes == 2 else [[1]],
        [[x1 + w], [x1 + x2 / 2 + w]][:modes], Noise((w,)),
        [(1 / modes, [0, 0], [[1, 0], [0, 1]])] * modes,
    )  # fmt: skip


def by_loops(chain, times, z, y, steps):
    """(4.4)-(4.10) written out: a dictionary from (memory) to the law of the chain."""
    nodes, values, modes = mesh(z), chain.values, chain.modes
    shown = mesh(y)
    likely = np.exp(chain.log_likelihood(0.0, shown)) * y[0].weights[:, None]
    likely /= likely.sum(axis=0)
    label = np.repeat(np.arange(modes), values.shape[1] // modes)
    joint, found = {None: chain.start()}, []
    for k in range(steps):
        square, wrong, new = 0.0, 0.0, {}
        for law in joint.values():
            for seen in likely:
                part = seen * law
                mass = part.sum()
                if mass < 1e-14:
                    continue
                mean = values @ part / mass
                square = square + ((values - mean[:, None]) ** 2 @ part)
                shares = np.array([part[label == i].sum() for i in range(modes)])
                mode = int(shares.argmax())
                wrong += mass - shares[mode]
                for corner, node in enumerate(nodes.T):
                    near = np.prod(
                        [
                            max(0.0, 1 - abs(np.clip(m, a.low, a.high) - c) / a.step)
                            for m, c, a in zip(mean, node, z, strict=True)
                        ]
                    )
                    if near:
                        new[mode, corner] = new.get((mode, corner), 0.0) + near * part
        found.append((*square, wrong))
        if k + 1 < steps:
            joint = {
                u: chain.move(law[:, None], times[k], times[k + 1])[:, 0] for u, law in new.items()
            }
            total = sum(law.sum() for law in joint.values())
            joint = {u: law / total for u, law in joint.items()}
    return np.array(found)


@pytest.mark.parametrize("kind", ["diffusion", "modes"])
def test_recursion_against_loops(kind):
    z, y = (Axis(-1.5, 1.5, 3), Axis(-1.0, 2.0, 4)), (Axis(-4.0, 4.0, 9),)
    if kind == "modes":
        chain, times = PlaneModes(switching(), [(-3, 3, 11), (-3, 3, 11)]), [0.0, 1.0, 2.0]
    else:
        chain = PlaneChain(zoo.linear_gaussian(), [(-4, 4, 13), (-4, 4, 13)], 0.25)
        times = [0.0, 0.5, 1.0]
    wanted = by_loops(chain, times, z, y, 3)
    found = [(*s.mse, s.mode_error) for s in plane_steps(chain, times, z=z, y=y)]
    np.testing.assert_allclose(found, wanted, atol=2e-5)


def kalman(move, noise, sensor, loud, steps):
    """Error variances of both components after each measurement."""
    cov, found = np.eye(2), []
    for k in range(steps):
        cov = move @ cov @ move.T + noise if k else cov
        cross = cov @ sensor
        cov = cov - np.outer(cross, cross) / (sensor @ cross + loud)
        found.append(np.diag(cov))
    return np.array(found)


def test_linear_system_of_one_mode_is_the_kalman_filter():
    """The loss by rounding the memory falls with the square of the step."""
    chain = PlaneModes(switching(1), [(-5, 5, 25), (-5, 5, 25)])
    wanted = kalman(TURN, np.eye(2) / 4, np.array([1.0, 0.0]), 1.0, 4)
    lost = [
        np.array([s.mse for s in plane_steps(chain, range(4), z=[(-3, 3, n)] * 2, y=(-9, 9, 22))])
        - wanted
        for n in (13, 25)
    ]
    assert (lost[0][1:] > -5e-5).all()
    assert np.abs(lost[0][0]).max() < 2e-4
    assert lost[0][-1].sum() / lost[1][-1].sum() == pytest.approx(4, rel=0.15)
    np.testing.assert_allclose(lost[1][-1], 0, atol=0.016)


def test_functions_are_those_of_the_step_that_is_left():
    """A turn that shrinks by a factor of the time: Kalman's covariances with the factor at k."""
    t = sympy.Symbol("t")
    factor = sympy.Rational(1, 2) + t / 2
    moves = [factor * sum(TURN[i, j] * x for j, x in enumerate((x1, x2))) for i in (0, 1)]
    system = SwitchingSystem(
        (x1, x2), [[moves[0] + v1, moves[1] + v2]], Noise((v1, v2), cov=np.eye(2) / 4), [[1]],
        [[x1 + w]], Noise((w,)), [(1, [0, 0], np.eye(2))],
    )  # fmt: skip
    steps = plane_steps(
        PlaneModes(system, [(-5, 5, 25)] * 2), [0, 1, 2], z=[(-3, 3, 13)] * 2, y=(-9, 9, 25)
    )
    found, cov = [s.mse for s in steps], np.eye(2)
    for k, errors in enumerate(found):
        if k:
            move = k / 2 * TURN
            cov = move @ cov @ move.T + np.eye(2) / 4
        cov = cov - np.outer(cov[:, 0], cov[0]) / (cov[0, 0] + 1)
        np.testing.assert_allclose(errors, np.diag(cov), rtol=0.1 if k == 2 else 0.02)


def test_linear_law_moves_with_an_error_of_second_order():
    from seedslib.models import van_loan

    system, drift = zoo.linear_gaussian(), np.array([[0.0, 1.0], [-1.0, -0.4]])
    move, noise = van_loan(drift, np.diag([0.0, 1.0]), 0.5)
    mean, cov = move @ system.mean0, move @ np.eye(2) @ move.T + noise
    missed = []
    for substep in (0.25, 0.125):
        chain = PlaneChain(system, [(-7, 7, 57), (-7, 7, 57)], substep)
        law = chain.move(chain.start()[:, None], 0.0, 0.5)[:, 0]
        about = chain.values - (chain.values @ law)[:, None]
        missed.append([*(chain.values @ law - mean), *((about * law) @ about.T - cov).ravel()])
        back = chain.back(chain.values, 0.0, 0.5)
        np.testing.assert_allclose(back @ chain.start(), chain.values @ law, atol=1e-4)
    assert np.abs(missed[1]).max() < 2.5e-3
    assert np.abs(missed[1]).max() < 0.3 * np.abs(missed[0]).max()


def test_linear_diffusion_is_the_kalman_filter():
    """Splitting and grid together miss the exact covariances by less than one per cent."""
    from scipy.linalg import expm

    drift, length = np.array([[0.0, 1.0], [-1.0, -0.4]]), 0.5
    move = expm(drift * length)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    flow = [expm(drift * length * (1 + s) / 2)[:, 1] for s in nodes]
    noise = sum(length / 2 * a * np.outer(f, f) for a, f in zip(weights, flow, strict=True))
    wanted = kalman(move, noise, np.array([1.0, 0.0]), 0.25, 2)
    chain = PlaneChain(zoo.linear_gaussian(), [(-5, 5, 41), (-5, 5, 41)], 0.025)
    coarse, fine = (
        np.array([s.mse for s in plane_steps(chain, [0, 0.5], z=[(-3, 4, n)] * 2, y=(-9, 9, 37))])
        for n in (15, 29)
    )
    assert (coarse[1] > fine[1]).all()
    np.testing.assert_allclose(fine + (fine - coarse) / 3, wanted, rtol=8e-3)


def test_law_of_the_oscillator_is_that_of_its_paths():
    chain = PlaneChain(zoo.van_der_pol(), [(-4.5, 4.5, 41), (-6, 6, 41)], 0.05)
    law = chain.move(chain.start()[:, None], 0.0, 1.0)[:, 0]
    assert law.sum() == pytest.approx(1, abs=1e-3)
    paths = zoo.van_der_pol().simulate([0, 1], 20_000, 1, step=0.005).states[1]
    for power in (1, 2):
        drawn = paths**power
        wanted = (chain.values**power) @ law / law.sum()
        error = drawn.std(axis=1) / np.sqrt(20_000)
        # Euler's method at this step and the splitting miss a little more than that
        assert (np.abs(drawn.mean(axis=1) - wanted) < 4 * error + 0.005 * np.abs(wanted)).all()


def rows(kind):
    with TABLE.open() as file:
        return [
            np.array([[float(row[f"{name}_{t:g}"]) for t in np.arange(0.5, 3.1, 0.5)]
                      for name in ("rms", "error")])
            for row in csv.DictReader(file) if row["kind"] == kind
        ]  # fmt: skip


def test_errors_of_the_oscillator():
    """The table's coarsest grid again; finer ones come between the posterior and its neighbours.

    Means over neighbours are above the optimum, but for their standard error, and so is every
    grid; what remembers everything is below.
    """
    chain = PlaneChain(zoo.van_der_pol(), [(-4.5, 4.5, 41), (-6, 6, 41)], 0.1)
    y = [(-5, 25, 31), (-10, 10, 21)]
    coarse = plane_steps(chain, 0.5 * np.arange(3), z=[(-4, 4, 21), (-5, 3, 16)], y=y)
    found = [np.sqrt(s.mse[0]) for s in coarse][1:]
    grids, near, all_known = rows("grid"), rows("neighbours"), rows("particles")[0]
    np.testing.assert_allclose(found, grids[0][0, :2], atol=6e-5)
    limit = grids[3][0] + (grids[3][0] - grids[2][0]) / 3
    assert (grids[5][0] < grids[3][0]).all()
    np.testing.assert_allclose(limit, grids[5][0], rtol=0.015)
    bound, spread = np.mean([r[0] for r in near], axis=0), np.mean([r[1] for r in near], axis=0)
    assert (limit < bound + 4 * spread / np.sqrt(len(near))).all()
    assert (limit > all_known[0] - 4 * all_known[1]).all()


def test_narrow_laws_keep_their_moments():
    axis = Axis(-3.0, 3.0, 25)
    mean, deviation = np.array([0.11, -1.3, 0.9]), np.array([0.0, 0.05, 0.19])
    mass = shared(axis, mean, deviation)
    raw = [mean**0, mean, mean**2 + deviation**2, mean**3 + 3 * mean * deviation**2]
    raw += [mean**4 + 6 * (mean * deviation) ** 2 + 3 * deviation**4]
    for power, wanted in enumerate(raw):
        np.testing.assert_allclose(axis.nodes**power @ mass, wanted, atol=1e-12)
    wide = shared(axis, np.array([0.1]), np.array([0.4]))[:, 0]
    assert axis.nodes @ wide == pytest.approx(0.1, abs=1e-6)
    assert axis.nodes**2 @ wide == pytest.approx(0.17, abs=1e-5)


def test_other_systems_are_refused():
    axes = [(-3, 3, 11), (-3, 3, 11)]
    tied = JumpDiffusion((x1, x2), [x2, -x1], [[1], [1]], [x1 + w], Noise((w,)), [0, 0], np.eye(2))
    bent = JumpDiffusion(
        (x1, x2), [x2, -x1], [[0], [1]], [x1 + w**2], Noise((w,)), [0, 0], np.eye(2)
    )
    for make, system, text in (
        (PlaneChain, zoo.flip_process(), "two state components"),
        (PlaneChain, zoo.kicked_duffing(), "no jumps"),
        (PlaneChain, tied, "noises of their own"),
        (PlaneChain, bent, "density"),
        (PlaneModes, zoo.scalar_switching(), "two state components"),
        (PlaneModes, zoo.manoeuvring_target(), "no indicator"),
    ):
        with pytest.raises(ValueError, match=text):
            make(system, axes)
