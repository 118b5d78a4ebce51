"""The Kolmogorov-Feller equation of a scalar jump-diffusion as a Markov chain on a grid."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np

from seedslib.base.clock import lengths_alike, step_count, when
from seedslib.base.objects import Shown
from seedslib.base.tables import Axis, AxisLike
from seedslib.base.values import present
from seedslib.models.jump_diffusion import JumpDiffusion
from seedslib.models.maps import StochasticMap

OUTSIDE = 1e-6
"""Probability in the outermost cells above which the grid is too short."""

MARK_NODES = 32
"""Gauss-Hermite nodes per mark where a jump is not affine in its marks."""


def generator(system: JumpDiffusion, axis: Axis, t: float = 0.0) -> np.ndarray:
    """Rates Q of the chain, dp/dt = Q p: columns sum to zero, the rest is nonnegative.

    Diffusion and drift: conservative finite volumes around the nodes with the exponentially
    fitted flux of Scharfetter and Gummel, which keeps p positive for every step of the grid, and
    no flux through the ends. Jumps: the probability that x + s falls into each cell, the outer
    cells reaching to infinity. (4.8) of the jump-diffusion paper, with the loss term.

    Parameters
    ----------
    system : JumpDiffusion
        With one state component.
    axis : Axis
    t : float

    Returns
    -------
    ndarray, shape (S, S)

    Raises
    ------
    ValueError
        A system with more components, a negative intensity, marks that are not Gaussian.
    """
    want_scalar(system)
    nodes, h = axis.nodes, axis.step
    faces = 0.5 * (nodes[1:] + nodes[:-1])
    spread = _half_square(system, t, nodes)
    across = _half_square(system, t, faces)
    # the flux (a p) - (D p)' written as (a - D') p - D p'
    speed = system.drift(t, faces[None])[0] - np.diff(spread) / h
    exchange = across / h**2 * _bernoulli(np.abs(speed) * h, across)
    up = np.maximum(speed, 0.0) / h + exchange
    down = np.maximum(-speed, 0.0) / h + exchange
    rates = np.diag(up, -1) + np.diag(down, 1)
    if system.jump is not None:
        intensity = np.asarray(system.intensity(t, nodes[None]), dtype=float)
        if not (intensity >= 0).all() or not np.isfinite(intensity).all():
            raise ValueError(
                f"intensity: wanted finite nonnegative numbers, got {intensity.min():g}"
            )
        rates += _landing(system.jump, axis, t) * intensity
    np.fill_diagonal(rates, 0.0)
    np.fill_diagonal(rates, -rates.sum(axis=0))
    return rates


class FellerChain(Shown):
    """Scalar jump-diffusion and its sensor as a chain that is seen through a likelihood.

    What the recursion of theorem 1 asks of a model: values of the chain's states, their initial
    probabilities, how these move, and the likelihood.

    Parameters
    ----------
    system : JumpDiffusion
        With one state component and a sensor that has a log-density.
    axis : Axis
        Nodes of the state. Their range should hold all but a millionth of the probability.

    Attributes
    ----------
    values : ndarray, shape (1, S)
        State at each node.
    modes, indicators : int
        1 and 0: there are neither.

    Raises
    ------
    ValueError
        More than one state component, no likelihood, or an initial law that is not Gaussian.
    """

    modes: int = 1
    indicators: int = 0
    loses: bool = False

    _shown = ("axis",)

    def __init__(self, system: JumpDiffusion, axis: AxisLike) -> None:
        want_scalar(system)
        if not system.sensor.has_log_density:
            raise ValueError(
                "system: wanted a sensor affine in Gaussian noise or one with a log_density, "
                "got one whose likelihood has no closed form"
            )
        self.system: JumpDiffusion = system
        self.axis: Axis = Axis.of("axis", axis)
        self.values: np.ndarray = self.axis.nodes[None]
        self._known: dict = {}

    def start(self) -> np.ndarray:
        """Initial probabilities, shape (S,)."""
        if not self.system.law.gaussian:
            raise ValueError("system: wanted a Gaussian initial law, got one that is only sampled")
        return normal_masses(self.axis, self.system.mean0[0], np.sqrt(self.system.cov0[0, 0]))

    def transition(self, start: float, stop: float) -> np.ndarray:
        """Transition matrix P, p(stop) = P p(start): nonnegative, columns sum to one.

        The matrix exponential of the rates, once for each length of an interval where they do
        not depend on time, and otherwise a product of those at the middle of integration steps.
        """
        if not stop > start:
            raise ValueError(f"stop: wanted a time after {when(start)}, got {when(stop)}")
        steady = self._steady(start, stop)
        length = (float(lengths_alike(stop - start)),) if steady else (start, stop)
        key = *length, *present(self.system.mentions)
        if key not in self._known:
            if steady:
                found = self._exponential(start, stop)
            else:
                steps = step_count(start, stop, self.system.step)
                grid = np.linspace(start, stop, steps + 1)
                found = np.eye(self.axis.count)
                for a, b in pairwise(grid):
                    found = self._exponential(a, b) @ found
            found = np.maximum(found, 0.0)
            self._known[key] = found / found.sum(axis=0)
        return self._known[key]

    def law(self, t: float, start: float = 0.0) -> np.ndarray:
        """Probabilities of the nodes at a later time, shape (S,)."""
        mass = self.start()
        return mass if t == start else self.transition(start, t) @ mass

    def log_likelihood(self, t: float, y: np.ndarray) -> np.ndarray:
        """Logarithm of the density of measurements y, (m, Y), at each node: (Y, S)."""
        return log_densities(self.system.sensor, t, y, self.values)

    def reach(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation of the measurement at each node, both (m, S)."""
        return sensor_reach(self.system.sensor, t, self.values)

    def look_at_ends(self, mass: np.ndarray) -> None:
        """Warn where the probability reaches the ends of the grid; mass of shape (S,)."""
        warn_at_ends(mass)

    def _steady(self, start: float, stop: float) -> bool:
        """Whether the rates in the interval are those of all others seen so far.

        Expressions without the time say so. Array functions are looked at, in every interval, at
        times that no regular change can hide between.
        """
        system = self.system
        if system.symbolic:
            parts = [system.drift_expressions, system.diffusion_expressions]
            parts += [] if system.jump is None else [system.jump.expressions]
            seen = set().union(*(e.free_symbols for part in parts for e in part.flat))
            return system.time not in seen | system.intensity_expression.free_symbols
        probes = start + (stop - start) * np.array([0.0, 0.3183, 0.6180, 0.8660])
        found = [generator(system, self.axis, t) for t in probes]
        first = self._known.setdefault("first", found[0])
        return all(np.array_equal(first, other) for other in found)

    def _exponential(self, start: float, stop: float) -> np.ndarray:
        from scipy.linalg import expm

        return expm(generator(self.system, self.axis, 0.5 * (start + stop)) * (stop - start))


def log_densities(sensor: StochasticMap, t: float, y: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Logarithm of the density of measurements (m, Y) at each of some states (n, S): (Y, S)."""
    shape = y.shape[1], nodes.shape[1]
    x = np.broadcast_to(nodes[:, None], (len(nodes), *shape))
    return sensor.log_density(t, np.broadcast_to(y[:, :, None], (len(y), *shape)), x)


def sensor_reach(sensor: StochasticMap, t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation (m, S) of what a sensor shows at states x (1, S)."""
    mean, cov = sensor.conditional_moments(float(t), x)
    shape = (sensor.size, x.shape[1])
    square = [np.broadcast_to(cov[i, i], shape[1:]) for i in range(sensor.size)]
    return np.broadcast_to(mean, shape), np.sqrt(square)


def warn_at_ends(mass: np.ndarray) -> None:
    """Warn where the probability (S,) reaches the ends of a grid."""
    outside = max(mass[0], mass[-1])
    if outside > OUTSIDE:
        warnings.warn(
            f"x: probability {outside:.2g} in an outermost cell; the axis is too short",
            stacklevel=5,
        )


def want_scalar(system: object) -> None:
    """Refuse a system of several components."""
    if system.state_size != 1:
        raise ValueError(
            f"system: wanted one state component for a grid, got {system.state_size}; "
            "simulated_synthesis takes more"
        )


def _half_square(system: JumpDiffusion, t: float, x: np.ndarray) -> np.ndarray:
    return 0.5 * np.einsum("jN,jN->N", *[system.diffusion(t, x[None])[0]] * 2)


def _bernoulli(product: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Bernoulli function q / (exp q - 1) of q = product / spread >= 0, zero without spread."""
    with np.errstate(over="ignore"):
        q = np.divide(product, spread, out=np.full_like(product, 700.0), where=spread > 0)
    q = np.minimum(q, 700.0)
    return np.divide(q, np.expm1(q), out=np.ones_like(q), where=q > 1e-12)


def normal_masses(axis: Axis, mean: float, deviation: float) -> np.ndarray:
    """Probabilities of the nodes (S,) for a normal law."""
    if deviation >= axis.step:
        # for a smooth density the values at the nodes are better than the cells' masses
        mass = np.exp(-0.5 * ((axis.nodes - mean) / deviation) ** 2)
    else:
        mass = cell_masses(axis, np.array([mean]), np.array([deviation]))[:, 0]
    return mass / mass.sum()


def cell_masses(axis: Axis, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Probability (S, N) of each cell for normal laws; a point goes to its two neighbours."""
    from scipy.special import ndtr

    nodes = axis.nodes
    edges = np.concatenate([[-np.inf], 0.5 * (nodes[1:] + nodes[:-1]), [np.inf]])
    wide = deviation > 0
    masses = np.empty((axis.count, len(mean)))
    masses[:, wide] = np.diff(ndtr((edges[:, None] - mean[wide]) / deviation[wide]), axis=0)
    masses[:, ~wide] = _split(axis, mean[~wide])
    return masses


def _split(axis: Axis, values: np.ndarray) -> np.ndarray:
    """Unit masses at `values` on their two neighbours, with the mean kept: (S, N)."""
    index, share = axis.place(values)
    masses = np.zeros((axis.count, len(values)))
    columns = np.arange(len(values))
    masses[index, columns] = 1.0 - share
    masses[index + 1, columns] += share
    return masses


def _landing(jump: StochasticMap, axis: Axis, t: float) -> np.ndarray:
    """Probability of each cell (rows) after a jump from each node (columns)."""
    x = axis.nodes[None]
    if not jump.noise.gaussian:
        raise ValueError("jump: wanted Gaussian marks for a grid, got others")
    if jump.symbolic and jump.has_log_density:
        mean, cov = jump.conditional_moments(t, x)
        deviation = np.sqrt(np.maximum(np.broadcast_to(cov[0, 0], x[0].shape), 0.0))
        return cell_masses(axis, x[0] + mean[0], deviation)
    marks, weights = jump.noise.rule(MARK_NODES)
    landing = np.zeros((axis.count, axis.count))
    for mark, weight in zip(marks.T, weights, strict=True):
        kick = jump.value(t, x, np.broadcast_to(mark[:, None], (len(mark), axis.count)))
        landing += weight * _split(axis, x[0] + kick[0])
    return landing
