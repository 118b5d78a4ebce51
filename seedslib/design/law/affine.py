"""Filters of theorem 2 with moments from the grid: affine forecasts, the common correction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.correction import correct
from seedslib.base.tables import AxesLike, AxisLike
from seedslib.base.values import Inputs
from seedslib.design.law.joint import BY_GRID, GridRisk, JointLaw
from seedslib.design.regression import regress
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import Start
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import Affine
from seedslib.linearization.moments import Linearization, Moments, as_linearization
from seedslib.models.kinds import AnySystem


def affine_synthesis(
    system: AnySystem, memory: Memory, linearization: Linearization, times: ArrayLike, *,
    x: AxisLike, z: AxesLike | None = None, y: AxesLike | None = None,
    inputs: Inputs | None = None,
) -> tuple[FiniteOrderFilter, GridRisk]:  # fmt: skip
    """Filter of theorem 2 with moments from the grid instead of simulated ones.

    Parameters
    ----------
    system, memory, times, x, z, y, inputs
        As `grid_synthesis`. The range of `z` should hold the estimates, which are not bounded
        here; what falls outside is counted.
    linearization : Linearization

    Returns
    -------
    filter : FiniteOrderFilter
        Without nodes between measurements.
    risk : GridRisk

    Raises
    ------
    TypeError, ValueError
        As `grid_synthesis`; something that is no linearization.
    """
    as_linearization(linearization)
    law = JointLaw(system, memory, times, x, z, y, inputs)
    sensor, start, fits = linearization.moments(system.sensor), None, []
    for k, t, sight, _ in law.steps():
        if k == 0:
            with law.held.at(0):
                start = _sensed(law, t)
            mean, cov, moments = start
            mean = mean[:, None]
            moments = moments._replace(mean=moments.mean[:, None])
        else:
            fits.append(regress(*_moments(law), 1))
            mean, cov = fits[-1].forecast(law.memory_points)
            with law.held.at(k):
                moments = sensor(float(t), mean, cov)
        law.take(k, corrected(law, mean, cov, moments), sight)
    none = tuple(np.empty(0) for _ in fits)
    designed = FiniteOrderFilter(
        system=system, memory=memory, predictor=Affine(), linearization=linearization,
        times=law.times, node_times=none, components=1, start=start, fits=tuple(fits),
        node_fits=tuple(() for _ in fits), predicted=law.prediction(), design=BY_GRID,
    )  # fmt: skip
    return designed, law.risk()


def _moments(law: JointLaw) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of state and memory together."""
    points, x = law.memory_points, law.values[0]
    mass, state = law.joint.sum(axis=1), law.joint.sum(axis=0)
    centre = np.concatenate([[state @ x], points @ mass])
    apart, within = points - centre[1:, None], x - centre[0]
    cov = np.empty((len(centre), len(centre)))
    cov[0, 0] = state @ within**2
    cov[0, 1:] = cov[1:, 0] = apart @ (law.joint @ within)
    cov[1:, 1:] = (apart * mass) @ apart.T
    return centre, cov


def _sensed(law: JointLaw, t: float) -> Start:
    """Moments of the state and the measurement before anything is remembered."""
    state, x = law.joint.sum(axis=0), law.values
    shown, noise = law.system.sensor.conditional_moments(float(t), x)
    shown = np.broadcast_to(shown, (len(shown), x.shape[1]))
    noise = np.broadcast_to(
        noise if noise.ndim == 3 else noise[..., None], (*noise.shape[:2], x.shape[1])
    )
    mean, expected = x @ state, shown @ state
    apart, around = shown - expected[:, None], x - mean[:, None]
    cross, spread = (around * state) @ apart.T, noise @ state + (apart * state) @ apart.T
    return Start(mean, (around * state) @ around.T, Moments(expected, cross, spread))


def corrected(law: JointLaw, mean: np.ndarray, cov: np.ndarray, moments: Moments) -> np.ndarray:
    """Estimates (1, Y, cells) by the common correction, from forecasts in each cell."""
    moments = Moments(moments.mean[:, None], _apart(moments.cross), _apart(moments.cov))
    return correct(mean[:, None], None, law.shown[:, :, None], moments)[0]


def _apart(array):
    """The same array with an axis for measurements before the one for cells, if it has that."""
    return array if array.ndim == 2 else np.expand_dims(array, 2)
