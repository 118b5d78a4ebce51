"""What several packages need and no subject owns.

Checks of arguments, batch axes, blocks and bundles of paths with their seeds, positive
semidefinite matrices (`linalg`), Gaussian moments given a measurement (`conditioning`), tables and
their look-up, parameters and inputs, how objects print and are pickled, and the lazy names of
these packages. No model, no filter.

May import: none.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.base.conditioning import update as update
    from seedslib.base.symbols import ELAPSED as ELAPSED
    from seedslib.base.symbols import Input as Input
    from seedslib.base.symbols import Parameter as Parameter
    from seedslib.base.tables import Axis as Axis
    from seedslib.base.tables import Nodes as Nodes
    from seedslib.base.tables import interpolate as interpolate
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
