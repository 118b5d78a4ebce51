"""The scalar Riemann problem on the unit circle, for any index."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from seedslib.base.checks import as_count
from seedslib.riemann.fourier import UnresolvedError, circle, fourier, split, tail, winding

FEWEST, MOST = 8, 2**20  # nodes
WIDEST = 700.0  # largest logarithm whose exponential is a number
TAIL = 1e-10  # relative size of the last Fourier coefficients beyond which M is too small
SOLVABLE = 1e-9  # relative size of a coefficient that counts as zero in a condition
LOST = 1e-8  # relative residual, or wrong side, of resolved data that rounding cannot excuse


@dataclass(frozen=True, eq=False)
class RiemannSolution:
    """Boundary values of a solution and what is known of its existence.

    Attributes
    ----------
    plus, minus : complex ndarray (M, ...)
        Phi+ and Phi- on the nodes; ``plus = G minus + g`` there in every case.
    index : int
        Winding number kappa of G.
    constants : int
        Number of free constants, the coefficients of P.
    conditions : complex ndarray (number, ...)
        Moments of ``g / X+`` that must vanish; empty for kappa >= 0.
    solvable : bool
        Whether they do, for every right side. If not, a `minus` has a pole at infinity.
    defect : float
        Largest Fourier coefficient of `plus` and `minus` on the wrong side, relative to the
        largest value on the circle; for an unsolvable problem the size of that pole.
    residual : float
        Largest ``|plus - G minus - g|``, relative to the largest term of the same right side.
    tail : float
        Relative size of the last Fourier coefficients that were used: the resolution.
    """

    plus: np.ndarray
    minus: np.ndarray
    index: int
    constants: int
    conditions: np.ndarray
    solvable: bool
    defect: float
    residual: float
    tail: float

    def inside(self, z: object) -> np.ndarray:
        """Phi+ at points ``|z| < 1`` of shape ``(k,)``, as ``(k, ...)``.

        Raises
        ------
        ValueError
            The problem is not solvable, or a point is not inside.
        """
        return self._off_circle(z, inside=True)

    def outside(self, z: object) -> np.ndarray:
        """Phi- at points ``|z| > 1`` of shape ``(k,)``, as ``(k, ...)``; errors as `inside`."""
        return self._off_circle(z, inside=False)

    def _off_circle(self, z: object, inside: bool) -> np.ndarray:
        points = as_complex("z", np.atleast_1d(z))
        if not self.solvable:
            raise ValueError(
                "solution: wanted a solvable problem, got conditions of size "
                f"{np.abs(self.conditions).max():.3g} that do not vanish"
            )
        if points.ndim != 1 or not (abs(points) < 1 if inside else abs(points) > 1).all():
            raise ValueError(f"z: wanted points {'inside' if inside else 'outside'} the circle")
        nodes = len(self.plus)
        if inside:
            coefficients = fourier(self.plus)[: nodes // 2]
            powers = points[:, None] ** np.arange(nodes // 2)
        else:
            coefficients = np.roll(fourier(self.minus)[::-1], 1, axis=0)[: nodes // 2]
            powers = (1.0 / points[:, None]) ** np.arange(nodes // 2)
        return np.tensordot(powers, coefficients, axes=1)


def solve_riemann(
    coefficient: object,
    right: object,
    polynomial: object = None,
    *,
    at_infinity: str = "zero",
    nodes: int | None = None,
) -> RiemannSolution:
    """Solve ``Phi+ = G Phi- + g`` on the unit circle for any index of G.

    ===========  ==============================  ===================================
    index        Phi- zero at infinity           Phi- finite at infinity
    ===========  ==============================  ===================================
    kappa >= 0   kappa free constants            kappa + 1 free constants
    kappa < 0    -kappa conditions               -kappa - 1 conditions
    ===========  ==============================  ===================================

    Parameters
    ----------
    coefficient, right : array_like (M,) and (M, ...), or callables
        G and g on the nodes of `circle`, several right sides at once along further axes; or
        functions of an array of nodes, sampled until they are resolved.
    polynomial : array_like (constants,) or (constants, ...), optional
        Coefficients of P, the constant first; zero by default.
    at_infinity : {"zero", "finite"}
        What is asked of Phi- at infinity.
    nodes : int, optional
        Number of nodes for callables; by default 64, doubled until the last Fourier coefficients
        are 1e-14 of the largest or stop falling and the index no longer changes, up to 2**20.

    Returns
    -------
    RiemannSolution
        Also where the conditions fail: see `RiemannSolution.solvable`.

    Raises
    ------
    TypeError, ValueError
        Fewer than 8 nodes, wrong shapes, values that are not finite, a zero of G on the circle, an
        index that the nodes leave uncertain, a wrong number of constants, a G whose canonical
        functions range so far that the digits are lost.

    Warns
    -----
    UserWarning
        The last Fourier coefficients exceed 1e-10 of the largest: too few nodes, or data that are
        not analytic near the circle.
    """
    if at_infinity not in ("zero", "finite"):
        raise ValueError(f"at_infinity: wanted 'zero' or 'finite', got {at_infinity!r}")
    if callable(coefficient) != callable(right):
        raise TypeError("right: wanted a callable exactly if coefficient is one")
    if callable(coefficient):
        solution = _sampled(coefficient, right, polynomial, at_infinity, nodes)
    elif nodes is not None:
        raise ValueError("nodes: wanted for callables only, got it beside arrays")
    else:
        solution = solve_boundary_values(coefficient, right, polynomial, at_infinity)
    judge(solution)
    return solution


def judge(solution: RiemannSolution, depth: int = 3) -> None:
    """Refuse a solution whose digits are lost, and warn of one with too few nodes."""
    lost = max(solution.residual, solution.defect if solution.solvable else 0.0)
    if solution.tail <= TAIL and lost > LOST:
        raise ValueError(
            "coefficient: wanted canonical functions of moderate range, got a relative residual "
            f"of {lost:.2g}: rounding has taken the digits"
        )
    if solution.tail > TAIL:
        warnings.warn(
            f"riemann: the last Fourier coefficients are {solution.tail:.2g} of the largest with "
            f"{len(solution.plus)} nodes; take more nodes",
            stacklevel=depth,
        )


def as_complex(name: str, value: object) -> np.ndarray:
    try:
        array = np.asarray(value)
        array = array.astype(complex) if array.dtype.kind in "fiubc" else None
    except ValueError:
        array = None
    if array is None or array.ndim == 0:
        raise TypeError(f"{name}: wanted an array of numbers or a callable, got {value!r:.60}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: wanted finite numbers, got one that is not")
    return array


def _sampled(
    coefficient: Callable, right: Callable, polynomial: object, at_infinity: str, nodes: int | None
) -> RiemannSolution:
    count, before = (64 if nodes is None else as_count("nodes", nodes, FEWEST)), np.inf
    while True:
        t = circle(count)
        try:
            solution = solve_boundary_values(coefficient(t), right(t), polynomial, at_infinity)
            # too few nodes can see a smooth phase of the wrong number of turns
            turns = winding(as_complex("coefficient", coefficient(circle(2 * count + 1))))
            if turns != solution.index:
                raise UnresolvedError(
                    f"coefficient: wanted nodes that count its turns, got index {solution.index} "
                    f"with {count} nodes and {turns} with {2 * count + 1}"
                )
        except UnresolvedError:
            if nodes is not None or count >= MOST:
                raise
        else:
            done = solution.tail <= 1e-14 or (before <= TAIL and solution.tail > 0.1 * before)
            if nodes is not None or done or count >= MOST:
                return solution
            before = solution.tail
        count *= 2


def solve_boundary_values(
    coefficient: object, right: object, polynomial: object, at_infinity: str
) -> RiemannSolution:
    """`solve_riemann` for arrays, without the warning."""
    values, free = as_complex("coefficient", coefficient), as_complex("right", right)
    nodes = len(values)
    if values.ndim != 1 or nodes < FEWEST:
        raise ValueError(f"coefficient: wanted shape (M,), M >= 8, got {values.shape}")
    if len(free) != nodes or not free.size:
        raise ValueError(f"right: wanted {nodes} nodes along the first axis, got {free.shape}")
    index, t = winding(values), circle(nodes)
    column = (slice(None),) + (None,) * (free.ndim - 1)

    shift = t[-index * np.arange(nodes) % nodes]  # t^-index, exactly
    phase, angle = np.unwrap(np.angle(values)), np.angle(shift * values)
    turns = phase - index * 2 * np.pi * np.arange(nodes) / nodes - angle
    turns = np.round(turns / (2 * np.pi))  # the logarithm is continuous, not the principal one
    logarithm = fourier(np.log(np.abs(values)) + 1j * (angle + 2 * np.pi * turns))
    inner, outer = split(logarithm)
    if max(np.abs(inner.real).max(), np.abs(outer.real).max()) > WIDEST:
        raise ValueError(
            f"coefficient: wanted a logarithm with projections below {WIDEST:g}, got "
            f"{max(np.abs(inner.real).max(), np.abs(outer.real).max()):.3g}"
        )
    x_plus, x_minus = np.exp(inner)[column], (shift * np.exp(outer))[column]

    moments = fourier(free / x_plus)
    psi_plus, psi_minus = split(moments)
    finite = at_infinity == "finite"
    constants, missing = max(index + finite, 0), max(-index - finite, 0)
    p = _polynomial(polynomial, constants, free.shape[1:], t)
    plus, minus = x_plus * (psi_plus + p), x_minus * (psi_minus + p)
    conditions = moments[nodes - missing :][::-1]

    # a function that is zero but for rounding is measured by what the other one amounts to
    product = values[column] * minus
    wrong = max(
        _relative(fourier(plus)[(nodes + 1) // 2 :], plus, product),
        _relative(fourier(minus)[int(finite) : (nodes + 1) // 2], minus, plus / values[column]),
    )
    return RiemannSolution(
        plus, minus, index, constants, conditions,
        solvable=bool(
            (np.abs(conditions) <= SOLVABLE * np.abs(moments).max(axis=0, keepdims=True)).all()
        ),
        defect=wrong,
        residual=_relative(plus - product - free, plus, free),
        tail=max(tail(logarithm, 1.0), tail(moments)),
    )  # fmt: skip


def _relative(error: np.ndarray, *terms: np.ndarray) -> float:
    """Largest error, relative to the largest of the terms of the same right side."""
    scale = np.max([np.abs(term).max(axis=0) for term in terms], axis=0)
    return float((np.abs(error).max(axis=0) / np.where(scale > 0, scale, 1.0)).max())


def _polynomial(
    polynomial: object, constants: int, shape: tuple[int, ...], t: np.ndarray
) -> np.ndarray:
    if polynomial is None:
        return np.zeros((len(t), *shape))
    p = np.zeros((0,)) if np.size(polynomial) == 0 else as_complex("polynomial", polynomial)
    if len(p) != constants or p.shape[1:] not in ((), shape):
        raise ValueError(
            f"polynomial: wanted {constants} free constants along the first axis, got {p.shape}"
        )
    p = np.broadcast_to(p.reshape(p.shape + (1,) * (1 + len(shape) - p.ndim)), (constants, *shape))
    return np.tensordot(t[:, None] ** np.arange(constants), p, axes=1)
