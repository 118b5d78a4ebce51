"""Wing: discrete systems with delay and their Kalman filters.

Four recursions of the optimal filter, the filter as printed, stationary and truncated gains, and
the examples. It uses the core and `riemann`; nothing uses it.

May import: base, models, filters, riemann.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.delay import examples as examples
    from seedslib.delay.analysis import apply_gains as apply_gains
    from seedslib.delay.analysis import error_covariance as error_covariance
    from seedslib.delay.analysis import greedy_gains as greedy_gains
    from seedslib.delay.analysis import separate_gains as separate_gains
    from seedslib.delay.filter import RECURSIONS as RECURSIONS
    from seedslib.delay.filter import DelayKalmanFilter as DelayKalmanFilter
    from seedslib.delay.printed import PrintedDelayFilter as PrintedDelayFilter
    from seedslib.delay.stationary import stationary_gains as stationary_gains
    from seedslib.delay.structure import StructureGains as StructureGains
    from seedslib.delay.system import DelaySystem as DelaySystem
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
