"""The book's harness: parameters, records, execution, sweeps, claims, plots.

It imports the library; the library never imports it.
"""

from seedslib._lazy import lazy_names

_HOMES = {
    "check": ".parameters",
    "choice": ".parameters",
    "flag": ".parameters",
    "integer": ".parameters",
    "real": ".parameters",
    "reals": ".parameters",
    "claim": ".recording",
    "record": ".recording",
    "run_sweep": ".sweeps",
    "plot_design": ".design_plots",
    "plots": "",
}
__getattr__, __dir__ = lazy_names(__name__, globals(), _HOMES)
__all__ = [*_HOMES]
