"""The normal distribution function as a SymPy function whose code keeps the digits of its tail."""

from __future__ import annotations

from typing import Any

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
