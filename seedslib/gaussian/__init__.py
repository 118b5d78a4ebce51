"""Means of functions of a Gaussian vector: closed forms, recursions, regions, quadrature."""

from seedslib._lazy import lazy_names

# These functions share their modules' names. Bound here they win over the modules, which a lazy
# look-up could not promise: importing a submodule binds its name in the package.
from seedslib.gaussian.interval import interval
from seedslib.gaussian.lift import lift
from seedslib.gaussian.polygon import polygon

_HOMES = {
    "FunctionClass": ".symbolic",
    "NoClosedForm": ".symbolic",
    "classify": ".symbolic",
    "expectation": ".symbolic",
    "expectation_function": ".symbolic",
    "abs_errors": ".functions",
    "abs_moments": ".functions",
    "max_errors": ".functions",
    "max_moments": ".functions",
    "norm_errors": ".functions",
    "norm_mean": ".functions",
    "sine_errors": ".functions",
    "sine_moments": ".functions",
    "elevation_moments": ".elevation",
    "bivariate_normal_cdf": ".bivariate",
    "positive_part_product": ".bivariate",
    "approximate_errors": ".errors",
    "hermite_expansion": ".errors",
    "mean_square_errors": ".errors",
    "posterior_variance_function": ".errors",
    "cubature": ".quadrature",
    "fifth_degree": ".quadrature",
    "gauss_hermite": ".quadrature",
    "mean_of": ".quadrature",
    "unscented": ".quadrature",
    "RegionMoments": ".regions",
    "pad_regions": ".polygon",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES, "interval", "lift", "polygon"]
