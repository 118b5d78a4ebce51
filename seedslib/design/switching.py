"""Design of finite-order filters of switching systems: moments of the running filter, step by
step.
"""

from __future__ import annotations

import math
import warnings
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import BLOCK, as_seed_sequence, seed_record
from seedslib.base.checks import as_count, outside
from seedslib.base.progress import followed
from seedslib.design.held_out import with_held_out
from seedslib.design.paths import Executor, PathSimulator, executor
from seedslib.design.regression import (
    Scatter,
    combine,
    inverse_root,
    root_mean_squares,
    scatter,
    semidefinite,
)
from seedslib.designed.accuracy import Accuracy, Design
from seedslib.designed.cells import CellFit, cell_count, cell_number, require_memory
from seedslib.designed.memory import Memory
from seedslib.designed.rules import SwitchingRules, compiled_rules
from seedslib.designed.switching import SwitchingFilter
from seedslib.linearization.moments import Linearization
from seedslib.models.kinds import as_grid
from seedslib.models.switching import SwitchingSystem

JITTER = 1e-8
"""Added to the covariance of the whitened memory before it is inverted."""

FEWEST = 50
"""Fewer samples than this are too few for moments of their own."""

OFTEN = 0.05
"""Part of pooled pairs of cell and mode above which the design warns."""


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
        cells.append(_cell(prob[:, c], moments, pooled, size, jitter))
    return _stacked(cells)


def fit_cells(scatters: list[list[Scatter]], size: int, total: int) -> tuple[CellFit, int]:
    """Fit from samples, with pooled moments where a cell has few.

    Moments of a mode in a cell with fewer than max(50, 3 (r + 1)) samples, r the rank of the
    memory there, are pooled over the modes of the cell; where those are few too, over the cells of
    the mode; where even those are few, over everything. No probability is zero: a cell that
    never occurred in the design works online.

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
    pooled : int
        Pairs of cell and mode whose moments are pooled ones.
    """
    modes = len(scatters[0])
    everything = combine([part for row in scatters for part in row])
    by_mode = [combine([row[i] for row in scatters]) for i in range(modes)]
    cells, borrowed = [], 0
    for row in scatters:
        pooled = combine(row)
        basis = pooled if pooled.count >= FEWEST else everything
        rank = inverse_root(basis.cov[size:, size:], _sizes(basis, size)).shape[1]
        least = max(FEWEST, 3 * (rank + 1))
        basis = pooled if pooled.count >= least else everything
        borrowed += sum(part.count < least for part in row)
        moments = []
        for i, part in enumerate(row):
            candidates = part, pooled, by_mode[i]
            moments.append(next((p for p in candidates if p.count >= least), everything))
        weights = np.array([max(part.count, 0.5) for part in row]) / total
        cells.append(_cell(weights, moments, basis, size, JITTER))
    return _stacked(cells), borrowed


def _stacked(cells):
    return CellFit(*(np.stack(parts, axis=-1) for parts in zip(*cells, strict=True)))


def _sizes(part, n):
    return np.sqrt(np.diagonal(part.cov)[n:] + part.mean[n:] ** 2)


def _cell(weights, moments, basis, n, jitter):
    """Arrays of one cell, those of a `CellFit`."""
    d = len(basis.mean) - n
    root = inverse_root(basis.cov[n:, n:], _sizes(basis, n))
    rank, modes = root.shape[1], len(weights)
    log_weight, centre = np.empty(modes), np.empty((d, modes))
    white, gain = np.zeros((d, d, modes)), np.zeros((n, d, modes))
    offset, cov = np.empty((n, modes)), np.empty((n, n, modes))
    for i, (weight, part) in enumerate(zip(weights, moments, strict=True)):
        inner = root.T @ part.cov[n:, n:] @ root + jitter * np.eye(rank)
        cross = part.cov[:n, n:] @ root
        lower = np.linalg.cholesky(inner)
        half = np.linalg.solve(lower, cross.T)
        white[:rank, :, i] = np.linalg.solve(lower, root.T)
        gain[:, :, i] = half.T @ white[:rank, :, i]
        centre[:, i] = part.mean[n:]
        offset[:, i] = part.mean[:n] - gain[:, :, i] @ part.mean[n:]
        cov[:, :, i] = semidefinite(part.cov[:n, :n] - half.T @ half, part.cov[:n, :n])
        with np.errstate(divide="ignore"):
            log_weight[i] = np.log(weight) - np.log(np.diagonal(lower)).sum()
    return log_weight, centre, white, gain, offset, cov


def synthesize_switching(
    system: SwitchingSystem,
    memory: Memory,
    linearization: Linearization,
    times: ArrayLike,
    *,
    paths: int,
    seed: object,
    workers: int | Executor = 1,
    normalisation: str = "consistent",
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
    workers : int or Executor
        Threads, or an executor such as `seedslib.extra.cluster` makes; the filter does not depend
        on it, bit by bit.
    normalisation
        As `SwitchingFilter`.

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
        More than a twentieth of the pairs of cell and mode have few paths; paths of the system or
        of the filter diverged and were left out; errors on held-out paths are not the predicted
        ones.
    """
    times = as_grid("times", times, system)
    require_memory(memory, system)
    n = system.state_size
    order = memory.order(n, system.measurement_size, system.modes)
    paths = as_count("paths", paths)
    if paths < n + order + 2:
        raise ValueError(f"paths: wanted at least {n + order + 2}, got {paths}")
    rules = compiled_rules(system, linearization, normalisation)
    root = as_seed_sequence(seed)
    with executor(workers) as each:
        simulator = PathSimulator(system.hybrid, paths, root, each, {})
        forward = SwitchingPass(simulator, system, memory, rules)
        forward.design(times)
        pooled, pairs = forward.pooled, forward.pairs
        if pooled > OFTEN * pairs:
            warnings.warn(
                f"paths: {pooled} of {pairs} pairs of cell and mode had too few paths of their own",
                stacklevel=outside(),
            )
        rms, error, rate, rate_error = (
            np.array(part) for part in zip(*forward.scores, strict=True)
        )
        designed = SwitchingFilter(
            system,
            linearization,
            memory,
            times,
            tuple(forward.fits),
            normalisation,
            Accuracy(times, rms, error, True, rate, rate_error),
            Design(
                paths,
                BLOCK,
                *seed_record(root),
                simulator.warn_of_diverged(),
                pooled=pooled,
                pairs=pairs,
            ),
        )
    del simulator, forward  # their paths are not needed any more
    return with_held_out(designed, root, paths, workers)


class SwitchingPass:
    """The filter runs on the paths, and is fitted before each step.

    Parameters
    ----------
    simulator : PathSimulator
    system : SwitchingSystem
    memory : Memory
    rules : SwitchingRules

    Attributes
    ----------
    fits : list of CellFit
    scores : list of (rms, error, mode_rate, mode_error)
    pooled, pairs : int
        See `Design`.
    """

    def __init__(
        self,
        simulator: PathSimulator,
        system: SwitchingSystem,
        memory: Memory,
        rules: SwitchingRules,
    ) -> None:
        self.simulator, self.system, self.memory = simulator, system, memory
        self.rules = rules
        self.states: Any = []
        self.fits, self.scores = [], []
        self.pooled = self.pairs = 0

    def design(self, times: np.ndarray) -> None:
        """Go through the measurements."""
        for k, t in enumerate(followed(times, "design")):
            if k == 0:
                self.simulator.begin()
                self.states = self.simulator.executor(
                    partial(_start, self.rules), self.simulator.states
                )
            else:
                self._predict(times[k - 1], t)
            self._correct(k, t)
            self._score()
            if k + 1 < len(times):
                self._fit(k)

    def _predict(self, old, t):
        rules, system, fit = self.rules, self.system, self.fits[-1]
        p = system.values(dt=t - old)

        def predict(state):
            cell = cell_number(state.past, system.modes, system.indicators, state.mode.shape)
            dist = rules.predict(old, fit.forecast(cell, state.past.vector), p)
            return state._replace(dist=dist, corrected=False)

        self.simulator.advance(old, t)
        self.states = self.simulator.executor(predict, self.states)

    def _correct(self, k, t):
        rules, memory, m = self.rules, self.memory, self.system.measurement_size
        with_indicator, p = self.system.indicators > 0, self.system.values()

        def correct(state, y):
            indicator = y[m].astype(int) if with_indicator else None
            return rules.correct(state._replace(index=k, time=t), y[:m], indicator, memory, p)

        y = self.simulator.measure(t)
        self.states = self.simulator.finite(correct, self.states, y, array=lambda state: state.mean)

    def _fit(self, k):
        """Fit the moments of mode, state and memory after measurement k."""
        system, cells = self.system, cell_count(self.memory, self.system, k)
        bundles = self.simulator.executor(
            lambda x, alive, state: _moments(system, x, alive, state, cells),
            self.simulator.states,
            self.simulator.alive,
            self.states,
        )
        scatters = [
            [combine([bundle[c][i] for bundle in bundles]) for i in range(system.modes)]
            for c in range(cells)
        ]
        count = sum(part.count for row in scatters for part in row)
        if not count:
            paths = sum(map(sum, self.simulator.counts))
            raise ValueError(f"paths: wanted some that stay finite, all {paths} diverged")
        fit, pooled = fit_cells(scatters, system.state_size, count)
        self.fits.append(fit)
        self.pooled += pooled
        self.pairs += cells * system.modes

    def _score(self):
        """Note root-mean-square errors, the part of wrong modes, and their standard errors."""

        def rows(x, state):
            return np.concatenate([(x[:-1] - state.mean) ** 2, (state.mode != x[-1])[None]])

        n, moments = self.system.state_size, self.simulator.gather(rows, self.states)
        rms, error, deviation = root_mean_squares(moments, n)
        mode_error = deviation[n] / math.sqrt(moments.count)
        self.scores.append((rms, error, moments.mean[n], mode_error))


def _start(rules, x):
    return rules.start(x.shape[1:])


def _moments(system, x, alive, state, cells) -> list[list[Scatter]]:
    """Moments of state and memory in each cell and mode of one bundle of paths."""
    rows = np.concatenate([x[:-1], state.past.vector])
    cell = cell_number(state.past, system.modes, system.indicators, state.mode.shape)
    group = cell * system.modes + x[-1].astype(int)
    if not alive.all():
        rows, group = rows[:, alive], group[alive]
    # equal groups side by side, in their order
    order = np.argsort(group, kind="stable")
    ends = np.searchsorted(group[order], np.arange(cells * system.modes + 1))
    rows = rows[:, order]
    parts = [scatter(rows[:, a:b]) for a, b in pairwise(ends)]
    return [parts[c * system.modes : (c + 1) * system.modes] for c in range(cells)]
