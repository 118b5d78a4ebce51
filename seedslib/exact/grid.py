"""Deterministic synthesis of filters of scalar systems, and their deterministic risk."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from seedslib.exact.joint import GridRisk, JointLaw
from seedslib.exact.recursion import conditional, posterior_means
from seedslib.filters.finite_order import FiniteOrderFilter
from seedslib.filters.finite_order_rules import Design, FiniteOrderState, Start
from seedslib.filters.table import OutputRules, Table, TableFilter, TableFit
from seedslib.linearization import Linearization
from seedslib.memory import Past
from seedslib.synthesis.predictors import Affine
from seedslib.synthesis.regression import regress
from seedslib.systems.simulation import as_count

BY_GRID = Design(0, 0, 0, (), 0, True)


def grid_synthesis(system, memory, times, *, x, z=None, y=None, nodes=4) -> TableFilter:
    """Optimal filter of finite order by the density recursion of theorem 1.

    (4.4)-(4.10) of the jump-diffusion paper: the joint law of the state and the memory moves by
    the Kolmogorov-Feller equation and jumps at measurements, where the estimate is the
    conditional mean. Estimates are remembered on the nodes of an axis; between two nodes the
    probability is split so that its mean is kept. The predicted errors are those of the filter
    with such rounding, which is an upper bound of the optimum where the axes of measurements are
    fine; the difference falls with the square of the step of `z`.

    Parameters
    ----------
    system : JumpDiffusion
        With one state component.
    memory : Memory
        Of estimates or of measurements (finite memory), not of both.
    times : array_like, shape (K+1,)
        Times of the measurements; the first is that of the initial law.
    x : Axis or (low, high, count)
        Nodes of the state; the range should hold all but a millionth of the probability.
    z : Axis or (low, high, count), optional
        Nodes of the remembered estimates; by default the range of `x` with twice its nodes.
    y : Axis or (low, high, count), or a sequence of them, optional
        Nodes for each component of a measurement. By default 6.5 deviations of the sensor
        beyond its means at the ends of `x`, four nodes to its smallest deviation.
    nodes : int
        Number of evenly spaced forecasts inside each interval.

    Returns
    -------
    TableFilter

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
    tables, ends, between = [], [], []
    for k, t in enumerate(law.times):
        sight = law.look(t)
        means = posterior_means(law.values, conditional(law.joint), sight.relative)
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


def grid_risk(filter: FiniteOrderFilter, *, x, z=None, y=None) -> GridRisk:
    """Mean-square errors of any designed filter of finite order, without random numbers.

    Parameters
    ----------
    filter : FiniteOrderFilter, TableFilter or LearnedFilter
        Of a scalar system, with a memory of estimates or of measurements.
    x, z, y
        As `grid_synthesis`. Estimates that are not bounded may need a longer `z`.

    Raises
    ------
    TypeError, ValueError
        As `grid_synthesis`.

    Warns
    -----
    UserWarning
        Probability at the ends of an axis.
    """
    law = JointLaw(filter.system, filter.memory, filter.times, x, z, y)
    for k, t in enumerate(law.times):
        sight = law.look(t)
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
