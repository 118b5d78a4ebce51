"""Bayes filter of a scalar switching system on a grid: the exact posterior law, for reference."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.tables import Axis, AxisLike
from seedslib.filters.estimates import as_seen
from seedslib.filters.verbs import Filter
from seedslib.filters.weights import logarithm, normalised, relative
from seedslib.models.chains.switching import SwitchingChain
from seedslib.models.kinds import AnySystem, as_system

FAINT = -460.0
"""Logarithm of a sum of weights, relative to the largest weight, that is formed again by itself."""


class GridState(NamedTuple):
    """Law of mode and state on the nodes, and the last estimate.

    ``log_prob`` (L, *batch) are logarithms of the probabilities of the modes, so that none is
    lost however small it becomes; ``law`` (L, S, *batch) is the law of the state in each mode.
    ``mode_prob`` has shape (L, *batch), ``mean`` (1, *batch), ``cov`` (1, 1, *batch);
    ``diverged`` marks the records with a measurement that no node explains, ``interval`` is the
    length of the first step.
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
    """Posterior law of mode and state on evenly spaced nodes.

    The absolutely optimal filter (the paper's AOF) of a system with one state component:
    (4.1) to (4.3) of the switching paper with the law of the object itself in place of its law
    given a finite memory. It uses no random numbers. Columns of the transition matrix are
    normalised, so what would leave the axis is spread over its nodes.

    Parameters
    ----------
    system : SwitchingSystem
        With one state component, whose next value and whose measurement have densities.
    x : Axis or (low, high, count)
        Nodes of the state; the range should hold all but a millionth of the probability.

    Raises
    ------
    TypeError, ValueError
        No switching system, more state components, branches without a density.
    """

    _shown = ("axis",)
    takes: ClassVar[tuple[str, ...]] = ("indicators",)
    records: int = 512

    def __init__(self, system: AnySystem, x: AxisLike = (-8.0, 8.0, 161)) -> None:
        as_system("system", system, "SwitchingSystem")
        self.system: Any = system
        self.axis: Axis = Axis.of("x", x)
        self._chain = SwitchingChain(system, self.axis)

    def initial(self, batch: tuple[int, ...] = (), seed: Any = None) -> GridState:
        """State before any measurement; see `Filter`."""
        shape = (self.system.modes, self.axis.count)
        law = self._chain.start().reshape(*shape, *(1,) * len(batch))
        log_prob, law = _split(np.broadcast_to(law, (*shape, *batch)))
        return GridState(
            None, log_prob, law, *self._moments(log_prob, law), np.zeros(batch),
            np.zeros(batch, dtype=bool),
        )  # fmt: skip

    def moved(self, state: GridState, t: float) -> GridState:
        """The law one step of the system later."""
        shape, move = state.law.shape, self._chain.transition(state.time, t)
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
        prob, mean, cov = self._moments(log_prob, law)
        return state._replace(log_prob=log_prob, law=law, mode_prob=prob, mean=mean, cov=cov)

    def _alone(self, move, l, log_prob, law):
        """Logarithm of the probability of the next mode l, and the law in it, formed by itself."""
        modes, count = self.system.modes, self.axis.count
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
            score = self._chain.log_likelihood(state.time, seen.reshape(len(seen), -1)).T
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
        return GridState(
            state.time, log_prob, law, *self._moments(log_prob, law), loglik,
            state.diverged | lost, state.interval,
        )  # fmt: skip

    def _moments(self, log_prob, law):
        prob, x = np.exp(log_prob), self.axis.nodes
        marginal = np.einsum("l...,ls...->s...", prob, law)
        # about a node, so that no digits are lost far from the origin
        apart = x - x[len(x) // 2]
        shift = np.tensordot(apart, marginal, 1)
        centred = apart.reshape(-1, *(1,) * shift.ndim) - shift
        return prob, (shift + x[len(x) // 2])[None], (centred**2 * marginal).sum(axis=0)[None, None]


def _split(joint):
    """Logarithms of the masses of the modes (L, *batch), and the law in each, from (L, S, *batch).

    The law of a mode without mass is zero.
    """
    mass = joint.sum(axis=1)
    law = joint / np.where(mass > 0, mass, 1.0)[:, None]
    return logarithm(mass), law
