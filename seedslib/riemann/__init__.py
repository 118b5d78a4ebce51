"""Scalar Riemann problem on the unit circle, and the causal Wiener filter as one of its cases.

Given G without zeros and g on the circle, find functions analytic inside and outside with
``Phi+ = G Phi- + g``. With the index kappa of G and the canonical functions
``X+ = exp(Gamma+)``, ``X- = t^-kappa exp(Gamma-)``, ``G = X+/X-``, the solution is
``Phi+- = X+- (Psi+- + P)``, where ``g / X+ = Psi+ - Psi-`` and P is a polynomial that is free up
to its degree. All projections are fast Fourier transforms, so for data analytic near the circle
the error falls geometrically with the number of nodes ``t_j = exp(2 pi i j / M)``.

Arrays have the nodes along their first axis.
"""

from seedslib._lazy import lazy_names

_HOMES = {
    "RiemannSolution": ".problem",
    "solve_riemann": ".problem",
    "solve_rotations": ".rotations",
    "circle": "._fourier",
    "winding": "._fourier",
    "WienerGain": ".wiener",
    "wiener_gain": ".wiener",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
