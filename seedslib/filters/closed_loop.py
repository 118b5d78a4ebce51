"""Simulation of a system that is controlled by what its filter estimates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, Seed
from seedslib.base.blocks import FILTERS, in_blocks
from seedslib.base.blocks import child as descendant
from seedslib.base.checks import as_count, as_real, brief
from seedslib.base.clock import when
from seedslib.base.values import as_trajectory
from seedslib.filters.base import Estimates, Filter, joined, stacked
from seedslib.models.kinds import AnySystem, as_grid, as_system, inputs_of

if TYPE_CHECKING:
    from seedslib.base.symbols import Input

KINDS = "JumpDiffusion", "DiscreteSystem", "LinearSystem"

Policy: TypeAlias = "Callable[[float, Estimates], Mapping[Input, ArrayLike]]"


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Simulated runs of a system, its filter and what chooses its inputs.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    states : ndarray, shape (K+1, n, paths)
    measurements : ndarray, shape (K+1, m, paths)
    inputs : dict of Input to ndarray, shape (K+1, paths)
        As `simulate` and `run` take them: those of a time act until the next. At the last time,
        when none is chosen, those before are repeated.
    estimates : Estimates
        After each measurement.
    """

    times: np.ndarray
    states: np.ndarray
    measurements: np.ndarray
    inputs: dict[Input, np.ndarray]
    estimates: Estimates


def simulate_closed_loop(
    system: AnySystem,
    filter: Filter,
    policy: Policy,
    times: ArrayLike,
    paths: Count,
    seed: Seed,
    **options: Any,
) -> ClosedLoop:
    """Simulate a system whose inputs are chosen from what a filter estimates.

    At each time the filter forecasts with the inputs that have acted since the time before and is
    corrected by the new measurement; then the policy chooses the inputs that act until the next
    time, in the system and in the filter's forecast. Random numbers are those of `simulate`: two
    policies, or two filters, are compared on the same noises.

    Parameters
    ----------
    system : JumpDiffusion or DiscreteSystem
        The truth. Its dynamics mention inputs, its sensor none, for they are chosen afterwards.
    filter : Filter
        Any that can be stepped through a system with inputs. Its model need not be the truth, but
        has the same inputs and measurements.
    policy : callable
        ``policy(t, estimate) -> {u: value}``, asked at every time but the last. The estimate is
        what the filter reports at that time, ``estimate.mean`` (n, paths) and so on; there is a
        value for each input, a number or an array (paths,). It is called with 8192 paths at most,
        and with those of another block from the first time on.
    times : array_like, shape (K+1,)
        Two at least; the first is the time of the initial distribution.
    paths : int
    seed : int, SeedSequence or Generator
    **options
        For ``system.advance``, such as `step` and `scheme` of a jump-diffusion.

    Returns
    -------
    ClosedLoop

    Raises
    ------
    TypeError, ValueError
        A system of another kind, without inputs, or with inputs in its sensor; a filter of other
        inputs or measurements; a policy that does not return a finite number for each input, or
        one for each path; what `simulate` refuses.
    """
    if not isinstance(filter, Filter):
        raise TypeError(f"filter: wanted a filter of this library, got {brief(filter)}")
    if not callable(policy):
        raise TypeError(f"policy: wanted a function of time and estimate, got {brief(policy)}")
    model = filter.system
    chosen, expected = _chosen("system", system), _chosen("filter", model)
    if not chosen:
        raise ValueError("system: wanted dynamics with an Input, got none that is not bound")
    size = system.measurement_size
    if expected != chosen or model.measurement_size != size:
        raise ValueError(
            f"filter: wanted one for {size} measured components and the inputs {_names(chosen)}, "
            f"got {model.measurement_size} and {_names(expected) or 'none'}"
        )
    times, paths = as_grid("times", times, system), as_count("paths", paths)
    count = len(times)
    if count < 2:
        raise ValueError("times: wanted at least two times, got one")
    states = np.empty((count, system.state_size, paths))
    measurements = np.empty((count, size, paths))
    inputs = {u: np.empty((count, paths)) for u in sorted(chosen, key=str)}
    nothing = dict.fromkeys(chosen, 0.0)  # for sensors, which do not look at inputs
    numbers = [
        as_trajectory(each, {u: np.zeros(count) for u in chosen}, count, (paths,))
        for each in (system, model)
    ]

    def work(start: int, stop: int, stream: np.random.SeedSequence) -> Estimates:
        own = slice(start, stop)
        truth, observer = (
            each.bind(part.of(own).constant)
            for each, part in zip((system, filter), numbers, strict=True)
        )
        state = observer.initial((stop - start,), descendant(stream, FILTERS))
        x, u, reports = None, nothing, []
        for k, child in enumerate(stream.spawn(count)):
            moving, sensing = (np.random.default_rng(s) for s in child.spawn(2))
            t = float(times[k])
            with np.errstate(over="ignore", invalid="ignore"):
                if k == 0:
                    x = truth.initial_sample(moving, stop - start)
                else:
                    p = truth.values(u, t - times[k - 1])
                    x = truth.advance(x, times[k - 1], t, moving, p, **options)
                y = truth.sensor.sample(t, x, sensing, truth.values(nothing))
            states[k, :, own], measurements[k, :, own] = x, y
            state = observer.correct(observer.predict(state, t, inputs=u), y, inputs=nothing)
            reports.append(observer.report(state))
            if k < count - 1:
                u = _values(policy(t, reports[-1]), chosen, stop - start, t)
            for name, value in u.items():
                inputs[name][k, own] = value
        return stacked(reports, count)

    estimates = joined(in_blocks(work, paths, seed), (paths,))
    return ClosedLoop(times, states, measurements, inputs, estimates)


def _names(inputs: frozenset[Input]) -> str:
    return ", ".join(sorted(map(str, inputs)))


def _chosen(name: str, system: AnySystem) -> frozenset[Input]:
    """Inputs of a system that have no number yet, none of which its sensor may mention."""
    free = inputs_of(as_system(name, system, *KINDS)) - system.numbers.keys()
    if early := free.intersection(system.sensor.mentions):
        raise ValueError(
            f"{name}: wanted a sensor without inputs, for they are chosen after the measurement, "
            f"got {_names(early)} in it"
        )
    return free


def _values(
    given: object, chosen: frozenset[Input], paths: int, t: float
) -> dict[Input, float | np.ndarray]:
    """What a policy returned, checked: a number or an array (paths,) for each input."""
    if not isinstance(given, Mapping) or set(given) != chosen:
        raise ValueError(
            f"policy: wanted a mapping of {_names(chosen)} to numbers at {when(t)}, "
            f"got {brief(given)}"
        )
    values = {}
    for u in chosen:
        value = as_real(f"policy[{u}] at {when(t)}", given[u])
        if value.shape not in {(), (paths,)}:
            raise ValueError(
                f"policy[{u}] at {when(t)}: wanted shape () or ({paths},), got {value.shape}"
            )
        values[u] = value[()]
    return values
