"""The command line: ``python -m seedslib design``, ``filter`` and ``fit``.

Words and files in, words and files out; whatever is computed is computed by the rooms below.

May import: base, models, linearization, filters, designed, design, evaluation.
"""
