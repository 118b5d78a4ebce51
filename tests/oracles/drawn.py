"""Numbers, covariances and records that tests of properties draw."""

import numpy as np
from hypothesis import strategies as st

EIGHTHS = st.integers(-24, 24).map(lambda k: k / 8)
"""Exact in binary: what is derived from them by sums and products is known to the last bit."""


def vectors(size, elements=EIGHTHS):
    """Arrays of this shape."""
    shape = (size,) if isinstance(size, int) else size
    flat = st.lists(elements, min_size=int(np.prod(shape)), max_size=int(np.prod(shape)))
    return flat.map(lambda numbers: np.array(numbers, dtype=float).reshape(shape))


def covariances(size, floor=0.0):
    """Covariances, singular ones among them where there is no floor under the eigenvalues."""
    return vectors((size, size)).map(lambda root: root @ root.T + floor * np.eye(size))
