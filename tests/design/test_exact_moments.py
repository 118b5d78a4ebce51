"""Designs of linear systems from exact moments: shifts, constants, known and wide starts."""

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.linearization import Taylor
from seedslib.models import JumpDiffusion, Noise

x1, x2, v1, v2, z, t = sympy.symbols("x1 x2 v1 v2 z t")
TIMES = np.array([0.5, 0.8, 1.6, 2.0, 3.1])


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
