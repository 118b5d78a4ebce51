"""What a filter is worth on test paths: errors with their standard errors, and consistency.

And `diff`, which compares two designs, and `fit`, which finds the parameters of a model from data.
It runs filters and knows none of them by name.

May import: base, models, filters, designed.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.evaluation.designs import diff as diff
    from seedslib.evaluation.fitting import Fit as Fit
    from seedslib.evaluation.fitting import fit as fit
    from seedslib.evaluation.scores import compare as compare
    from seedslib.evaluation.scores import evaluate as evaluate
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
