"""Deterministic synthesis of filters of scalar systems: theorems 1 and 2 on a grid."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, MaybeArray
from seedslib.base.checks import as_count
from seedslib.base.correction import correct
from seedslib.base.tables import AxesLike, AxisLike, Labels, NodesLike
from seedslib.design.law import BY_GRID, GridRisk, JointLaw, conditional, seen
from seedslib.design.regression import regress
from seedslib.designed.finite_order import FiniteOrderFilter, Start
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import Affine
from seedslib.designed.switching import SwitchingFilter
from seedslib.designed.tables import Output, OutputFilter, Step, Table, TableFilter, prior, recalled
from seedslib.linearization.moments import Linearization, Moments, as_linearization
from seedslib.models.kinds import AnySystem, in_steps

METHOD = "density recursion"


def grid_synthesis(
    system: AnySystem,
    memory: Memory,
    times: ArrayLike,
    *,
    x: NodesLike,
    z: AxesLike | None = None,
    y: AxesLike | None = None,
    nodes: Count = 4,
    probabilities: bool = False,
) -> TableFilter:
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
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
        With one state component.
    memory : Memory
        Of estimates or of measurements (finite memory), not of both; of as many indicators too,
        where the system has one and they are to be remembered.
    times : array_like, shape (K+1,)
        Times of the measurements; the first is that of the initial law.
    x : Axis, (low, high, count) or Nodes
        Nodes of the state; the range should hold all but a millionth of the probability. For
        a `DiscreteSystem` they may be `Nodes`, which can be dense where the dynamics are steep.
    z : Axis or (low, high, count), optional
        Nodes of the remembered estimates; by default the range of `x` with twice its nodes.
    y : Axis or (low, high, count), or a sequence of them, optional
        Nodes for each component of a measurement. By default 6.5 deviations of the sensor
        beyond its means at the ends of `x`, four nodes to its smallest deviation. The step
        should move an estimate by less than the step of `z`.
    nodes : int
        Number of evenly spaced forecasts inside each interval; a system in discrete time
        has none.
    probabilities : bool
        Whether tables of the probabilities of the modes are wanted too.

    Returns
    -------
    TableFilter
        For a switching system it decides the modes too.

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
    if probabilities and not law.switching:
        raise ValueError("probabilities: wanted False, the system has no modes")
    nodes = 0 if in_steps(system) else nodes
    steps, changes, between, before = [], [], [], None
    for k, found in enumerate(optimal_steps(law, nodes)):
        changes.append(_change(before, found))
        steps.append(_tables(law, k, found, probabilities))
        between.append(found.between)
        before = found
    stops = [np.linspace(a, b, nodes + 2)[1:-1] for a, b in pairwise(law.times)]
    return TableFilter(
        system=law.system,
        memory=law.memory,
        times=law.times,
        steps=tuple(steps),
        method=METHOD,
        predicted=law.prediction(),
        covariances=law.errors(),
        design=BY_GRID,
        node_times=tuple(stops),
        node_fits=tuple(between[1:]),
        changes=np.array(changes).T,
    )


class Optimal(NamedTuple):
    """What is optimal at one measurement, on the grid of measurements and memory.

    Attributes
    ----------
    blocks : int
        Blocks in the memory.
    law : ndarray, shape (cells, S)
        Of the chain in each cell of the memory.
    means : ndarray, shape (1, Y, cells)
    modes : ndarray of int8, shape (Y, cells), or None
    prob : ndarray, shape (L, Y, cells), or None
    mass : ndarray, shape (Y, cells)
        Probability of measurement and memory.
    between : tuple of Table
        Forecasts at the nodes since the measurement before.
    """

    blocks: int
    law: np.ndarray
    means: np.ndarray
    modes: MaybeArray
    prob: MaybeArray
    mass: np.ndarray
    between: tuple[Table, ...]


def optimal_steps(law: JointLaw, nodes: int = 0) -> Iterator[Optimal]:
    """The alternation of theorems 1 and 2: what is optimal at a measurement, then the joint law.

    Parameters
    ----------
    law : JointLaw
        Of a system of either kind; it is moved on.
    nodes : int
        Number of evenly spaced forecasts inside each interval.

    Yields
    ------
    Optimal
    """
    for k, _, sight, between in law.steps(nodes):
        blocks, given = law.filled, conditional(law.joint)
        found = law.posterior(sight.relative, given)
        mass = law.take(k, found.mean, sight, found.mode)
        yield Optimal(blocks, given, *found, mass, between)


def _change(before, now):
    """How far estimates and modes are from those before, over the law of their arguments."""
    if before is None or before.means.shape != now.means.shape:
        return np.nan, np.nan
    square = np.vdot(now.mass, (now.means[0] - before.means[0]) ** 2)
    other = 0.0 if now.modes is None else now.mass[now.modes != before.modes].sum()
    return np.sqrt(square), other


def _tables(law, k, optimal, probabilities) -> Step:
    """Tables of a step: on the grid, with the indicator missing, with the measurement missing."""
    given, found, t = optimal.law, Output(optimal.means, optimal.modes, optimal.prob), law.times[k]
    axes, values = law.measurement_axes, law.chain.indicators
    labels, memory = (Labels(values + 1),) * bool(values), law.block_axes * optimal.blocks
    if values:
        axes, y = axes[1:], law.shown[1:, : len(law.weights) // values]
        unseen = law.chain.log_likelihood(t, np.concatenate([np.full((1, y.shape[1]), -1.0), y]))
        more = law.posterior(seen(unseen, law.weights[: y.shape[1]]).relative, given)
        found = Output(*(np.concatenate(pair, axis=-2) for pair in zip(found, more, strict=True)))

    shown = Table.of(labels + axes + memory, found, probabilities)
    if law.switching:
        more = law.posterior(law.chain.told(t), given)
        return Step(shown, Table.of(labels + memory, more, probabilities))
    blind = Table.of(memory, Output(given @ law.values[0]))
    return Step(shown, blind if k else prior(law.system, 1))


def optimal_risk(
    system: AnySystem,
    memory: Memory,
    times: ArrayLike,
    *,
    x: NodesLike,
    z: AxesLike | None = None,
    y: AxesLike | None = None,
) -> GridRisk:
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


def affine_synthesis(
    system: AnySystem,
    memory: Memory,
    linearization: Linearization,
    times: ArrayLike,
    *,
    x: AxisLike,
    z: AxesLike | None = None,
    y: AxesLike | None = None,
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
    as_linearization(linearization)
    law = JointLaw(system, memory, times, x, z, y)
    sensor, start, fits = linearization.moments(system.sensor), None, []
    for k, t, sight, _ in law.steps():
        if k == 0:
            start = _sensed(law, t)
            mean, cov, moments = start
            mean = mean[:, None]
            moments = moments._replace(mean=moments.mean[:, None])
        else:
            fits.append(regress(*_moments(law), 1))
            mean, cov = fits[-1].forecast(law.memory_points)
            moments = sensor(float(t), mean, cov)
        law.take(k, corrected(law, mean, cov, moments), sight)
    none = tuple(np.empty(0) for _ in fits)
    designed = FiniteOrderFilter(
        system=system,
        memory=memory,
        predictor=Affine(),
        linearization=linearization,
        times=law.times,
        node_times=none,
        components=1,
        start=start,
        fits=tuple(fits),
        node_fits=tuple(() for _ in fits),
        predicted=law.prediction(),
        design=BY_GRID,
    )
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


def grid_risk(
    filter: FiniteOrderFilter | SwitchingFilter | OutputFilter,
    *,
    x: AxisLike,
    z: AxesLike | None = None,
    y: AxesLike | None = None,
) -> GridRisk:
    """Mean-square errors of any designed filter of finite order, without random numbers.

    Parameters
    ----------
    filter : FiniteOrderFilter, SwitchingFilter, TableFilter or LearnedFilter
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
    if filter.measured is not None or filter.availability is not None:
        raise ValueError(
            "filter: wanted one whose measurements all arrive, got one with a schedule"
        )
    law = JointLaw(filter.system, filter.memory, filter.times, x, z, y)
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
    return _corrected(filter, law, filter.predict(state, t), cells)


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
