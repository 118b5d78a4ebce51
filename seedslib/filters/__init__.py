"""Filters: a system, what is remembered, and how means are taken."""

from seedslib._lazy import lazy_names

_HOMES = {
    "Estimates": ".estimates",
    "KalmanBucyFilter": ".kalman_bucy",
    "TwoStepEstimator": ".two_step",
    "augmented_extended_kalman": ".augmented",
    "DelayKalmanFilter": ".delay",
    "PrintedDelayFilter": ".delay_printed",
    "StructureGains": ".delay_analysis",
    "apply_gains": ".delay_analysis",
    "error_covariance": ".delay_analysis",
    "greedy_gains": ".delay_analysis",
    "stationary_gains": ".delay_stationary",
    "CovarianceFilter": ".covariance",
    "extended_kalman": ".covariance",
    "assumed_density": ".covariance",
    "unscented_kalman": ".covariance",
    "cubature_kalman": ".covariance",
    "FiniteOrderFilter": ".finite_order",
    "SwitchingFilter": ".switching",
    "TableFilter": ".table",
    "SwitchingTableFilter": ".switching_table",
    "ParticleFilter": ".particle",
    "RaoBlackwellFilter": ".rao_blackwell",
    "GridBayesFilter": ".grid_bayes",
    "KnownModeFilter": ".known_modes",
    "PiecewiseLinearFilter": ".piecewise",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
