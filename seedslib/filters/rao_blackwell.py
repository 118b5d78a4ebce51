"""Rao-Blackwellised particle filter of a jump-linear system: modes drawn, states by Kalman."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count, align
from seedslib.base.blocks import BLOCK, as_seed_sequence
from seedslib.base.checks import as_count
from seedslib.base.objects import Remade
from seedslib.base.values import on_paths
from seedslib.filters.base import Filter, as_seen
from seedslib.filters.covariance import SensorUpdate
from seedslib.filters.particle import resampled, stream
from seedslib.filters.weights import logarithm, mix, normalised
from seedslib.models.kinds import AnySystem, as_system


class RaoBlackwellState(NamedTuple):
    """Histories of modes with their weights and Gaussian laws, and the last estimate.

    Each of P drawn histories is continued by every mode, so for the logarithms of their
    probabilities ``log_prob`` (L, P, *batch), ``law``
    = means (n, L, P, *batch) and covariances (n, n, L, P, *batch) the mode of the present is the
    first of the two axes. ``seed`` and ``draws`` fix the random numbers that come next.
    ``mode_prob`` has shape (L, *batch); ``interval`` is the length of the first step.
    """

    time: float | None
    log_prob: np.ndarray
    law: tuple[Any, ...]
    seed: np.random.SeedSequence
    draws: int
    mean: np.ndarray
    cov: np.ndarray
    mode_prob: np.ndarray
    loglik: np.ndarray
    diverged: np.ndarray
    interval: float | None = None


class RaoBlackwellFilter(Filter, Remade):
    """Posterior of mode and state as a mixture over histories of modes.

    Given the history of the modes a jump-linear system is linear and the Kalman filter is exact;
    only histories have to be drawn. Every drawn one is continued by all modes, these are weighted
    by the measurement, and `particles` of them are drawn (systematic resampling) before the next
    step. While there are no more than `particles` nothing is drawn: then the filter is exact.

    Parameters
    ----------
    system : SwitchingSystem
        With dynamics and sensors affine in state and Gaussian noise, and probabilities of
        switches and indicators that depend on neither.
    particles : int
        Histories kept after a step.

    Raises
    ------
    TypeError, ValueError
        No switching system, or one that is not jump-linear; a count below one.

    Notes
    -----
    A mode whose last history is gone does not come back unless the system can switch to it.
    """

    _shown = ("particles",)
    takes: ClassVar[tuple[str, ...]] = ("indicators", "seed")

    def __init__(self, system: AnySystem, particles: Count = 100) -> None:
        require_jump_linear(system)
        from seedslib.linearization.taylor_and_exact import Taylor

        self.system: Any = system
        self.particles: int = as_count("particles", particles)
        self.records: int = max(1, 2 * BLOCK // self.particles)
        exact = Taylor()
        self._move = [exact.moments(map) for map in system.dynamics]
        self._sensors = [SensorUpdate(map, exact) for map in system.sensors]

    def initial(self, batch: tuple[int, ...] = (), seed: Any = None) -> RaoBlackwellState:
        """State before any measurement: one history for each mode of the start."""
        seed = as_seed_sequence(0 if seed is None else seed)
        modes, n, parts = self.system.modes, self.system.state_size, self.system.initial
        tail = (1,) * (1 + len(batch))
        prob = logarithm(self.system.initial_probabilities)
        prob = np.broadcast_to(prob.reshape(-1, *tail), (modes, 1, *batch))
        mean = np.stack([part.mean for part in parts], axis=1).reshape(n, modes, *tail)
        cov = np.stack([part.cov for part in parts], axis=2).reshape(n, n, modes, *tail)
        law = (
            np.broadcast_to(mean, (n, modes, 1, *batch)),
            np.broadcast_to(cov, (n, n, modes, 1, *batch)),
        )
        none, clean = np.zeros(batch), np.zeros(batch, dtype=bool)
        return RaoBlackwellState(None, prob, law, seed, 0, *_estimate(prob, law), none, clean)

    def propagate(self, state: RaoBlackwellState, t: float) -> RaoBlackwellState:
        """Histories one step of the system later."""
        modes, n, batch = self.system.modes, self.system.state_size, state.log_prob.shape[2:]
        prob, mean, cov = _in_one_row(state.log_prob, state.law)
        count, draws = len(prob), state.draws
        mode = np.repeat(np.arange(modes), count // modes).reshape(-1, *(1,) * len(batch))
        mode = np.broadcast_to(mode, prob.shape)
        if count > self.particles:
            chosen = resampled(np.exp(prob), self.particles, stream(state.seed, draws))
            mean, cov = (_taken(part, chosen) for part in (mean, cov))
            mode = np.take_along_axis(mode, chosen, axis=0)
            prob = np.full(mode.shape, -np.log(self.particles))
            draws += 1
        leave = np.full((modes, *prob.shape), -np.inf)
        for i, row in enumerate(self.system.branches):
            here = mode == i
            for l, branch in enumerate(row):
                if branch is not None:
                    chance = logarithm(_chance(branch, state.time, n, batch))
                    leave[l, here] = np.broadcast_to(chance, here.shape)[here]
        if self.system.drives == "new":  # each history moves in every mode that continues it
            made = [move(state.time, mean, cov) for move in self._move]
            law = (
                np.stack([y for y, _, _ in made], axis=1),
                np.stack([_batched(square, y) for y, _, square in made], axis=2),
            )
        else:
            moved, spread = np.empty(mean.shape), np.empty(cov.shape)
            for i, move in enumerate(self._move):
                here = mode == i
                with on_paths(here.shape, here):
                    y, _, square = move(state.time, mean[:, here], cov[:, :, here])
                moved[:, here], spread[:, :, here] = y, _batched(square, y)
            law = (
                np.broadcast_to(moved[:, None], (n, modes, *prob.shape)),
                np.broadcast_to(spread[:, :, None], (n, n, modes, *prob.shape)),
            )
        prob = prob + leave
        mean, cov, mode_prob = _estimate(prob, law)
        return state._replace(
            log_prob=prob, law=law, draws=draws, mean=mean, cov=cov, mode_prob=mode_prob
        )

    def correct(
        self, state: RaoBlackwellState, y: ArrayLike, indicator: ArrayLike | None = None
    ) -> RaoBlackwellState:
        """Correct every history by a measurement, shape (m, *batch), and weight it.

        Parameters
        ----------
        state : RaoBlackwellState
        y : array_like, shape (m, *batch)
            NaN where missing.
        indicator : array_like of int, shape (*batch), optional
            -1 where missing.

        Raises
        ------
        ValueError
            A state without a time: `predict` gives it one.
        """
        y, shown = as_seen(state, self.system, y, indicator)
        system, t = self.system, state.time
        law = np.empty(state.law[0].shape), np.empty(state.law[1].shape)
        score = np.empty(state.log_prob.shape)
        for i, sensor in enumerate(self._sensors):
            prior = state.law[0][:, i], state.law[1][:, :, i]
            law[0][:, i], cov, score[i] = sensor(t, *prior, y[:, None])
            law[1][:, :, i] = _batched(cov, prior[0])
            if shown is not None:
                none, size = np.zeros(y.shape[1:]), system.state_size
                row = system.readings[i]
                chances = [none if b is None else _chance(b, t, size, none.shape) for b in row]
                chances.append(none + 1.0)  # of a missing one
                score[i] += logarithm(np.take_along_axis(np.stack(chances), shown[None], 0)[0])
        known = np.where(state.log_prob > -np.inf, score + state.log_prob, -np.inf)
        prob, loglik = normalised(known, (0, 1))
        lost = ~np.isfinite(loglik)
        if lost.any():  # no history explains the measurement: all stays as it was forecast
            prob, loglik = np.where(lost, state.log_prob, prob), np.where(lost, -np.inf, loglik)
            law = tuple(np.where(lost, *pair) for pair in zip(state.law, law, strict=True))
        lost, estimate = state.diverged | lost, _estimate(prob, law)
        given = t, prob, law, state.seed, state.draws
        return RaoBlackwellState(*given, *estimate, loglik, lost, state.interval)


def require_jump_linear(system: AnySystem) -> None:
    """Refuse anything but a jump-linear system with Gaussian noise.

    Raises
    ------
    TypeError, ValueError
        What is missing is named.
    """
    as_system("system", system, "SwitchingSystem")
    for name, maps, odds, table in (
        ("dynamics", system.dynamics, "switching", system.branches),
        ("sensor", system.sensors, "indicator", system.readings),
    ):
        for i, map in enumerate(maps):
            if not map.noise.gaussian or not map.symbolic or not _affine(map):
                wanted = "formulas affine in state and Gaussian noise"
                raise ValueError(f"{name}: wanted {wanted}, got another map in mode {i}")
            if not all(b is None or b.constant for b in table[i]):
                wanted = "probabilities that depend on neither state nor noise"
                raise ValueError(f"{odds}: wanted {wanted}, got others in mode {i}")


def _affine(map) -> bool:
    import sympy

    variables = (*map.state, *map.noise.symbols)
    seconds = (sympy.diff(y, a, b) for y in map.expressions for a in variables for b in variables)
    return all(sympy.simplify(second) == 0 for second in seconds)


def _chance(branch, t, n, batch) -> np.ndarray:
    """Probability of a branch that no state moves, (*batch): records may have inputs of theirs."""
    return branch.probability(t, np.zeros((n, *batch)))


def _batched(cov, mean):
    """Covariances with the batch axes of the means."""
    return np.broadcast_to(align(cov, 2, mean.ndim - 1), (len(mean), *mean.shape))


def _taken(part, chosen):
    """Chosen histories of an array (components..., histories, *batch)."""
    core = part.ndim - chosen.ndim
    return np.take_along_axis(part, chosen[(None,) * core], axis=core)


def _in_one_row(prob, law):
    """Weights, means and covariances of all histories, whatever their mode, along one axis."""
    batch, n = prob.shape[2:], len(law[0])
    mean, cov = law[0].reshape(n, -1, *batch), law[1].reshape(n, n, -1, *batch)
    return prob.reshape(-1, *batch), mean, cov


def _estimate(prob, law):
    """Mean, covariance and mode probabilities of a weighted mixture."""
    prob = np.exp(prob)
    _, mean, cov = mix(*_in_one_row(prob, law))
    return mean, cov, prob.sum(axis=1)
