"""Designed filters: their memories, their numbers, how they run, and their files.

The finite-order filter, the switching filter and the table filters. `design` makes them.

May import: base, tape, gaussian, models, linearization, filters.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.designed import lemmas as lemmas
    from seedslib.designed.between import FORECAST_KINDS as FORECAST_KINDS
    from seedslib.designed.cells import CellFit as CellFit
    from seedslib.designed.files import load as load
    from seedslib.designed.files import save as save
    from seedslib.designed.finite_order import FiniteOrderFilter as FiniteOrderFilter
    from seedslib.designed.memory import Memory as Memory
    from seedslib.designed.memory import Past as Past
    from seedslib.designed.memory import finite_memory as finite_memory
    from seedslib.designed.memory import large_order as large_order
    from seedslib.designed.memory import small_order as small_order
    from seedslib.designed.minimax import MinimaxFilter as MinimaxFilter
    from seedslib.designed.rules import SwitchingRules as SwitchingRules
    from seedslib.designed.switching import SwitchingFilter as SwitchingFilter
    from seedslib.designed.tables import TableFilter as TableFilter
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
