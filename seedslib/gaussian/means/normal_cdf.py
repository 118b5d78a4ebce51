"""SymPy functions for switching planes, whose code keeps the digits of a tail and a known state."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp

from seedslib.base.tables import AxesLike


class NormalCDF(sp.Function):
    """``Phi(z)``, the probability that a standard normal number is below z.

    SymPy rewrites ``erfc(-z)`` as ``2 - erfc(z)`` at will, which loses the tail; this function
    stays as it is until it is printed.
    """

    nargs = 1
    is_real = True

    @classmethod
    def eval(cls, z: AxesLike | None) -> Any:
        """Value at zero; nothing else is evaluated by itself."""
        return sp.S.Half if z.is_zero else None

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivative: the normal density."""
        return sp.exp(-(self.args[0] ** 2) / 2) / sp.sqrt(2 * sp.pi)

    def _eval_rewrite_as_erf(self, z, **options):
        return (1 + sp.erf(z / sp.sqrt(2))) / 2

    def _eval_evalf(self, prec):
        return (sp.erfc(-self.args[0] / sp.sqrt(2)) / 2)._eval_evalf(prec)

    def _numpycode(self, printer):
        erfc = printer._module_format("scipy.special.erfc")
        argument = printer._print(sp.Float(-(0.5**0.5)) * self.args[0])
        return f"(0.5*{erfc}({argument}))"


def spread(variance: Any, least: Any, square: Any) -> Any:
    """Variance, or where it is no larger than `least` what leaves the side of a plane certain.

    The mean of the switching function, whose square is given, is then a hundred deviations from
    the plane, or on it.
    """
    certain = np.minimum(1e-4 * square, 1e300) + (square <= least)
    return np.maximum(variance, (variance <= least) * certain)


class Spread(sp.Function):
    """Variance of a switching function by which one may divide where the state is known.

    The second argument is what counts as zero, the third the square of the mean of the function.
    Terms that have the covariance as a factor vanish where the variance does.
    """

    nargs = 3
    is_positive = True

    @classmethod
    def eval(cls, variance: Any, least: Any, square: Any) -> Any:
        """What is known to be positive is itself."""
        return variance if variance.is_positive else None

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivative: that of the variance."""
        return sp.S.One if argindex == 1 else sp.S.Zero

    def _eval_rewrite_as_erf(self, variance, least, square, **options):
        return variance

    def _eval_evalf(self, prec):
        return self.args[0]._eval_evalf(prec)

    def _numpycode(self, printer):
        return f"spread({', '.join(printer._print(part) for part in self.args)})"
