"""The density recursion in the plane, against loops, the Kalman filter and forecasts of
distributions."""

import numpy as np
import pytest
import sympy

from oracles.linear import Linear, kalman
from seedslib import zoo
from seedslib.base import Axis
from seedslib.design import PlaneStep, plane_steps
from seedslib.models import Noise, PlaneChain, SwitchingSystem, grid_chain

x1, x2, v1, v2, w = sympy.symbols("x1 x2 v1 v2 w", real=True)
t = sympy.Symbol("t")
TURN = np.array([[0.8, 0.4], [-0.4, 0.8]])


def switching(modes, factor=1):
    """A turn, or a turn and a pull to the side, that switch with the second component."""
    loud = (1 + t) / 3
    turn = [factor * sum(TURN[i, j] * x for j, x in enumerate((x1, x2))) for i in (0, 1)]
    moves = [[turn[0] + v1, turn[1] + v2], [x1 / 2 - 1 + v1, x2 / 2 + 1 + v2]][:modes]
    leave = 2 / (5 * (1 + sympy.exp(1 - x2)))
    return SwitchingSystem(
        (x1, x2),
        moves,
        Noise((v1, v2), cov=np.eye(2) / 4),
        [[1 - leave, leave], [0.3, 0.7]] if modes == 2 else [[1]],
        [[x1 + w * loud], [x1 + x2 / 2 + w * loud]][:modes],
        Noise((w,)),
        [(1 / modes, [0, 0], [[1, 0], [0, 1]])] * modes,
    )


def by_loops(chain, times, z, y):
    """(4.4)-(4.10) written out: a dictionary from (mode, node) to the distribution of the chain."""
    nodes = [np.array([a, b]) for a in z[0].nodes for b in z[1].nodes]
    values, modes = chain.values, chain.modes
    label = np.repeat(np.arange(modes), values.shape[1] // modes)
    joint, found = {None: chain.initial}, []
    for k, time in enumerate(times):
        likely = np.exp(chain.log_likelihood(time, y.nodes[None])) * y.weights[:, None]
        likely /= likely.sum(axis=0)
        square, wrong, new = 0.0, 0.0, {}
        for dist in joint.values():
            for part in likely * dist:
                mass = part.sum()
                if mass < 1e-14:
                    continue
                mean = values @ part / mass
                square = square + ((values - mean[:, None]) ** 2 @ part)
                shares = np.array([part[label == i].sum() for i in range(modes)])
                wrong += mass - shares.max()
                for corner, node in enumerate(nodes):
                    ends = zip(mean, node, z, strict=True)
                    near = np.prod(
                        [
                            max(0.0, 1 - abs(np.clip(m, a.low, a.high) - c) / a.step)
                            for m, c, a in ends
                        ]
                    )
                    if near:
                        cell = int(shares.argmax()), corner
                        new[cell] = new.get(cell, 0.0) + near * part
        found.append((*square, wrong))
        if k + 1 < len(times):
            joint = {
                cell: chain.move(dist[:, None], times[k], times[k + 1])[:, 0]
                for cell, dist in new.items()
            }
            total = sum(dist.sum() for dist in joint.values())
            joint = {cell: dist / total for cell, dist in joint.items()}
    return np.array(found)


@pytest.mark.parametrize("kind", ["diffusion", "modes"])
def test_recursion_equals_loops_over_all_events(kind):
    z, y = (Axis(-1.5, 1.5, 3), Axis(-1.0, 2.0, 4)), Axis(-4.0, 4.0, 9)
    if kind == "modes":
        chain, times = grid_chain(switching(2), [(-3, 3, 9), (-3, 3, 11)]), [1.0, 2.0, 3.0]
    else:
        chain = PlaneChain(zoo.linear_gaussian(), [(-4, 4, 13), (-4, 4, 11)], 0.25)
        times = [0.5, 1.0, 1.75]
    steps = list(plane_steps(chain, times, z=z, y=(y,)))
    found = [(*step.mse, step.mode_error) for step in steps]
    np.testing.assert_allclose(found, by_loops(chain, times, z, y), atol=2e-5)
    assert all(isinstance(step, PlaneStep) for step in steps)
    assert [step.time for step in steps] == times
    assert (steps[-1].mode is None) == (kind == "diffusion")
    # estimates are conditional means of the joint distribution, and the mass is that of the
    # arguments
    step = steps[-1]
    mass = step.likelihood @ step.dist
    np.testing.assert_allclose(step.mass, mass, atol=1e-6)
    mean = np.einsum("ys,is,sc->iyc", step.likelihood, chain.values, step.dist) / mass
    heavy = mass > 1e-3
    np.testing.assert_allclose(step.mean[:, heavy], mean[:, heavy], atol=1e-4)
    assert step.cells.max() < chain.modes * 12


def test_linear_system_of_one_mode_is_the_kalman_filter_of_each_time():
    """Dynamics of time and a late start; rounding is lost with the square of the step."""
    factor, times = sympy.Rational(1, 2) + t / 4, np.array([2.0, 3.0, 4.0])
    chain = grid_chain(switching(1, factor), [(-5, 5, 25), (-5, 5, 25)])
    moves = (0.5 + times[:-1] / 4)[:, None, None] * TURN
    many = np.ones((3, 1, 1))
    model = Linear(
        moves,
        np.zeros((2, 2)),
        many[1:] * np.eye(2) / 4,
        many * [[1.0, 0.0]],
        np.zeros((3, 1)),
        ((1 + times) / 3)[:, None, None] ** 2,
        np.zeros(2),
        np.eye(2),
    )
    wanted = np.diagonal(kalman(model, np.zeros((3, 1))).cov, axis1=1, axis2=2)
    lost = [
        np.array([s.mse for s in plane_steps(chain, times, z=[(-3.2, 3.2, n)] * 2, y=(-9, 9, 22))])
        - wanted
        for n in (11, 21)
    ]
    assert (lost[0][1:] > -5e-5).all()
    assert np.abs(lost[0][0]).max() < 3e-4
    assert lost[0][-1].sum() / lost[1][-1].sum() == pytest.approx(4, rel=0.25)
    np.testing.assert_allclose(lost[1][-1], 0, atol=0.025)
