"""Deterministic synthesis of filters of scalar systems, and their deterministic risk."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from seedslib.base.blocks import as_count
from seedslib.design.law.joint import GridRisk, JointLaw
from seedslib.design.law.switching_grid import optimal_steps, switching_synthesis
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.finite_order_rules import Design, FiniteOrderState, Start
from seedslib.designed.memory import Past
from seedslib.designed.predictors import Affine
from seedslib.designed.regression import regress
from seedslib.designed.switching_table import SwitchingTableFilter
from seedslib.designed.table import OutputRules, Table, TableFilter, TableFit
from seedslib.linearization.moments import Linearization

BY_GRID = Design(0, 0, 0, (), 0, True)


def grid_synthesis(
    system, memory, times, *, x, z=None, y=None, nodes=4, probabilities=False
) -> TableFilter | SwitchingTableFilter:
    """Optimal filter of finite order by the density recursion of theorem 1.

    (4.4)-(4.10) of the jump-diffusion paper: the joint law of the state and the memory moves by
    the Kolmogorov-Feller equation and jumps at measurements, where the estimate is the
    conditional mean. Estimates are remembered on the nodes of an axis; between two nodes the
    probability is split so that its mean is kept. The predicted errors are those of the filter
    with such rounding, which is an upper bound of the optimum where the axes of measurements are
    fine; the difference falls with the square of the step of `z`.

    For a switching system it is theorem 2 of the switching paper, (3.1) to (4.8): the chain is
    mode and state, and with each estimate the decided mode is remembered.

    Parameters
    ----------
    system : JumpDiffusion or SwitchingSystem
        With one state component.
    memory : Memory
        Of estimates or of measurements (finite memory), not of both; of as many indicators too,
        where the system has one and they are to be remembered.
    times : array_like, shape (K+1,)
        Times of the measurements; the first is that of the initial law.
    x : Axis or (low, high, count)
        Nodes of the state; the range should hold all but a millionth of the probability.
    z : Axis or (low, high, count), optional
        Nodes of the remembered estimates; by default the range of `x` with twice its nodes.
    y : Axis or (low, high, count), or a sequence of them, optional
        Nodes for each component of a measurement. By default 6.5 deviations of the sensor
        beyond its means at the ends of `x`, four nodes to its smallest deviation. The step
        should move an estimate by less than the step of `z`.
    nodes : int
        Number of evenly spaced forecasts inside each interval; a switching system has none.
    probabilities : bool
        Whether tables of the probabilities of the modes are wanted too.

    Returns
    -------
    TableFilter, or SwitchingTableFilter for a switching system

    Raises
    ------
    TypeError, ValueError
        A system with more components or without likelihood; a memory of another kind; axes that
        are none.

    Warns
    -----
    UserWarning
        Probability at the ends of an axis.
    """
    if nodes != 0:
        as_count("nodes", nodes)
    law = JointLaw(system, memory, times, x, z, y)
    if law.switching:
        return switching_synthesis(law, probabilities)
    if probabilities:
        raise ValueError("probabilities: wanted False, the system has no modes")
    tables, ends, between = [], [], []
    for k, t in enumerate(law.times):
        sight = law.look(t)
        means, _ = law.posterior(sight.relative)
        shape = tuple(axis.count for axis in law.measurement_axes)
        tables.append(
            TableFit(
                law.measurement_axes + law.memory_axes,
                means.reshape(1, *shape, *law.shape),
            )
        )
        law.take(k, means, sight)
        if k + 1 < len(law.times):
            found = []
            stops = np.linspace(t, law.times[k + 1], nodes + 2)
            for a, b in pairwise(stops):
                law.move(a, b)
                found.append(law.forecast(b, last=b == stops[-1]))
            between.append((stops[1:-1], tuple(found[:-1])))
            ends.append(found[-1])
    law.look_at_memory()
    predictor = Table(law.measurement_axes, law.letter_axes, "density recursion")
    return TableFilter(
        system=system, memory=memory, predictor=predictor, linearization=None,
        times=law.times, node_times=tuple(stops for stops, _ in between), components=1,
        start=Start(system.mean0, system.cov0, None), fits=tuple(ends),
        node_fits=tuple(fits for _, fits in between), predicted=law.prediction(),
        design=BY_GRID,
        rules=OutputRules(
            memory, 1, sensor=None, outputs=tuple(tables), covariances=law.errors()
        ),
    )  # fmt: skip


def affine_synthesis(
    system, memory, linearization, times, *, x, z=None, y=None
) -> tuple[FiniteOrderFilter, GridRisk]:
    """Filter of theorem 2 with moments from the grid instead of simulated ones.

    Parameters
    ----------
    system, memory, times, x, z, y
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
    if not isinstance(linearization, Linearization):
        raise TypeError(f"linearization: wanted a Linearization, got {linearization!r}")
    law = JointLaw(system, memory, times, x, z, y)
    sensor, start, fits = linearization.moments(system.sensor), None, []
    for k, t in enumerate(law.times):
        sight = law.look(t)
        if k == 0:
            start = law.sensed(t)
            mean, cov, moments = start
            mean = mean[:, None]
            moments = moments._replace(mean=moments.mean[:, None])
        else:
            fits.append(regress(*law.moments(), 1))
            mean, cov = fits[-1].forecast(law.memory_points)
            moments = sensor(float(t), mean, cov)
        law.take(k, law.corrected(mean, cov, moments), sight)
        if k + 1 < len(law.times):
            law.move(t, law.times[k + 1])
    law.look_at_memory()
    none = tuple(np.empty(0) for _ in fits)
    designed = FiniteOrderFilter(
        system=system, memory=memory, predictor=Affine(), linearization=linearization,
        times=law.times, node_times=none, components=1, start=start, fits=tuple(fits),
        node_fits=tuple(() for _ in fits), predicted=law.prediction(), design=BY_GRID,
    )  # fmt: skip
    return designed, law.risk()


def optimal_risk(system, memory, times, *, x, z=None, y=None) -> GridRisk:
    """Least mean-square errors that a memory allows: the risk of `grid_synthesis` without tables.

    Parameters
    ----------
    system, memory, times, x, z, y
        As `grid_synthesis`.

    Returns
    -------
    GridRisk

    Raises
    ------
    TypeError, ValueError
        As `grid_synthesis`.
    """
    law = JointLaw(system, memory, times, x, z, y)
    for _ in optimal_steps(law):
        pass
    return law.risk()


def grid_risk(filter: FiniteOrderFilter, *, x, z=None, y=None) -> GridRisk:
    """Mean-square errors of any designed filter of finite order, without random numbers.

    Parameters
    ----------
    filter : FiniteOrderFilter, TableFilter, LearnedFilter, SwitchingTableFilter, SwitchingFilter
        Of a scalar system, with a memory of estimates or of measurements.
    x, z, y
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
    law = JointLaw(filter.system, filter.memory, filter.times, x, z, y)
    for k, t in enumerate(law.times):
        sight = law.look(t)
        if law.switching:
            means, modes = _decisions(filter, law, k)
            law.take(k, means, sight, modes)
        else:
            law.take(k, _estimates(filter, law, k, float(t)), sight)
        if k + 1 < len(law.times):
            law.move(t, law.times[k + 1])
    law.look_at_memory()
    return law.risk()


def _estimates(filter, law, k, t):
    """What a filter makes of each measurement in each cell of its memory, (1, Y, cells)."""
    shown, known = law.shown, law.memory_points
    if hasattr(filter, "output"):
        found = filter.output(k, shown[:, :, None], known[:, None, :])
        return np.broadcast_to(found, (1, shown.shape[1], known.shape[1]))
    state = filter.initial(known.shape[1:])
    if k:
        held = len(known) // (1 if filter.memory.estimates else len(shown))
        blocks = tuple(np.split(known, held))
        past = Past(estimates=blocks) if filter.memory.estimates else Past(measurements=blocks)
        state = FiniteOrderState(k - 1, known[:1], None, past, None, 0.0, None, True)
    state = filter.predict(state, t)
    return law.corrected(state.mean, state.cov, filter.expect(state))


def _decisions(filter, law, k):
    """Estimates (1, Y, cells) and modes (Y, cells) of a filter of a switching system."""
    known, t = law.memory_points, float(law.times[k])
    state = filter.initial(known.shape[1:])
    if k:
        past = _past(law)
        mode = past.modes[0] if past.modes else np.zeros(known.shape[1], dtype=int)
        state = state._replace(
            index=k - 1, time=float(law.times[k - 1]), mode=mode, past=past, corrected=True
        )
    state = filter.predict(state, t)
    told, y = None, law.shown
    if law.chain.indicators:
        told, y = y[0].astype(int), y[1:]
    means = np.empty((1, y.shape[1], known.shape[1]))
    modes = np.empty(means.shape[1:], dtype=int)
    for row in range(y.shape[1]):
        shown = np.repeat(y[:, row, None], known.shape[1], axis=1)
        seen = None if told is None else np.full(known.shape[1], told[row])
        found = filter.correct(state, shown, seen)
        means[0, row], modes[row] = found.mean[0], found.mode
    return means, modes


def _past(law):
    """The memory of a switching system at each cell; its arrays are (..., cells)."""
    parts = {"modes": [], "indicators": [], "estimates": [], "measurements": []}
    memory = law.memory
    labels = ["modes"] * bool(memory.estimates) + ["indicators"] * bool(memory.indicators)
    kind = "estimates" if memory.estimates else "measurements"
    for block in np.split(law.memory_points, law.held):
        for name, row in zip(labels, block, strict=False):
            parts[name].append(row.astype(int))
        parts[kind].append(block[len(labels) :])
    return Past(**{name: tuple(blocks) for name, blocks in parts.items()})
