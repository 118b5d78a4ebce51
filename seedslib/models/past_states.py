"""Systems that keep their past states, for measurements that arrive late."""

from __future__ import annotations

from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import align
from seedslib.base.checks import as_count, as_real, as_whole
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.kinds import as_system
from seedslib.models.linear import LinearSystem, Remade
from seedslib.models.maps import Noise, StochasticMap

InSteps = TypeVar("InSteps", LinearSystem, DiscreteSystem)
"""The kind of the system, which stays."""


def with_past_states(system: InSteps, lag: int) -> InSteps:
    """The same system whose state is that of now and of the last `lag` steps, newest first.

    Its sensor measures all of them, each with a noise of its own: the m components from ``j * m``
    on are a measurement that was taken j steps ago and arrives now, and NaN says that none does.
    `by_arrival` lays out a record so. Any filter of this system takes measurements that are late
    and out of sequence; its Kalman filter is exact, and its estimate of the state j steps ago is
    that of the fixed-lag smoother. The augmented state is in Challa, Evans, Wang (2003).

    Parameters
    ----------
    system : DiscreteSystem or LinearSystem
        Of formulas; its sensor must not depend on the time or on inputs.
    lag : int
        The longest delay L in steps.

    Returns
    -------
    DiscreteSystem or LinearSystem
        With (L+1) n states and (L+1) m measured components. States before the first time are the
        mean of the first state, and nothing is known to have been measured then. Simulate the
        original system: here a state would be measured again at each step, with new noise.

    Raises
    ------
    TypeError, ValueError
        Another system, a map of array functions, a sensor that depends on the time or on inputs, a
        first state or a noise of the sensor that is not Gaussian; a lag that is no positive number.
    """
    as_system("system", system, "DiscreteSystem", "LinearSystem")
    copies, sensor = as_count("lag", lag) + 1, system.sensor
    if not sensor.timeless or any(p.role == "input" for p in sensor.mentions):
        raise ValueError("system: wanted a sensor of formulas without time and inputs, got another")
    if system.initial is not None or not sensor.noise.gaussian:
        raise ValueError("system: wanted a Gaussian first state and sensor noise, got samples")
    first = system.first or system  # formulas of parameters, or numbers
    size = copies * system.state_size
    mean0, cov0 = np.tile(first.mean0, copies), placed(np.zeros((size, size)), first.cov0)
    larger: Any
    if isinstance(system, LinearSystem):
        larger = _linear(system, copies, mean0, cov0)
    elif system.dynamics.symbolic:
        larger = DiscreteSystem(*_maps(system, copies), mean0, cov0)
    else:
        raise ValueError("system: wanted dynamics of formulas, got array functions")
    return larger.bind(system.numbers)


def by_arrival(measurements: ArrayLike, delays: ArrayLike, lag: int) -> np.ndarray:
    """Measurements at the steps at which they arrive, for a filter of `with_past_states`.

    Parameters
    ----------
    measurements : array_like, shape (K+1, m, *batch)
        At the steps at which they were taken; NaN marks one that never arrives.
    delays : array_like of int, shape (K+1, *batch) or (K+1, m, *batch)
        Steps after which each of them arrives, or each of its components: of those that do not
        arrive together the noises must be uncorrelated. Of what never arrives any number.
    lag : int
        The longest delay L.

    Returns
    -------
    ndarray, shape (K+1, (L+1) m, *batch)
        The components from ``j * m`` on of row k were measured at step k - j. What would arrive
        after the last step is left out.

    Raises
    ------
    TypeError, ValueError
        No numbers, shapes that do not fit; a delay that is negative or longer than `lag`.
    """
    y, lag = as_real("measurements", measurements, nan=True), as_count("lag", lag)
    if y.ndim < 2:
        raise ValueError(f"measurements: wanted shape (K+1, m, *batch), got {y.shape}")
    whole = np.ndim(delays) < y.ndim
    steps = as_whole("delays", delays, (len(y), *y.shape[2:]) if whole else y.shape)
    steps = np.broadcast_to(steps[:, None] if whole else steps, y.shape)
    wrong = np.isfinite(y) & ((steps < 0) | (steps > lag))
    if wrong.any():
        k = int(np.argwhere(wrong)[0, 0])
        raise ValueError(
            f"delays: wanted 0 to {lag}, the lag, got {steps[wrong][0]} of the measurement of "
            f"step {k}"
        )
    arrived = np.full((len(y), lag + 1, *y.shape[1:]), np.nan)
    for j in range(min(lag + 1, len(y))):
        arrived[j:, j] = np.where(steps == j, y, np.nan)[: len(y) - j]
    return arrived.reshape(len(y), -1, *y.shape[2:])


def placed(whole: np.ndarray, matrix: Any) -> np.ndarray:
    """A matrix (n, k, *batch) or a vector in the upper left corner of a larger one."""
    matrix = np.asarray(matrix)
    batch = matrix.shape[whole.ndim :]
    larger = np.empty(whole.shape + batch, matrix.dtype)
    larger[...] = align(whole, whole.ndim, len(batch))
    larger[tuple(map(slice, matrix.shape[: whole.ndim]))] = matrix
    return larger


def _linear(system: Any, copies: int, mean0: np.ndarray, cov0: np.ndarray) -> LinearSystem:
    n = system.state_size
    size, repeat = copies * n, np.eye(copies, dtype=int)
    corners = np.eye(size, k=-n), np.zeros((size, size)), np.zeros(size)
    F, Q, b = (
        Remade.of(matrix, partial(placed, corner))
        for matrix, corner in zip(system.dynamics.matrices, corners, strict=True)
    )
    H, R, d = (getattr(matrix, "expressions", matrix) for matrix in system.sensor.matrices)
    H, R, d = np.kron(repeat, H), np.kron(repeat, R), np.tile(d, copies)
    return LinearSystem(F, Q, H, R, mean0, cov0, b=b, d=d, diffuse=system.diffuse)


def _maps(system: DiscreteSystem, copies: int) -> list[StochasticMap]:
    """Dynamics and sensor of formulas, for the state and its past."""
    import sympy

    def past(symbols: Any, j: int) -> list[Any]:
        return [sympy.Symbol(f"{s}_past{j}", **s.assumptions0) if j else s for s in symbols]

    dynamics, sensor, n = system.dynamics, system.sensor, system.state_size
    state = [s for j in range(copies) for s in past(dynamics.state, j)]
    noises, values, noise = [], [], sensor.noise
    for j in range(copies):
        noises += past(noise.symbols, j)
        now = past(dynamics.state, j), past(noise.symbols, j)
        own = (*sensor.state, *noise.symbols)
        names = dict(zip(own, (s for part in now for s in part), strict=True))
        values += [y.xreplace(names) for y in sensor.expressions]
    cov = np.kron(np.eye(copies), noise.cov)
    return [
        StochasticMap(
            state,
            [*dynamics.expressions, *state[:-n]],
            dynamics.noise,
            time=dynamics.time,
            period=dict(dynamics.period),
        ),
        StochasticMap(
            state,
            values,
            Noise(noises, np.tile(noise.mean, copies), cov),
            time=sensor.time,
            period={j * sensor.size + k: P for j in range(copies) for k, P in sensor.period},
        ),
    ]
