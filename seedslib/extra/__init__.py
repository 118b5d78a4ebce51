"""What wants another package: a cluster, learned functions, a picture.

`learn` wants scikit-learn, `cluster` wants Dask, and `plot_estimates` wants matplotlib. Nothing
uses this package.

May import: base, models, linearization, filters, designed, design, evaluation.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.extra.dask_crew import cluster as cluster
    from seedslib.extra.learned import learn as learn
    from seedslib.extra.plots import plot_estimates as plot_estimates
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
