"""Design of finite-order filters of switching systems: moments of the running filter, step by
step.
"""

from __future__ import annotations

import math
import warnings
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import BLOCK, as_seed_sequence, seed_record
from seedslib.base.checks import as_count, outside
from seedslib.base.progress import followed
from seedslib.base.values import Inputs
from seedslib.design.cells import fit_cells
from seedslib.design.histories import few_patterns, keep_indicators
from seedslib.design.paths.forward_pass import as_read
from seedslib.design.paths.held_out import examined
from seedslib.design.paths.walk import Crew, Walk, crew
from seedslib.design.regression import combine, root_mean_squares, scatter
from seedslib.designed.guards import warn_of_mended
from seedslib.designed.memory import Memory
from seedslib.designed.prediction import Design, Prediction
from seedslib.designed.switching.filter import SwitchingFilter
from seedslib.designed.switching.fits import cell_count, cell_number, require_memory
from seedslib.designed.switching.rules import compiled_rules
from seedslib.linearization.moments import Linearization
from seedslib.models.kinds import as_grid, course_of, elapsed
from seedslib.models.simulation import Schedule
from seedslib.models.switching import SwitchingSystem

OFTEN = 0.05
"""Part of thin pairs of cell and mode above which the design warns."""


def synthesize_switching(
    system: SwitchingSystem, memory: Memory, linearization: Linearization, times: ArrayLike, *,
    paths: int, seed: object, workers: int | Crew = 1, normalisation: str = "consistent",
    split: bool = True, inputs: Inputs | None = None, measured: Any = None,
    availability: Any = None,
) -> SwitchingFilter:  # fmt: skip
    """Design a filter of finite order for a switching system: theorem 3 of the switching paper.

    One pass over simulated paths. At each step the filter corrects on all paths and puts its
    decisions on the memory; the moments of mode, state and memory on the paths, (6.31), are what
    it will know of its memory online. While the memory fills it is shorter, not padded.

    Parameters
    ----------
    system : SwitchingSystem
    memory : Memory
    linearization : Linearization
    times : array_like, shape (K+1,)
    paths : int
        Design paths.
    seed : int, SeedSequence or Generator
        The design paths are ``system.simulate(times, paths, seed)``.
    workers : int or Crew
        Threads, or a crew such as `seedslib.extra.cluster` makes; the filter does not depend on
        it, bit by bit.
    normalisation, split
        As `SwitchingFilter`.
    measured : array_like, optional
        As `seedslib.models.simulate`; of a memory of indicators they are all measured.
    availability : float or array_like, optional
        Probabilities with which what is read arrives, of an indicator the last.

    Returns
    -------
    SwitchingFilter

    Raises
    ------
    TypeError, ValueError
        An argument that does not fit; too few paths.
    NoClosedForm
        The linearization has no formulas for a branch.

    Warns
    -----
    UserWarning
        More than a twentieth of the pairs of cell and mode are thin; covariances were mended;
        paths of the system or of the filter diverged and were left out. What held-out paths
        say against the design, see `seedslib.design.paths.held_out`.
    """
    times = as_grid("times", times, system)
    held = course_of(system, inputs, len(times))
    require_memory(memory, system)
    n = system.state_size
    order = memory.order(n, system.measurement_size, system.modes)
    paths = as_count("paths", paths)
    if paths < n + order + 2:
        raise ValueError(f"paths: wanted at least {n + order + 2}, got {paths}")
    rules = compiled_rules(system, linearization, normalisation, split)
    there, rates = Schedule.of(measured, availability, len(times), system.hybrid.sensor.size)
    keep_indicators(memory, there, rates)
    if rates is not None:
        there = there & (rates > 0.0)
        rates = rates.copy() if len(few_patterns(rates)) else None
    root = as_seed_sequence(seed)
    with crew(workers) as each:
        walk = Walk(system.hybrid, paths, root, len(times), each, {}, np.inf)
        arrivals: Any = ()
        if rates is None:
            found = _pass(walk, system, memory, rules, times, held, there)
        else:
            from seedslib.design.paths.switching_patterns import pattern_pass

            *found, arrivals = pattern_pass(walk, system, memory, rules, times, held, there, rates)
        fits, scores, forecasts, thin, pairs, raised = found
        if thin > OFTEN * pairs:
            warnings.warn(
                f"paths: {thin} of {pairs} pairs of cell and mode had too few paths of their own",
                stacklevel=outside(),
            )
        warn_of_mended(raised)
        rms, error, rate, doubt = (np.array(part) for part in zip(*scores, strict=True))
        designed = SwitchingFilter(
            system, linearization, memory, times, tuple(fits), normalisation, split,
            Prediction(times, rms, error, True, rate, doubt),
            Design(
                paths, BLOCK, *seed_record(root), walk.warn_of_lost(), False, thin, pairs, raised
            ),
            rules=rules, measured=None if there.all() else there.copy(), availability=rates,
            arrivals=tuple(arrivals),
        )  # fmt: skip
        del walk  # its paths are not wanted any more
        return examined(
            designed, root, paths, each, times, forecasts=np.array(forecasts), course=held
        )


def _pass(walk, system, memory, rules, times, held, there):
    """Run the filter on the paths, and fit it before each step."""
    n, m = system.state_size, system.measurement_size
    states, fits, scores, thin, pairs, raised = [], [], [], 0, 0, 0
    forecasts = [np.full(n, np.nan)]
    for k, t in enumerate(followed(times, "design")):
        if k == 0:
            walk.begin(t)
            states = walk.each(lambda x: rules.start(x.shape[1:]), walk.states)
        else:
            fit, old = fits[-1], times[k - 1]

            def predict(state, fit=fit, old=old):
                cell = cell_of(system, state)
                law = rules.predict(old, fit.forecast(cell, state.past.vector))
                return state._replace(law=law, corrected=False)

            with held.at(k - 1), elapsed(system, old, t):
                walk.advance(old, t)
                states = walk.each(predict, states)
            found = walk.gather(lambda x, state: (x[:n] - forecast_mean(state.law)) ** 2, states)
            forecasts.append(np.sqrt(found.mean))

        def correct(state, y, k=k, t=t):
            y = as_read(there[k], y)
            seen = np.nan_to_num(y[m], nan=-1.0).astype(int) if system.indicators else None
            return rules.correct(state._replace(index=k, time=t), y[:m], seen, memory)

        with held.at(k):
            states = walk.kept(correct, states, walk.measure(t), array=lambda state: state.mean)
        scores.append(score(walk, n, states))
        if k + 1 == len(times):
            continue
        cells = cell_count(memory, system, k)
        scatters, left = moments_of_cells(walk, system, states, cells)
        fit, few, bent = fit_cells(scatters, n, left)
        fits.append(fit)
        thin, pairs, raised = thin + few, pairs + cells * system.modes, raised + bent
    raised += sum(state.mended for state in states)
    return fits, scores, forecasts, thin, pairs, raised


def moments_of_cells(walk: Any, system: Any, states: Any, cells: int) -> tuple[list, int]:
    """Moments of state and memory in each cell and mode, and how many paths they are of.

    Raises
    ------
    ValueError
        No path.
    """
    groups = walk.each(
        lambda x, alive, state: _groups(system, x, alive, state, cells),
        walk.states, walk.alive, states,
    )  # fmt: skip
    scatters = [
        [combine([bundle[c][i] for bundle in groups]) for i in range(system.modes)]
        for c in range(cells)
    ]
    left = sum(part.count for row in scatters for part in row)
    if not left:
        raise ValueError(
            f"paths: wanted some that stay finite, all {sum(map(sum, walk.counts))} diverged"
        )
    return scatters, left


def forecast_mean(law: Any) -> Any:
    """Mean of the state, (n, paths), under a forecast law."""
    weight = law.prob / law.prob.sum(axis=(0, 1))
    return (weight * law.mean).sum(axis=(1, 2))


def cell_of(system: Any, state: Any) -> np.ndarray:
    """Number of the cell of a state's memory."""
    return cell_number(state.past, system.modes, system.indicators, state.mode.shape)


def _groups(system, x, alive, state, cells):
    """Moments of state and memory in each cell and mode of one bundle of paths."""
    rows = np.concatenate([x[:-1], state.past.vector])
    group = cell_of(system, state) * system.modes + x[-1].astype(int)
    if not alive.all():
        rows, group = rows[:, alive], group[alive]
    # equal groups side by side, in their order
    order = np.argsort(group, kind="stable")
    ends = np.searchsorted(group[order], np.arange(cells * system.modes + 1))
    sorted_rows = rows[:, order]
    parts = [scatter(sorted_rows[:, a:b]) for a, b in pairwise(ends)]
    return [parts[c * system.modes : (c + 1) * system.modes] for c in range(cells)]


def score(walk: Any, n: int, *states: Any, weights: Any = (1.0,)) -> tuple[Any, ...]:
    """Root-mean-square errors, part of wrong modes, and their standard errors.

    Of one state on the paths, or of several with weights that sum to one.
    """

    def rows(x, *several):
        found = [
            np.concatenate([(x[:-1] - state.mean) ** 2, (state.mode != x[-1])[None]])
            for state in several
        ]
        if len(found) == 1:
            return found[0]
        return sum(weight * part for weight, part in zip(weights, found, strict=True))

    found = walk.gather(rows, *states)
    rms, error, spread = root_mean_squares(found, n)
    return rms, error, found.mean[n], spread[n] / math.sqrt(found.count)
