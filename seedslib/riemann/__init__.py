"""Wing: the scalar Riemann problem on the unit circle, and the causal Wiener filter.

Given G without zeros and g on the circle, find functions analytic inside and outside with
``Phi+ = G Phi- + g``. With the index kappa of G and the canonical functions
``X+ = exp(Gamma+)``, ``X- = t^-kappa exp(Gamma-)``, ``G = X+/X-``, the solution is
``Phi+- = X+- (Psi+- + P)``, where ``g / X+ = Psi+ - Psi-`` and P is a polynomial that is free up
to its degree. All projections are fast Fourier transforms, so for data analytic near the circle
the error falls geometrically with the number of nodes ``t_j = exp(2 pi i j / M)``.

Arrays have the nodes along their first axis.

No filter and no model; of the wings only `delay` uses this one.

May import: base.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.riemann.fourier import circle as circle
    from seedslib.riemann.fourier import winding as winding
    from seedslib.riemann.problem import RiemannSolution as RiemannSolution
    from seedslib.riemann.problem import solve_riemann as solve_riemann
    from seedslib.riemann.rotations import solve_rotations as solve_rotations
    from seedslib.riemann.wiener import WienerGain as WienerGain
    from seedslib.riemann.wiener import wiener_gain as wiener_gain
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
