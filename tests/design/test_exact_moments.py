"""Designs from exact moments do not depend on where the origin lies."""

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.linearization import Taylor
from seedslib.models import JumpDiffusion, Noise

x1, x2, v, u = sympy.symbols("x1 x2 v u")
TIMES = np.arange(6) * 0.5
SMALL = 1e-6
"""Deviations beside an origin at 1e6: less than any floor relative to second moments."""


def oscillator(origin, more=()):
    return JumpDiffusion(
        (x1, x2), [x2 - origin, -(x1 - origin) - 0.3 * (x2 - origin)], [[0], [SMALL / 2]],
        [x1 - origin + v, *more], Noise((v,), cov=[[SMALL**2 / 10]]), [origin + SMALL, origin],
        SMALL**2 * np.eye(2), step=0.1,
    )  # fmt: skip


@pytest.mark.parametrize("memory", [Memory(3), Memory(1, 2)])
def test_a_shift_of_the_origin_moves_no_gain(memory):
    options = {"exact_moments": True, "nodes": 1}
    here, there = (
        synthesize(oscillator(c), memory, Taylor(), TIMES, **options) for c in (0.0, 1e6)
    )
    for a, b in zip(here.fits, there.fits, strict=True):
        np.testing.assert_allclose(b.gain, a.gain, rtol=1e-12)
        np.testing.assert_allclose(b.cov, a.cov, rtol=1e-12)
        assert np.abs(a.gain).max() > 0.1
    for a, b in zip(here.node_fits[2], there.node_fits[2], strict=True):
        np.testing.assert_allclose(b.gain, a.gain, rtol=1e-12)
    np.testing.assert_allclose(there.predicted.rms, here.predicted.rms, rtol=1e-6)


def test_the_units_do_not_matter_and_a_constant_is_no_regressor():
    """A second measured component without noise or state in it: it must not become a memory."""
    made = synthesize(
        oscillator(1e6, [sympy.Integer(3)]), Memory(0, 2), Taylor(), TIMES, exact_moments=True
    )
    plain = synthesize(oscillator(1e6), Memory(0, 2), Taylor(), TIMES, exact_moments=True)
    for a, b in zip(made.fits, plain.fits, strict=True):
        np.testing.assert_allclose(a.gain[:, ::2], b.gain, rtol=1e-9)
        assert not a.gain[:, 1::2].any()
