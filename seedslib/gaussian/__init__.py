"""Means of functions of a Gaussian vector.

Closed forms of E f(x) from symbols (`algebra`, `formulas`) to numbers (`means`,
`functions`, `forms`), exact mean-square errors of estimates of f (`errors`,
`hermite`), moments over intervals and polygons (`regions`, `polygons`) and `quadrature`. No system
and no time; what a filter does with a mean is decided elsewhere.

May import: base.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.gaussian import forms as forms
    from seedslib.gaussian.algebra import NoClosedForm as NoClosedForm
    from seedslib.gaussian.errors import mean_square_errors as mean_square_errors
    from seedslib.gaussian.errors import (
        posterior_variance_function as posterior_variance_function,
    )
    from seedslib.gaussian.formulas import expectation as expectation
    from seedslib.gaussian.functions import abs_errors as abs_errors
    from seedslib.gaussian.functions import abs_moments as abs_moments
    from seedslib.gaussian.functions import bivariate_normal_cdf as bivariate_normal_cdf
    from seedslib.gaussian.functions import elevation_moments as elevation_moments
    from seedslib.gaussian.functions import max_errors as max_errors
    from seedslib.gaussian.functions import max_moments as max_moments
    from seedslib.gaussian.functions import norm_errors as norm_errors
    from seedslib.gaussian.functions import norm_mean as norm_mean
    from seedslib.gaussian.functions import sine_errors as sine_errors
    from seedslib.gaussian.functions import sine_moments as sine_moments
    from seedslib.gaussian.hermite import hermite_expansion as hermite_expansion
    from seedslib.gaussian.means import FunctionClass as FunctionClass
    from seedslib.gaussian.means import classify as classify
    from seedslib.gaussian.means import expectation_function as expectation_function
    from seedslib.gaussian.polygons import pad_regions as pad_regions
    from seedslib.gaussian.polygons import polygon as polygon
    from seedslib.gaussian.quadrature import cubature as cubature
    from seedslib.gaussian.quadrature import fifth_degree as fifth_degree
    from seedslib.gaussian.quadrature import gauss_hermite as gauss_hermite
    from seedslib.gaussian.quadrature import mean_of as mean_of
    from seedslib.gaussian.quadrature import unscented as unscented
    from seedslib.gaussian.regions import RegionMoments as RegionMoments
    from seedslib.gaussian.regions import interval as interval
    from seedslib.gaussian.regions import lift as lift
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
