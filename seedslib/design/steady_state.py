"""A design that goes on for ever: its last steps serve all later ones, where it has settled."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from seedslib.base.arrays import Count, Seed
from seedslib.base.checks import as_count, as_positive
from seedslib.design.carriers import prediction_of
from seedslib.designed.accuracy import HeldOut
from seedslib.designed.base import DesignedFilter
from seedslib.filters.base import Estimates
from seedslib.models.kinds import UnknownModel
from seedslib.models.simulation import Simulation

SURE = 4.0
"""Standard errors that a growth of the error must have to be one."""


def stationary(
    filter: Any,
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
        A small filter uses the functions of the end before the law of the start is forgotten.
    paths : int
    seed : int, SeedSequence or Generator
    **options
        Of ``system.simulate``, such as `step`.

    Returns
    -------
    filter
        Of the same kind. Where steps were left out, `held_out` is what was found here, and of
        `predicted` the rows of the steps that are left.

    Raises
    ------
    TypeError, ValueError
        No designed filter, one that was loaded without its model, arguments that do not fit; a
        design that has not settled, or a filter that does not keep its error: the message has the
        numbers.
    """
    if not isinstance(filter, DesignedFilter) or filter.memory is None:
        raise TypeError(f"filter: wanted a filter with a design, got {filter!r}")
    if isinstance(filter.system, UnknownModel):
        raise ValueError("filter: wanted one with its model, got one that was loaded without")
    tolerance = as_positive("tolerance", tolerance, infinite=True)
    last, depth = len(filter.times) - 1, max(1, filter.memory.depth)
    cycle, paths = as_count("cycle", cycle), as_count("paths", paths, 2)
    span = cycle * max(1, last // (4 * cycle))
    if last < depth + cycle + span:
        raise ValueError(
            f"times: wanted a design of {depth + cycle + span} steps or more, for a memory of "
            f"depth {depth} and a cycle of {cycle}, got {last}"
        )
    made = replace(filter, cycle=cycle)
    times = np.array([made.clock.moment(k, cycle) for k in range(2 * last + 1)])
    pattern = _schedule(made, 2 * last + 1)
    turn = slice(last + 1 - span, None)
    if (pattern[turn] != pattern[turn.start - cycle : -cycle]).any():
        raise ValueError(f"cycle: wanted the period of the schedule of the design, got {cycle}")
    data = filter.system.simulate(
        times, paths, seed, measured=pattern, availability=filter.availability, **options
    )
    found = _on(made, data)
    early = _on(replace(filter.taking([*range(last + 1 - span)]), cycle=cycle), data)
    settled = slice(last + 1 - span, last + 1)
    scale = (_errors(found, data)[settled] ** 2).mean(axis=(0, 2)) ** 0.5
    moved = ((found.mean - early.mean)[settled] ** 2).mean(axis=(0, 2)) ** 0.5 / scale
    moved, modes, said = float(moved.max()), 0.0, ""
    if data.modes is not None:
        modes = float((found.modes != early.modes)[settled].mean())
        said = f" and {modes:.3g} in the probability of another mode"
    if not max(moved, modes) <= tolerance:
        raise ValueError(
            f"tolerance: wanted estimates that change by at most {tolerance:g} of their error "
            f"over the last {span} steps, got {moved:.3g}{said}; design for more times, or on "
            "more paths"
        )
    if transient is not None:
        transient = as_count("transient", transient, depth, last - cycle)
        kept = [*range(transient), *range(last + 1 - cycle, last + 1)]
        made = replace(filter.taking(kept), cycle=cycle)
        if (_schedule(made, 2 * last + 1) != pattern).any():
            raise ValueError(
                f"transient: wanted {(last + 1) % cycle} and a multiple of the cycle of {cycle}, "
                f"since the schedule goes on in turn, got {transient}"
            )
        found = _on(made, data)
        made = replace(made, held_out=_held_out(made, found, data))
    square = _errors(found, data) ** 2
    change = square[last + 1 :].mean(axis=0) - square[settled].mean(axis=0)
    change /= 2.0 * scale[:, None] ** 2
    grown, doubt = change.mean(axis=1), change.std(axis=1) / np.sqrt(paths)
    if not np.all(grown <= tolerance + SURE * doubt):
        worst = int(np.argmax(np.where(np.isnan(grown), np.inf, grown - SURE * doubt)))
        raise ValueError(
            f"filter: wanted an error that stays, got one of component {worst} that grows by "
            f"{grown[worst]:.3g} ± {doubt[worst]:.2g} of itself over {last} steps after the design"
        )
    return made


def _schedule(filter, count):
    """Components that may be measured, (count, m)."""
    return filter.schedule.mask[[filter.served(k) for k in range(count)]]


def _on(filter: Any, data: Simulation) -> Estimates:
    """The filter's estimates on paths that go on beyond its design."""
    told = {} if data.indicators is None else {"indicators": data.indicators}
    with np.errstate(over="ignore", invalid="ignore"):  # what diverges grows too much
        return filter.run(data.times, data.measurements, **told)


def _errors(found: Estimates, data: Simulation) -> np.ndarray:
    return found.mean - data.states[:, : found.mean.shape[1]]


def _held_out(filter: Any, found: Estimates, data: Simulation) -> HeldOut:
    """Accuracy at the filter's own times."""
    squares = _errors(found, data) ** 2
    wrong = () if data.modes is None else (found.modes != data.modes)[: len(filter.times)]
    now = prediction_of(list(zip(filter.times, squares, strict=False)), wrong)
    paths = data.states.shape[2]
    return HeldOut(filter.times, now.rms, now.error, paths, 0, now.mode_rate, now.mode_error)
