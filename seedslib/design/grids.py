"""Deterministic design of filters of scalar systems: theorems 1 and 2 on a grid."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.conditioning import update
from seedslib.base.tables import AxesLike, AxisLike, Labels, NodesLike
from seedslib.design.joint import BY_GRID, GridRisk, JointDistribution, conditional, likelihood_of
from seedslib.design.regression import regress
from seedslib.designed.finite_order import FiniteOrderFilter, Start
from seedslib.designed.memory import Memory
from seedslib.designed.predictors import Affine
from seedslib.designed.switching import SwitchingFilter
from seedslib.designed.tables import Output, OutputFilter, Step, Table, TableFilter, prior, recalled
from seedslib.linearization.moments import Linearization, Moments, as_linearization
from seedslib.models.kinds import AnySystem

METHOD = "density recursion"


def grid_synthesis(
    system: AnySystem,
    memory: Memory,
    times: ArrayLike,
    *,
    x: NodesLike,
    z: AxesLike | None = None,
    y: AxesLike | None = None,
) -> TableFilter:
    """Optimal filter of finite order by the density recursion of theorem 1.

    (4.4)-(4.10) of the jump-diffusion paper: the joint distribution of the state and the memory
    moves by the Kolmogorov-Feller equation and jumps at measurements, where the estimate is the
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
        Times of the measurements; the first is that of the initial distribution.
    x : Axis, (low, high, count) or Nodes
        Nodes of the state; the range should hold all but a millionth of the probability. For
        a `DiscreteSystem` they may be `Nodes`, which can be dense where the dynamics are steep.
    z : Axis or (low, high, count), optional
        Nodes of the remembered estimates; by default the range of `x` with twice its nodes.
    y : Axis or (low, high, count), or a sequence of them, optional
        Nodes for each component of a measurement. By default 6.5 deviations of the sensor
        beyond its means at the ends of `x`, four nodes to its smallest deviation. The step
        should move an estimate by less than the step of `z`.

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
        Probability at or beyond the ends of an axis, or between its nodes: once, the worst.
    """
    dist = JointDistribution(system, memory, times, x, z, y)
    steps, changes, before = [], [], None
    for k, optimal in enumerate(optimal_steps(dist)):
        changes.append(_change(before, optimal))
        steps.append(_tables(dist, k, optimal))
        before = optimal
    return TableFilter(
        system=dist.system,
        memory=dist.memory,
        times=dist.times,
        steps=tuple(steps),
        method=METHOD,
        predicted=dist.prediction(),
        covariances=dist.covariances(),
        design=BY_GRID,
        changes=np.array(changes).T,
    )


class Optimal(NamedTuple):
    """What is optimal at one measurement, on the grid of measurements and memory.

    Attributes
    ----------
    blocks : int
        Blocks in the memory.
    dist : ndarray, shape (cells, S)
        Of the chain in each cell of the memory.
    means : ndarray, shape (1, Y, cells)
    modes : ndarray of int8, shape (Y, cells), or None
    mass : ndarray, shape (Y, cells)
        Probability of measurement and memory.
    """

    blocks: int
    dist: np.ndarray
    means: np.ndarray
    modes: MaybeArray
    mass: np.ndarray


def optimal_steps(dist: JointDistribution) -> Iterator[Optimal]:
    """The alternation of theorems 1 and 2: what is optimal at a measurement, then the joint
    distribution.

    Parameters
    ----------
    dist : JointDistribution
        Of a system of either kind; it is moved on.

    Yields
    ------
    Optimal
    """
    for k, _, likelihood in dist.steps():
        blocks, given = dist.filled, conditional(dist.joint)
        output = dist.posterior(likelihood.relative, given)
        mass = dist.take(k, output.mean, likelihood, output.mode)
        yield Optimal(blocks, given, *output, mass)


def _change(before, now):
    """How far estimates and modes are from those before, over their arguments."""
    if before is None or before.means.shape != now.means.shape:
        return np.nan, np.nan
    square = np.vdot(now.mass, (now.means[0] - before.means[0]) ** 2)
    other = 0.0 if now.modes is None else now.mass[now.modes != before.modes].sum()
    return np.sqrt(square), other


def _tables(dist, k, optimal) -> Step:
    """Tables of a step: on the grid, with the indicator missing, with the measurement missing."""
    given, t = optimal.dist, dist.times[k]
    output = Output(optimal.means, optimal.modes)
    axes, values = dist.measurement_axes, dist.chain.indicators
    labels, memory = (Labels(values + 1),) * bool(values), dist.block_axes * optimal.blocks
    if values:
        axes, y = axes[1:], dist.y_grid[1:, : len(dist.weights) // values]
        without = np.concatenate([np.full((1, y.shape[1]), -1.0), y])
        missing = likelihood_of(dist.chain.log_likelihood(t, without), dist.weights[: y.shape[1]])
        more = dist.posterior(missing.relative, given)
        output = Output(*(np.concatenate(pair, axis=-2) for pair in zip(output, more, strict=True)))
    update = Table.of(labels + axes + memory, output)
    if dist.switching:
        forecast = dist.posterior(dist.chain.indicator_prob(t), given)
        return Step(update, Table.of(labels + memory, forecast))
    if k == 0:
        return Step(update, prior(dist.system, 1))
    return Step(update, Table.of(memory, Output(given @ dist.values[0])))


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
    dist = JointDistribution(system, memory, times, x, z, y)
    for _ in optimal_steps(dist):
        pass
    return dist.risk()


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
    dist = JointDistribution(system, memory, times, x, z, y)
    sensor, start, fits = linearization.moments(system.sensor), None, []
    for k, t, likelihood in dist.steps():
        if k == 0:
            start = _start(dist, t)
            mean, cov, moments = start
            mean = mean[:, None]
            moments = moments._replace(mean=moments.mean[:, None])
        else:
            fits.append(regress(*_moments(dist), 1))
            mean, cov = fits[-1].forecast(dist.memory_points)
            moments = sensor(float(t), mean, cov, system.values())
        dist.take(k, corrected(dist, mean, cov, moments), likelihood)
    none = tuple(np.empty(0) for _ in fits)
    designed = FiniteOrderFilter(
        system=system,
        memory=memory,
        predictor=Affine(),
        linearization=linearization,
        times=dist.times,
        node_times=none,
        components=1,
        start=start,
        fits=tuple(fits),
        node_fits=tuple(() for _ in fits),
        predicted=dist.prediction(),
        design=BY_GRID,
    )
    return designed, dist.risk()


def _moments(dist: JointDistribution) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of state and memory together."""
    points, x = dist.memory_points, dist.values[0]
    mass, state = dist.joint.sum(axis=1), dist.joint.sum(axis=0)
    mean = np.concatenate([[state @ x], points @ mass])
    residual, state_residual = points - mean[1:, None], x - mean[0]
    cov = np.empty((len(mean), len(mean)))
    cov[0, 0] = state @ state_residual**2
    cov[0, 1:] = cov[1:, 0] = residual @ (dist.joint @ state_residual)
    cov[1:, 1:] = (residual * mass) @ residual.T
    return mean, cov


def _start(dist: JointDistribution, t: float) -> Start:
    """Moments of the state and the measurement before anything is remembered."""
    state, x = dist.joint.sum(axis=0), dist.values
    y, noise = dist.system.sensor.conditional_moments(float(t), x, dist.system.values())
    y = np.broadcast_to(y, (len(y), x.shape[1]))
    noise = noise if noise.ndim == 3 else noise[..., None]
    noise = np.broadcast_to(noise, (*noise.shape[:2], x.shape[1]))
    mean, predicted = x @ state, y @ state
    residual, innovation = x - mean[:, None], y - predicted[:, None]
    cross = (residual * state) @ innovation.T
    cov = noise @ state + (innovation * state) @ innovation.T
    return Start(mean, (residual * state) @ residual.T, Moments(predicted, cross, cov))


def corrected(
    dist: JointDistribution, mean: np.ndarray, cov: np.ndarray, moments: Moments
) -> np.ndarray:
    """Estimates (1, Y, cells) by the common correction, from forecasts in each cell."""
    # an axis for measurements before the one for cells, where there is that
    cross, cov = (a if a.ndim == 2 else np.expand_dims(a, 2) for a in moments[1:])
    moments = Moments(moments.mean[:, None], cross, cov)
    return update(mean[:, None], None, dist.y_grid[:, :, None], moments)[0]


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
        Probability at or beyond the ends of an axis, or between its nodes: once, the worst.
    """
    if filter.memory is None:
        raise ValueError("filter: wanted one with a memory, got one without")
    if filter.measured is not None or filter.availability is not None:
        raise ValueError(
            "filter: wanted one whose measurements all arrive, got one with a schedule"
        )
    dist = JointDistribution(filter.system, filter.memory, filter.times, x, z, y)
    for k, _, likelihood in dist.steps():
        output = _output(filter, dist, k)
        dist.take(k, output.mean, likelihood, output.mode)
    return dist.risk()


def _output(filter, dist, k) -> Output:
    """Estimates (1, Y, cells) and modes of a filter, by measurement and cell of its memory."""
    memory, t = dist.memory_points, float(dist.times[k])
    cells, shape = memory.shape[1], (dist.y_grid.shape[1], memory.shape[1])
    if isinstance(filter, OutputFilter):
        output = filter.output(k, dist.y_grid[:, :, None], memory[:, None, :])
        mode = None if output.mode is None else np.broadcast_to(output.mode, shape)
        return Output(np.broadcast_to(output.mean, (1, *shape)), mode)
    state = filter.initial((cells,))
    if k:
        past = recalled(filter.system, filter.memory, 1, k - 1, memory)
        parts = {"mean": memory[:1], "cov": None}
        if dist.switching:
            mode = past.modes[0] if past.modes else np.zeros(cells, dtype=int)
            parts = {"time": float(dist.times[k - 1]), "mode": mode}
        state = state._replace(index=k - 1, past=past, corrected=True, **parts)
    state = filter.predict(state, t)
    if not dist.switching:
        return Output(corrected(dist, state.mean, state.cov, filter.expect(state)))
    means, modes, y = np.empty((1, *shape)), np.empty(shape, dtype=int), dist.y_grid
    for row in range(shape[0]):
        record = np.repeat(y[:, row, None], cells, axis=1)
        indicator = record[0].astype(int) if dist.chain.indicators else None
        after = filter.correct(state, record[len(y) - filter.system.measurement_size :], indicator)
        means[0, row], modes[row] = after.mean[0], after.mode
    return Output(means, modes)
