"""Finite-dimensional optimal nonlinear filtering.

An observation system, what is remembered of the past, and how means are taken: together they
make a filter. ``DESIGN.md`` beside this file says on one page how the parts fit together. The
library is a core in layers, each of which uses only layers before it,

``base``, ``tape``, ``gaussian``, ``models``, ``linearization``, ``filters``, ``designed``,
``design``, ``evaluation``, ``zoo``, ``commands``,

and one package for each subject, which uses only the core: ``two_step``, ``delay``, ``piecewise``,
``pareto``, ``riemann`` (``zoo`` has their systems too). ``export`` writes filters in C and
JavaScript, ``extra`` is what wants another package; nothing uses them. A public name has one
address, its package: ``from seedslib.models import Noise``. What a package may import stands in
its opening lines.
"""

from seedslib.base.lazy import lazy_names

__version__ = "0.1.0"

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib import base as base
    from seedslib import commands as commands
    from seedslib import delay as delay
    from seedslib import design as design
    from seedslib import designed as designed
    from seedslib import evaluation as evaluation
    from seedslib import export as export
    from seedslib import extra as extra
    from seedslib import filters as filters
    from seedslib import gaussian as gaussian
    from seedslib import linearization as linearization
    from seedslib import models as models
    from seedslib import pareto as pareto
    from seedslib import piecewise as piecewise
    from seedslib import riemann as riemann
    from seedslib import tape as tape
    from seedslib import two_step as two_step
    from seedslib import zoo as zoo
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
