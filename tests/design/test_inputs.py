"""Designs for known inputs are those for the same course as a function of time."""

import numpy as np
import pytest
import sympy

from seedslib.base import Input
from seedslib.design import affine_synthesis, grid_risk, grid_synthesis, optimal_risk, synthesize
from seedslib.designed import Memory
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

x, v, w, t = sympy.symbols("x v w t")
u = Input("u")
VALUES = np.array([0.5, -1.0, 2.0, 0.3, 1.0])
AXES = {"x": (-14, 14, 141), "z": (-12, 12, 97)}


def continuous(u):
    sensor = [x + u / 3 + (1 + u / 8) * w]
    return JumpDiffusion([x], [u - x], [[1 + u / 5]], sensor, Noise((w,)), [0], [[1]], step=0.05)


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
    times = [0.5, 0.9, 1.6, 1.9, 2.8] if kind is continuous else [1.0, 2.0, 3.0, 4.0, 5.0]
    steps = zip(VALUES, times[1:], strict=False)
    course = sympy.Piecewise(*((value, t < end) for value, end in steps), (VALUES[-1], True))
    return times, kind(u), kind(course), {"inputs": {u: VALUES}}


@pytest.mark.parametrize(
    ("kind", "rate"),
    [(continuous, None), (continuous, 0.8), (discrete, None), (discrete, 0.8), (switching, None)],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_inputs_of_a_simulated_design_are_a_course_of_time(kind, rate):
    """On its own paths, on those held out, and in a run."""
    times, told, written, given = both(kind)
    more = {"paths": 1500, "seed": 3, "availability": rate}
    found = synthesize(told, Memory(1), Taylor(), times, **given, **more)
    wanted = synthesize(written, Memory(1), Taylor(), times, **more)
    np.testing.assert_allclose(found.predicted.rms, wanted.predicted.rms, rtol=1e-9)
    np.testing.assert_allclose(found.held_out.rms, wanted.held_out.rms, rtol=1e-9)
    y = written.simulate(times, 6, 1, availability=rate).measurements
    one, two = found.run(times, y, **given).mean, wanted.run(times, y).mean
    np.testing.assert_allclose(one, two, rtol=1e-8)
    other = found.run(times, y, inputs={u: VALUES + 1}).mean
    assert not np.allclose(other, one, rtol=1e-3)
    with pytest.raises(ValueError, match=r"\bu\b"):
        synthesize(told, Memory(1), Taylor(), times, **more)


@pytest.mark.parametrize("kind", [continuous, switching])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_inputs_of_an_exact_design_are_a_course_of_time(kind):
    """In tables, their runs, their risk, and affine designs; in forecasts between too."""
    times, told, written, given = both(kind)
    found = grid_synthesis(told, Memory(1), times, nodes=1, **given, **AXES)
    wanted = grid_synthesis(written, Memory(1), times, nodes=1, **AXES)
    np.testing.assert_allclose(found.predicted.rms, wanted.predicted.rms, rtol=1e-9)
    assert np.ptp(found.predicted.rms) > 0.01
    y = written.simulate(times, 4, 0).measurements
    one, two = found.run(times, y, **given).mean, wanted.run(times, y).mean
    np.testing.assert_allclose(one, two, rtol=1e-8)
    risk = optimal_risk(told, Memory(1), times, **given, **AXES)
    np.testing.assert_allclose(risk.mse, wanted.covariances[:, 0, 0], rtol=1e-9)
    if kind is switching:
        np.testing.assert_allclose(risk.mode_error, wanted.predicted.mode_rate, rtol=1e-9)
        more, axes = (
            {"paths": 1500, "seed": 3},
            {"x": (-14, 14, 57), "z": (-12, 12, 17), "y": (-16, 16, 49)},
        )
        one = synthesize(told, Memory(1), Taylor(), times, **given, **more)
        two = synthesize(written, Memory(1), Taylor(), times, **more)
        risk, wanted = grid_risk(one, **given, **axes), grid_risk(two, **axes)
        np.testing.assert_allclose(risk.mse, wanted.mse, rtol=1e-8)
        return
    made, risk = affine_synthesis(told, Memory(1), Taylor(), times, **given, **AXES)
    other, wanted = affine_synthesis(written, Memory(1), Taylor(), times, **AXES)
    np.testing.assert_allclose(risk.mse, wanted.mse, rtol=1e-9)
    np.testing.assert_allclose(made.fits[2].offset, other.fits[2].offset, rtol=1e-8)
    again = grid_risk(made, **given, **AXES)
    np.testing.assert_allclose(again.mse, risk.mse, rtol=1e-6)
