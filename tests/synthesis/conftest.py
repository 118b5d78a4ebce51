"""What the tests of interrupted and of distributed designs share."""

import numpy as np
import pytest

from seedslib.systems import zoo


@pytest.fixture(scope="module")
def oscillator():
    return zoo.van_der_pol()


@pytest.fixture
def same():
    """Whether two designs agree bit by bit."""

    def agree(one, two):
        parts = []
        for filter in (one, two):
            fits = [*filter.fits, *(fit for row in filter.node_fits for fit in row)]
            parts.append(
                [filter.start.mean, filter.start.cov, *filter.start.moments, *filter.predicted]
                + [np.asarray(part) for fit in fits for part in fit]
            )
        equal = (np.array_equal(a, b) for a, b in zip(*parts, strict=True))
        return all(equal) and one.design == two.design

    return agree
