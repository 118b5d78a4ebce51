"""SymPy functions for half-spaces whose code keeps tails and the digits of known states."""

from __future__ import annotations

from typing import Any

import sympy as sp


class Coded(sp.Function):
    """A function with a `plain` form in SymPy's own, which stays as it is until it is printed."""

    is_real = True

    def _eval_rewrite_as_erf(self, *args: Any, **options: Any) -> Any:
        return self.plain(*args)

    def _eval_evalf(self, prec: int) -> Any:
        return self.plain(*self.args)._eval_evalf(prec)


class NormalCDF(Coded):
    """``Phi(z)``, the probability that a standard normal number is below z.

    SymPy rewrites ``erfc(-z)`` as ``2 - erfc(z)`` at will, which loses the tail.
    """

    nargs = 1

    @classmethod
    def eval(cls, z: Any) -> Any:
        """Value at zero; nothing else is evaluated by itself."""
        return sp.S.Half if z.is_zero else None

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivative: the normal density."""
        return sp.exp(-(self.args[0] ** 2) / 2) / sp.sqrt(2 * sp.pi)

    @staticmethod
    def plain(z: Any) -> Any:
        """In terms of the error function."""
        return (1 + sp.erf(z / sp.sqrt(2))) / 2

    def _eval_evalf(self, prec: int) -> Any:
        return (sp.erfc(-self.args[0] / sp.sqrt(2)) / 2)._eval_evalf(prec)

    def _numpycode(self, printer: Any) -> str:
        erfc = printer._module_format("scipy.special.erfc")
        argument = printer._print(sp.Float(-(0.5**0.5)) * self.args[0])
        return f"(0.5*{erfc}({argument}))"


class Divisor(Coded):
    """Variance of a switching function as what is divided by, in code also where it is zero.

    What is divided is a covariance with the same function, which is zero there as well.
    """

    nargs = 1
    is_positive = True

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivative: that of the variance."""
        return sp.S.One

    @staticmethod
    def plain(variance: Any) -> Any:
        """The variance itself."""
        return variance

    def _numpycode(self, printer: Any) -> str:
        return f"(abs({printer._print(self.args[0])}) + 1e-100)"


def difference(first: Any, second: Any, rest: Any) -> Any:
    """``first - second - rest``, or zero where it is only the rounding of the first two."""
    left = first - second - rest
    return left * (abs(left) > 2.0**-48 * (abs(first) + abs(second)))


class Difference(Coded):
    """``a - b - c``, where c is what is known of ``a - b`` without subtraction."""

    nargs = 3

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivatives of the difference."""
        return sp.S.One if argindex == 1 else sp.S.NegativeOne

    @staticmethod
    def plain(first: Any, second: Any, rest: Any) -> Any:
        """The difference itself."""
        return first - second - rest

    def _numpycode(self, printer: Any) -> str:
        return f"difference({', '.join(map(printer._print, self.args))})"
