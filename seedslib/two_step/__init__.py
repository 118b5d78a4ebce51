"""Linear diffusions and the two-step estimator of a function of their state.

May import: base, gaussian, models, filters.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.two_step.estimator import TwoStepEstimator as TwoStepEstimator
    from seedslib.two_step.linear import LinearDiffusion as LinearDiffusion
    from seedslib.two_step.linear import kalman_bucy as kalman_bucy
    from seedslib.two_step.linear import kalman_bucy_gains as kalman_bucy_gains
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
