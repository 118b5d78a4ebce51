"""Differences of exponentials as a SymPy function that keeps their digits where they are close."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp
from sympy.codegen.cfunctions import expm1


def exp_difference(first: Any, second: Any, gap: Any) -> Any:
    """``exp(first) - exp(second)`` where ``gap = first - second`` is known with its digits."""
    return np.sign(gap) * (np.exp(np.maximum(first, second)) * -np.expm1(-abs(gap)))


class ExpDifference(sp.Function):
    """``exp(u) - exp(v)`` of u, v and their difference u - v.

    The third argument is taken at its word: it is the one that is not found by subtraction.
    """

    nargs = 3
    is_real = True

    @classmethod
    def eval(cls, first: Any, second: Any, gap: Any) -> Any:
        """Nothing where the exponents are equal; numbers are evaluated; of a known sign shorter."""
        if gap.is_zero:
            return sp.S.Zero
        if first.is_number and second.is_number and gap.is_number:
            return sp.Float(float(exp_difference(float(first), float(second), float(gap))))
        if gap.is_nonnegative:
            return -sp.exp(first) * expm1(-gap)
        return sp.exp(second) * expm1(gap) if gap.is_nonpositive else None

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivatives: of the exponentials by their exponents, the gap is no argument of its own.

        The derivative of the gap is that of the exponents, which is counted once already.
        """
        first, second, _ = self.args
        return (sp.exp(first), -sp.exp(second), sp.S.Zero)[argindex - 1]

    def _numpycode(self, printer: Any) -> str:
        return f"exp_difference({', '.join(printer._print(part) for part in self.args)})"
