"""Deterministic synthesis of filters of scalar systems: theorems 1 and 2 on a grid."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, MaybeArray
from seedslib.base.checks import as_count
from seedslib.base.tables import AxesLike, Labels, NodesLike
from seedslib.base.values import Inputs
from seedslib.design.law.joint import BY_GRID, GridRisk, JointLaw
from seedslib.design.law.patterns import PatternLaw
from seedslib.design.law.recursion import conditional, seen
from seedslib.designed.memory import Memory
from seedslib.designed.outputs.lookup import Output, Step, Table, prior
from seedslib.designed.outputs.table import TableFilter
from seedslib.models.kinds import AnySystem, in_steps
from seedslib.models.simulation import Schedule

METHOD = "density recursion"


def grid_synthesis(
    system: AnySystem, memory: Memory, times: ArrayLike, *, x: NodesLike, z: AxesLike | None = None,
    y: AxesLike | None = None, nodes: Count = 4, probabilities: bool = False,
    inputs: Inputs | None = None, measured: ArrayLike | None = None,
    availability: ArrayLike | None = None,
) -> TableFilter:  # fmt: skip
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
    inputs : mapping of Input to array_like, shape (K+1,), optional
        Values of the inputs that the system mentions: the tables are those for this course. An
        input of which a law is known is a component of the state.
    measured : array_like, optional
        The schedule of the sensor, as `seedslib.models.simulate` takes it; for a memory of
        estimates. An indicator counts as the last component.
    availability : float or array_like, optional
        Probabilities with which the components that are read arrive. There is then a table for
        each pattern of what was seen, over classes of histories of what arrived before, see
        `seedslib.design.law.patterns`: errors are known after gaps too, likely or not, and
        `predicted` is their average.

    Returns
    -------
    TableFilter
        For a switching system it decides the modes too.

    Raises
    ------
    TypeError, ValueError
        A system with more components or without likelihood; a memory of another kind; axes that
        are none; a schedule or probabilities that do not fit, or that leave too many patterns.

    Warns
    -----
    UserWarning
        Probability at the ends of an axis; classes of histories that are far apart.
    """
    if nodes != 0:
        as_count("nodes", nodes)
    law = _law_of((system, memory, times, x, z, y, inputs), measured, availability)
    if probabilities and not law.switching:
        raise ValueError("probabilities: wanted False, the system has no modes")
    nodes = 0 if in_steps(system) else nodes
    if isinstance(law, PatternLaw):
        return _by_patterns(law, nodes, probabilities)
    steps, changes, between, before = [], [], [], None
    for k, found in enumerate(optimal_steps(law, nodes)):
        changes.append(_change(before, found))
        with law.held.at(k):
            steps.append(_tables(law, k, found, probabilities))
        between.append(found.between)
        before = found
    return _filter(law, steps, nodes, between, changes=np.array(changes).T)


def _law_of(arguments: tuple[Any, ...], measured: Any, availability: Any) -> JointLaw:
    """The law of a sensor, whose components are all there, or come by patterns.

    Raises
    ------
    TypeError, ValueError
        As `grid_synthesis`.
    """
    law = JointLaw(*arguments)
    size = law.system.measurement_size + (law.chain.indicators > 0)
    schedule = Schedule.of(measured, availability, len(law.times), size)
    sure = schedule.availability is None or (schedule.availability == 1.0).all()
    return law if sure and schedule.mask.all() else PatternLaw(arguments, schedule)


def _by_patterns(law, nodes, probabilities) -> TableFilter:
    """As `grid_synthesis`, by the law of patterns."""
    steps, between = [], []
    for k, t, sight, nodes_before in law.steps(nodes):
        with law.held.at(k):
            steps.append(law.decided(k, t, sight, probabilities))
        between.append(nodes_before)
    few = len(law.histories.loose) > 0
    return _filter(
        law, steps, nodes, between, arrivals=tuple(law.histories.arrivals),
        measured=None if law.mask.all() else law.mask, availability=law.rates if few else None,
    )  # fmt: skip


def _filter(law, steps, nodes, between, **told) -> TableFilter:
    stops = [np.linspace(a, b, nodes + 2)[1:-1] for a, b in pairwise(law.times)]
    return TableFilter(
        system=law.system, memory=law.memory, times=law.times, steps=tuple(steps), method=METHOD,
        predicted=law.prediction(), covariances=law.errors(), design=BY_GRID,
        node_times=tuple(stops), node_fits=tuple(between[1:]), **told,
    )  # fmt: skip


class Optimal(NamedTuple):
    """What is optimal at one measurement, on the grid of measurements and memory.

    Attributes
    ----------
    held : int
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

    held: int
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
        held, given = law.filled, conditional(law.joint)
        found = law.posterior(sight.relative, given)
        mass = law.take(k, found.mean, sight, found.mode)
        yield Optimal(held, given, *found, mass, between)


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
    told, held = (Labels(values + 1),) * bool(values), law.letter_axes * optimal.held
    if values:
        axes, y = axes[1:], law.shown[1:, : len(law.weights) // values]
        unseen = law.chain.log_likelihood(t, np.concatenate([np.full((1, y.shape[1]), -1.0), y]))
        more = law.posterior(seen(unseen, law.weights[: y.shape[1]]).relative, given)
        found = Output(*(np.concatenate(pair, axis=-2) for pair in zip(found, more, strict=True)))

    shown = Table.of(told + axes + held, found, probabilities)
    if law.switching:
        more = law.posterior(law.chain.told(t), given)
        return Step(shown, Table.of(told + held, more, probabilities))
    blind = Table.of(held, Output(given @ law.values[0]))
    return Step(shown, blind if k else prior(law.system, 1))


def optimal_risk(
    system: AnySystem, memory: Memory, times: ArrayLike, *, x: NodesLike, z: AxesLike | None = None,
    y: AxesLike | None = None, inputs: Any = None, measured: ArrayLike | None = None,
    availability: ArrayLike | None = None,
) -> GridRisk:  # fmt: skip
    """Least mean-square errors that a memory allows: the risk of `grid_synthesis` without tables.

    Parameters
    ----------
    system, memory, times, x, z, y, inputs, measured, availability
        As `grid_synthesis`.

    Returns
    -------
    GridRisk

    Raises
    ------
    TypeError, ValueError
        As `grid_synthesis`.
    """
    law = _law_of((system, memory, times, x, z, y, inputs), measured, availability)
    if isinstance(law, PatternLaw):
        for k, t, sight, _ in law.steps():
            with law.held.at(k):
                law.decided(k, t, sight)
    else:
        for _ in optimal_steps(law):
            pass
    return law.risk()
