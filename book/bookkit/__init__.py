"""The book's harness: parameters, records, execution, sweeps, claims, plots.

It uses the library, which knows nothing of it, and it is not in the wheel: `setup.sh` and
`.binder/postBuild` let notebooks and workers import it by a path file.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from bookkit import plots as plots
    from bookkit.parameters import check as check
    from bookkit.parameters import choice as choice
    from bookkit.parameters import integer as integer
    from bookkit.parameters import real as real
    from bookkit.recording import claim as claim
    from bookkit.recording import record as record
    from bookkit.sweeps import run_sweep as run_sweep
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
