"""Means of the delay filter: a table of gains applied to many records at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from seedslib.base.checks import as_count, as_real
from seedslib.base.semidefinite import LOG_2PI
from seedslib.delay.coefficients import require_finite
from seedslib.delay.gains import DelayGains, StepGains
from seedslib.delay.system import DelaySystem


def as_records(
    value: object, m: int, count: int | None = None
) -> tuple[np.ndarray, tuple[Any, ...]]:
    """Measurements (K+1, m, N) with one batch axis, and the batch axes as given.

    Raises
    ------
    TypeError, ValueError
        A wrong shape, also one of another number of instants than `count`; an infinite value,
        no path, or a measurement at k = 0.
    """
    y = as_real("measurements", value, nan=True)
    if y.ndim < 2 or y.shape[1] != m or len(y) < 2 or (count is not None and len(y) != count):
        wanted = "K+1" if count is None else count
        raise ValueError(
            f"measurements: wanted shape ({wanted}, {m}, *batch) with K >= 1, got {y.shape}"
        )
    if y.size == 0:
        raise ValueError(f"measurements: wanted at least one path, got shape {y.shape}")
    if not np.isnan(y[0]).all():
        raise ValueError("measurements: wanted NaN at k = 0, where nothing is measured")
    return y.reshape(*y.shape[:2], -1), y.shape[2:]


def as_flags(value: object, shape: tuple[int, int]) -> np.ndarray:
    """Booleans (K+1, m) that mark missing components.

    Raises
    ------
    TypeError, ValueError
        A ragged list; not booleans; a wrong shape.
    """
    try:
        flags = np.asarray(value)
    except ValueError:
        raise TypeError("missing: wanted an array of booleans, got a ragged list") from None
    if flags.dtype != bool or flags.shape != shape:
        raise ValueError(
            f"missing: wanted booleans of shape {shape}, got {flags.dtype} of shape {flags.shape}"
        )
    return flags


def patterns_of_gaps(missing: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Distinct patterns (K+1, m) of missing components, each with the indices of its paths."""
    flat = missing.reshape(-1, missing.shape[-1])
    if (flat == flat[:, :1]).all():
        yield missing[..., 0], np.arange(flat.shape[1])
        return
    packed = np.ascontiguousarray(np.packbits(flat, axis=0).T)
    keys = packed.view(np.dtype((np.void, packed.shape[1]))).ravel()
    _, first, group = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(group, kind="stable")
    ends = np.cumsum(np.bincount(group))[:-1]
    for start, members in zip(first, np.split(order, ends), strict=True):
        yield missing[..., start], members


def start_mean(system: DelaySystem, batch: object) -> np.ndarray:
    """Means (N+1, n, *batch) of x_0, x_{-1}, ..., x_{-N}.

    Raises
    ------
    TypeError, ValueError
        `batch` is not a tuple of positive integers.
    """
    if not isinstance(batch, tuple):
        raise TypeError(f"batch: wanted a tuple of whole numbers, got {batch!r}")
    batch = tuple(as_count("batch", size) for size in batch)
    mean = system.mean0.reshape(-1, system.state_size, *(1,) * len(batch))
    return np.broadcast_to(mean, (*mean.shape[:2], *batch)).copy()


def predicted_mean(system: DelaySystem, k: int, mean: np.ndarray) -> np.ndarray:
    """Means (N+1, n, *batch), newest first, one instant on: those of x_k, ..., x_{k-N}."""
    with np.errstate(over="ignore", invalid="ignore"):
        newest = sum(np.tensordot(a, mean[d], 1) for d, a in system.step(k).dynamics.items())
    require_finite("estimates", k, newest)
    return np.concatenate([newest[None], mean[:-1]])


def move_mean(
    system: DelaySystem, k: int, ring: np.ndarray, now: StepGains, y: np.ndarray
) -> np.ndarray:
    """Predict and correct the ring of means (N+1, n, N) in place; returns the innovation.

    Instant k sits in block ``k mod (N+1)``. A missing component has innovation zero.
    """
    blocks = len(ring)
    c = system.step(k)
    with np.errstate(over="ignore", invalid="ignore"):
        mean = sum(a @ ring[(k - 1 - d) % blocks] for d, a in c.dynamics.items())
        error = y - c.sensor @ mean
        error[np.isnan(y)] = 0.0
        ring[k % blocks] = mean
        lags = (k - np.arange(blocks)) % blocks
        ring += now.gain[lags] @ error
    require_finite("estimates", k, ring[k % blocks], error)
    return error


def log_density(error: np.ndarray, inner: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """Log density of the observed components; a missing one has error 0 and pivot 1."""
    low = np.linalg.cholesky(inner)
    white = solve_triangular(low, error, lower=True, check_finite=False)
    constant = np.log(np.diag(low)).sum() + 0.5 * LOG_2PI * np.count_nonzero(~missing)
    return -0.5 * np.einsum("ij,ij->j", white, white) - constant


def filter_records(
    system: DelaySystem, table: DelayGains, y: np.ndarray, lag: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means (K+1, n, N) with a lag, log densities (K+1, N) and innovations (K+1, m, N)."""
    count, m, paths = y.shape
    blocks, n = system.max_delay + 1, system.state_size
    start = system.mean0.reshape(blocks, n, 1)[-np.arange(blocks) % blocks]
    ring = np.broadcast_to(start, (blocks, n, paths)).copy()
    mean, loglik = np.empty((count, n, paths)), np.zeros((count, paths))
    errors = np.zeros((count, m, paths))
    if lag == 0:
        mean[0] = ring[0]
    for k in range(1, count):
        now = StepGains(*(array[k] for array in table[:-1]))
        errors[k] = move_mean(system, k, ring, now, y[k])
        loglik[k] = log_density(errors[k], now.innovation_cov, np.isnan(y[k, :, 0]))
        if k >= lag:
            mean[k - lag] = ring[(k - lag) % blocks]
    for s in range(min(lag, count)):  # the last instants, with all measurements there are
        mean[count - 1 - s] = ring[(count - 1 - s) % blocks]
    return mean, loglik, errors
