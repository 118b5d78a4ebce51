"""SymPy functions for switching planes whose code keeps tails, known states and wide laws."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
import sympy as sp
from scipy.special import erfc

from seedslib.base.tables import AxesLike

_HEIGHT = 1.0 / np.sqrt(2.0 * np.pi)


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


def tilted_tail(exponent: Any, z: Any, boundary: Any, power: int) -> Any:
    """``exp(exponent) E max(z + e, 0)^power`` for a standard normal e; of power 0, ``Phi(z)``.

    The boundary is ``exponent - z^2 / 2`` with its digits. The exponential overflows and the
    probability is lost long before their product is: beyond z = -16 it is a series in 1/z^2.
    """
    beyond = z < -16.0
    near = isinstance(beyond, bool | np.bool_ | np.ndarray) and not np.any(beyond)
    far: Any = 0.0 if near else 1.0 * beyond
    scale = np.exp(exponent if near else (1.0 - far) * exponent + far * boundary)
    last, found = 0.0, scale * (0.5 * erfc(-(0.5**0.5) * z))
    for k in range(power):
        step = k * last if k else _HEIGHT * np.exp(boundary)
        last, found = found, z * found + step
    if near:
        return found
    deviations = np.maximum(-z, 16.0)
    r = 1.0 / (deviations * deviations)
    series: Any = 1.0
    for k in range(12 + 2 * power, 0, -1):
        series = 1.0 - (power + 2 * k) * (power + 2 * k - 1) / (2 * k) * r * series
    tail = _HEIGHT * factorial(power) * series / deviations ** (power + 1)
    return (1.0 - far) * found + far * scale * tail


class TiltedTail(sp.Function):
    """``exp(u) E max(z + e, 0)^k`` of u, z, the exponent ``u - z^2 / 2`` and a whole k.

    The third argument is taken at its word: it is the one that is not found by subtraction.
    """

    nargs = 4
    is_real = True

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivatives by the exponent and by z; the third argument is none of its own."""
        *law, power = self.args
        slope = power * TiltedTail(*law, power - 1) if power else _height(law[2])
        return (self, slope, sp.S.Zero)[argindex - 1]

    def _eval_rewrite_as_erf(self, exponent, z, boundary, power, **options):
        last, found = sp.S.Zero, sp.exp(exponent) * sp.erfc(-z / sp.sqrt(2)).rewrite(sp.erf) / 2
        for k in range(power):
            last, found = found, z * found + (k * last if k else _height(boundary))
        return found

    def _eval_evalf(self, prec):
        return self.rewrite(sp.erf).rewrite(sp.erfc)._eval_evalf(prec)

    def _numpycode(self, printer):
        return f"tilted_tail({', '.join(printer._print(part) for part in self.args)})"


def _height(exponent: Any) -> sp.Expr:
    return sp.exp(exponent) / sp.sqrt(2 * sp.pi)


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
