"""How designed filters are made: on simulated paths, on the exact law, as tables.

Shelves: `paths` (regression over simulated paths), `law` (the law of memory and state on a grid),
`tables` (tables by regression); beside them, how moments become fits (`regression`, `fitting`,
`cells`). Nothing here runs on data, and what a fit is and does there is in `designed`.

May import: base, models, linearization, filters, designed.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.design.cells import cells_from_moments as cells_from_moments
    from seedslib.design.law.affine import affine_synthesis as affine_synthesis
    from seedslib.design.law.dependent import DependentStep as DependentStep
    from seedslib.design.law.dependent import dependent_steps as dependent_steps
    from seedslib.design.law.grid import grid_synthesis as grid_synthesis
    from seedslib.design.law.grid import optimal_risk as optimal_risk
    from seedslib.design.law.grid import optimal_steps as optimal_steps
    from seedslib.design.law.joint import JointLaw as JointLaw
    from seedslib.design.law.plane import PlaneStep as PlaneStep
    from seedslib.design.law.plane import plane_steps as plane_steps
    from seedslib.design.law.recursion import GridRisk as GridRisk
    from seedslib.design.law.risk import grid_risk as grid_risk
    from seedslib.design.paths.minimax import minimax_synthesis as minimax_synthesis
    from seedslib.design.paths.simulated import synthesize as synthesize
    from seedslib.design.paths.stationary import stationary as stationary
    from seedslib.design.paths.walk import Crew as Crew
    from seedslib.design.tables.binned import binned_synthesis as binned_synthesis
    from seedslib.design.tables.simulated import simulated_synthesis as simulated_synthesis
    from seedslib.design.tables.tabulation import tabulated as tabulated
    from seedslib.designed.outputs.minimax import BoundedPolynomial as BoundedPolynomial
    from seedslib.designed.predictors import Affine as Affine
    from seedslib.designed.predictors import Continuous as Continuous
    from seedslib.designed.predictors import Polynomial as Polynomial
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
