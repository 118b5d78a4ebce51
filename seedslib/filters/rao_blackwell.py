"""Rao-Blackwellised particle filter of a jump-linear system: modes drawn, states by Kalman."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from seedslib.base.arrays import Count, Seed, align
from seedslib.base.blocks import BLOCK, as_seed_sequence
from seedslib.base.checks import as_count
from seedslib.base.values import Values, of_paths
from seedslib.filters.base import Filter, clean
from seedslib.filters.covariance import SensorUpdate
from seedslib.filters.particle import resampled, stream
from seedslib.filters.weights import logarithm, mix, normalised
from seedslib.models.kinds import AnySystem, as_system


class RaoBlackwellState(NamedTuple):
    """Histories of modes with their weights and Gaussian moments, and the last estimate.

    Each of P drawn histories is continued by every mode, so the mode of the present is the first
    of the two axes of the logarithms of their probabilities, ``log_prob`` (L, P, *batch), and of
    their ``means`` (n, L, P, *batch) and ``covs`` (n, n, L, P, *batch). ``seed`` and
    ``draws`` fix the random numbers that come next. ``mode_prob`` has shape (L, *batch);
    ``interval`` is the length of the first step.
    """

    time: float | None
    log_prob: np.ndarray
    means: np.ndarray
    covs: np.ndarray
    seed: np.random.SeedSequence
    draws: int
    mean: np.ndarray
    cov: np.ndarray
    mode_prob: np.ndarray
    loglik: np.ndarray
    diverged: np.ndarray
    interval: float | None = None


class RaoBlackwellFilter(Filter):
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

    takes: ClassVar[tuple[str, ...]] = ("indicators", "seed")

    def __init__(self, system: AnySystem, particles: Count = 100) -> None:
        require_jump_linear(system)
        self.system: Any = system
        self.particles: int = as_count("particles", particles)
        self.records: int = max(1, 2 * BLOCK // self.particles)

    @cached_property
    def _dynamics(self) -> list[Any]:
        from seedslib.linearization.taylor_and_exact import Taylor

        return [Taylor().moments(map) for map in self.system.dynamics]

    @cached_property
    def _sensors(self) -> list[SensorUpdate]:
        from seedslib.linearization.taylor_and_exact import Taylor

        return [SensorUpdate(map, Taylor()) for map in self.system.sensors]

    def initial(self, batch: tuple[int, ...] = (), seed: Seed | None = None) -> RaoBlackwellState:
        """State before any measurement: one history for each mode of the start."""
        seed = as_seed_sequence(0 if seed is None else seed)
        prob = logarithm(self.system.initial_probabilities)
        mean = np.stack([part.mean for part in self.system.initial], axis=1)
        cov = np.stack([part.cov for part in self.system.initial], axis=2)
        prob, mean, cov = (
            np.broadcast_to(align(part, part.ndim, 1 + len(batch)), (*part.shape, 1, *batch))
            for part in (prob, mean, cov)
        )
        return RaoBlackwellState(
            None, prob, mean, cov, seed, 0, **_estimate(prob, mean, cov), **clean(batch)
        )

    def propagate(self, state: RaoBlackwellState, t: float, p: Values) -> RaoBlackwellState:
        """Histories one step of the system later."""
        modes, n, batch = self.system.modes, self.system.state_size, state.log_prob.shape[2:]
        log_prob, mean, cov = _flattened(state.log_prob, state.means, state.covs)
        count, draws = len(log_prob), state.draws
        mode = align(np.repeat(np.arange(modes), count // modes), 1, len(batch))
        mode = np.broadcast_to(mode, log_prob.shape)
        if count > self.particles:
            chosen = resampled(np.exp(log_prob), self.particles, stream(state.seed, draws))
            mean = np.take_along_axis(mean, chosen[None], axis=1)
            cov = np.take_along_axis(cov, chosen[None, None], axis=2)
            mode = np.take_along_axis(mode, chosen, axis=0)
            log_prob = np.full(mode.shape, -np.log(self.particles))
            draws += 1
        log_switch = np.full((modes, *log_prob.shape), -np.inf)
        for i, row in enumerate(self.system.branches):
            mask = mode == i
            for l, branch in enumerate(row):
                if branch is not None:
                    chance = logarithm(_chance(branch, state.time, n, batch, p))
                    log_switch[l, mask] = np.broadcast_to(chance, mask.shape)[mask]
        if self.system.drives == "new":  # each history moves in every mode that continues it
            moments = [dynamics(state.time, mean, cov, p) for dynamics in self._dynamics]
            means = np.stack([y for y, _, _ in moments], axis=1)
            covs = np.stack([_batched(square, y) for y, _, square in moments], axis=2)
        else:
            new_mean, new_cov = np.empty(mean.shape), np.empty(cov.shape)
            for i, dynamics in enumerate(self._dynamics):
                mask = mode == i
                own = of_paths(p, mask.shape, mask)
                y, _, square = dynamics(state.time, mean[:, mask], cov[:, :, mask], own)
                new_mean[:, mask], new_cov[:, :, mask] = y, _batched(square, y)
            means = np.broadcast_to(new_mean[:, None], (n, modes, *log_prob.shape))
            covs = np.broadcast_to(new_cov[:, :, None], (n, n, modes, *log_prob.shape))
        log_prob = log_prob + log_switch
        parts = {"log_prob": log_prob, "means": means, "covs": covs}
        return state._replace(draws=draws, **parts, **_estimate(**parts))

    def update(
        self,
        state: RaoBlackwellState,
        y: np.ndarray,
        p: Values,
        indicator: np.ndarray | None = None,
    ) -> RaoBlackwellState:
        """Correct every history by the measurement and weight it; see `Filter.update`."""
        system, t = self.system, state.time
        means, covs = np.empty(state.means.shape), np.empty(state.covs.shape)
        score = np.empty(state.log_prob.shape)
        for i, sensor in enumerate(self._sensors):
            prior = state.means[:, i], state.covs[:, :, i]
            means[:, i], cov, score[i] = sensor(t, *prior, y[:, None], p)
            covs[:, :, i] = _batched(cov, prior[0])
            if indicator is not None:
                none, size = np.zeros(y.shape[1:]), system.state_size
                row = system.readings[i]
                chances = [none if b is None else _chance(b, t, size, none.shape, p) for b in row]
                chances.append(none + 1.0)  # of a missing one
                score[i] += logarithm(np.take_along_axis(np.stack(chances), indicator[None], 0)[0])
        score = np.where(state.log_prob > -np.inf, score + state.log_prob, -np.inf)
        log_prob, loglik = normalised(score, (0, 1))
        unexplained = ~np.isfinite(loglik)
        if unexplained.any():  # no history explains the measurement: all stays as predicted
            log_prob = np.where(unexplained, state.log_prob, log_prob)
            loglik = np.where(unexplained, -np.inf, loglik)
            means = np.where(unexplained, state.means, means)
            covs = np.where(unexplained, state.covs, covs)
        parts = {"log_prob": log_prob, "means": means, "covs": covs}
        diverged = state.diverged | unexplained
        return state._replace(loglik=loglik, diverged=diverged, **parts, **_estimate(**parts))


def require_jump_linear(system: AnySystem) -> None:
    """Refuse anything but a jump-linear system with Gaussian noise.

    Raises
    ------
    TypeError, ValueError
        What is missing is named.
    """
    as_system("system", system, "SwitchingSystem")
    for name, maps, probabilities, table in (
        ("dynamics", system.dynamics, "switching", system.branches),
        ("sensor", system.sensors, "indicator", system.readings),
    ):
        for i, map in enumerate(maps):
            if not map.noise.gaussian or not _affine(map):
                wanted = "formulas affine in state and Gaussian noise"
                raise ValueError(f"{name}: wanted {wanted}, got another map in mode {i}")
            if not all(b is None or b.constant for b in table[i]):
                wanted = "probabilities that depend on neither state nor noise"
                raise ValueError(f"{probabilities}: wanted {wanted}, got others in mode {i}")


def _affine(map) -> bool:
    import sympy

    variables = (*map.state, *map.noise.symbols)
    seconds = (sympy.diff(y, a, b) for y in map.expressions for a in variables for b in variables)
    return all(sympy.simplify(second) == 0 for second in seconds)


def _chance(branch, t, n, batch, p) -> np.ndarray:
    """Probability of a branch at any state, (*batch): records may have inputs of their own."""
    return branch.probability(t, np.zeros((n, *batch)), p)


def _batched(cov: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Covariances with the batch axes of the means."""
    return np.broadcast_to(align(cov, 2, mean.ndim - 1), (len(mean), *mean.shape))


def _flattened(prob: np.ndarray, means: np.ndarray, covs: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights, means and covariances of all histories, whatever their mode, along one axis."""
    batch, n = prob.shape[2:], len(means)
    means, covs = means.reshape(n, -1, *batch), covs.reshape(n, n, -1, *batch)
    return prob.reshape(-1, *batch), means, covs


def _estimate(log_prob: np.ndarray, means: np.ndarray, covs: np.ndarray) -> dict[str, np.ndarray]:
    """Mean, covariance and mode probabilities of a weighted mixture."""
    prob = np.exp(log_prob)
    _, mean, cov = mix(*_flattened(prob, means, covs))
    return {"mean": mean, "cov": cov, "mode_prob": prob.sum(axis=1)}
