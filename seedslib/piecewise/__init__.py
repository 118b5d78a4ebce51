"""Piecewise-linear systems and their filter.

It uses the core; of the library only the falling body of the `zoo` uses it.

May import: base, gaussian, models, linearization, filters.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.piecewise.cells import line_cells as line_cells
    from seedslib.piecewise.filter import PiecewiseLinearFilter as PiecewiseLinearFilter
    from seedslib.piecewise.system import PiecewiseLinearSystem as PiecewiseLinearSystem
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
