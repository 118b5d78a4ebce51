"""Exact synthesis of finite-order filters: densities on grids, regressions on paths."""

from seedslib._lazy import lazy_names

_HOMES = {
    "Axis": ".axes",
    "interpolate": ".axes",
    "FellerChain": ".feller",
    "grid_synthesis": ".grid",
    "affine_synthesis": ".grid",
    "grid_risk": ".grid",
    "optimal_risk": ".grid",
    "SwitchingChain": ".switching_chain",
    "GridRisk": ".joint",
    "simulated_synthesis": ".simulated",
    "tabulated": ".tabulation",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
