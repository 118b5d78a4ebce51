"""Commands of the library, ``python -m seedslib design | filter``: filters without writing code.

They want nothing but the library itself, none of the book's extras.
"""
