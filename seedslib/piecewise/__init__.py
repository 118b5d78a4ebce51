"""Wing: piecewise-linear systems and their filter.

Cells, branches, merging, and the falling body in `examples`. It uses the core; nothing uses it.

May import: base, gaussian, models, linearization, filters.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.piecewise import examples as examples
    from seedslib.piecewise.cells import line_cells as line_cells
    from seedslib.piecewise.filter import PiecewiseLinearFilter as PiecewiseLinearFilter
    from seedslib.piecewise.system import PiecewiseLinearSystem as PiecewiseLinearSystem
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
