"""Design of a finite-order filter of a linear system from exact moments, without simulation."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import outside
from seedslib.base.correction import correct
from seedslib.base.semidefinite import LOST
from seedslib.base.values import Course
from seedslib.design.regression import ROUNDING, regress
from seedslib.designed.accuracy import Design, Prediction
from seedslib.designed.finite_order import Start
from seedslib.designed.memory import Past
from seedslib.linearization.moments import Moments
from seedslib.models.kinds import AnySystem
from seedslib.models.propagation import integrated, stepped


def linear_design(
    system: AnySystem,
    rules: Any,
    times: ArrayLike,
    grid: Any,
    measured: np.ndarray,
    inputs: Course,
) -> Any:
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
    inputs : Course
        At the measurement times.

    Returns
    -------
    start, fits, node_fits, prediction, design

    Raises
    ------
    ValueError
        A system that is not linear; the message says which part is not.
    """
    linear = _Linear(system)
    joint = _Joint(rules, system.mean0, system.cov0)
    with inputs.at(0):
        start = joint.first(measured[0], *linear.sensor(times[0]))
    scores = [(times[0], joint.error)]
    fits, node_fits = [], []
    for k, nodes in enumerate(grid):
        t, found = times[k], []
        with inputs.at(k):
            for node in nodes:
                joint.move(*linear.transition(t, node))
                found.append(joint.node_fit())
                scores.append((node, np.diagonal(found[-1].cov)))
                t = node
            joint.move(*linear.transition(t, times[k + 1]))
        node_fits.append(tuple(found))
        with inputs.at(k + 1):
            fits.append(joint.correct(measured[k + 1], *linear.sensor(times[k + 1])))
        scores.append((times[k + 1], joint.error))
    stamps, squares = (np.array(part) for part in zip(*scores, strict=True))
    rms = np.sqrt(np.maximum(squares, 0.0))
    predicted = Prediction(stamps, rms, np.zeros_like(rms))
    return start, tuple(fits), tuple(node_fits), predicted, Design(0, 0, 0, (), exact=True)


class _Linear:
    """dX = (A X + a) dt + noise of intensity Sigma, Y = C X + c + noise of covariance R."""

    def __init__(self, system):
        import sympy

        from seedslib.models.codegen import compile_array

        if not system.symbolic:
            raise ValueError("exact_moments: wanted a symbolic system, got array functions")
        velocity, spread = system.moment_expressions
        mean, cov, _ = system.sensor.conditional_expressions
        origin = dict.fromkeys(system.state, 0)
        parts = []
        for name, value in (("drift", velocity), ("sensor", mean)):
            slope = sympy.Matrix(list(value)).jacobian(system.state)
            if slope.free_symbols & set(system.state):
                raise ValueError(
                    f"exact_moments: wanted a linear {name}, got {', '.join(map(str, value))}"
                )
            parts += [slope.tolist(), [entry.subs(origin) for entry in value]]
        for name, value in (("diffusion", spread), ("sensor noise", cov)):
            if set().union(*(sympy.sympify(e).free_symbols for e in value.flat)) & set(
                system.state
            ):
                raise ValueError(f"exact_moments: wanted a {name} that is free of the state")
            parts.append(value)
        self.constant = all(
            system.time not in sympy.sympify(e).free_symbols
            for part in parts
            for e in np.array(part, dtype=object).flat
        )
        self.functions = [compile_array((system.time,), part) for part in parts]

    def transition(self, start, stop):
        """Transition matrix, offset and noise covariance from one time to a later one."""

        def extended(t):
            """Coefficients of (X, 1), so that the offset comes out with the matrix."""
            slope, shift, _, _, spread, _ = (f(t) for f in self.functions)
            n = len(slope)
            drift, diffusion = np.zeros((2, n + 1, n + 1))
            drift[:n, :n], drift[:n, n], diffusion[:n, :n] = slope, shift, spread
            return drift, diffusion

        if self.constant:
            matrix, noise = stepped(*extended(start), stop - start)
        else:
            matrix, noise = integrated(extended, start, stop)
        return matrix[:-1, :-1], matrix[:-1, -1], noise[:-1, :-1]

    def sensor(self, t):
        """Matrix, offset and noise covariance of the sensor."""
        return tuple(self.functions[i](t) for i in (2, 3, 5))


class _Joint:
    """Mean and covariance of (X, U): state and memory."""

    def __init__(self, rules, mean, cov):
        self.rules, self.n = rules, len(mean)
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

    def first(self, there, matrix, offset, noise):
        """First estimate, affine in the measurement."""
        mean, cov = self.mean.copy(), self.cov.copy()
        moments = _sensed(matrix, offset, noise, mean, cov)
        constant = np.zeros((self.n, 0))
        gain = _gain(moments, self.rules.components, there)
        self._take(there, matrix, offset, noise, constant, mean, gain)
        return Start(mean, cov, moments)

    def correct(self, there, matrix, offset, noise):
        """Fit the forecast, correct it, remember; returns the fit."""
        fit = self._regressed(self.n)
        wide, left = (np.diagonal(cov)[: len(self.error)] for cov in (self.cov, fit.cov))
        lost = (left < LOST * wide) & (self.error > ROUNDING**2 * wide)
        if lost.any():
            warnings.warn(
                f"cov0: the variance of x{int(np.argmax(lost)) + 1} given the memory is below "
                f"{LOST:g} of itself, and its digits are lost; wanted a narrower prior",
                stacklevel=outside(),
            )
        moments = _sensed(matrix, offset, noise, fit.mean(self.mean[self._memory]), fit.cov)
        gain = _gain(moments, self.rules.components, there)
        self._take(there, matrix, offset, noise, fit.gain, fit.offset, gain)
        return fit

    def node_fit(self):
        """Fit of the estimated components at a node."""
        return self._regressed(self.rules.components)

    @property
    def _memory(self):
        return slice(self.n, self.n + self.dimension)

    def _regressed(self, targets):
        """Fit of the first `targets` components from the memory.

        Of centred variables: where the origin lies must not decide what is a constant. That is
        an estimate that hardly varies beside its state, a measurement beside what it is made of.
        """
        index = np.r_[:targets, self._memory]
        mean, cov = self.mean[index], self.cov[np.ix_(index, index)]
        fit = regress(np.zeros(len(index)), cov, targets, self.sizes.vector)
        return fit._replace(offset=mean[:targets] - fit.gain @ mean[targets:])

    def _take(self, there, matrix, offset, noise, forecast, forecast_offset, gain):
        """Put estimate and measurement in the memory, as rows over (X, U, noise, 1)."""
        n, d, m = self.n, self.dimension, len(matrix)
        base = np.eye(n + d + m + 1)
        state, old, rest, one = np.split(base, [n, n + d, n + d + m])
        shown = matrix @ state + rest + np.outer(offset, one)
        expected = forecast @ old + np.outer(forecast_offset, one)
        innovation = shown - matrix @ expected - np.outer(offset, one)
        if not there.all():  # what is missing has no gain, and is remembered as what was expected
            shown = np.where(there[:, None], shown, shown - innovation)
        components = self.rules.components
        estimate = expected[:components] + gain @ innovation
        cut = np.cumsum([len(b) for b in self.past.estimates + self.past.measurements])[:-1]
        blocks = tuple(np.split(old, cut)) if d else ()
        count = len(self.past.estimates)
        held = Past(blocks[:count], blocks[count:])
        self.past = self.rules.memory.push(held, estimate=estimate, measurement=shown)
        spread = np.sqrt(np.diagonal(self.cov)[:n])
        size = np.abs(matrix) @ spread + np.sqrt(np.diagonal(noise))
        self.sizes = self.rules.memory.push(
            self.sizes, estimate=spread[:components], measurement=size
        )
        rows = np.concatenate([state, self.past.vector])
        mean = np.concatenate([self.mean[: n + d], np.zeros(m), [1.0]])
        cov = np.zeros((len(base), len(base)))
        cov[: n + d, : n + d] = self.cov[: n + d, : n + d]
        cov[n + d : -1, n + d : -1] = noise
        error = state[:components] - estimate
        self.error = np.einsum("ij,jk,ik->i", error, cov, error) + (error @ mean) ** 2
        self.mean, self.cov = rows @ mean, rows @ cov @ rows.T
        self.dimension = len(self.past.vector)


def _sensed(matrix, offset, noise, mean, cov) -> Moments:
    cross = cov @ matrix.T
    return Moments(matrix @ mean + offset, cross, matrix @ cross + noise)


def _gain(moments, rows, there):
    """Gain of the correction, found by correcting zero with unit innovations."""
    m = len(moments.cov)
    if not there.all():
        part = Moments(moments.mean, moments.cross[:, there], moments.cov[np.ix_(there, there)])
        gain = np.zeros((rows, m))
        gain[:, there] = _gain(part, rows, there[there]) if there.any() else 0.0
        return gain
    unit = Moments(np.zeros((m, 1)), moments.cross, moments.cov)
    return correct(np.zeros((len(moments.cross), m)), None, np.eye(m), unit, rows)[0]
