"""The function sin(x) / x of models, with derivatives that keep their digits at and about zero.

SymPy's derivative of ``sinc`` is cos(x)/x - sin(x)/x², which has no value at zero and hardly a
digit near it, where a coordinated turn starts.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import sympy

TERMS = 14
"""Terms of the series within two of zero: the next one is below rounding."""


class SincRatio(sympy.Function):
    """j_k(x) / x**k of spherical Bessel functions: sinc for k = 0, and even in x.

    The derivative is -x times the next one, so none of them divides by x.
    """

    nargs = (2,)

    @classmethod
    def eval(cls, k: Any, x: Any) -> Any:
        """Numbers are evaluated."""
        return sympy.Float(float(sinc_ratio(int(k), float(x)))) if x.is_number else None

    def fdiff(self, argindex: int = 2) -> Any:
        """Derivative by x."""
        parts: Any = self.args
        return -parts[1] * SincRatio(parts[0] + 1, parts[1])

    def _eval_is_extended_real(self) -> Any:
        return self.args[1].is_extended_real

    def _numpycode(self, printer: Any) -> str:
        return f"sinc_ratio({', '.join(printer._print(part) for part in self.args)})"

    def _sympystr(self, printer: Any) -> str:
        k, x = (printer._print(part) for part in self.args)
        return f"sinc({x})" if k == "0" else f"sinc_ratio({k}, {x})"


def with_ratios(expression: Any) -> Any:
    """The same expression with `SincRatio` in the place of SymPy's sinc."""
    if not expression.has(sympy.sinc):
        return expression
    return expression.replace(sympy.sinc, lambda x: SincRatio(0, x))


def sinc_ratio(k: int, x: Any) -> Any:
    """Values of `SincRatio`: the power series within two of zero, the recurrence elsewhere."""
    near = x * x < 4.0
    square, series = np.select([near], [x * x], 0.0), 1.0
    for m in range(TERMS, 0, -1):
        series = 1.0 - series * square / (2 * m * (2 * (k + m) + 1))
    away = np.select([near], [2.0], x)
    before, ratio = np.cos(away), np.sin(away) / away
    for j in range(k):
        before, ratio = ratio, ((2 * j + 1) * ratio - before) / (away * away)
    return np.select([near], [series / math.prod(range(1, 2 * k + 2, 2))], ratio)
