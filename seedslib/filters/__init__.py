"""Filters that need no design: covariance filters, particles, grids, known modes.

And what all filters share: estimates, mixtures, weights of modes. No synthesis, no tables, no
files.

May import: base, tape, models, linearization.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.filters.base import Estimates as Estimates
    from seedslib.filters.base import Filter as Filter
    from seedslib.filters.closed_loop import ClosedLoop as ClosedLoop
    from seedslib.filters.closed_loop import simulate_closed_loop as simulate_closed_loop
    from seedslib.filters.constraints import constrain as constrain
    from seedslib.filters.covariance import CovarianceFilter as CovarianceFilter
    from seedslib.filters.covariance import assumed_density as assumed_density
    from seedslib.filters.covariance import cubature_kalman as cubature_kalman
    from seedslib.filters.covariance import extended_kalman as extended_kalman
    from seedslib.filters.covariance import unscented_kalman as unscented_kalman
    from seedslib.filters.forecasting import forecast_measurements as forecast_measurements
    from seedslib.filters.grid_bayes import GridBayesFilter as GridBayesFilter
    from seedslib.filters.kalman import KalmanFilter as KalmanFilter
    from seedslib.filters.known_modes import KnownModeFilter as KnownModeFilter
    from seedslib.filters.particle import ParticleFilter as ParticleFilter
    from seedslib.filters.rao_blackwell import RaoBlackwellFilter as RaoBlackwellFilter
    from seedslib.filters.smoothing import smooth as smooth
    from seedslib.filters.square_root import SquareRootKalmanFilter as SquareRootKalmanFilter
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
