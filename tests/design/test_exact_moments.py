"""Designs of linear systems from exact moments, against coefficients of all noises."""

from itertools import pairwise

import numpy as np
import pytest
import sympy

from oracles.finite_order import FiniteOrderOracle, transition
from seedslib.design import synthesize
from seedslib.designed import Memory, finite_memory
from seedslib.linearization import Taylor
from seedslib.models import JumpDiffusion, Noise

x1, x2, v1, v2, z, t = sympy.symbols("x1 x2 v1 v2 z t")
u = 2 - 3 * t / 4
TIMES = np.array([0.5, 0.8, 1.6, 2.0, 3.1])
READ = np.array([[True, True], [False, True], [True, True], [False, False], [True, False]])
MEAN0, COV0 = np.array([0.7, -0.4]), np.array([[0.8, 0.3], [0.3, 0.5]])
NOISE_MEAN, NOISE_COV = np.array([0.2, -0.1]), np.array([[0.5, 0.1], [0.1, 0.3]])


def reference_system():
    """Everything at once: coefficients of time, a drive, jumps, a non-symmetric sensor."""
    return JumpDiffusion(
        (x1, x2),
        [x2 - t * x1 / 5 + u, -x1 * (1 + t / 4) - 0.4 * x2 + 1],
        [[0.3, 0.0], [0.2, 1 + t / 3]],
        [x1 + t * x2 / 6 + u / 4 + v1, (x2 - x1 / 3) * (1 + u / 8) + (1 + t / 5) * v2],
        Noise((v1, v2), mean=NOISE_MEAN, cov=NOISE_COV),
        MEAN0,
        COV0,
        intensity=1.5,
        jump=[z / 2, 0.2 - z / 3],
        marks=Noise((z,), cov=[[1.2]]),
    )


def coefficients(time):
    """Matrix, offset and noise intensity of the state; matrix, offset, noise of the sensor."""
    value = 2 - 0.75 * time
    drift = np.array([[-time / 5, 1.0], [-(1 + time / 4), -0.4]])
    shift = np.array([value, 1.0 + 1.5 * 0.2])
    spread = np.array([[0.3, 0.0], [0.2, 1 + time / 3]])
    jumps = 1.5 * (1.2 * np.outer([0.5, -1 / 3], [0.5, -1 / 3]) + np.diag([0.0, 0.04]))
    scale = 1 + value / 8
    sensor = np.array([[1.0, time / 6], [-scale / 3, scale]])
    loud = np.diag([1.0, 1 + time / 5])
    level = np.array([value / 4, 0.0]) + loud @ NOISE_MEAN
    return drift, shift, spread @ spread.T + jumps, sensor, level, loud @ NOISE_COV @ loud


def oracle(memory, components, node_times, read):
    """The filter by regression of everything on everything."""
    moves, sensors = [], []
    parts = [
        lambda at: coefficients(at)[0],
        lambda at: coefficients(at)[1],
        lambda at: np.linalg.cholesky(coefficients(at)[2]),
    ]
    for k, time in enumerate(TIMES):
        sensors.append(coefficients(time)[3:])
        if k + 1 < len(TIMES):
            stops = [time, *node_times[k], TIMES[k + 1]]
            moves.append([transition(*parts, *pair) for pair in pairwise(stops)])
    return FiniteOrderOracle(
        MEAN0,
        COV0,
        moves,
        sensors,
        memory.estimates,
        memory.measurements,
        components,
        read,
    )


@pytest.mark.parametrize(
    ("memory", "components", "gaps"),
    [
        (Memory(1), 2, True),
        (Memory(2), 1, False),
        (Memory(2), 1, True),
        (finite_memory(2), 2, False),
        (Memory(1, 1), 1, False),
        (Memory(1, 1), 1, True),
    ],
)
def test_exact_design_of_the_reference_system_equals_regressions_on_all_noises(
    memory, components, gaps
):
    read = READ if gaps else np.ones_like(READ)
    made = synthesize(
        reference_system(),
        memory,
        Taylor(),
        TIMES,
        components=components,
        nodes=1,
        exact_moments=True,
        measured=read,
    )
    middle = [[(a + b) / 2] for a, b in pairwise(TIMES)]
    for nodes, wanted in zip(made.node_times, middle, strict=True):
        np.testing.assert_allclose(nodes, wanted)
    wanted = oracle(memory, components, made.node_times, read)
    pairs = list(zip(made.fits, wanted.fits[1:], strict=True))
    for fits, others in zip(made.node_fits, wanted.node_fits[:-1], strict=True):
        pairs += zip(fits, others, strict=True)
    for fit, other in pairs:
        np.testing.assert_allclose(fit.cov, other.cov, rtol=1e-7, atol=1e-9)
        # gaps, and estimates beside what they are made of, depend on each other
        if memory == Memory(1) or not (gaps or memory == Memory(1, 1)):
            np.testing.assert_allclose(fit.gain, other.gain, rtol=1e-6, atol=1e-7)
            np.testing.assert_allclose(fit.offset, other.offset, rtol=1e-6, atol=1e-7)
    rms = dict(zip(TIMES, (np.sqrt(np.diagonal(cov)) for cov in wanted.errors), strict=True))
    for times, fits in zip(made.node_times, wanted.node_fits[:-1], strict=True):
        rms.update(zip(times, (np.sqrt(np.diagonal(fit.cov)) for fit in fits), strict=True))
    np.testing.assert_array_equal(made.predicted.times, sorted(rms))
    np.testing.assert_allclose(made.predicted.rms, [rms[k] for k in sorted(rms)], rtol=1e-7)
    np.testing.assert_array_equal(made.predicted.error, 0.0)
    assert made.design.exact
    assert not made.predicted.in_sample
    assert made.held_out is None


def narrow(origin, more=()):
    """An oscillator with deviations of 1e-6 about an origin, and further sensors."""
    return JumpDiffusion(
        (x1, x2),
        [x2 - origin, -(x1 - origin) - 0.3 * (x2 - origin)],
        [[0], [5e-7]],
        [x1 - origin + v1, *more],
        Noise((v1,), cov=[[1e-13]]),
        [origin + 1e-6, origin],
        1e-12 * np.eye(2),
        step=0.1,
    )


@pytest.mark.parametrize("memory", [Memory(3), Memory(1, 2)])
def test_a_shift_of_the_origin_moves_no_gain(memory):
    here, there = (
        synthesize(narrow(c), memory, Taylor(), TIMES[:4], nodes=1, exact_moments=True)
        for c in (0.0, 1e6)
    )
    rows = zip([*here.fits, *here.node_fits[2]], [*there.fits, *there.node_fits[2]], strict=True)
    for one, other in rows:
        np.testing.assert_allclose(other.gain, one.gain, rtol=1e-12)
        np.testing.assert_allclose(other.cov, one.cov, rtol=1e-12)
    np.testing.assert_allclose(there.predicted.rms, here.predicted.rms, rtol=1e-6)


def test_a_constant_measurement_is_no_regressor():
    options = {"exact_moments": True, "nodes": 1}
    memory = Memory(0, 2)
    plain = synthesize(narrow(1e6), memory, Taylor(), TIMES, **options)
    more = synthesize(narrow(1e6, [sympy.Integer(3)]), memory, Taylor(), TIMES, **options)
    for one, other in zip(plain.fits, more.fits, strict=True):
        np.testing.assert_allclose(other.gain[:, ::2], one.gain, rtol=1e-9)
        assert not other.gain[:, 1::2].any()


def test_a_known_start_is_no_regressor_in_either_kind_of_design():
    system = JumpDiffusion((x1,), [-x1], [[1]], [x1 + v1], Noise((v1,)), [0.3], [[0]])
    for options in ({"exact_moments": True}, {"paths": 2000, "seed": 1}):
        made = synthesize(system, Memory(2), Taylor(), [0, 0.5, 1.0], **options)
        assert made.fits[0].gain[0, 0] == 0.0
        assert made.fits[1].gain[0, 1] == 0.0
        assert made.fits[1].gain[0, 0] != 0.0
        assert made.predicted.rms[0, 0] < 1e-12
