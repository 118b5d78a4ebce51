"""Wing: compromise between criteria, by equal or by least largest relative loss.

Of the paper on two-criteria optimisation by bisection only the end survives, with equations
(18), (19) and the proof that a point of equal losses exists; `bisect` is its method. `compromise`
is the robust form of it on a segment or in a box, `choose` the form for a list of choices (the
order of a filter, the number of innovations it keeps), where error is weighed against cost.

All criteria are losses: less is better. With the minimisers ``x_i`` the utopia is
``m_i = I_i(x_i)``, the nadir of the payoff table ``M_i = max_j I_i(x_j)``, and the relative loss
``(I_i(x) - m_i) / (M_i - m_i)``. From three criteria on, the nadir of the payoff table can differ
from the nadir of the efficient set, and equal losses of all criteria need not exist.

No filter and no model: criteria are plain functions.

May import: base.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.pareto.bisection import Bisection as Bisection
    from seedslib.pareto.bisection import bisect as bisect
    from seedslib.pareto.choice import choose as choose
    from seedslib.pareto.continuous import compromise as compromise
    from seedslib.pareto.result import Compromise as Compromise
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
