"""How far ours and theirs are apart, kept for the table of `benchmarks/peers_table.py`."""

import numpy as np
import pytest


def distance(ours, theirs):
    """Largest difference, relative to the largest entry of theirs where that is above one."""
    ours, theirs = np.asarray(ours, dtype=float), np.asarray(theirs, dtype=float)
    assert ours.shape == theirs.shape
    assert np.isfinite(theirs).all()
    return float(np.abs(ours - theirs).max() / max(1.0, np.abs(theirs).max()))


@pytest.fixture
def held(record_property):
    """``held(peer, what, (ours, theirs), ...)``: equal to 1e-10; the largest distance is kept.

    Another bound wants a reason.
    """

    def held(peer, what, *pairs, bound=1e-10, reason=""):
        assert reason or bound <= 1e-10
        found = max(distance(*pair) for pair in pairs)
        record_property("held", (peer, what, found, reason))
        assert found <= bound

    return held


@pytest.fixture
def apart(record_property):
    """``apart(peer, what, reason, ours, theirs, least)``: they differ, and why."""

    def apart(peer, what, reason, ours, theirs, least):
        found = distance(ours, theirs)
        record_property("held", (peer, what, found, reason))
        assert found >= least

    return apart
