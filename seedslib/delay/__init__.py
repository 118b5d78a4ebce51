"""Discrete systems with delay, their optimal filter, and the filter as the paper prints it.

The optimal filter is `seedslib.filters.KalmanFilter` on ``DelaySystem.stacked()``; its gains come
without the stacked matrices from `optimal_gains`. For any gains the errors they leave are exact.

May import: base, models.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.delay.gains import OptimalGains as OptimalGains
    from seedslib.delay.gains import PrintedGains as PrintedGains
    from seedslib.delay.gains import StructureErrors as StructureErrors
    from seedslib.delay.gains import StructureGains as StructureGains
    from seedslib.delay.gains import apply_gains as apply_gains
    from seedslib.delay.gains import error_covariance as error_covariance
    from seedslib.delay.gains import greedy_gains as greedy_gains
    from seedslib.delay.gains import optimal_gains as optimal_gains
    from seedslib.delay.gains import printed_gains as printed_gains
    from seedslib.delay.gains import repaired_gains as repaired_gains
    from seedslib.delay.gains import separate_gains as separate_gains
    from seedslib.delay.system import DelaySystem as DelaySystem
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
