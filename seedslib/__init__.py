"""Finite-dimensional optimal nonlinear filtering.

An observation system, what is remembered of the past, and how means are taken: together
they make a filter. The rooms of the library, in the direction in which data flows:

``systems``, ``linearization`` and ``gaussian``, ``correction`` and ``memory``, ``synthesis``
(with ``exact`` and ``learned`` beside it), ``filters``, ``storage`` and ``export``, ``evaluation``.
Apart from them stand ``pareto`` and ``riemann``; ``commands`` is what ``python -m seedslib`` does
with the library. ``experiments`` is the harness of the book and is never imported by the others.
"""

from seedslib._lazy import lazy_names

__version__ = "0.1.0"

_ROOMS = (
    "gaussian", "systems", "linearization", "correction", "memory", "synthesis", "exact",
    "learned", "filters", "storage", "export", "evaluation", "pareto", "riemann", "commands",
    "experiments",
)  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__, globals(), dict.fromkeys(_ROOMS, ""))
__all__ = ["__version__", *_ROOMS]
