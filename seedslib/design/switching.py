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
from seedslib.base.semidefinite import NEGATIVE
from seedslib.base.values import Inputs
from seedslib.design.held_out import with_held_out
from seedslib.design.paths import Crew, Walk, crew
from seedslib.design.regression import Scatter, combine, inverse_root, root_mean_squares, scatter
from seedslib.designed.accuracy import Design, Prediction
from seedslib.designed.base import warn_of_repairs
from seedslib.designed.memory import Memory
from seedslib.designed.rules import compiled_rules
from seedslib.designed.switching import (
    CellFit,
    SwitchingFilter,
    cell_count,
    cell_number,
    require_memory,
)
from seedslib.linearization.moments import Linearization
from seedslib.models.kinds import as_grid, course_of, elapsed
from seedslib.models.switching import SwitchingSystem

JITTER = 1e-8
"""Added to the covariance of the whitened memory before it is inverted."""

FEWEST = 50
"""Fewer samples than this make a cell thin."""


def cells_from_moments(
    prob: np.ndarray, mean: np.ndarray, cov: np.ndarray, size: int, *, jitter: float = JITTER
) -> CellFit:
    """Fit from given moments of state and memory together, instead of simulated ones.

    Parameters
    ----------
    prob : ndarray, shape (L, C)
        Probabilities of mode and cell.
    mean : ndarray, shape (n + d, L, C)
        Of the state and, below it, the memory.
    cov : ndarray, shape (n + d, n + d, L, C)
    size : int
        n.
    jitter : float
        Added to the covariance of the whitened memory.

    Returns
    -------
    CellFit
    """
    cells = []
    for c in range(prob.shape[1]):
        parts = [Scatter(p, mean[:, i, c], p * cov[:, :, i, c]) for i, p in enumerate(prob[:, c])]
        pooled = combine([part for part in parts if part.count > 0])
        moments = [part if part.count > 0 else pooled for part in parts]
        cells.append(_cell(prob[:, c], moments, pooled, size, jitter)[0])
    return _stacked(cells)


def fit_cells(scatters: list[list[Scatter]], size: int, total: int) -> tuple[CellFit, int, int]:
    """Fit from samples, with the rules for thin cells.

    Moments of a mode in a cell with fewer than max(50, 3 (r + 1)) samples, r the rank of the
    memory there, are pooled over the modes of the cell; where that is thin too, over the cells of
    the mode; where even that is thin, over everything. No probability is zero: a cell never met
    in the design works online.

    Parameters
    ----------
    scatters : list of list of Scatter
        Moments of state and memory for each cell and mode.
    size : int
        n.
    total : int
        Number of samples.

    Returns
    -------
    fit : CellFit
    thin : int
        Pairs of cell and mode that borrowed their moments.
    mended : int
        Covariances T whose eigenvalues were raised.
    """
    modes = len(scatters[0])
    everything = combine([part for row in scatters for part in row])
    by_mode = [combine([row[i] for row in scatters]) for i in range(modes)]
    cells, thin, raised = [], 0, 0
    for row in scatters:
        pooled = combine(row)
        basis = pooled if pooled.count >= FEWEST else everything
        rank = inverse_root(basis.cov[size:, size:], _sizes(basis, size)).shape[1]
        least = max(FEWEST, 3 * (rank + 1))
        basis = pooled if pooled.count >= least else everything
        moments = []
        for i, part in enumerate(row):
            if part.count < least:
                thin += 1
                part = next(
                    (p for p in (pooled, by_mode[i], everything) if p.count >= least), everything
                )
            moments.append(part)
        weights = np.array([max(part.count, 0.5) for part in row]) / total
        cell, floors = _cell(weights, moments, basis, size, JITTER)
        cells.append(cell)
        raised += floors
    return _stacked(cells), thin, raised


def _stacked(cells):
    return CellFit(*(np.stack(parts, axis=-1) for parts in zip(*cells, strict=True)))


def _sizes(part, n):
    return np.sqrt(np.diagonal(part.cov)[n:] + part.mean[n:] ** 2)


def _cell(weights, moments, basis, n, jitter):
    """Arrays of one cell, and how many covariances were mended."""
    d = len(basis.mean) - n
    root = inverse_root(basis.cov[n:, n:], _sizes(basis, n))
    rank, modes = root.shape[1], len(weights)
    log_weight, centre = np.empty(modes), np.empty((d, modes))
    white, gain = np.zeros((d, d, modes)), np.zeros((n, d, modes))
    offset, cov = np.empty((n, modes)), np.empty((n, n, modes))
    raised = 0
    for i, (weight, part) in enumerate(zip(weights, moments, strict=True)):
        inner = root.T @ part.cov[n:, n:] @ root + jitter * np.eye(rank)
        cross = part.cov[:n, n:] @ root
        lower = np.linalg.cholesky(inner)
        half = np.linalg.solve(lower, cross.T)
        scaled = np.linalg.solve(lower, root.T)
        gain[:, :, i] = half.T @ scaled
        white[:rank, :, i] = scaled
        centre[:, i] = part.mean[n:]
        offset[:, i] = part.mean[:n] - gain[:, :, i] @ part.mean[n:]
        rest = part.cov[:n, :n] - half.T @ half
        # a function of the matrix: the same for every basis of its eigenvectors
        values, vectors = np.linalg.eigh(0.5 * (rest + rest.T))
        least = NEGATIVE * max(np.trace(part.cov[:n, :n]), 0.0)
        negative = values < -least
        raised += int(negative.any())
        values = np.where(negative, least, np.maximum(values, 0.0))
        cov[:, :, i] = (vectors * values) @ vectors.T
        with np.errstate(divide="ignore"):
            log_weight[i] = np.log(weight) - np.log(np.diagonal(lower)).sum()
    return (log_weight, centre, white, gain, offset, cov), raised


OFTEN = 0.05
"""Part of thin pairs of cell and mode above which the design warns."""


def synthesize_switching(
    system: SwitchingSystem,
    memory: Memory,
    linearization: Linearization,
    times: ArrayLike,
    *,
    paths: int,
    seed: object,
    workers: int | Crew = 1,
    normalisation: str = "consistent",
    inputs: Inputs | None = None,
) -> SwitchingFilter:
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
    normalisation
        As `SwitchingFilter`.
    inputs : mapping of Input to array_like, shape (K+1,), optional
        As `seedslib.design.synthesize`.

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
        say against the design, see `seedslib.design.held_out`.
    """
    times = as_grid("times", times, system)
    require_memory(memory, system)
    n = system.state_size
    order = memory.order(n, system.measurement_size, system.modes)
    paths = as_count("paths", paths)
    if paths < n + order + 2:
        raise ValueError(f"paths: wanted at least {n + order + 2}, got {paths}")
    course = course_of(system, inputs, len(times))
    rules = compiled_rules(system, linearization, normalisation)
    root = as_seed_sequence(seed)
    with crew(workers) as each:
        walk = Walk(system.hybrid, paths, root, len(times), each, {})
        fits, scores, thin, pairs, mended = _pass(walk, system, memory, rules, times, course)
        if thin > OFTEN * pairs:
            warnings.warn(
                f"paths: {thin} of {pairs} pairs of cell and mode had too few paths of their own",
                stacklevel=outside(),
            )
        warn_of_repairs(mended)
        rms, error, rate, rate_error = (np.array(part) for part in zip(*scores, strict=True))
        designed = SwitchingFilter(
            system,
            linearization,
            memory,
            times,
            tuple(fits),
            normalisation,
            Prediction(times, rms, error, True, rate, rate_error),
            Design(
                paths, BLOCK, *seed_record(root), walk.warn_of_lost(), False, thin, pairs, mended
            ),
            rules=rules,
        )
    del walk  # its paths are not wanted any more
    return with_held_out(designed, root, paths, workers, inputs=course.values)


def _pass(walk, system, memory, rules, times, inputs):
    """Run the filter on the paths, and fit it before each step."""
    n, m = system.state_size, system.measurement_size
    states, fits, scores, thin, pairs, mended = [], [], [], 0, 0, 0
    for k, t in enumerate(followed(times, "design")):
        if k == 0:
            walk.begin(t)
            states = walk.each(lambda x: rules.start(x.shape[1:]), walk.states)
        else:
            fit, old = fits[-1], times[k - 1]

            def predict(state, fit=fit, old=old):
                cell = cell_number(state.past, system.modes, system.indicators, state.mode.shape)
                law = rules.predict(old, fit.forecast(cell, state.past.vector))
                return state._replace(law=law, corrected=False)

            with inputs.at(k - 1), elapsed(system, old, t):
                walk.advance(old, t)
                states = walk.each(predict, states)

        def correct(state, y, k=k, t=t):
            indicator = y[m].astype(int) if system.indicators else None
            return rules.correct(state._replace(index=k, time=t), y[:m], indicator, memory)

        with inputs.at(k):
            states = walk.kept(correct, states, walk.measure(t), array=lambda state: state.mean)
        scores.append(_score(walk, n, states))
        if k + 1 == len(times):
            continue
        cells = cell_count(memory, system, k)
        scatters, count = _moments_of_cells(walk, system, states, cells)
        fit, more_thin, more_mended = fit_cells(scatters, n, count)
        fits.append(fit)
        thin, pairs, mended = thin + more_thin, pairs + cells * system.modes, mended + more_mended
    mended += sum(state.repaired for state in states)
    return fits, scores, thin, pairs, mended


def _moments_of_cells(walk: Any, system: Any, states: Any, cells: int) -> tuple[list, int]:
    """Moments of state and memory in each cell and mode, and how many paths they are of.

    Raises
    ------
    ValueError
        No path.
    """
    groups = walk.each(
        lambda x, alive, state: _groups(system, x, alive, state, cells),
        walk.states,
        walk.alive,
        states,
    )
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


def _groups(system, x, alive, state, cells):
    """Moments of state and memory in each cell and mode of one bundle of paths."""
    rows = np.concatenate([x[:-1], state.past.vector])
    cell = cell_number(state.past, system.modes, system.indicators, state.mode.shape)
    group = cell * system.modes + x[-1].astype(int)
    if not alive.all():
        rows, group = rows[:, alive], group[alive]
    # equal groups side by side, in their order
    order = np.argsort(group, kind="stable")
    ends = np.searchsorted(group[order], np.arange(cells * system.modes + 1))
    sorted_rows = rows[:, order]
    parts = [scatter(sorted_rows[:, a:b]) for a, b in pairwise(ends)]
    return [parts[c * system.modes : (c + 1) * system.modes] for c in range(cells)]


def _score(walk, n, states):
    """Root-mean-square errors, part of wrong modes, and their standard errors."""

    def rows(x, state):
        return np.concatenate([(x[:-1] - state.mean) ** 2, (state.mode != x[-1])[None]])

    moments = walk.gather(rows, states)
    rms, error, spread = root_mean_squares(moments, n)
    return rms, error, moments.mean[n], spread[n] / math.sqrt(moments.count)
