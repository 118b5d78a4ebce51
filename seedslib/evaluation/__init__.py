"""What a filter is worth on test paths: errors with their standard errors, and consistency.

And `fit`, which finds the parameters of a model from data. No filter is known here by name.

May import: base, models, filters, designed.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.evaluation.comparison import compare as compare
    from seedslib.evaluation.comparison import evaluate as evaluate
    from seedslib.evaluation.fitting import Fit as Fit
    from seedslib.evaluation.fitting import fit as fit
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
