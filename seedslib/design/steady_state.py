"""A design without an end: its last steps serve all later ones, where they have converged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from seedslib.base.arrays import Count, Seed
from seedslib.base.checks import as_count, as_positive
from seedslib.designed.base import DesignedFilter
from seedslib.filters.base import Estimates
from seedslib.models.simulation import Simulation

SURE = 4.0
"""Standard errors that a growth of the error must have to be one."""


def stationary(
    filter: DesignedFilter,
    tolerance: float = 0.02,
    *,
    cycle: Count = 1,
    transient: Count | None = None,
    paths: Count = 2048,
    seed: Seed = 0,
    **options: Any,
) -> Any:
    """The same filter without an end: its last step, or its last few in turn, serve all later ones.

    That is right where the recursion of the design has come to its fixed point, and the filter
    does not run away from it. Both are looked at on other paths, over twice the times of the
    design: (1) the estimates over its last quarter are compared with those that the steps before
    that quarter give when they go on in the same way; (2) the error after the end of the design
    is compared with the one before it.

    Parameters
    ----------
    filter : FiniteOrderFilter, SwitchingFilter, TableFilter or another designed filter
        With a memory, designed at more times than it takes to settle.
    tolerance : float
        Largest change (1) of the estimates in units of their root-mean-square errors, and of the
        decided modes as a probability; largest growth (2) of the error, in units of itself.
    cycle : int
        So many steps in turn, for a system, times or a schedule with a period.
    transient : int, optional
        Keep only so many steps of the design before those that go on for ever; by default all.
        A small filter uses the functions of the end before the start is forgotten.
    paths : int
    seed : int, SeedSequence or Generator
    **options
        Of ``system.simulate``, such as `step`.

    Returns
    -------
    filter
        Of the same kind. Where steps were left out, `held_out` are the errors on the paths of this
        test, and of `predicted` only the rows of the other steps remain.

    Raises
    ------
    TypeError, ValueError
        No designed filter, arguments that do not fit; a
        design that has not converged, or a filter that does not keep its error: the message has the
        numbers.
    """
    if not isinstance(filter, DesignedFilter) or filter.memory is None:
        raise TypeError(f"filter: wanted a filter with a design, got {filter!r}")
    if filter.availability is not None:
        raise ValueError("filter: wanted one without an availability, whose classes have an end")
    tolerance = as_positive("tolerance", tolerance, infinite=True)
    last, depth = len(filter.times) - 1, max(1, filter.memory.depth)
    cycle, paths = as_count("cycle", cycle), as_count("paths", paths, 2)
    span = cycle * max(1, last // (4 * cycle))
    if last < depth + cycle + span:
        raise ValueError(
            f"times: wanted a design of {depth + cycle + span} steps or more, for a memory of "
            f"depth {depth} and a cycle of {cycle}, got {last}"
        )
    endless = replace(filter, cycle=cycle)
    times = np.array([endless.clock.moment(k, cycle) for k in range(2 * last + 1)])
    pattern = _schedule(endless, 2 * last + 1)
    period = slice(last + 1 - span, None)
    if (pattern[period] != pattern[period.start - cycle : -cycle]).any():
        raise ValueError(f"cycle: wanted the period of the schedule of the design, got {cycle}")
    data = filter.system.simulate(times, paths, seed, measured=pattern, **options)
    estimates = _run(endless, data)
    earlier = _run(replace(filter.taking([*range(last + 1 - span)]), cycle=cycle), data)
    end = slice(last + 1 - span, last + 1)
    scale = (_errors(estimates, data)[end] ** 2).mean(axis=(0, 2)) ** 0.5
    moved = ((estimates.mean - earlier.mean)[end] ** 2).mean(axis=(0, 2)) ** 0.5 / scale
    moved, modes, of_modes = float(moved.max()), 0.0, ""
    if data.modes is not None:
        modes = float((estimates.modes != earlier.modes)[end].mean())
        of_modes = f" and {modes:.3g} in the probability of another mode"
    if not max(moved, modes) <= tolerance:
        raise ValueError(
            f"tolerance: wanted estimates that change by at most {tolerance:g} of their error "
            f"over the last {span} steps, got {moved:.3g}{of_modes}; design for more times, or on "
            "more paths"
        )
    if transient is not None:
        transient = as_count("transient", transient, depth, last - cycle)
        steps = [*range(transient), *range(last + 1 - cycle, last + 1)]
        endless = replace(filter.taking(steps), cycle=cycle)
        if (_schedule(endless, 2 * last + 1) != pattern).any():
            raise ValueError(
                f"transient: wanted {(last + 1) % cycle} and a multiple of the cycle of {cycle}, "
                f"since the schedule goes on in turn, got {transient}"
            )
        estimates = _run(endless, data)
    square = _errors(estimates, data) ** 2
    growth = square[last + 1 :].mean(axis=0) - square[end].mean(axis=0)
    growth /= 2.0 * scale[:, None] ** 2
    growth, error = growth.mean(axis=1), growth.std(axis=1) / np.sqrt(paths)
    if not np.all(growth <= tolerance + SURE * error):
        worst = int(np.argmax(np.where(np.isnan(growth), np.inf, growth - SURE * error)))
        raise ValueError(
            f"filter: wanted an error that stays, got one of component {worst} that grows by "
            f"{growth[worst]:.3g} ± {error[worst]:.2g} of itself over {last} steps after the design"
        )
    return endless


def _schedule(filter, count):
    """Components that may be measured, (count, m)."""
    return filter.schedule.mask[[filter.served(k) for k in range(count)]]


def _run(filter: DesignedFilter, data: Simulation) -> Estimates:
    """The filter's estimates on paths that go on beyond its design."""
    with np.errstate(over="ignore", invalid="ignore"):  # what diverges grows too much
        return filter.run(data.times, data.measurements, indicators=data.indicators)


def _errors(estimates: Estimates, data: Simulation) -> np.ndarray:
    return estimates.mean - data.states[:, : estimates.mean.shape[1]]
