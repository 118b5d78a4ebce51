"""Systems on a grid: probabilities of its nodes, how they move, and the likelihoods of nodes.

What the exact recursions ask of a model, as a `GridChain` that `grid_chain` makes of any of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from seedslib.base.arrays import MaybeArray
from seedslib.base.clock import lengths_alike, step_count, when
from seedslib.base.linalg import cholesky, variances
from seedslib.base.tables import (
    Axis,
    AxisLike,
    Grid,
    Nodes,
    as_axes,
    as_grids,
    locate,
    mesh,
)
from seedslib.base.values import Values
from seedslib.models.discrete import DiscreteSystem
from seedslib.models.jump_diffusion import JumpDiffusion
from seedslib.models.kinds import AnySystem
from seedslib.models.maps import StochasticMap
from seedslib.models.switching import CLOSE, Branch, SwitchingSystem

if TYPE_CHECKING:
    import sympy

STORED = 64, 1
"""Transitions that are stored, of times or of values of inputs; of large ones the last."""

POINTS = 6
"""Nodes that a narrow distribution is shared between: its moments up to the fifth are kept."""

NARROW = 0.8
"""Deviation, in steps of the grid, below which it has no density to speak of on the nodes."""

SHIFT = 1e-5
"""Relative shift of a state for the derivative of its drift."""


class GridChain:
    """A system on the nodes of a grid, a Markov chain that is observed through a likelihood.

    The states of the chain are the nodes in mode 0, then those in mode 1, and so on. `grid_chain`
    makes one of a system.

    Parameters
    ----------
    system : DiscreteSystem, SwitchingSystem or JumpDiffusion
        With a sensor that has a density.
    axes : sequence of Axis or Nodes
    initial : ndarray, shape (S,)
        Initial probabilities.
    matrix : callable
        ``matrix(start, stop, p)``, probabilities (S, S) of a transition, column by column, and
        the `loss` (S,) in it.
    steady : bool
        Whether it depends on the length of the step only.
    missed : float
        Initial probability beyond the nodes or between them.

    Attributes
    ----------
    loses : bool
        Whether columns of the transition need not sum to one.
    nodes : ndarray, shape (n, N)
        Of the system's state, the last component fastest.
    values : ndarray, shape (n, S)
        State of the system at each state of the chain, S = N modes.
    modes, indicators : int
        1 and 0 where there are neither.
    """

    def __init__(
        self,
        system: AnySystem,
        axes: Sequence[Axis | Nodes],
        initial: MaybeArray,
        matrix: Callable[[float, float, Values], tuple[np.ndarray, np.ndarray]] | None = None,
        *,
        missed: float = 0.0,
        steady: bool = False,
    ) -> None:
        switching = isinstance(system, SwitchingSystem)
        self.system: Any = system
        self.axes: tuple[Axis | Nodes, ...] = tuple(axes)
        self.initial: MaybeArray = initial
        self.missed: float = missed
        self.steady, self.loses = steady, isinstance(system, DiscreteSystem)
        self.nodes: np.ndarray = mesh(self.axes)
        self.modes: int = system.modes if switching else 1
        self.indicators: int = system.indicators
        self.values: np.ndarray = np.tile(self.nodes, self.modes)
        self._matrix = matrix
        self._known: dict[tuple[float, ...], tuple] = {}
        self._sensors: Any = system.sensors if switching else (system.sensor,)
        self._readings: Any = system.readings if switching else ((system.sensor,),)
        require_densities("sensor", self._readings)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(map(str, self.axes))})"

    def numbers(self, p: Values | None, dt: float = np.nan) -> Values:
        """Numbers of the parameters; the system's own where None are given.

        Raises
        ------
        ValueError
            A parameter that has a number for each path.
        """
        p = self.system.values(dt=dt) if p is None else p
        for parameter, value in zip(self.system.parameters, p, strict=True):
            if np.ndim(value):
                raise ValueError(
                    f"{parameter}: wanted one number on a grid, got {np.shape(value)}; make the "
                    "filter anew for each, as fit does with a function that makes it"
                )
        return tuple(map(float, p))

    def transition(self, start: float, stop: float, p: Values | None = None) -> np.ndarray:
        """Transition matrix P, p(stop) = P p(start), computed once for equal steps.

        Parameters
        ----------
        start, stop : float
        p : tuple of float, optional
            Numbers of the system's parameters; its own by default.

        Raises
        ------
        ValueError
            A parameter that has a number for each path; noise that does not move the state;
            probabilities that are none.
        """
        return self._moved(start, stop, p)[0]

    def loss(self, start: float, stop: float, p: Values | None = None) -> np.ndarray:
        """Probability (S,) that a step from each state goes beyond the nodes or between them.

        Parameters
        ----------
        start, stop, p
            As `transition`.
        """
        return self._moved(start, stop, p)[1]

    def _moved(self, start: float, stop: float, p: Values | None) -> tuple[np.ndarray, np.ndarray]:
        if not stop > start:
            raise ValueError(f"stop: wanted a time after {when(start)}, got {when(stop)}")
        p = self.numbers(p, stop - start)
        span = (float(lengths_alike(stop - start)),) if self.steady else (start, stop)
        key = *span, *p
        if key not in self._known:
            if len(self._known) >= STORED[self.loses]:
                self._known.clear()
            self._known[key] = self._matrix(float(start), float(stop), p)
        return self._known[key]

    def move(
        self, prob: np.ndarray, start: float, stop: float, p: Values | None = None
    ) -> np.ndarray:
        """Distributions (S, C) at a later time, each a column."""
        return self.transition(start, stop, p) @ prob

    def distribution(self, t: float, start: float = 0.0) -> np.ndarray:
        """Probabilities at a later time, shape (S,)."""
        return self.initial if t == start else self.transition(start, t) @ self.initial

    def log_likelihood(self, t: float, y: np.ndarray, p: Values | None = None) -> np.ndarray:
        """Logarithm of the density of measurements (m, Y) at each state: (Y, S).

        Where there is an indicator, its values are the first row, (1 + m, Y); -1 is a missing one.
        """
        p = self.numbers(p)
        indicator, y = (y[0], y[1:]) if self.indicators else (np.zeros(y.shape[1]), y)
        log_density = np.full((y.shape[1], self.modes, self.nodes.shape[1]), -np.inf)
        for j in np.unique(indicator):
            columns = np.flatnonzero(indicator == j)
            for i in range(self.modes):
                reading = self._sensors[i] if j < 0 else self._readings[i][int(j)]
                if reading is not None:
                    density = reading.log_density(t, y[:, columns, None], self.nodes[:, None], p)
                    log_density[columns, i] = density
        return log_density.reshape(len(log_density), -1)

    def indicator_prob(self, t: float, p: Values | None = None) -> np.ndarray:
        """Probability of each value of the indicator at each state, and one for none: (M+1, S).

        What is known without a measurement; (1, S) where there is no indicator.
        """
        p = self.numbers(p)
        prob = np.ones((self.indicators + 1, self.modes, self.nodes.shape[1]))
        for j in range(self.indicators):
            for i, row in enumerate(self._readings):
                prob[j, i] = 0.0 if row[j] is None else row[j].probability(t, self.nodes, p)
        return prob.reshape(len(prob), -1)

    def measurement_moments(
        self, t: float, p: Values | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation of the measurement at each state, both (m, S)."""
        p = self.numbers(p)
        parts = [mean_and_deviation(sensor, t, self.nodes, p) for sensor in self._sensors]
        return tuple(np.concatenate(part, axis=1) for part in zip(*parts, strict=True))

    def at_ends(self, mass: np.ndarray) -> float:
        """Probability of the likelier one of the outermost cells; mass of shape (S,)."""
        mass = mass.reshape(self.modes, -1).sum(axis=0)
        return float(max(mass[0], mass[-1]))


def grid_chain(system: AnySystem, axes: Grid) -> GridChain:
    """A system of one or two state components as a chain on a grid.

    Of a `DiscreteSystem` means over the state are quadrature on the nodes, p'(x') = sum of
    w p(x' | x) p(x). On evenly spaced nodes the trapezoid rule converges faster than any power of
    the step for smooth densities; a step of half of the noise's deviation leaves rounding. No
    column is normalised: what leaves the nodes is lost, and likelihoods say so.

    Of a `SwitchingSystem` it is (1.3) and (1.4) of the switching paper on the nodes. Columns are
    normalised, so what would leave the nodes is spread over them. In the plane the steps are below
    the deviations of the noise, which moves both components.

    Of a scalar `JumpDiffusion` it is the exponential of the `generator`; one in the plane is a
    `PlaneChain`.

    Parameters
    ----------
    system : DiscreteSystem, SwitchingSystem or JumpDiffusion
        In discrete time each component is moved by noise of its own, and next state and
        measurement have densities; the initial distribution is Gaussian.
    axes : Axis, (low, high, count), or two of them
        Nodes of the state, which of a `DiscreteSystem` may be `Nodes`. Their range should hold all
        but a millionth of the probability.

    Raises
    ------
    TypeError, ValueError
        More components, no density, an initial distribution that is only sampled, axes that are
        none.
    """
    require_few(system)
    n = system.state_size
    if isinstance(system, DiscreteSystem):
        return _discrete_chain(system, as_grids("axes", axes, n))
    axes = as_axes("axes", axes, n)
    if isinstance(system, SwitchingSystem):
        return _switching_chain(system, axes)
    return PlaneChain(system, axes) if n == 2 else _feller_chain(system, axes)


def _discrete_chain(system: DiscreteSystem, axes: Sequence[Axis | Nodes]) -> GridChain:
    require_densities("dynamics", ((system.dynamics,),))
    weights = _weights(axes)
    matrix = partial(_discrete_matrix, system.dynamics, mesh(axes), weights)
    steady = _without(system.dynamics.time, system.dynamics.expressions)
    initial = _discrete_start(system, axes, weights)
    missed = abs(1.0 - float(initial.sum()))
    return GridChain(system, axes, initial, matrix, missed=missed, steady=steady)


def _discrete_start(system: DiscreteSystem, axes: Sequence[Axis | Nodes], weights: np.ndarray):
    """Masses of the initial state; a known one at a node, or shared between those about it."""
    require_gaussian(system)
    mean, cov = system.mean0, system.cov0
    if not cov.any():
        place = locate(tuple(axes), list(mean))
        return np.array([place.linear(row) for row in np.eye(len(weights))])
    require_moved("cov0", cov)
    error = mesh(axes) - mean[:, None]
    square = np.einsum("iS,iS->S", error, np.linalg.solve(cov, error))
    return weights * np.exp(-0.5 * square) / np.sqrt(np.linalg.det(2.0 * np.pi * cov))


def _discrete_matrix(
    map: StochasticMap, x: np.ndarray, weights: np.ndarray, start: float, stop: float, p: Values
) -> tuple[np.ndarray, np.ndarray]:
    matrix = _density(map, x, start, p)
    matrix *= weights[:, None]
    return matrix, np.abs(1.0 - matrix.sum(axis=0))


def _density(map: StochasticMap, x: np.ndarray, start: float, p: Values) -> np.ndarray:
    """Densities (S, S) of the next state at each node, from each node."""
    if map.gaussian_density:
        mean, cov = map.conditional_moments(start, x, p)
        require_moved("dynamics", cov)
        if len(x) == 1 and not map.period:
            # in place: these matrices are large, and made anew at every time
            deviation, density = np.sqrt(cov[0, 0]), x.T - mean[0]
            density /= deviation
            density *= density
            density *= -0.5
            np.exp(density, out=density)
            density /= np.sqrt(2.0 * np.pi) * deviation
            return density
    return np.exp(map.log_density(start, x[:, :, None], x[:, None, :], p))


def _switching_chain(system: SwitchingSystem, axes: Sequence[Axis]) -> GridChain:
    require_densities("dynamics", system.branches)
    maps = [b.map for row in system.branches for b in row if b is not None]
    steady = _without(
        maps[0].time, [e for m in maps for e in (m.weight_expression, *m.expressions)]
    )
    starts = [(chance, *_normal(axes, mean, cov)) for chance, mean, cov in system.initial]
    initial = np.concatenate([chance * mass for chance, mass, _ in starts])
    missed = sum(chance * loss for chance, _, loss in starts)
    matrix = partial(_switching_matrix, system, axes)
    return GridChain(system, axes, initial, matrix, missed=missed, steady=steady)


def _switching_matrix(
    system: SwitchingSystem, axes: Sequence[Axis], start: float, stop: float, p: Values
) -> tuple[np.ndarray, np.ndarray]:
    nodes, maps, table = mesh(axes), system.dynamics, system.branches
    count, modes = nodes.shape[1], system.modes
    matrix, loss = np.zeros((modes, count, modes, count)), np.zeros((modes, count))
    with np.errstate(invalid="ignore"):  # logarithms of probabilities that are none
        if system.drives == "new":  # the switch at each node, and the move of the new mode
            moves = [_leaving(axes, nodes, start, map, [Branch(map)], p) for map in maps]
            for i, l in np.ndindex(modes, modes):
                if (branch := table[i][l]) is not None:
                    chance = branch.probability(start, nodes, p)
                    matrix[l, :, i] = moves[l][0][0] * chance
                    loss[i] += moves[l][1] * chance
        else:
            for i in range(modes):
                matrix[:, :, i], loss[i] = _leaving(axes, nodes, start, maps[i], table[i], p)
    proper = (matrix >= -CLOSE).all(axis=(0, 1))
    if not proper.all():
        i, place = np.argwhere(~proper)[0]
        at = ", ".join(f"{value:g}" for value in nodes[:, place])
        raise ValueError(
            f"switching of mode {i}: wanted probabilities from 0 to 1 at all nodes, got others at "
            f"x = {at}"
        )
    return matrix.reshape(modes * count, -1), loss.ravel()


def _leaving(
    axes: Sequence[Axis],
    x: np.ndarray,
    t: float,
    map: StochasticMap,
    row: Sequence[Branch | None],
    p: Values,
) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities (branches, N, N) of the branches of a map and the next node, and the loss."""
    if len(x) == 1 and map.noise.gaussian:
        mean, deviation = (part[0] for part in mean_and_deviation(map, t, x, p))
        if (deviation < axes[0].step).any():
            if any(b is not None and b.depends_on_noise for b in row):
                raise ValueError(
                    f"x: wanted a step below the deviation {deviation.min():g} of the noise, "
                    "which the switching depends on"
                )
            masses = cell_masses(axes[0], mean, deviation)
            parts = [masses * (0.0 if b is None else b.probability(t, x, p)) for b in row]
            outside = (mean < axes[0].low) | (mean > axes[0].high)
            # the error of the trapezoid rule for the density, from which on a rounding to cells
            # shows; a point of no deviation keeps its mean
            coarse = 2.0 * np.exp(-2.0 * (np.pi * deviation / axes[0].step) ** 2)
            coarse = np.where(deviation > 0, np.minimum(coarse, 1.0), 0.0)
            return np.stack(parts), np.maximum(outside, coarse)
    logs = np.full((len(row), *(x.shape[1],) * 2), -np.inf)
    for log, branch in zip(logs, row, strict=True):
        if branch is not None:
            log[:] = branch.log_density(t, x[:, :, None], x[:, None, :], p)
    # a state that moves far beyond the ends goes to the node that is the least far away
    highest = logs.max(axis=(0, 1))
    masses = np.exp(logs - highest)
    loss = np.abs(1.0 - np.exp(highest) * (_weights(axes) @ masses.sum(axis=0)))
    return masses / masses.sum(axis=(0, 1)), loss


def _weights(axes: Sequence[Axis | Nodes]) -> np.ndarray:
    """Weights of the quadrature at all nodes, (S,)."""
    weights = np.ones(1)
    for axis in axes:
        weights = np.outer(weights, axis.weights).ravel()
    return weights


def _feller_chain(system: JumpDiffusion, axes: Sequence[Axis]) -> GridChain:
    formulas = [*system.drift_expressions, *system.diffusion_expressions.flat]
    formulas += [system.intensity_expression, *(system.jump.expressions if system.jump else ())]
    steady = _without(system.time, formulas)
    matrix = partial(_feller_matrix, system, axes[0], steady)
    initial, missed = _diffusion_start(system, axes)
    return GridChain(system, axes, initial, matrix, missed=missed, steady=steady)


def _feller_matrix(
    system: JumpDiffusion, axis: Axis, steady: bool, start: float, stop: float, p: Values
) -> tuple[np.ndarray, np.ndarray]:
    """Matrix exponential of the rates, or of those at the middle of integration steps."""
    from scipy.linalg import expm

    steps = 1 if steady else step_count(start, stop, system.step)
    h, last, matrix = (stop - start) / steps, None, np.eye(axis.count)
    for k in range(steps):
        rates = generator(system, axis, start + (k + 0.5) * h, p)
        if last is None or not np.array_equal(rates, last):
            step, last = expm(rates * h), rates
        matrix = step @ matrix
    matrix = np.maximum(matrix, 0.0)
    return matrix / matrix.sum(axis=0), np.zeros(axis.count)  # no flux through the ends


def _diffusion_start(system: JumpDiffusion, axes: Sequence[Axis]) -> tuple[np.ndarray, float]:
    require_gaussian(system)
    return _normal(axes, system.mean0, system.cov0)


def _normal(axes: Sequence[Axis], mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, float]:
    """Probabilities of the nodes for a normal distribution, and what is beyond them."""
    deviation = np.sqrt(cov[0, 0])
    if len(axes) == 1 and deviation < axes[0].step:
        mass = cell_masses(axes[0], mean[:1], deviation[None])[:, 0]
        return mass / mass.sum(), float(not axes[0].low <= mean[0] <= axes[0].high)
    # for a smooth density the values at the nodes are better than masses of cells
    error = mesh(axes) - mean[:, None]
    mass = np.exp(-0.5 * np.einsum("iN,iN->N", error, np.linalg.solve(cov, error)))
    whole = np.sqrt(np.linalg.det(2.0 * np.pi * cov))
    return mass / mass.sum(), abs(1.0 - float(_weights(axes) @ mass) / whole)


def _without(time: sympy.Symbol, expressions: Iterable[sympy.Expr] | None) -> bool:
    """Whether there are formulas, which do not mention the time."""
    return expressions is not None and not any(e.has(time) for e in expressions)


def require_densities(name: str, table: Sequence[Sequence[StochasticMap | Branch | None]]) -> None:
    """Refuse maps without a density."""
    if not all(map is None or map.has_log_density for row in table for map in row):
        raise ValueError(
            f"{name}: wanted values affine in noise with a density or with a log_density, got "
            "one whose density has no closed form"
        )


def require_gaussian(system: JumpDiffusion | DiscreteSystem) -> None:
    """Refuse an initial distribution without a density."""
    if not system.prior.gaussian:
        raise ValueError(
            "system: wanted a Gaussian initial distribution, got one that is only sampled"
        )


class PlaneChain(GridChain):
    """Diffusion in the plane, seen through a likelihood, whose density moves on a grid.

    The Kolmogorov equation between measurements by splitting: half a substep of the second
    component with the first held, a substep of the first with the second held, and again half a
    substep of the second. Each is the transition density of a scalar diffusion, Gaussian with the
    exact moments of its linear part, so a component that moves linearly when the other is held
    moves without error. Narrow densities are shared between six nodes with their moments up to the
    fifth kept, hence there is no artificial diffusion, and densities may be slightly negative
    where they are small.

    Parameters
    ----------
    system : JumpDiffusion
        Of two components, without jumps, driven by noises that are not correlated with each
        other, and with a sensor that has a density. Its functions do not depend on time.
    axes : two of Axis or (low, high, count)
    substep : float
        Largest substep.

    Attributes
    ----------
    initial : ndarray or None
        None where the initial distribution is only sampled.

    Raises
    ------
    ValueError
        A system of another kind.
    """

    def __init__(
        self, system: JumpDiffusion, axes: Sequence[AxisLike], substep: float = 0.1
    ) -> None:
        if system.state_size != 2 or system.jump is not None:
            raise ValueError("system: wanted two state components and no jumps")
        axes = as_axes("axes", axes, 2)
        initial, missed = _diffusion_start(system, axes) if system.prior.gaussian else (None, 0.0)
        super().__init__(system, axes, initial, missed=missed)
        self.substep: float = float(substep)
        if np.abs(self._diffusion(system.nominal_values())[0, 1]).max() > 0:
            raise ValueError("system: wanted components driven by noises of their own")

    def _diffusion(self, p: Values) -> np.ndarray:
        """Covariance of the noise per unit of time at each state, (2, 2, S)."""
        root = self.system.diffusion(0.0, self.values, p)
        root = np.broadcast_to(root, (2, self.system.wiener_size, self.values.shape[1]))
        return np.einsum("iwN,jwN->ijN", root, root)

    def move(
        self, prob: np.ndarray, start: float, stop: float, p: Values | None = None
    ) -> np.ndarray:
        """Distributions (S, C) of the state at a later time, each a column."""
        steps, first, half = self._kernels(start, stop, p)
        whole = half @ half
        grid = prob.reshape(*(axis.count for axis in self.axes), -1)
        for k in range(steps):
            grid = (whole if k else half) @ grid
            grid = (first @ grid.swapaxes(0, 1)).swapaxes(0, 1)
        return np.maximum((half @ grid).reshape(prob.shape), 0.0)

    def back(
        self, values: np.ndarray, start: float, stop: float, p: Values | None = None
    ) -> np.ndarray:
        """Means of functions (q, S) of the later state, given the state at `start`: (q, S)."""
        steps, first, half = self._kernels(start, stop, p)
        first, half = first.swapaxes(1, 2), half.swapaxes(1, 2)
        grid = values.T.reshape(*(axis.count for axis in self.axes), -1)
        for _ in range(steps):  # the moves of a substep, in the same order, turned over
            grid = (first @ (half @ grid).swapaxes(0, 1)).swapaxes(0, 1)
            grid = half @ grid
        return grid.reshape(values.shape[1], -1).T

    def _kernels(
        self, start: float, stop: float, p: Values | None
    ) -> tuple[int, np.ndarray, np.ndarray]:
        """Substeps, and matrices of the first component (n2, n1, n1), half the second (n1, n2, n2).

        The other component numbers the matrices.
        """
        steps = step_count(start, stop, self.substep)
        length, p = float(lengths_alike((stop - start) / steps)), self.numbers(p)
        key = length, *p
        if key not in self._known:
            rows = zip(*(part.T for part in self._one(0, length, p)), strict=True)
            first = np.stack([shared(self.axes[0], *row) for row in rows])
            rows = zip(*self._one(1, 0.5 * length, p), strict=True)
            self._known[key] = first, np.stack([shared(self.axes[1], *row) for row in rows])
        return steps, *self._known[key]

    def _one(self, i: int, time: float, p: Values) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation (n1, n2) of component i after a time, the other one held."""
        x, shift = self.values, np.zeros((2, 1))
        shift[i] = SHIFT
        speed, up, down = (
            np.broadcast_to(self.system.drift(0.0, at, p)[i], x.shape[1:])
            for at in (x, x + shift, x - shift)
        )
        slope = (up - down) / (2.0 * SHIFT)
        mean = x[i] + speed * _grown(slope, time)
        deviation = np.sqrt(self._diffusion(p)[i, i] * _grown(2.0 * slope, time))
        shape = tuple(axis.count for axis in self.axes)
        return mean.reshape(shape), deviation.reshape(shape)


def generator(
    system: JumpDiffusion, axis: Axis, t: float = 0.0, p: Values | None = None
) -> np.ndarray:
    """Rates Q (S, S) of the chain, dp/dt = Q p: columns sum to zero, the rest is nonnegative.

    Diffusion and drift: conservative finite volumes around the nodes with the exponentially
    fitted flux of Scharfetter and Gummel, which keeps p positive for every step of the grid, and
    no flux through the ends. Jumps: the probability that x + s falls into each cell, the outer
    cells reaching to infinity. (4.8) of the jump-diffusion paper, with the loss term.

    Raises
    ------
    ValueError
        A negative intensity, jumps that are not affine in Gaussian marks.
    """
    p = system.values() if p is None else p
    nodes, h = axis.nodes, axis.step
    faces = 0.5 * (nodes[1:] + nodes[:-1])
    at_nodes, at_faces = (
        0.5 * np.einsum("jN,jN->N", *[system.diffusion(t, x[None], p)[0]] * 2)
        for x in (nodes, faces)
    )
    # the flux (a p) - (D p)' written as (a - D') p - D p'
    speed = system.drift(t, faces[None], p)[0] - np.diff(at_nodes) / h
    exchange = at_faces / h**2 * _bernoulli(np.abs(speed) * h, at_faces)
    up = np.maximum(speed, 0.0) / h + exchange
    down = np.maximum(-speed, 0.0) / h + exchange
    rates = np.diag(up, -1) + np.diag(down, 1)
    if system.jump is not None:
        intensity = np.asarray(system.intensity(t, nodes[None], p), dtype=float)
        if not (intensity >= 0).all() or not np.isfinite(intensity).all():
            raise ValueError(
                f"intensity: wanted finite nonnegative numbers, got {intensity.min():g}"
            )
        rates += _landing(system.jump, axis, t, p) * intensity
    np.fill_diagonal(rates, 0.0)
    np.fill_diagonal(rates, -rates.sum(axis=0))
    return rates


def mean_and_deviation(
    map: StochasticMap, t: float, x: np.ndarray, p: Values
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation (m, S) of what a map gives at states x (n, S)."""
    mean, cov = map.conditional_moments(float(t), x, p)
    shape = (map.size, x.shape[1])
    square = [np.broadcast_to(cov[i, i], shape[1:]) for i in range(map.size)]
    return np.broadcast_to(mean, shape), np.sqrt(square)


def require_few(system: AnySystem, most: int = 2) -> None:
    """Refuse a system of more state components than a grid can have."""
    if system.state_size > most:
        raise ValueError(
            f"system: wanted at most {most} state component{'s' * (most > 1)} for a grid, got "
            f"{system.state_size}; ParticleFilter and simulated_synthesis take more"
        )


def require_moved(name: str, cov: np.ndarray) -> None:
    """Refuse covariances (n, n, *batch) in which a direction has no variance."""
    if not (variances(cholesky(cov)) > 0).all():
        raise ValueError(
            f"{name}: wanted noise of its own in every state component for a grid, got none in "
            "some direction"
        )


def _bernoulli(product: np.ndarray, diffusion: np.ndarray) -> np.ndarray:
    """Bernoulli function q / (exp q - 1) of q = product / diffusion >= 0, zero without any."""
    with np.errstate(over="ignore"):
        q = np.divide(product, diffusion, out=np.full_like(product, 700.0), where=diffusion > 0)
    q = np.minimum(q, 700.0)
    return np.divide(q, np.expm1(q), out=np.ones_like(q), where=q > 1e-12)


def cell_masses(axis: Axis, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Normal probability (S, N) of each cell; a point goes to its two neighbours."""
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


def _landing(jump: StochasticMap, axis: Axis, t: float, p: Values) -> np.ndarray:
    """Probability of each cell (rows) after a jump from each node (columns)."""
    x = axis.nodes[None]
    if not jump.gaussian_density:
        raise ValueError("jump: wanted jumps affine in Gaussian marks for a grid, got others")
    mean, deviation = (part[0] for part in mean_and_deviation(jump, t, x, p))
    return cell_masses(axis, x[0] + mean, deviation)


def shared(axis: Axis, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Masses (nodes, N) of normal distributions: the density where it is wide, else kept moments.

    What one has beyond the ends of the axis stays in them.
    """
    nodes, size = axis.nodes, axis.count
    mean = np.clip(mean, axis.low, axis.high)
    masses = np.zeros((size, len(mean)))
    wide = deviation >= NARROW * axis.step
    masses[:, wide] = np.exp(-0.5 * ((nodes[:, None] - mean[wide]) / deviation[wide]) ** 2)
    masses[:, wide] /= masses[:, wide].sum(axis=0)
    mean, deviation = mean[~wide], deviation[~wide]
    first = np.floor((mean - axis.low) / axis.step).astype(int) - POINTS // 2 + 1
    first = np.clip(first, 0, size - POINTS)
    # three Gauss-Hermite points integrate a polynomial of the fifth degree
    place, weights = np.array([-np.sqrt(3.0), 0.0, np.sqrt(3.0)]), np.array([1.0, 4.0, 1.0]) / 6.0
    at = (mean + deviation * place[:, None] - axis.low) / axis.step - first
    columns = np.flatnonzero(~wide)
    for a in range(POINTS):
        others = [b for b in range(POINTS) if b != a]
        share = np.prod([(at - b) / (a - b) for b in others], axis=0)
        masses[first + a, columns] = weights @ share
    return masses


def _grown(rate: np.ndarray, time: float) -> np.ndarray:
    """Integral of exp(rate s) over a time."""
    product = rate * time
    safe = np.where(np.abs(product) > 1e-9, product, 1.0)
    return time * np.where(np.abs(product) > 1e-9, np.expm1(product) / safe, 1.0)
