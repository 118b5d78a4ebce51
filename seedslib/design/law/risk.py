"""Deterministic risk: what any filter of a scalar system does in each cell of its memory."""

from __future__ import annotations

import numpy as np

from seedslib.base.tables import AxesLike, AxisLike
from seedslib.base.values import Inputs
from seedslib.design.law.affine import corrected
from seedslib.design.law.joint import GridRisk, JointLaw
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.outputs.filter import OutputFilter
from seedslib.designed.outputs.lookup import Output, recalled
from seedslib.designed.switching.filter import SwitchingFilter


def grid_risk(
    filter: FiniteOrderFilter | SwitchingFilter | OutputFilter, *, x: AxisLike,
    z: AxesLike | None = None, y: AxesLike | None = None, inputs: Inputs | None = None,
) -> GridRisk:  # fmt: skip
    """Mean-square errors of any designed filter of finite order, without random numbers.

    Parameters
    ----------
    filter : FiniteOrderFilter, SwitchingFilter, TableFilter or LearnedFilter
        Of a scalar system, with a memory of estimates or of measurements.
    x, z, y, inputs
        As `grid_synthesis`. Estimates that are not bounded may need a longer `z`.

    Returns
    -------
    GridRisk
        With the probability of a wrong mode for a switching system.

    Raises
    ------
    TypeError, ValueError
        As `grid_synthesis`.

    Warns
    -----
    UserWarning
        Probability at the ends of an axis.
    """
    if filter.memory is None:
        raise ValueError("filter: wanted one with a memory, got one that carries whole laws")
    if filter.measured is not None or filter.availability is not None:
        raise ValueError(
            "filter: wanted one whose sensor is always there; what a design by grid_synthesis "
            "predicts for a schedule or an availability is its risk"
        )
    law = JointLaw(filter.system, filter.memory, filter.times, x, z, y, inputs)
    for k, _, sight, _ in law.steps():
        found = _decided(filter, law, k)
        law.take(k, found.mean, sight, found.mode)
    return law.risk()


def _decided(filter, law, k) -> Output:
    """What a filter makes of each measurement in each cell of its memory: (1, Y, cells)."""
    known, t = law.memory_points, float(law.times[k])
    cells = known.shape[1]
    if isinstance(filter, OutputFilter):
        found = filter.output(k, law.shown[:, :, None], known[:, None, :])
        shape = law.shown.shape[1], cells
        mode = None if found.mode is None else np.broadcast_to(found.mode, shape)
        return Output(np.broadcast_to(found.mean, (1, *shape)), mode)
    state = filter.initial((cells,))
    if k:
        past = recalled(filter.system, filter.memory, 1, k - 1, known)
        known = {"mean": known[:1], "cov": None}
        if law.switching:
            mode = past.modes[0] if past.modes else np.zeros(cells, dtype=int)
            known = {"time": float(law.times[k - 1]), "mode": mode}
        state = state._replace(index=k - 1, past=past, corrected=True, **known)
    with law.held.at(max(k - 1, 0)):
        state = filter.predict(state, t)
    with law.held.at(k):
        return _corrected(filter, law, state, cells)


def _corrected(filter, law, state, cells) -> Output:
    if not law.switching:
        return Output(corrected(law, state.mean, state.cov, filter.expect(state)))
    told, y = None, law.shown
    if law.chain.indicators:
        told, y = y[0].astype(int), y[1:]
    means = np.empty((1, y.shape[1], cells))
    modes = np.empty(means.shape[1:], dtype=int)
    for row in range(y.shape[1]):
        seen = None if told is None else np.full(cells, told[row])
        found = filter.correct(state, np.repeat(y[:, row, None], cells, axis=1), seen)
        means[0, row], modes[row] = found.mean[0], found.mode
    return Output(means, modes)
