"""A boundary value problem with rotated arguments that splits into scalar Riemann problems."""

from __future__ import annotations

from typing import Any

import numpy as np

from seedslib.riemann.fourier import circle
from seedslib.riemann.problem import FEWEST, as_complex, judge, solve_boundary_values

INVARIANT = 1e-10  # relative deviation of a coefficient from its rotation


def solve_rotations(
    coefficients: object, right: object, polynomials: object = None
) -> tuple[np.ndarray, np.ndarray, tuple[Any, ...]]:
    """Solve ``Phi+(t) = sum_j G_j(t) Phi-(w^j t) + g(t)``, w = exp(2 pi i / p), ``Phi-(oo) = 0``.

    Each of the p coefficients must be a function of ``s = t^p``. Then the powers of t that are
    congruent to r modulo p decouple, and ``Phi_r(t) = t^r phi_r(s)`` leaves p scalar problems on
    the circle of s, ``phi_r+ = H_r phi_r- + g_r`` with ``H_r = sum_j w^(j r) G_j``. For p = 3
    this is an example of a problem that reduces to three Riemann problems. It is an example of
    ours, not the theorem of the paper, whose text is lost.

    Parameters
    ----------
    coefficients : array_like (p, M)
        ``G_j`` on the nodes of `circle`; M is a multiple of p.
    right : array_like (M,)
    polynomials : sequence of p sequences, optional
        Free constants of each scalar problem.

    Returns
    -------
    plus, minus : complex ndarray (M,)
    problems : tuple of p RiemannSolution
        In the variable s, each with M / p nodes.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes, M not a multiple of p or too small, a coefficient that is not a function of
        ``t^p``, and all that `solve_riemann` raises.

    Warns
    -----
    UserWarning
        As `solve_riemann`.
    """
    g, free = as_complex("coefficients", coefficients), as_complex("right", right)
    if g.ndim != 2 or not g.size:
        raise ValueError(f"coefficients: wanted shape (p, M), got {g.shape}")
    count, nodes = g.shape
    if nodes % count or nodes < FEWEST * count:
        raise ValueError(f"coefficients: wanted M a multiple of p, at least 8 p, got {g.shape}")
    if free.shape != (nodes,):
        raise ValueError(f"right: wanted shape ({nodes},), got {free.shape}")
    if polynomials is not None and not isinstance(polynomials, (list, tuple, np.ndarray)):
        raise TypeError(f"polynomials: wanted a sequence of {count}, got {polynomials!r:.60}")
    if polynomials is not None and len(polynomials) != count:
        raise ValueError(f"polynomials: wanted {count} of them, got {len(polynomials)}")
    folded = nodes // count
    deviation = np.abs(g - np.roll(g, -folded, axis=1)).max(axis=1)
    if (deviation > INVARIANT * np.abs(g).max()).any():
        j = int(np.argmax(deviation))
        raise ValueError(
            f"coefficients: wanted functions of t^{count}, got a change of {deviation[j]:.3g} of "
            f"coefficient {j} under rotation"
        )
    t, turn = circle(nodes), circle(count)
    arcs = free.reshape(count, folded)  # values at t, w t, w^2 t, ... over one arc
    plus, minus, problems = np.zeros(nodes, complex), np.zeros(nodes, complex), []
    for r in range(count):
        weights = turn[np.arange(count) * r % count]
        part = t[:folded] ** -r * (weights.conj() @ arcs) / count
        solution = solve_boundary_values(
            weights @ g[:, :folded], part, None if polynomials is None else polynomials[r], "zero"
        )
        plus += t**r * np.tile(solution.plus, count)
        minus += t**r * np.tile(solution.minus, count)
        judge(solution)
        problems.append(solution)
    return plus, minus, tuple(problems)
