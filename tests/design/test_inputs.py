"""Designs for known inputs are those for the same course as a function of time."""

import numpy as np
import pytest
import sympy

from seedslib.base import Input
from seedslib.design import Continuous, synthesize
from seedslib.designed import Memory, load, save
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

x, v, w, t = sympy.symbols("x v w t")
u = Input("u")
VALUES = np.array([0.5, -1.0, 2.0, 0.3, 1.0])


def continuous(u):
    sensor = [x + u / 3 + (1 + u / 8) * w]
    return JumpDiffusion([x], [u - x], [[1 + u / 5]], sensor, Noise((w,)), [0], [[1]], step=0.05)


def linear(u):
    return JumpDiffusion([x], [u - x], [[1 + u / 5]], [x + u / 3 + w], Noise((w,)), [0], [[1]])


def discrete(u):
    moves = StochasticMap([x], [0.8 * sympy.sin(x) + u + 0.3 * v], Noise((v,)))
    return DiscreteSystem(moves, StochasticMap([x], [x + u * x / 5 + w], Noise((w,))), [0], [[1]])


def switching(u):
    stay = 1 / (1 + sympy.exp(-u))
    leave, moves = [[stay, 1 - stay], [1 - stay, stay]], [[x / 2 + u + v], [x / 2 - u + 2 * v]]
    first = [(0.5, [0], [[1]]), (0.5, [1], [[1]])]
    return SwitchingSystem(
        [x], moves, Noise((v,)), leave, [[x + u / 5 + w], [x + w / 2]], Noise((w,)), first
    )


def both(kind):
    """Times with a late start, uneven where they may be, and the system in both ways."""
    uneven = kind in (continuous, linear)
    times = [0.5, 0.9, 1.6, 1.9, 2.8] if uneven else [1.0, 2.0, 3.0, 4.0, 5.0]
    steps = zip(VALUES, times[1:], strict=False)
    course = sympy.Piecewise(*((value, t < end) for value, end in steps), (VALUES[-1], True))
    return times, kind(u), kind(course)


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        (continuous, {}),
        (continuous, {"availability": 0.8}),
        (continuous, {"predictor": Continuous()}),
        (linear, {"exact_moments": True}),
        (discrete, {}),
        (discrete, {"availability": 0.8}),
        (switching, {}),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_inputs_of_a_design_are_a_course_of_time(kind, more, tmp_path):
    """On its own paths, on those held out, in a run and in a file."""
    times, told, written = both(kind)
    memory = Memory(0, 1) if kind is linear else Memory(1)
    if "exact_moments" not in more:
        more = {"paths": 1500, "seed": 3, **more}
    made = synthesize(told, memory, Taylor(), times, inputs={u: VALUES}, **more)
    wanted = synthesize(written, memory, Taylor(), times, **more)
    np.testing.assert_allclose(made.predicted.rms, wanted.predicted.rms, rtol=1e-6)
    if made.held_out is not None:
        np.testing.assert_allclose(made.held_out.rms, wanted.held_out.rms, rtol=1e-8)
    y = written.simulate(times, 6, 1, availability=more.get("availability")).measurements
    one, two = made.run(times, y, inputs={u: VALUES}).mean, wanted.run(times, y).mean
    np.testing.assert_allclose(one, two, rtol=1e-6)
    other = made.run(times, y, inputs={u: VALUES + 1}).mean
    assert not np.allclose(other, one, rtol=1e-3)
    with pytest.raises(ValueError, match=r"\bu\b"):
        synthesize(told, memory, Taylor(), times, **more)
    save(made, tmp_path / "f.npz")
    again = load(tmp_path / "f.npz", told).run(times, y, inputs={u: VALUES})
    np.testing.assert_array_equal(again.mean, one)
