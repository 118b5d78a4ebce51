"""Result of a compromise, and criteria that are checked and counted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from seedslib.base.checks import as_real

SAME, BETTER = 1e-12, 1e-5  # of the range of a criterion
LARGEST = 1e300  # size of a value beyond which ranges overflow

Criteria = Sequence[Callable[..., Any]] | Callable[..., Any]


@dataclass(frozen=True, eq=False)
class Compromise:
    """Where the largest relative loss is least, and how far that can be trusted.

    Attributes
    ----------
    x : float, ndarray (d,) or object
        The compromise: a point of the segment or of the box, or one of the choices.
    index : int or None
        Position of `x` in the list of choices; None for a segment or a box.
    values, losses : ndarray (p,)
        Criteria at `x` and their relative losses.
    utopia, nadir : ndarray (p,)
        ``m`` and ``M`` of the payoff table.
    minimizers : ndarray (p,) or (p, d)
        Minimisers of each criterion (positions, for choices); ties are broken by the others.
    status : str
        ``"equal losses"``, ``"minimax"`` (losses not equal), ``"ideal point"`` (one point
        is best for all criteria), ``"no bracket"`` (the criteria jump over the root),
        ``"not converged"``.
    efficiency : str
        Of `x`: ``"full"`` (nothing seen improves one criterion and worsens none), ``"weak"``
        (something does, but nothing improves all), ``"unknown"`` (the check failed).
    balanced : float or None
        The paper's point of equal losses, which need not be `x`; for two criteria on a segment.
    balanced_efficiency : str
        The same as `efficiency` for `balanced`, or ``"none"`` if all criteria can be
        improved at once, or empty.
    unimodal : bool
        Whether the difference of the two losses was seen strictly monotone between
        the minimisers, with one change of sign; True where that is not asked.
    evaluations : int
        Different points (choices) at which the criteria were evaluated.
    inseparable : tuple of int
        Choices whose largest loss exceeds that of `x` by at most two standard errors, the
        scale of the losses being that of the choices kept; `x` is one of them. Empty without noise.
    sensitivity : tuple of int
        Choices that become the compromise if the minimiser of a criterion is withdrawn: how much
        the answer depends on the range that was offered.
    """

    x: Any
    index: Any
    values: np.ndarray
    losses: np.ndarray
    utopia: np.ndarray
    nadir: np.ndarray
    minimizers: np.ndarray
    status: str
    efficiency: str
    balanced: Any = None
    balanced_efficiency: str = ""
    unimodal: bool = True
    evaluations: int = 0
    inseparable: tuple[int, ...] = ()
    sensitivity: tuple[int, ...] = ()

    @property
    def worst(self) -> float:
        """Largest relative loss, a number between 0 and 1 where the losses are normalised."""
        return float(self.losses.max())


class Evaluated:
    """Criteria evaluated once at each point, checked, and counted."""

    def __init__(self, criteria: Criteria, probe: object) -> None:
        if not callable(criteria):
            if not isinstance(criteria, (list, tuple)):
                raise TypeError(f"criteria: wanted a list of callables, got {criteria!r}")
            if len(criteria) < 2:
                raise ValueError(f"criteria: wanted at least two, got {len(criteria)}")
            if not all(callable(c) for c in criteria):
                raise TypeError("criteria: wanted callables, one for each criterion")
        self.criteria: Criteria = criteria
        self.known: dict[Any, np.ndarray] = {}
        self.count: int = self._call(probe).size
        if self.count < 2:
            raise ValueError(f"criteria: wanted at least two, got {self.count}")
        self.repeat(probe)

    def repeat(self, x: object) -> None:
        """Refuse criteria that are not what they were at the same point: noise."""
        first, again = self(x), self._call(x)
        if (first != again).any():
            i = int(np.argmax(first != again))
            raise ValueError(
                f"criteria[{i}]: wanted the same value at the same point, got {first[i]:.6g} and "
                f"{again[i]:.6g} at {x}; use common random numbers, or a table in `choose`"
            )

    def seen(self) -> np.ndarray:
        """Values at all points so far, shape (n, p)."""
        return np.array(list(self.known.values()))

    def _call(self, x: object) -> np.ndarray:
        several = not callable(self.criteria)
        values = [c(x) for c in self.criteria] if several else self.criteria(x)
        try:
            return as_losses(values, ndim=1)
        except ValueError as error:
            raise ValueError(f"{error}, at x = {x}") from None

    def __call__(self, x: object) -> np.ndarray:
        key = x.tobytes() if isinstance(x, np.ndarray) else x
        if key not in self.known:
            values = self._call(x)
            if values.size != self.count:
                raise ValueError(
                    f"criteria: wanted {self.count} values as before, got {values.size} at x = {x}"
                )
            self.known[key] = values
        return self.known[key]


def as_losses(value: object, ndim: int | None = None) -> np.ndarray:
    """Real values whose differences are numbers too.

    Raises
    ------
    TypeError, ValueError
        As `as_real`; a value beyond 1e300.
    """
    values = as_real("criteria", value, ndim=ndim)
    if np.abs(values).max(initial=0.0) > LARGEST:
        raise ValueError(
            f"criteria: wanted values up to {LARGEST:g}, got {np.abs(values).max():.3g}"
        )
    return values


def efficiency(values: np.ndarray, known: np.ndarray, exact: bool = False) -> str:
    """Efficiency of a point ``(p,)`` against all points seen ``(n, p)``: full, weak or none.

    Unless `exact`, a criterion is not worse within 1e-12 of its range seen, and better from 1e-5
    of the range on: between the two lies what rounding can trade for another criterion.
    """
    unit = 0.0 if exact else np.ptp(known, axis=0)
    better = known < values - BETTER * unit
    dominating = better[(known <= values + SAME * unit).all(axis=1)]
    if dominating.all(axis=1).any():
        return "none"
    return "weak" if dominating.any() else "full"
