"""Rao-Blackwellised particle filter of a jump-linear system: modes drawn, states by Kalman."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import Count
from seedslib.base.blocks import BLOCK, as_seed_sequence
from seedslib.base.checks import as_count
from seedslib.base.correction import correct
from seedslib.base.objects import Remade
from seedslib.base.values import on_paths
from seedslib.filters.estimates import as_seen
from seedslib.filters.mixture import mix
from seedslib.filters.particle import resampled, stream
from seedslib.filters.verbs import Filter
from seedslib.filters.weights import logarithm, normalised
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
        from seedslib.linearization.symbolic import Taylor

        self.system: Any = system
        self.particles: int = as_count("particles", particles)
        self.records: int = max(1, 2 * BLOCK // self.particles)
        exact = Taylor()
        self._move = [exact.transition(map) for map in system.dynamics]
        self._sense = [exact.moments(map) for map in system.sensors]

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
        return RaoBlackwellState(
            None, prob, law, seed, 0, **_estimate(prob, law), loglik=np.zeros(batch),
            diverged=np.zeros(batch, dtype=bool),
        )  # fmt: skip

    def moved(self, state: RaoBlackwellState, t: float) -> RaoBlackwellState:
        """Histories one step of the system later."""
        modes, n, batch = self.system.modes, self.system.state_size, state.log_prob.shape[2:]
        prob = state.log_prob.reshape(-1, *batch)
        count = len(prob)
        mean = state.law[0].reshape(n, count, *batch)
        cov = state.law[1].reshape(n, n, count, *batch)
        mode = np.broadcast_to(
            np.repeat(np.arange(modes), count // modes).reshape(-1, *(1,) * len(batch)), prob.shape
        )
        draws = state.draws
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
                np.stack([y for y, _ in made], axis=1),
                np.stack([_wide(square, y) for y, square in made], axis=2),
            )
        else:
            moved, spread = np.empty(mean.shape), np.empty(cov.shape)
            for i, move in enumerate(self._move):
                here = mode == i
                with on_paths(here.shape, here):
                    y, square = move(state.time, mean[:, here], cov[:, :, here])
                moved[:, here], spread[:, :, here] = y, _wide(square, y)
            law = (
                np.broadcast_to(moved[:, None], (n, modes, *prob.shape)),
                np.broadcast_to(spread[:, :, None], (n, n, modes, *prob.shape)),
            )
        prob = prob + leave
        found = _estimate(prob, law)
        return state._replace(log_prob=prob, law=law, draws=draws, **found)

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
        n, t = self.system.state_size, state.time
        mean, cov = (np.empty(part.shape) for part in state.law)
        score = np.empty(state.log_prob.shape)
        for i, sense in enumerate(self._sense):
            prior = state.law[0][:, i], state.law[1][:, :, i]
            mean[:, i], square, score[i] = correct(
                *prior, y[:, None], sense(t, *prior), periods=self.system.sensors[i].period,
                noise=lambda f=sense, m=prior[0], d=prior[1]: f(t, m, np.zeros_like(d)).cov,
                exact=True,
            )  # fmt: skip
            cov[:, :, i] = _wide(square, mean[:, i])
            if shown is not None:
                row = self.system.readings[i]
                chances = [
                    np.zeros(y.shape[1:]) if b is None else _chance(b, t, n, y.shape[1:])
                    for b in row
                ]
                chances.append(np.ones(y.shape[1:]))  # of a missing one
                score[i] += logarithm(np.take_along_axis(np.stack(chances), shown[None], 0)[0])
        known = np.where(state.log_prob > -np.inf, score + state.log_prob, -np.inf)
        prob, loglik = normalised(known, (0, 1))
        lost, law = ~np.isfinite(loglik), (mean, cov)
        if lost.any():  # no history explains the measurement: keep what was forecast
            prob, loglik = np.where(lost, state.log_prob, prob), np.where(lost, -np.inf, loglik)
        return state._replace(
            log_prob=prob, law=law, loglik=loglik, diverged=state.diverged | lost,
            **_estimate(prob, law),
        )  # fmt: skip


def require_jump_linear(system: AnySystem) -> None:
    """Refuse anything but a jump-linear system with Gaussian noise.

    Raises
    ------
    TypeError, ValueError
        What is missing is named.
    """
    as_system("system", system, "SwitchingSystem")
    for name, maps, table, odds in (
        ("dynamics", system.dynamics, system.branches, "switching"),
        ("sensor", system.sensors, system.readings, "indicator"),
    ):
        for i, map in enumerate(maps):
            if not map.noise.gaussian:
                raise ValueError(f"{name}: wanted Gaussian noise, got a law of its own")
            if not map.symbolic or not _affine(map):
                raise ValueError(
                    f"{name}: wanted symbolic maps affine in state and noise, got another in "
                    f"mode {i}"
                )
            if not all(b is None or b.constant for b in table[i]):
                raise ValueError(
                    f"{odds}: wanted probabilities that depend on neither state nor noise, got "
                    f"others in mode {i}"
                )


def _affine(map) -> bool:
    import sympy

    variables = (*map.state, *map.noise.symbols)
    return all(
        sympy.simplify(sympy.diff(y, a, b)) == 0
        for y in map.expressions for a in variables for b in variables
    )  # fmt: skip


def _chance(branch, t, n, batch) -> np.ndarray:
    """Probability of a branch that no state moves, (*batch): records may have inputs of theirs."""
    return branch.probability(t, np.zeros((n, *batch)))


def _wide(square, mean):
    """Covariances with the batch axes of the means."""
    square = square.reshape(*square.shape, *(1,) * (mean.ndim + 1 - square.ndim))
    return np.broadcast_to(square, (len(mean), *mean.shape))


def _taken(part, chosen):
    """Chosen histories of an array (components..., histories, *batch)."""
    core = part.ndim - chosen.ndim
    return np.take_along_axis(part, chosen[(None,) * core], axis=core)


def _estimate(prob, law) -> dict[str, np.ndarray]:
    """Mean, covariance and mode probabilities of a weighted mixture, by the state's names."""
    prob, batch, n = np.exp(prob), prob.shape[2:], len(law[0])
    found = mix(
        prob.reshape(-1, *batch), law[0].reshape(n, -1, *batch), law[1].reshape(n, n, -1, *batch)
    )
    return {"mean": found.mean, "cov": found.cov, "mode_prob": prob.sum(axis=1)}
