"""Designs for a known course of inputs are those for the course as a function of time."""

import numpy as np
import pytest
import sympy as sp

from seedslib.base import ELAPSED, Input
from seedslib.design import affine_synthesis, grid_risk, grid_synthesis, optimal_risk, synthesize
from seedslib.designed import Memory, load, save
from seedslib.evaluation import compare
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

x, v, w, t = sp.symbols("x v w t")
u = Input("u")
TIMES = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
VALUES = np.array([0.5, -1.0, 2.0, 0.3, 1.0])
COURSE = sp.Piecewise(*((c, t < b) for c, b in zip(VALUES, TIMES[1:], strict=False)), (1, True))
TOLD = {u: VALUES}
AXIS = -14, 14, 141


def continuous(u):
    return JumpDiffusion(
        [x], [u - x], [[1 + u / 5]], [x + u / 3 + w], Noise((w,)), [0], [[1]], step=0.05
    )


def discrete(u):
    moves = StochasticMap([x], [0.8 * sp.sin(x) + u + 0.3 * v], Noise((v,)))
    return DiscreteSystem(moves, StochasticMap([x], [x + u * x / 5 + w], Noise((w,))), [0], [[1]])


def switching(u):
    stay = 1 / (1 + sp.exp(-u))
    leave, moves = [[stay, 1 - stay], [1 - stay, stay]], [[x / 2 + u + v], [x / 2 - u + 2 * v]]
    first = [(0.5, [0], [[1]]), (0.5, [1], [[1]])]
    return SwitchingSystem(
        [x], moves, Noise((v,)), leave, [[x + u / 5 + w], [x + w / 2]], Noise((w,)), first
    )


KINDS = [continuous, discrete, switching]


@pytest.mark.parametrize("kind", KINDS)
def test_simulated_designs(kind):
    told, written = kind(u), kind(COURSE)
    more = {"paths": 6000, "seed": 3}
    found = synthesize(told, Memory(2), Taylor(), TIMES, inputs=TOLD, **more)
    wanted = synthesize(written, Memory(2), Taylor(), TIMES, **more)
    assert np.allclose(found.predicted.rms, wanted.predicted.rms, rtol=1e-11)
    assert np.allclose(found.held_out.rms, wanted.held_out.rms, rtol=1e-11)
    data = written.simulate(TIMES, 6, 1)
    runs = found.run(TIMES, data.measurements, inputs=TOLD), wanted.run(TIMES, data.measurements)
    assert np.allclose(runs[0].mean, runs[1].mean, rtol=1e-10)
    alone = found.run(TIMES, data.measurements[..., 2], inputs=TOLD).mean
    assert np.allclose(alone, runs[0].mean[..., 2], rtol=1e-10)
    other = found.run(TIMES, data.measurements, inputs={u: VALUES + 1}).mean
    assert not np.allclose(other, runs[0].mean, rtol=1e-3)  # the sensor has them
    with pytest.raises(ValueError, match="wanted values of u"):
        found.run(TIMES, data.measurements)
    with pytest.raises(ValueError, match="wanted values of u"):
        synthesize(told, Memory(2), Taylor(), TIMES, **more)


def test_threads_files_and_checkpoints(tmp_path):
    system, more = continuous(u), {"paths": 20_000, "seed": 3, "nodes": 0}
    place = tmp_path / "progress.npz"
    found = synthesize(
        system, Memory(1), Taylor(), TIMES, inputs=TOLD, checkpoint=place, workers=3, **more
    )
    again = synthesize(system, Memory(1), Taylor(), TIMES, inputs=TOLD, checkpoint=place, **more)
    assert np.array_equal(found.predicted.rms, again.predicted.rms)
    plain = synthesize(system, Memory(1), Taylor(), TIMES, inputs=TOLD, **more)
    assert np.array_equal(found.predicted.rms, plain.predicted.rms)
    with pytest.raises(ValueError, match="differs in input u"):
        synthesize(
            system, Memory(1), Taylor(), TIMES, inputs={u: -VALUES}, checkpoint=place, **more
        )
    save(found, tmp_path / "f.npz")
    read = load(tmp_path / "f.npz", system)
    y = system.simulate(TIMES, 4, 0, inputs=TOLD).measurements
    assert np.array_equal(
        read.run(TIMES, y, inputs=TOLD).mean, found.run(TIMES, y, inputs=TOLD).mean
    )
    with pytest.raises(ValueError, match="differs"):
        load(tmp_path / "f.npz", continuous(2 * u))
    scored = compare({"f": found}, system, TIMES, 4000, 9, inputs=TOLD)["f"]
    gap = np.abs(scored.rms - found.predicted.rms)
    assert (gap < 5 * np.hypot(scored.rms_error, found.predicted.error)).all()


def test_exact_moments():
    def system(u):
        sensor = [x * (1 + u / 4) + u / 3 + w]  # its gain changes the errors, its shift none
        return JumpDiffusion([x], [u - x], [[1]], sensor, Noise((w,)), [0], [[1]])

    told, written = system(u), system(COURSE)
    more = {"exact_moments": True, "nodes": 2}
    found = synthesize(told, Memory(1), Taylor(), TIMES, inputs=TOLD, **more)
    wanted = synthesize(written, Memory(1), Taylor(), TIMES, **more)
    assert np.allclose(found.predicted.rms, wanted.predicted.rms, rtol=1e-9)
    for one, other in zip(found.fits, wanted.fits, strict=True):
        assert np.allclose(one.offset, other.offset, rtol=1e-9)


@pytest.mark.parametrize("kind", [continuous, switching])
def test_designs_on_the_law(kind):
    told, written = kind(u), kind(COURSE)
    more = {"x": AXIS, "z": (-12, 12, 97)}
    found = grid_synthesis(told, Memory(1), TIMES, inputs=TOLD, **more)
    wanted = grid_synthesis(written, Memory(1), TIMES, **more)
    assert np.allclose(found.predicted.rms, wanted.predicted.rms, rtol=1e-10)
    assert np.ptp(found.predicted.rms) > 0.01
    y = written.simulate(TIMES, 4, 0).measurements
    tables = found.run(TIMES, y, inputs=TOLD).mean, wanted.run(TIMES, y).mean
    assert np.allclose(*tables, rtol=1e-9)
    risk = optimal_risk(told, Memory(1), TIMES, inputs=TOLD, **more)
    assert np.allclose(risk.mse, optimal_risk(written, Memory(1), TIMES, **more).mse, rtol=1e-10)


def test_moments_and_risk_on_the_law():
    told, written, more = continuous(u), continuous(COURSE), {"x": AXIS, "z": (-12, 12, 97)}
    found, risk = affine_synthesis(told, Memory(1), Taylor(), TIMES, inputs=TOLD, **more)
    wanted, other = affine_synthesis(written, Memory(1), Taylor(), TIMES, **more)
    assert np.allclose(risk.mse, other.mse, rtol=1e-10)
    assert np.allclose(found.fits[2].offset, wanted.fits[2].offset, rtol=1e-9)
    again = grid_risk(found, inputs=TOLD, **more)
    assert np.allclose(again.mse, grid_risk(wanted, **more).mse, rtol=1e-9)
    assert np.allclose(again.mse, risk.mse, rtol=1e-6)


def test_a_design_on_irregular_times_of_a_map_that_sees_the_elapsed_time():
    times = np.array([0.0, 0.2, 1.0, 1.1, 2.4])
    fade = sp.exp(-ELAPSED)
    move = [fade * x + sp.sqrt((1 - fade**2) / 2) * v]
    sensor = StochasticMap([x], [x + w], Noise((w,)))
    system = DiscreteSystem(StochasticMap([x], move, Noise((v,))), sensor, [0], [[1]])
    found = synthesize(system, Memory(1), Taylor(), times, paths=20_000, seed=1)
    same = JumpDiffusion([x], [-x], [[1]], [x + w], Noise((w,)), [0], [[1]])
    exact = synthesize(same, Memory(1), Taylor(), times, exact_moments=True, nodes=0)
    gap = np.abs(found.predicted.rms - exact.predicted.rms)
    assert (gap < 4.5 * found.predicted.error).all()
