"""Filters as programs in other languages.

`to_c` and `to_js` write a filter as a C header and as a JavaScript module, `compiled` runs that C
behind the filter's own verbs.

May import: base, tape, models, linearization, filters, designed.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.export.c import to_c as to_c
    from seedslib.export.compilation import CompiledFilter as CompiledFilter
    from seedslib.export.compilation import compiled as compiled
    from seedslib.export.javascript import to_js as to_js
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
