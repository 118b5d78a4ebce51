"""Bootstrap particle filter: the reference that approaches the exact posterior."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seedslib._validate import as_times
from seedslib.filters.estimates import Estimates, as_record
from seedslib.systems.simulation import BLOCK, as_count, as_seed_sequence, in_blocks


class ParticleState(NamedTuple):
    """Particles of shape (n, particles, *batch) with equal weights, and the last correction.

    ``seed`` and ``draws`` fix the random numbers that come next, so that equal states move
    equally. ``mean``, ``cov``, ``loglik`` are those of the weighted particles before resampling;
    ``diverged`` marks the data sets that no particle explained.
    """

    time: float | None
    particles: np.ndarray
    seed: np.random.SeedSequence
    draws: int
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    diverged: np.ndarray


class ParticleFilter:
    """Bootstrap filter with systematic resampling at every measurement.

    Section 7 of the jump-diffusion paper, "lower bound": particles move as the system does, are
    weighted by the likelihood of the measurement, and the estimate is the weighted mean before
    resampling.

    Parameters
    ----------
    system : JumpDiffusion or DiscreteSystem
        With ``initial_sample``, ``advance`` and a sensor that has a log-density.
    particles : int
    **options
        For ``system.advance``, such as the integration step.

    Raises
    ------
    TypeError, ValueError
        A count below one, or a sensor without a log-density.
    """

    def __init__(self, system, particles=1000, **options):
        self.system, self.options = system, options
        self.particles = as_count("particles", particles)
        if not system.sensor.has_log_density:
            raise ValueError(
                "system: wanted a sensor affine in Gaussian noise or one with a log_density, "
                "got one whose likelihood has no closed form"
            )

    def initial(self, batch=(), seed=0) -> ParticleState:
        """Particles of the initial law for data sets of the given batch shape."""
        seed = as_seed_sequence(seed)
        count = self.particles * int(np.prod(batch, dtype=int))
        x = self.system.initial_sample(_stream(seed, 0), count)
        x = x.reshape(len(x), self.particles, *batch)
        mean, cov = _moments(x, np.full(x.shape[1:], 1.0 / self.particles))
        return ParticleState(
            None, x, seed, 1, mean, cov, np.zeros(batch), np.zeros(batch, dtype=bool)
        )

    def predict(self, state: ParticleState, t: float) -> ParticleState:
        """Move the particles to time t; a state without a time is only given one.

        Raises
        ------
        ValueError
            A time before that of the state.
        """
        if state.time is None or t == state.time:
            return state._replace(time=float(t))
        if not t > state.time:
            raise ValueError(f"t: wanted a time from {state.time:g} on, got {t:g}")
        rng = _stream(state.seed, state.draws)
        x = self.system.advance(state.particles, state.time, t, rng, **self.options)
        return state._replace(time=float(t), particles=x, draws=state.draws + 1)

    def correct(self, state: ParticleState, y) -> ParticleState:
        """Weight by the measurement y, shape (m, *batch), estimate, resample.

        Raises
        ------
        ValueError
            A state without a time: `predict` gives it one.
        """
        if state.time is None:
            raise ValueError("state: wanted a state with a time, got None; predict to it first")
        y, x = np.asarray(y, dtype=float), state.particles
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            log_weight = self.system.sensor.log_density(state.time, y[:, None], x)
        log_weight = np.where(np.isfinite(log_weight), log_weight, -np.inf)
        highest = log_weight.max(axis=0)
        lost = np.isneginf(highest)
        weight = np.exp(log_weight - np.where(lost, 0.0, highest))
        weight = np.where(lost, 1.0, weight)
        total = weight.sum(axis=0)
        loglik = np.where(lost, -np.inf, highest + np.log(total / self.particles))
        weight = weight / total
        mean, cov = _moments(x, weight)
        rng = _stream(state.seed, state.draws)
        if np.isfinite(y).any():
            x = _resample(x, weight, rng)
        return ParticleState(
            state.time, x, state.seed, state.draws + 1, mean, cov, loglik, state.diverged | lost
        )

    def step(self, state: ParticleState, t: float, y) -> ParticleState:
        """Move to time t and correct there."""
        return self.correct(self.predict(state, t), y)

    def forecast(self, state: ParticleState, t: float) -> Estimates:
        """Mean (n, *batch) and covariance of the particles at a later time."""
        x = self.predict(state, t).particles
        return Estimates(*_moments(x, np.full(x.shape[1:], 1.0 / self.particles)))

    def run(self, times, measurements, *, seed=0, workers=1) -> Estimates:
        """Filter a record, or many at once.

        Parameters
        ----------
        times : array_like, shape (K+1,)
        measurements : array_like, shape (K+1, m, *batch)
            NaN marks a missing component.
        seed : int, SeedSequence or Generator
        workers : int
            Threads over blocks of data sets; the numbers do not depend on it.

        Returns
        -------
        Estimates
            ``mean`` (K+1, n, *batch), ``cov`` (K+1, n, n, *batch), ``loglik`` (K+1, *batch) and
            ``diverged`` (*batch).

        Raises
        ------
        TypeError, ValueError
            Times that do not increase, infinite measurements, shapes that do not fit.
        """
        times = as_times("times", times)
        y = as_record(measurements, len(times), self.system.sensor.size)
        batch = y.shape[2:]
        flat = y.reshape(*y.shape[:2], -1)

        def work(start, stop, stream):
            state = self.initial((stop - start,), stream)
            rows = []
            for k, t in enumerate(times):
                state = self.step(state, t, flat[k, :, start:stop])
                rows.append((state.mean, state.cov, state.loglik))
            return [np.stack(part) for part in zip(*rows, strict=True)] + [state.diverged]

        block = max(1, BLOCK // self.particles)
        parts = in_blocks(work, flat.shape[2], seed, workers=workers, block=block)
        mean, cov, loglik, diverged = (
            np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)
        )
        return Estimates(
            mean.reshape(*mean.shape[:-1], *batch),
            cov.reshape(*cov.shape[:-1], *batch),
            loglik=loglik.reshape(*loglik.shape[:-1], *batch),
            diverged=diverged.reshape(batch),
        )


def _stream(seed, draw) -> np.random.Generator:
    """Generator of one draw, found from its number alone."""
    child = np.random.SeedSequence(
        seed.entropy, spawn_key=(*seed.spawn_key, draw), pool_size=seed.pool_size
    )
    return np.random.default_rng(child)


def _moments(x, weight):
    """Weighted mean (n, *batch) and covariance (n, n, *batch) of particles (n, P, *batch)."""
    mean = np.einsum("ip...,p...->i...", x, weight)
    apart = x - mean[:, None]
    return mean, np.einsum("ip...,jp...,p...->ij...", apart, apart, weight)


def _resample(x, weight, rng):
    """Systematic resampling of every data set with one uniform number each."""
    n, count = x.shape[:2]
    flat = x.reshape(n, count, -1)
    sets = flat.shape[2]
    edges = np.cumsum(weight.reshape(count, sets), axis=0)
    # the sets are laid end to end on one line, so that one sorted search serves all
    edges = edges / edges[-1] + np.arange(sets)
    places = (rng.random(sets) + np.arange(count)[:, None]) / count + np.arange(sets)
    chosen = np.searchsorted(edges.T.ravel(), places.T.ravel(), side="right")
    chosen = chosen.reshape(sets, count) - count * np.arange(sets)[:, None]
    chosen = np.clip(chosen, 0, count - 1).T
    return np.take_along_axis(flat, chosen[None], axis=1).reshape(x.shape)
