"""Bayes filter of a system in discrete time on a grid: the exact posterior law, for reference."""

from __future__ import annotations

import warnings
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.arrays import MaybeArray
from seedslib.base.checks import outside
from seedslib.base.tables import Axis, Grid, Nodes
from seedslib.filters.base import Estimates, Filter, as_seen
from seedslib.filters.smoothing import Smoother
from seedslib.filters.weights import logarithm, most_probable, normalised, relative
from seedslib.models.chains import DiscreteChain, SwitchingChain, require_scalar
from seedslib.models.kinds import AnySystem, as_system, switches

FAINT = -460.0
"""Logarithm of a sum of weights, relative to the largest weight, that is formed again by itself."""


LOST = 1e-6
"""Probability that leaves the nodes in a step, or that they are too coarse for, worth a warning."""


ENDS = 0.99
"""Probability of the outermost nodes from which on the state is not on the nodes."""


class GridState(NamedTuple):
    """Law of mode and state on the nodes, and the last estimate.

    ``log_prob`` (L, *batch) are logarithms of the probabilities of the modes, so that none is
    lost however small it becomes, L = 1 where there are none; ``law`` (L, S, *batch) is the law of
    the state in each mode. ``mode_prob`` has shape (L, *batch), ``mean`` (n, *batch), ``cov``
    (n, n, *batch); ``diverged`` marks the records with a measurement that no node explains
    or that leaves only the outermost, ``interval`` is the length of the first step.
    """

    time: float | None
    log_prob: np.ndarray
    law: np.ndarray
    mode_prob: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    loglik: np.ndarray
    diverged: np.ndarray
    interval: float | None = None


class GridBayesFilter(Filter):
    """Posterior law of mode and state on nodes.

    The absolutely optimal filter (the paper's AOF): (4.1) to (4.3) of the switching paper with
    the law of the object itself in place of its law given a finite memory. It uses no random
    numbers, and its log-likelihood is deterministic.

    Of a `DiscreteSystem` what leaves the nodes is dropped: likelihoods are those of paths that
    stay on them, and a warning says when that is not all. On evenly spaced nodes with a step
    below the deviations of the noise they are exact to many digits, see `accuracy`. Of a
    switching system columns of the transition matrix are normalised, so what would leave the axis
    is spread over its nodes.

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

    _shown = ("axes",)
    takes: ClassVar[tuple[str, ...]] = ("indicators",)
    records: int = 512

    def __init__(self, system: AnySystem, x: Grid = (-8.0, 8.0, 161)) -> None:
        as_system("system", system, "DiscreteSystem", "SwitchingSystem")
        self.system: Any = system
        if switches(system):
            require_scalar(system)
            self.chain: Any = SwitchingChain(system, Axis.of("x", x))
            self.axes: tuple[Axis | Nodes, ...] = (self.chain.axis,)
        else:
            self.chain = DiscreteChain(system, x)
            self.axes = self.chain.axes
        self._modes: int = self.chain.modes
        self._count: int = self.chain.values.shape[1] // self._modes
        x = self.chain.values[: len(self.axes), : self._count]
        self._ends: np.ndarray = ((x == x.min(1)[:, None]) | (x == x.max(1)[:, None])).any(axis=0)

    def initial(self, batch: tuple[int, ...] = (), seed: Any = None) -> GridState:
        """State before any measurement; see `Filter`."""
        shape = (self._modes, self._count)
        law = self.chain.start().reshape(*shape, *(1,) * len(batch))
        log_prob, law = _split(np.broadcast_to(law, (*shape, *batch)))
        self._look(log_prob, 0.0)
        none, clean = np.zeros(batch), np.zeros(batch, dtype=bool)
        return GridState(None, log_prob, law, *self._moments(log_prob, law), none, clean)

    def propagate(self, state: GridState, t: float) -> GridState:
        """The law one step of the system later."""
        shape, move = state.law.shape, self.chain.transition(state.time, t)
        weight, highest, _ = relative(state.log_prob, 0)
        joint = weight[:, None] * state.law
        log_prob, law = _split((move @ joint.reshape(len(move), -1)).reshape(shape))
        faint = log_prob < FAINT
        log_prob += highest
        for l in np.flatnonzero(faint.any(axis=tuple(range(1, faint.ndim)))):
            here = faint[l]
            log_prob[l, here], law[l][:, here] = self._alone(
                move, l, state.log_prob[:, here], state.law[:, :, here]
            )
        self._look(log_prob, state.log_prob)
        prob, mean, cov = self._moments(log_prob, law)
        return state._replace(log_prob=log_prob, law=law, mode_prob=prob, mean=mean, cov=cov)

    def _alone(self, move, l, log_prob, law):
        """Logarithm of the probability of the next mode l, and the law in it, formed by itself."""
        modes, count = self._modes, self._count
        rows = move[l * count : (l + 1) * count].reshape(count, modes, count)
        masses, parts = _split(np.stack([rows[:, i] @ law[i] for i in range(modes)]))
        share, highest, lost = relative(log_prob + masses, 0)
        total, mixed = _split((share[:, None] * parts).sum(axis=0)[None])
        return np.where(lost, 0.0, highest) + total[0], mixed[0]

    def correct(
        self, state: GridState, y: ArrayLike, indicator: ArrayLike | None = None
    ) -> GridState:
        """Weight the law by a measurement.

        Parameters
        ----------
        state : GridState
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
        seen = y if shown is None else np.concatenate([shown[None].astype(float), y])
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            score = self.chain.log_likelihood(state.time, seen.reshape(len(seen), -1)).T
        score = np.where(np.isfinite(score), score, -np.inf).reshape(state.law.shape)
        weight, highest, lost = relative(np.moveaxis(score, 1, 0), 0)
        weight = np.moveaxis(weight, 0, 1)
        weight *= state.law
        evidence, law = _split(weight)
        each = np.where(lost, -np.inf, highest + evidence) + state.log_prob
        log_prob, loglik = normalised(each, 0)
        lost = ~np.isfinite(loglik)
        if lost.any():
            loglik = np.where(lost, -np.inf, loglik)
            log_prob = np.where(lost, state.log_prob, log_prob)
        law = np.where((evidence == -np.inf)[:, None] | lost, state.law, law)
        if not np.isnan(seen).all():
            lost = lost | self._at_ends(log_prob, law)
        estimate, lost = self._moments(log_prob, law), state.diverged | lost
        return GridState(state.time, log_prob, law, *estimate, loglik, lost, state.interval)

    def _at_ends(self, log_prob, law):
        """Where nearly all that is left of the probability is on the outermost nodes, (*batch)."""
        prob = np.exp(log_prob)
        beyond = (prob * law[:, self._ends].sum(axis=1)).sum(axis=0)
        return beyond > ENDS * prob.sum(axis=0)

    def smoother(self) -> GridSmoother:
        """Exact on the nodes; see `Filter.smoother`."""
        return GridSmoother(self)

    def moments_of(self, joint: np.ndarray) -> tuple[Any, ...]:
        """Mode probabilities or None, mean and covariance of joint laws (S, N)."""
        return self._moments(*_split(joint.reshape(self._modes, self._count, -1)))

    def _look(self, log_prob, before):
        """Warn where a step changes the probability: by what leaves the nodes or is between."""
        if not self.chain.loses:
            return
        with np.errstate(invalid="ignore"):  # nothing was left before
            change = np.abs(np.expm1(log_prob - before))
        if (change > LOST).any():
            warnings.warn(
                f"x: more than {LOST:g} of the probability leaves the nodes in a step, and is "
                "dropped, or they are too coarse for the noise; compare with a run on more of them",
                stacklevel=outside(),
            )

    def _moments(self, log_prob, law):
        prob, x = np.exp(log_prob), self.chain.values[:, : self._count]
        if self.chain.loses:
            prob = prob / prob.sum(axis=0)
        marginal = np.einsum("l...,ls...->s...", prob, law)
        # about a node, so that no digits are lost far from the origin
        middle = x[:, self._count // 2]
        apart, batch = x - middle[:, None], law.shape[2:]
        shift = np.stack([np.tensordot(row, marginal, 1) for row in apart])
        centred = list(apart.reshape(*apart.shape, *(1,) * len(batch)) - shift[:, None])
        cov = [
            [((a**2 if a is b else a * b) * marginal).sum(axis=0) for b in centred] for a in centred
        ]
        mean = shift + middle.reshape(-1, *(1,) * len(batch))
        return prob if switches(self.system) else None, mean, np.array(cov)


class GridSmoother(Smoother):
    """The exact step back on nodes, of mode and state together.

    p(x | later) = p(x) sum over x' of P(x' | x) p(x' | later) / p'(x'), with the forecast p' = P p:
    nothing is approximated but the nodes. A part is the joint law (S, N) of N records.
    """

    def forecast(self, state: Any, t: float) -> tuple[Any, Any]:
        """See `Smoother.forecast`; the link is the transition."""
        before = state.time
        later, _ = super().forecast(state, t)
        return later, None if before is None else self.filter.chain.transition(before, t)

    def last(self, state: Any) -> Any:
        """See `Smoother.last`."""
        joint = np.exp(state.log_prob)[:, None] * state.law
        return joint.reshape(joint.shape[0] * joint.shape[1], -1)

    def back(self, state: Any, part: Any, link: Any, indicator: MaybeArray = None) -> Any:
        """See `Smoother.back`."""
        now = self.last(state)
        ahead = link @ now
        ratio = np.divide(part, ahead, out=np.zeros_like(part), where=ahead > 0)
        return now * (link.T @ ratio)

    def report(self, part: Any) -> Estimates:
        """Mean, covariance, and the modes with their probabilities, where there are modes."""
        prob, mean, cov = self.filter.moments_of(part)
        modes = None if prob is None else most_probable(prob)
        return Estimates(mean, cov, prob, modes=modes)


def _split(joint):
    """Logarithms of the masses of the modes (L, *batch), and the law in each, from (L, S, *batch).

    The law of a mode without mass is zero.
    """
    mass = joint.sum(axis=1)
    law = joint / np.where(mass > 0, mass, 1.0)[:, None]
    return logarithm(mass), law
