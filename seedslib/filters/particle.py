"""Bootstrap particle filter: the reference that approaches the exact posterior."""

from __future__ import annotations

import math
import warnings
from typing import Any, ClassVar, NamedTuple

import numpy as np

from seedslib.base.arrays import Count, MaybeArray, Seed
from seedslib.base.blocks import BLOCK, as_seed_sequence, child
from seedslib.base.checks import as_count, outside
from seedslib.base.circle import Periods, nearest, wrapped
from seedslib.base.clock import when
from seedslib.base.values import Inputs, Values
from seedslib.filters.base import Estimates, Filter, clean
from seedslib.filters.weights import relative
from seedslib.models.kinds import AnySystem, as_system, switches

FAR = 1000.0
"""A density of the measurement below exp of minus this at every particle, for each component."""


class ParticleState(NamedTuple):
    """Particles of shape (n, particles, *batch) with equal weights, and the last correction.

    ``seed`` and ``draws`` fix the random numbers that come next, so that equal states move
    equally. ``mean``, ``cov``, ``loglik`` are those of the weighted particles before resampling;
    ``diverged`` marks the data sets that no particle explained. Particles of a switching system
    have the mode as last row, and ``mode_prob`` (L, *batch) is that of the weighted ones.
    ``interval`` is the length of the first step.
    """

    time: float | None
    particles: np.ndarray
    seed: np.random.SeedSequence
    draws: int
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    diverged: np.ndarray
    mode_prob: MaybeArray = None
    interval: float | None = None


class ParticleFilter(Filter):
    """Bootstrap filter with systematic resampling at every measurement.

    Section 7 of the jump-diffusion paper, "lower bound": particles move as the system does, are
    weighted by the likelihood of the measurement, and the estimate is the weighted mean before
    resampling.

    Parameters
    ----------
    system : JumpDiffusion, DiscreteSystem or SwitchingSystem
        With ``initial_sample``, ``advance`` and a sensor that has a log-density.
    particles : int
    **options
        For ``system.advance``, such as the integration step.

    Raises
    ------
    TypeError, ValueError
        Another system, a count below one, or a sensor without a log-density.

    Notes
    -----
    A mode whose last particle is gone does not come back unless the system can switch to it.
    """

    takes: ClassVar[tuple[str, ...]] = ("indicators", "seed")
    alone = True

    def __init__(self, system: AnySystem, particles: Count = 1000, **options: Any) -> None:
        self._modes = system.modes if switches(system) else None
        self._moving = as_system("system", system.hybrid if self._modes else system)
        self.system: Any = system
        dynamics = getattr(system, "dynamics", None)
        self._periods: Periods = getattr(dynamics, "period", ())
        self.options: dict[str, Any] = options
        self.particles: int = as_count("particles", particles)
        self.records: int = max(1, BLOCK // self.particles)
        if not self._moving.sensor.has_log_density:
            raise ValueError(
                "system: wanted a sensor affine in Gaussian noise or one with a log_density, "
                "got one whose likelihood has no closed form"
            )

    def initial(self, batch: tuple[int, ...] = (), seed: Seed | None = None) -> ParticleState:
        """Particles of the initial distribution for data sets of the given batch shape."""
        seed = as_seed_sequence(0 if seed is None else seed)
        count = self.particles * math.prod(batch)
        x = self._moving.initial_sample(stream(seed, 0), count)
        x = x.reshape(len(x), self.particles, *batch)
        mean, cov, prob = self.estimate(x, np.full(x.shape[1:], 1.0 / self.particles))
        return ParticleState(None, x, seed, 1, mean, cov, **clean(batch), mode_prob=prob)

    def propagate(self, state: ParticleState, t: float, p: Values) -> ParticleState:
        """The particles at time t."""
        rng = stream(state.seed, state.draws)
        x = self._moving.advance(state.particles, state.time, t, rng, p, **self.options)
        return state._replace(particles=x, draws=state.draws + 1)

    def update(
        self, state: ParticleState, y: np.ndarray, p: Values, indicator: np.ndarray | None = None
    ) -> ParticleState:
        """Weight by the measurement, estimate, resample; see `Filter.update`.

        Warns
        -----
        UserWarning
            No particle is near the measurement.
        """
        x = state.particles
        if indicator is not None:
            y = np.concatenate([y, np.where(indicator < 0, np.nan, indicator)[None]])
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            log_weight = self._moving.sensor.log_density(state.time, y[:, None], x, p)
            weight, highest, unexplained = relative(log_weight, 0)
            if unexplained.any():  # some density is no number, or infinite, or all are zero
                log_weight = np.where(np.isfinite(log_weight), log_weight, -np.inf)
                weight, highest, unexplained = relative(log_weight, 0)
                weight = np.where(unexplained, 1.0, weight)
        observed = np.isfinite(y)
        if ((highest < -FAR * observed.sum(axis=0)) & ~unexplained).any():
            warnings.warn(
                f"y: no particle is near the measurement at time {when(state.time)}: wanted more "
                "particles, or a measurement that the model allows",
                stacklevel=outside(),
            )
        total = weight.sum(axis=0)
        weight /= total
        mean, cov, prob = self.estimate(x, weight)
        if observed.any():
            chosen = resampled(weight, self.particles, stream(state.seed, state.draws))
            sets = chosen[0].size
            places = chosen.reshape(-1, sets) * sets + np.arange(sets)
            x = x.reshape(len(x), -1).take(places.ravel(), axis=1).reshape(x.shape)
        loglik = highest + np.log(total / self.particles)
        diverged = state.diverged | unexplained
        estimate = {"mean": mean, "cov": cov, "mode_prob": prob, "loglik": loglik}
        return state._replace(particles=x, draws=state.draws + 1, diverged=diverged, **estimate)

    def forecast(
        self, state: ParticleState, t: float, *, inputs: Inputs | None = None
    ) -> Estimates:
        """Mean (n, *batch), covariance (and mode probabilities) of particles at a later time."""
        x = self.predict(state, t, inputs=inputs).particles
        return Estimates(*self.estimate(x, np.full(x.shape[1:], 1.0 / self.particles)))

    def estimate(
        self, x: np.ndarray, weight: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, MaybeArray]:
        """Weighted mean (n, *batch), covariance (n, n, *batch), mode probabilities or None.

        Circular components of the state are counted from their mean direction.

        Parameters
        ----------
        x : ndarray, shape (n, particles, *batch)
            With the mode as one more row of a switching system.
        weight : ndarray, shape (particles, *batch)
            Of sum one.
        """
        if self._modes is None:
            if self._periods:
                x = nearest(x, _direction(x, weight, self._periods)[:, None], self._periods)
            mean, cov = _moments(x, weight)
            return wrapped(mean, self._periods), cov, None
        prob = np.stack([(weight * (x[-1] == i)).sum(axis=0) for i in range(self._modes)])
        return *_moments(x[:-1], weight), prob


def stream(seed: np.random.SeedSequence, draw: int) -> np.random.Generator:
    """Generator of one draw, found from its number alone."""
    return np.random.default_rng(child(seed, draw))


def _direction(x: np.ndarray, weight: np.ndarray, periods: Periods) -> np.ndarray:
    """Mean directions of circular components, zero for the others, (n, *batch)."""
    middle = np.zeros((len(x), *x.shape[2:]))
    for k, period in periods:
        angle = 2.0 * np.pi / period * x[k]
        sine, cosine = ((weight * f(angle)).sum(axis=0) for f in (np.sin, np.cos))
        middle[k] = period / (2.0 * np.pi) * np.arctan2(sine, cosine)
    return middle


def _moments(x: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean (n, *batch) and covariance (n, n, *batch) of particles (n, P, *batch)."""
    mean = np.einsum("ip...,p...->i...", x, weight)
    error = x - mean[:, None]
    return mean, np.einsum("ip...,jp...,p...->ij...", error, error, weight)


def resampled(weight: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Numbers (count, *batch) of the particles that systematic resampling draws.

    Parameters
    ----------
    weight : ndarray, shape (particles, *batch)
        Weights that need not sum to one.
    count : int
    rng : numpy.random.Generator
        Gives one uniform number for each data set.
    """
    total, batch = len(weight), weight.shape[1:]
    edges = weight.reshape(total, -1).cumsum(axis=0)
    sets = np.arange(edges.shape[1])
    # the sets lie end to end on one line, so that one sorted search serves all
    edges = edges / edges[-1] + sets
    points = (rng.random(len(sets)) + np.arange(count)[:, None]) / count + sets
    chosen = edges.T.ravel().searchsorted(points.T.ravel(), side="right")
    chosen = chosen.reshape(len(sets), count) - total * sets[:, None]
    return np.minimum(chosen, total - 1).T.reshape(count, *batch)
