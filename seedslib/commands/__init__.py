"""The command line: ``python -m seedslib design`` and ``filter``.

Words and files in, words and files out; whatever is computed is computed by the rooms below.

May import: base, models, linearization, filters, designed, design.
"""
