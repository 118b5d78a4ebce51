"""Wing: linear diffusions and the two-step estimator of a function of their state.

With the Kalman-Bucy filter it stands on and the augmented extended Kalman filter it is compared
with. It uses the core; nothing uses it.

May import: base, gaussian, models, filters.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.two_step.augmented import AugmentedDiffusion as AugmentedDiffusion
    from seedslib.two_step.augmented_filter import (
        augmented_extended_kalman as augmented_extended_kalman,
    )
    from seedslib.two_step.estimator import TwoStepEstimator as TwoStepEstimator
    from seedslib.two_step.kalman_bucy import KalmanBucyFilter as KalmanBucyFilter
    from seedslib.two_step.linear import LinearDiffusion as LinearDiffusion
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
