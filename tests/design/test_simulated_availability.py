"""Tables on simulated paths that condition on what has arrived."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.design import grid_synthesis, simulated_synthesis
from seedslib.designed import Memory, load, save
from seedslib.filters import extended_kalman
from seedslib.models import DiscreteSystem, Noise, StochasticMap

p, q, v, w = sympy.symbols("p q v w", real=True)
TIMES = np.arange(8.0)
AXES = {"y": (-11, 11, 45), "z": (-9, 9, 45)}


@pytest.fixture(scope="module")
def system():
    return DiscreteSystem(
        StochasticMap([p], [0.95 * p + q], Noise([q], cov=[[0.7]])),
        StochasticMap([p], [p + v], Noise([v])), [0.5], [[1.0]],
    )  # fmt: skip


def claims(found):
    return np.sqrt(found.cov.reshape(len(found.cov), -1))


def test_claims_after_a_silence_are_those_of_the_kalman_filter(system, tmp_path):
    made = simulated_synthesis(system, Memory(1), TIMES, paths=4000, seed=1, method="histogram",
                               availability=0.8, **AXES)  # fmt: skip
    data = system.simulate(TIMES, 2000, 3)
    for count in (1, 5):
        y = data.measurements.copy()
        y[2 : 2 + count] = np.nan
        found = made.run(TIMES, y, covariances=True)
        best = extended_kalman(system).run(TIMES, y)
        right = np.sqrt(best.cov.reshape(len(TIMES), -1)[:, 0])
        assert np.abs(claims(found).mean(axis=1) / right - 1).max() < 4 / np.sqrt(2 * 4000)
        # on the same paths, what the filter has more than the Kalman filter
        square = (found.mean - data.states)[:, 0] ** 2
        more = square - (best.mean - data.states)[:, 0] ** 2
        assert (more.mean(axis=1) / right**2 < 0.04 + 4 * more.std(axis=1) / np.sqrt(2000)).all()
    save(made, tmp_path / "f.npz")
    again = load(tmp_path / "f.npz").run(TIMES, y, covariances=True)
    np.testing.assert_array_equal(again.mean, found.mean)
    np.testing.assert_array_equal(again.cov, found.cov)
    np.testing.assert_allclose(made.held_out.rms, made.predicted.rms, rtol=0.15)


@pytest.mark.parametrize("method", ["likelihood", "histogram"])
def test_a_part_of_two_sensors(method):
    """The table of one component: its likelihood summed over the other, or counted without it."""
    pair = DiscreteSystem(
        StochasticMap([p], [0.8 * p + q], Noise([q])),
        StochasticMap([p], [p + v, p - w], Noise([v, w], cov=np.diag([1.0, 0.3]))), [0.0], [[2.0]],
    )  # fmt: skip
    axes = {"y": [(-8, 8, 21), (-7, 7, 25)], "z": (-6, 6, 25)}
    mask = np.array([[True, True], [False, True], [True, False]])
    made = simulated_synthesis(pair, Memory(1), TIMES[:3], paths=2000, seed=1, method=method,
                               measured=mask, **axes)  # fmt: skip
    y = pair.simulate(TIMES[:3], 1500, 4, measured=mask).measurements
    best = extended_kalman(pair).run(TIMES[:3], y)
    found = made.run(TIMES[:3], y, covariances=True)
    right = np.sqrt(best.cov.reshape(3, -1)[:, 0])
    np.testing.assert_allclose(claims(found)[:, 0], right, rtol=4 / np.sqrt(2 * 2000))
    apart = np.sqrt(((found.mean - best.mean) ** 2).mean(axis=2)[:, 0])
    assert (apart < 0.3 * right).all()


def test_modes_and_forecasts_between_are_those_of_the_exact_design():
    system, times = zoo.scalar_switching("A1L"), TIMES[:4]
    axes = {"z": (-6, 6, 41), "y": (-11, 13, 61)}
    exact = grid_synthesis(system, Memory(1), times, x=(-8, 8, 65), availability=0.7, **axes)
    made = simulated_synthesis(system, Memory(1), times, paths=3000, seed=1, availability=0.7,
                               method="histogram", **axes)  # fmt: skip
    doubt = 5 * made.predicted.error[:, 0] + 0.03 * exact.predicted.rms[:, 0]
    assert (np.abs(made.predicted.rms - exact.predicted.rms)[:, 0] < doubt).all()
    assert (np.abs(made.predicted.mode_rate - exact.predicted.mode_rate) < 0.03).all()
    flip, times = zoo.flip_process(), 0.25 * np.arange(3)
    axes = {"z": (-2.4, 2.4, 41), "y": (-8, 8, 41)}
    exact = grid_synthesis(flip, Memory(1), times, x=(-3.5, 3.5, 57), availability=0.5, nodes=1,
                           **axes)  # fmt: skip
    told = {"paths": 2000, "seed": 1, "method": "histogram", "nodes": 1, **axes}
    made = simulated_synthesis(flip, Memory(1), times, availability=0.5, **told)
    np.testing.assert_allclose(made.predicted.rms, exact.predicted.rms, rtol=0.08)


def test_what_is_sure_is_the_old_design_and_what_does_not_fit_is_refused(system, tmp_path):
    told = {"paths": 500, "seed": 1, "method": "histogram", **AXES}
    for name, more in (("a", {}), ("b", {"availability": 1.0})):
        made = simulated_synthesis(system, Memory(1), TIMES[:3], **told, **more)
        save(made, tmp_path / f"{name}.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with pytest.raises(ValueError, match="memory: wanted estimates alone for a sensor with"):
        simulated_synthesis(system, Memory(0, 1), TIMES[:3], availability=0.5, **told)
    with pytest.raises(ValueError, match="availability: wanted a probability"):
        simulated_synthesis(system, Memory(1), TIMES[:3], availability=2, **told)
