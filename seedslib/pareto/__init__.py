"""Compromise between criteria: equal relative losses, or the least largest relative loss.

Of the paper on two-criteria optimisation by bisection only the end survives, with equations
(18), (19) and the proof that a point of equal losses exists; `bisect` is its method. `compromise`
is the robust form of it on a segment or in a box, `choose` the form for a list of choices (the
order of a filter, the number of innovations it keeps), where error is weighed against cost.

All criteria are losses: less is better. With the minimisers ``x_i`` the utopia is
``m_i = I_i(x_i)``, the nadir of the payoff table ``M_i = max_j I_i(x_j)``, and the relative loss
``(I_i(x) - m_i) / (M_i - m_i)``. From three criteria on, the nadir of the payoff table can differ
from the nadir of the efficient set, and equal losses of all criteria need not exist.
"""

from seedslib._lazy import lazy_names

_HOMES = {
    "Compromise": ".result",
    "Bisection": ".bisection",
    "bisect": ".bisection",
    "compromise": ".continuous",
    "choose": ".choice",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
