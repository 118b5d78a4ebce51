"""Quadratic polynomials as Gram matrices."""

from __future__ import annotations

import numpy as np
import sympy as sp


def quadratic_gram(square: sp.Poly) -> sp.Matrix:
    """Gram matrix G of ``square = [1; x]' G [1; x]``, shape (n + 1, n + 1)."""
    n = len(square.gens)
    gram = sp.zeros(n + 1, n + 1)
    for monomial, c in square.terms():
        axes = [i + 1 for i, k in enumerate(monomial) for _ in range(k)]
        i, j = (*axes, 0, 0)[:2]
        gram[i, j] += c / 2
        gram[j, i] += c / 2
    return gram


def is_semidefinite(gram: sp.Matrix) -> bool:
    """Whether a matrix of numbers has no eigenvalue below rounding."""
    if gram.free_symbols:
        return False
    values = np.linalg.eigvalsh(np.array(gram.evalf().tolist(), dtype=float))
    return bool(values[0] >= -1e-12 * max(values[-1], 0.0))
