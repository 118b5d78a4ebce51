"""How designed filters are made: on simulated paths, from exact moments and densities, as tables.

Regressions on simulated paths (`finite_order`, `switching`, `minimax`), the exact distribution of
state and memory (`exact_moments`, `grids`, `plane`), tables from simulated paths (`tables`,
`binned`). Nothing here runs on data; what a fit is and how it runs is in `designed`.

May import: base, models, linearization, filters, designed, evaluation.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.design.binned import binned_synthesis as binned_synthesis
    from seedslib.design.finite_order import synthesize as synthesize
    from seedslib.design.grids import affine_synthesis as affine_synthesis
    from seedslib.design.grids import grid_risk as grid_risk
    from seedslib.design.grids import grid_synthesis as grid_synthesis
    from seedslib.design.grids import optimal_risk as optimal_risk
    from seedslib.design.grids import optimal_steps as optimal_steps
    from seedslib.design.joint import GridRisk as GridRisk
    from seedslib.design.joint import JointDistribution as JointDistribution
    from seedslib.design.minimax import minimax_synthesis as minimax_synthesis
    from seedslib.design.paths import Executor as Executor
    from seedslib.design.plane import PlaneStep as PlaneStep
    from seedslib.design.plane import plane_steps as plane_steps
    from seedslib.design.steady_state import stationary as stationary
    from seedslib.design.switching import cells_from_moments as cells_from_moments
    from seedslib.design.tables import simulated_synthesis as simulated_synthesis
    from seedslib.designed.minimax import BoundedPolynomial as BoundedPolynomial
    from seedslib.designed.predictors import Affine as Affine
    from seedslib.designed.predictors import Continuous as Continuous
    from seedslib.designed.predictors import Polynomial as Polynomial
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
