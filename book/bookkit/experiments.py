"""What chapters do to a filter to see why another one loses."""

from __future__ import annotations

from typing import Any

import numpy as np


def averaged(filter: Any, times: np.ndarray, y: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Means when covariances are, before each correction, means over other records.

    So a filter that carries a covariance knows as little of its own record's past as one that was
    designed with one covariance for all, and nothing else is changed.

    Parameters
    ----------
    filter : CovarianceFilter
    times : ndarray, shape (K+1,)
    y, others : ndarray, shape (K+1, m, runs)
        The records to be filtered, and those that covariances are averaged over.

    Returns
    -------
    ndarray, shape (K+1, n, runs)
    """
    state, other = (filter.initial((part.shape[2],)) for part in (y, others))
    means = []
    for k, t in enumerate(times):
        state, other = filter.predict(state, t), filter.predict(other, t)
        cov = other.cov if other.cov.ndim == 2 else other.cov.mean(axis=2)
        wide = np.ascontiguousarray(np.broadcast_to(cov[..., None], (*cov.shape, y.shape[2])))
        state = filter.correct(state._replace(cov=wide), y[k])
        other = filter.correct(other, others[k])
        means.append(state.mean)
    return np.array(means)
