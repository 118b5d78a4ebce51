"""Formulas as programs: numbers that write down what is done with them, and programs in Python.

A filter records one measurement on a tape. `floats` makes a Python function of it, which filters
one record several times as fast as NumPy; `seedslib.export` writes it in other languages.

May import: base.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.tape.floats import as_function as as_function
    from seedslib.tape.tape import Array as Array
    from seedslib.tape.tape import Scalar as Scalar
    from seedslib.tape.tape import Tape as Tape
    from seedslib.tape.tape import choose as choose
    from seedslib.tape.writer import Writer as Writer
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
