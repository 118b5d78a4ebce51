"""The paper's bisection between two minimisers."""

import numpy as np
import pytest

from seedslib.pareto import bisect


def test_the_trace_of_a_cube_against_a_square_by_hand():
    """At 1/2, 1/4, 3/8, 7/16 the gap is x² - (1 - x)³ exactly; it need not fall at every step."""
    trace = bisect([lambda x: x**2, lambda x: (1 - x) ** 3], 0.0, 1.0)
    np.testing.assert_array_equal(trace.points[:4], [0.5, 0.25, 0.375, 0.4375])
    gaps = trace.points**2 - (1 - trace.points) ** 3
    np.testing.assert_allclose(trace.gaps, gaps, atol=1e-15)
    assert abs(trace.gaps[1]) > abs(trace.gaps[0])
    assert trace.converged
    assert trace.x == pytest.approx(0.4301597090019, abs=1e-11)
    assert abs(trace.gaps[-1]) <= 1e-12 < np.abs(trace.gaps[:-1]).min()
    step = bisect([lambda x: x, lambda x: float(x < 0.7)], 0.0, 1.0)
    assert (len(step.points), step.converged) == (60, False)


def test_a_segment_of_the_plane_in_other_units():
    first, second = np.array([0.0, 1.0]), np.array([2.0, -1.0])
    criteria = [lambda x: ((x - first) ** 2).sum() + 1.0, lambda x: 3 * np.abs(x - second).sum()]
    found = bisect(criteria, first, second, tolerance=1e-3)
    # at the share s of the segment the losses are s² and 1 - s: the golden section
    share = (np.sqrt(5.0) - 1) / 2
    np.testing.assert_allclose(found.x, first + share * (second - first), atol=2e-3)
    np.testing.assert_allclose(found.losses[0], [0.25, 0.5], rtol=1e-14)
    np.testing.assert_allclose(found.points[:3], [[1.0, 0.0], [1.5, -0.5], [1.25, -0.25]])
    np.testing.assert_allclose(found.gaps, found.losses[:, 0] - found.losses[:, 1])
    assert found.converged
    short = bisect(lambda x: [c(x) for c in criteria], first, second, steps=4)
    assert (len(short.points), short.converged) == (4, False)
