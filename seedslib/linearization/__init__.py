"""Conditional moments: what a map y = g(t, x, v) does to a Gaussian state.

A linearization turns such a map and N(m, D) into the mean of y, its covariance with x, and its
covariance; every filter that takes means uses nothing else. A new one writes `moments`, from which
continuous-time flows follow, and `row` where it is for systems that switch. No filter, no
correction.

May import: base, tape, gaussian, models.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.linearization.formulas import Formulas as Formulas
    from seedslib.linearization.moments import Gaussian as Gaussian
    from seedslib.linearization.moments import Linearization as Linearization
    from seedslib.linearization.moments import Matrices as Matrices
    from seedslib.linearization.moments import Moments as Moments
    from seedslib.linearization.moments import Weighted as Weighted
    from seedslib.linearization.points import Cubature as Cubature
    from seedslib.linearization.points import GaussHermite as GaussHermite
    from seedslib.linearization.points import PointRule as PointRule
    from seedslib.linearization.points import Unscented as Unscented
    from seedslib.linearization.taylor_and_exact import ExactGaussian as ExactGaussian
    from seedslib.linearization.taylor_and_exact import Taylor as Taylor
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
