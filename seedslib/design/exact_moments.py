"""Design of a finite-order filter of a linear system from exact moments, without simulation."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from seedslib.base.conditioning import kalman_gain
from seedslib.design.regression import regress
from seedslib.designed.accuracy import Accuracy, Design
from seedslib.designed.finite_order import Rules, Start
from seedslib.designed.memory import Past
from seedslib.designed.predictors import AffineFit
from seedslib.linearization.moments import Moments
from seedslib.models.jump_diffusion import JumpDiffusion
from seedslib.models.linear import integrated, stepped


def linear_design(
    system: JumpDiffusion,
    rules: Rules,
    times: np.ndarray,
    grid: tuple[np.ndarray, ...],
    measured: np.ndarray,
) -> dict[str, Any]:
    """Forecasts and predicted errors by the covariance recursion of state and memory.

    The state and the memory are jointly linear in the noises, so their mean and covariance
    follow from one recursion; it is exact for Gaussian and non-Gaussian noises alike.

    Parameters
    ----------
    system : JumpDiffusion
        With a linear mean velocity, a constant diffusion and a linear sensor.
    rules : Rules
    times : ndarray, shape (K+1,)
    grid : tuple of ndarray
        Node times.
    measured : ndarray of bool, shape (K+1, m)
        Components that are measured at each time.

    Returns
    -------
    dict
        ``start``, ``fits``, ``node_fits``, ``predicted`` and ``design`` of the filter.

    Raises
    ------
    ValueError
        A system that is not linear; the message says which part is not.
    """
    linear = _Linear(system)
    joint = _Joint(rules, system.mean0, system.cov0)
    p = system.values()
    start = joint.start(measured[0], linear.sensor(times[0], p))
    scores = [(times[0], joint.error)]
    fits, node_fits = [], []
    for k, nodes in enumerate(grid):
        t, between = times[k], []
        for node in nodes:
            joint.move(*linear.transition(t, node, p))
            between.append(joint.fit(rules.components))
            scores.append((node, np.diagonal(between[-1].cov)))
            t = node
        joint.move(*linear.transition(t, times[k + 1], p))
        node_fits.append(tuple(between))
        fits.append(joint.correct(measured[k + 1], linear.sensor(times[k + 1], p)))
        scores.append((times[k + 1], joint.error))
    stamps, squares = (np.array(part) for part in zip(*scores, strict=True))
    rms = np.sqrt(np.maximum(squares, 0.0))
    return {
        "start": start,
        "fits": tuple(fits),
        "node_fits": tuple(node_fits),
        "predicted": Accuracy(stamps, rms, np.zeros_like(rms)),
        "design": Design(0, 0, 0, (), exact=True),
    }


class _Sensor(NamedTuple):
    """Y = matrix X + offset + noise with this covariance."""

    matrix: np.ndarray
    offset: np.ndarray
    noise: np.ndarray

    def moments(self, mean: np.ndarray, cov: np.ndarray) -> Moments:
        """Moments of a measurement from those of the state."""
        cross = cov @ self.matrix.T
        return Moments(self.matrix @ mean + self.offset, cross, self.matrix @ cross + self.noise)


class _Linear:
    """dX = (A X + a) dt + noise of intensity Sigma, Y = C X + c + noise of covariance R."""

    def __init__(self, system):
        import sympy

        from seedslib.models.codegen import compile_array

        velocity, intensity = system.moment_expressions
        mean, cov, _ = system.sensor.conditional_expressions
        origin, state = dict.fromkeys(system.state, 0), set(system.state)
        parts = []
        for name, value in (("drift", velocity), ("sensor", mean)):
            slope = sympy.Matrix(list(value)).jacobian(system.state)
            if slope.free_symbols & state:
                raise ValueError(
                    f"exact_moments: wanted a linear {name}, got {', '.join(map(str, value))}"
                )
            parts += [slope.tolist(), [entry.subs(origin) for entry in value]]
        for name, value in (("diffusion", intensity), ("sensor noise", cov)):
            if sympy.Matrix(value).free_symbols & state:
                raise ValueError(f"exact_moments: wanted a {name} that is free of the state")
            parts.append(value)
        self._constant = all(
            system.time not in sympy.sympify(entry).free_symbols
            for part in parts
            for entry in np.array(part, dtype=object).flat
        )
        given = system.time, system.parameters
        functions = [compile_array(given, part) for part in parts]
        self._motion, self._sensor = functions[:2] + functions[4:5], functions[2:4] + functions[5:]

    def transition(self, start, stop, p):
        """Transition matrix, offset and noise covariance from one time to a later one."""

        def extended(t):
            """Coefficients of (X, 1), so that the offset comes out with the matrix."""
            slope, shift, intensity = (f(t, p) for f in self._motion)
            n = len(slope)
            drift, diffusion = np.zeros((2, n + 1, n + 1))
            drift[:n, :n], drift[:n, n], diffusion[:n, :n] = slope, shift, intensity
            return drift, diffusion

        if self._constant:
            matrix, noise = stepped(*extended(start), stop - start)
        else:
            matrix, noise = integrated(extended, start, stop)
        return matrix[:-1, :-1], matrix[:-1, -1], noise[:-1, :-1]

    def sensor(self, t, p) -> _Sensor:
        """The sensor at a time."""
        return _Sensor(*(f(t, p) for f in self._sensor))


class _Joint:
    """Mean and covariance of (X, U): state and memory."""

    def __init__(self, rules, mean, cov):
        self.memory, self.components, self.n = rules.memory, rules.components, len(mean)
        self.mean, self.cov = np.array(mean), np.array(cov)
        self.past, self.dimension = Past(), 0
        self.sizes, self.error = Past(), None

    def move(self, matrix, offset, noise):
        """Let the state move on."""
        n = self.n
        self.mean[:n] = matrix @ self.mean[:n] + offset
        self.cov[:n, n:] = matrix @ self.cov[:n, n:]
        self.cov[n:, :n] = self.cov[:n, n:].T
        self.cov[:n, :n] = matrix @ self.cov[:n, :n] @ matrix.T + noise

    def start(self, observed: np.ndarray, sensor: _Sensor) -> Start:
        """First estimate, affine in the measurement."""
        mean, cov = self.mean.copy(), self.cov.copy()
        start = Start(mean, cov, sensor.moments(mean, cov))
        self._remember(observed, sensor, AffineFit(np.zeros((self.n, 0)), mean, cov), start.moments)
        return start

    def correct(self, observed: np.ndarray, sensor: _Sensor) -> AffineFit:
        """Fit the forecast, correct it, remember; returns the fit."""
        fit = self.fit(self.n)
        moments = sensor.moments(fit.mean(self.mean[self.n :]), fit.cov)
        self._remember(observed, sensor, fit, moments)
        return fit

    def fit(self, targets: int) -> AffineFit:
        """Regression of the first `targets` components on the memory.

        Of centred variables: where the origin lies must not decide what is a constant. That is
        an estimate that hardly varies beside its state, a measurement beside what it is made of.
        """
        index = np.r_[:targets, self.n : self.n + self.dimension]
        mean, cov = self.mean[index], self.cov[np.ix_(index, index)]
        fit = regress(np.zeros(len(index)), cov, targets, self.sizes.vector)
        return fit._replace(offset=mean[:targets] - fit.gain @ mean[targets:])

    def _remember(self, observed, sensor, fit, moments):
        """Put estimate and measurement in the memory, as rows over (X, U, noise, 1)."""
        n, d, m = self.n, self.dimension, len(sensor.matrix)
        base = np.eye(n + d + m + 1)
        state, old, noise, one = np.split(base, [n, n + d, n + d + m])
        offset = np.outer(sensor.offset, one)
        y = sensor.matrix @ state + noise + offset
        predicted = fit.gain @ old + np.outer(fit.offset, one)
        innovation = y - sensor.matrix @ predicted - offset
        if not observed.all():  # a missing one has no gain, and is remembered as its prediction
            y = np.where(observed[:, None], y, y - innovation)
        gain = _gain(moments, self.components, observed)
        estimate = predicted[: self.components] + gain @ innovation
        ends = np.cumsum([len(b) for b in self.past.estimates + self.past.measurements])[:-1]
        blocks, count = tuple(np.split(old, ends)) if d else (), len(self.past.estimates)
        past = Past(blocks[:count], blocks[count:])
        self.past = self.memory.push(past, estimate=estimate, measurement=y)
        deviation = np.sqrt(np.diagonal(self.cov)[:n])
        size = np.abs(sensor.matrix) @ deviation + np.sqrt(np.diagonal(sensor.noise))
        self.sizes = self.memory.push(
            self.sizes, estimate=deviation[: self.components], measurement=size
        )
        rows = np.concatenate([state, self.past.vector])
        mean = np.concatenate([self.mean[: n + d], np.zeros(m), [1.0]])
        cov = np.zeros((len(base), len(base)))
        cov[: n + d, : n + d] = self.cov[: n + d, : n + d]
        cov[n + d : -1, n + d : -1] = sensor.noise
        error = state[: self.components] - estimate
        self.error = np.einsum("ij,jk,ik->i", error, cov, error) + (error @ mean) ** 2
        self.mean, self.cov = rows @ mean, rows @ cov @ rows.T
        self.dimension = len(self.past.vector)


def _gain(moments, rows, observed):
    """Gain of the leading rows of the state; zero of a component that is not measured."""
    gain = np.zeros((rows, len(moments.cov)))
    if observed.any():
        cov = moments.cov[np.ix_(observed, observed)]
        gain[:, observed] = kalman_gain(moments.cross[:rows, observed], cov)
    return gain
