"""Bayes filter of a system in discrete time on a grid: the exact posterior, for reference."""

from __future__ import annotations

import warnings
from typing import Any, ClassVar, NamedTuple

import numpy as np

from seedslib.base.arrays import Seed, align
from seedslib.base.checks import outside
from seedslib.base.clock import lengths_alike
from seedslib.base.tables import Axis, Grid, Nodes, as_grids
from seedslib.base.values import Values
from seedslib.filters.base import Estimates, Filter, Record, clean
from seedslib.filters.smoothing import Smoother
from seedslib.filters.weights import logarithm, most_probable, normalised, relative
from seedslib.models.chains import GridChain, grid_chain, require_few
from seedslib.models.kinds import AnySystem, as_system, switches

LARGEST = 20_000_000
"""Numbers, a node for each time, that may be in memory at once."""

FAINT = -460.0
"""Logarithm of a sum of weights, relative to the largest weight, that is formed again by itself."""


LOSS = 1e-6
"""Probability that leaves the nodes in a step, or that they are too coarse for, worth a warning."""


ENDS = 0.99
"""Probability of the outermost nodes from which on the state is not on the nodes."""


class GridState(NamedTuple):
    """Distribution of mode and state on the nodes, and the last estimate.

    ``log_prob`` (L, *batch) are logarithms of the probabilities of the modes, so that none
    vanishes however small it becomes, L = 1 where there are none; ``node_prob`` (L, S, *batch) are
    the probabilities of the nodes in each mode. ``mode_prob`` has shape (L, *batch), ``mean``
    (n, *batch), ``cov`` (n, n, *batch); ``diverged`` marks the records with a measurement that no
    node explains or that leaves only the outermost, ``interval`` is the length of the first step.
    """

    time: float | None
    log_prob: np.ndarray
    node_prob: np.ndarray
    mode_prob: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    diverged: np.ndarray
    interval: float | None = None


class GridBayesFilter(Filter):
    """Posterior distribution of mode and state on nodes.

    The absolutely optimal filter (the paper's AOF): (4.1) to (4.3) of the switching paper with
    the distribution of the object itself in place of that given a finite memory. It uses no
    random numbers, and its log-likelihood is deterministic.

    Of a `DiscreteSystem` what leaves the nodes is dropped: likelihoods are those of trajectories
    that stay on them, and a warning says when that is not all. On evenly spaced nodes with a step
    below the deviations of the noise they are exact to many digits. Of a switching system columns
    of the transition matrix are normalised, so what would leave the axis is spread over its nodes.

    Parameters
    ----------
    system : DiscreteSystem or SwitchingSystem
        With one state component, or two of a `DiscreteSystem`, whose next value and whose
        measurement have densities.
    x : Axis, (low, high, count) or Nodes; of two components two of them
        Nodes of the state; the range should hold all but a millionth of the probability. `Nodes`,
        which need not be evenly spaced, are for a `DiscreteSystem`.

    Raises
    ------
    TypeError, ValueError
        Another system, more state components, maps without a density, a component of the state
        that is moved without noise.

    Warns
    -----
    UserWarning
        More than a millionth of the probability leaves the nodes in a step, or they are too
        coarse for the noise.
    """

    takes: ClassVar[tuple[str, ...]] = ("indicators",)
    records: int = 512

    def __init__(self, system: AnySystem, x: Grid = (-8.0, 8.0, 161)) -> None:
        as_system("system", system, "DiscreteSystem", "SwitchingSystem")
        self.system: Any = system
        if switches(system):
            require_few(system, 1)
            axes: Any = [Axis.of("x", x)]
        else:
            require_few(system)
            axes = as_grids("x", x, system.state_size)
        self.chain: GridChain = grid_chain(system, axes)
        self.axes: tuple[Axis | Nodes, ...] = self.chain.axes
        self._modes: int = self.chain.modes
        self._count: int = self.chain.values.shape[1] // self._modes
        x = self.chain.values[: len(self.axes), : self._count]
        self._ends: np.ndarray = ((x == x.min(1)[:, None]) | (x == x.max(1)[:, None])).any(axis=0)

    def initial(self, batch: tuple[int, ...] = (), seed: Seed | None = None) -> GridState:
        """State before any measurement; see `Filter`."""
        shape = (self._modes, self._count)
        node_prob = align(self.chain.initial.reshape(shape), 2, len(batch))
        log_prob, node_prob = _split(np.broadcast_to(node_prob, (*shape, *batch)))
        self._warn_of_loss(self.chain.missed)
        parts = {"log_prob": log_prob, "node_prob": node_prob}
        return GridState(None, **parts, **self._estimate(**parts), **clean(batch))

    def propagate(self, state: GridState, t: float, p: Values) -> GridState:
        """The distribution one step of the system later."""
        shape, transition = state.node_prob.shape, self.chain.transition(state.time, t, p)
        weight, highest, _ = relative(state.log_prob, 0)
        joint = (weight[:, None] * state.node_prob).reshape(len(transition), -1)
        log_prob, node_prob = _split((transition @ joint).reshape(shape))
        faint = log_prob < FAINT
        log_prob += highest
        for l in np.flatnonzero(faint.any(axis=tuple(range(1, faint.ndim)))):
            mask = faint[l]
            log_prob[l, mask], node_prob[l][:, mask] = self._into_mode(
                l, transition, state.log_prob[:, mask], state.node_prob[:, :, mask]
            )
        with np.errstate(invalid="ignore"):  # nothing was left before
            self._warn_of_loss(self.chain.loss(state.time, t, p) @ joint / joint.sum(axis=0))
        parts = {"log_prob": log_prob, "node_prob": node_prob}
        return state._replace(**parts, **self._estimate(**parts))

    def _into_mode(
        self, l: int, transition: np.ndarray, log_prob: np.ndarray, node_prob: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logarithm of the probability of mode l, and the state in it, relative to itself."""
        modes, count = self._modes, self._count
        rows = transition[l * count : (l + 1) * count].reshape(count, modes, count)
        masses, parts = _split(np.stack([rows[:, i] @ node_prob[i] for i in range(modes)]))
        share, highest, empty = relative(log_prob + masses, 0)
        total, mixed = _split((share[:, None] * parts).sum(axis=0)[None])
        return np.where(empty, 0.0, highest) + total[0], mixed[0]

    def update(
        self, state: GridState, y: np.ndarray, p: Values, indicator: np.ndarray | None = None
    ) -> GridState:
        """Weight the distribution by the measurement; see `Filter.update`."""
        if indicator is not None:
            y = np.concatenate([indicator[None].astype(float), y])
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            score = self.chain.log_likelihood(state.time, y.reshape(len(y), -1), p).T
        score = np.where(np.isfinite(score), score, -np.inf).reshape(state.node_prob.shape)
        weight, highest, impossible = relative(np.moveaxis(score, 1, 0), 0)
        evidence, node_prob = _split(np.moveaxis(weight, 0, 1) * state.node_prob)
        each = np.where(impossible, -np.inf, highest + evidence) + state.log_prob
        log_prob, loglik = normalised(each, 0)
        unexplained = ~np.isfinite(loglik)
        if unexplained.any():
            loglik = np.where(unexplained, -np.inf, loglik)
            log_prob = np.where(unexplained, state.log_prob, log_prob)
        node_prob = np.where(
            (evidence == -np.inf)[:, None] | unexplained, state.node_prob, node_prob
        )
        diverged = state.diverged | unexplained
        if not np.isnan(y).all():
            diverged = diverged | self._at_ends(log_prob, node_prob)
        parts = {"log_prob": log_prob, "node_prob": node_prob}
        estimate = self._estimate(**parts)
        return state._replace(loglik=loglik, diverged=diverged, **parts, **estimate)

    def at_once(self, record: Record) -> Estimates | None:
        """See `Filter.at_once`: of a system without modes that does not change with time."""
        if switches(self.system) or type(self).update is not GridBayesFilter.update:
            return None
        chain, times, count = self.chain, record.times, len(record.times)
        steady = chain.steady and self.system.sensor.timeless and not record.inputs.values
        if not steady or count * self._count > LARGEST:
            return None
        p, y = self.values(), record.y.reshape(count, -1).T
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            score = chain.log_likelihood(times[0], y, p).T
        weight, highest, impossible = relative(np.where(np.isfinite(score), score, -np.inf), 0)
        if impossible.any():
            return None
        prob, before, total = chain.initial, np.empty((count, self._count)), np.empty(count)
        lengths, last, parts = lengths_alike(np.diff(times)), None, []
        for k in range(count):
            if k:
                if lengths[k - 1] != last:
                    last = lengths[k - 1]
                    given = times[k - 1], times[k], self.values(dt=times[k] - times[k - 1])
                    transition, loss = chain.transition(*given), chain.loss(*given)
                parts.append(loss @ prob)
                prob = transition @ prob
            before[k] = weight[:, k] * prob
            total[k] = before[k].sum()
            if not total[k] > 0:
                return None
            prob = before[k] = before[k] / total[k]
        self._warn_of_loss(max([chain.missed, *parts]))
        log_prob, node_prob = np.zeros((1, count)), before.T[None]
        measured = ~np.isnan(y).all(axis=0)
        diverged = (self._at_ends(log_prob, node_prob) & measured).any()
        found = self._estimate(log_prob, node_prob)
        mean, cov = found["mean"].T, np.moveaxis(found["cov"], -1, 0)
        return Estimates(mean, cov, None, highest + np.log(total), diverged)

    def _at_ends(self, log_prob: np.ndarray, node_prob: np.ndarray) -> np.ndarray:
        """Where nearly all that is left of the probability is on the outermost nodes, (*batch)."""
        prob = np.exp(log_prob)
        beyond = (prob * node_prob[:, self._ends].sum(axis=1)).sum(axis=0)
        return beyond > ENDS * prob.sum(axis=0)

    def smoother(self) -> GridSmoother:
        """Exact on the nodes; see `Filter.smoother`."""
        return GridSmoother(self)

    def estimate(self, joint: np.ndarray) -> dict[str, Any]:
        """Mode probabilities or None, mean and covariance of joint distributions (S, N)."""
        return self._estimate(*_split(joint.reshape(self._modes, self._count, -1)))

    def _warn_of_loss(self, lost: np.ndarray | float) -> None:
        """Warn of the probability that leaves the nodes in a step or is between them."""
        if np.max(lost) > LOSS:
            warnings.warn(
                f"x: more than {LOSS:g} of the probability leaves the nodes in a step, or they "
                "are too coarse for the noise; compare with a run on more of them",
                stacklevel=outside(),
            )

    def _estimate(self, log_prob: np.ndarray, node_prob: np.ndarray) -> dict[str, Any]:
        prob, x = np.exp(log_prob), self.chain.values[:, : self._count]
        if self.chain.loses:
            prob = prob / prob.sum(axis=0)
        marginal = np.einsum("l...,ls...->s...", prob, node_prob)
        # about a node, so that no digits are lost far from the origin
        origin = x[:, self._count // 2]
        offset = x - origin[:, None]
        shift = np.stack([np.tensordot(row, marginal, 1) for row in offset])
        centred = list(align(offset, 2, prob.ndim - 1) - shift[:, None])
        cov = [
            [((a**2 if a is b else a * b) * marginal).sum(axis=0) for b in centred] for a in centred
        ]
        mean, cov = shift + align(origin, 1, prob.ndim - 1), np.array(cov)
        return {"mode_prob": prob if switches(self.system) else None, "mean": mean, "cov": cov}


class GridSmoother(Smoother):
    """The exact step back on nodes, of mode and state together.

    p(x | later) = p(x) sum over x' of P(x' | x) p(x' | later) / p'(x'), with the forecast p' = P p:
    nothing is approximated but the nodes. The smoothed state is the joint distribution (S, N) of
    N records.
    """

    def forecast(self, state: Any, t: float, inputs: Any = None) -> tuple[Any, Any]:
        """See `Smoother.forecast`; the link is the transition."""
        later, _ = super().forecast(state, t, inputs)
        if state.time is None:
            return later, None
        p = self.filter.values(inputs, t - state.time)
        return later, self.filter.chain.transition(state.time, t, p)

    def last(self, state: Any) -> Any:
        """See `Smoother.last`."""
        joint = np.exp(state.log_prob)[:, None] * state.node_prob
        return joint.reshape(joint.shape[0] * joint.shape[1], -1)

    def back(self, state: Any, later: Any, link: Any) -> Any:
        """See `Smoother.back`."""
        now = self.last(state)
        predicted = link @ now
        ratio = np.divide(later, predicted, out=np.zeros_like(later), where=predicted > 0)
        return now * (link.T @ ratio)

    def report(self, smoothed: Any) -> Estimates:
        """Mean, covariance, and the modes with their probabilities, where there are modes."""
        estimate = self.filter.estimate(smoothed)
        prob = estimate["mode_prob"]
        return Estimates(**estimate, modes=None if prob is None else most_probable(prob))


def _split(joint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the masses (L, *batch) of the modes, and probabilities of the nodes in each.

    The latter are zero in a mode without mass.
    """
    mass = joint.sum(axis=1)
    node_prob = joint / np.where(mass > 0, mass, 1.0)[:, None]
    return logarithm(mass), node_prob
