"""What wants another package or another language: C, JavaScript, a cluster, a picture.

`to_c` and `to_js` write a filter as a C header and as a JavaScript module, `compiled` runs that C
behind the filter's own verbs, `learn` wants scikit-learn, `cluster` wants Dask, and
`plot_estimates` wants matplotlib. Nothing uses this room.

May import: base, models, linearization, filters, designed, design, evaluation.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.extra.c.header import to_c as to_c
    from seedslib.extra.compilation import CompiledFilter as CompiledFilter
    from seedslib.extra.compilation import compiled as compiled
    from seedslib.extra.dask_crew import cluster as cluster
    from seedslib.extra.js.module import to_js as to_js
    from seedslib.extra.learned import learn as learn
    from seedslib.extra.plots import plot_estimates as plot_estimates
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
