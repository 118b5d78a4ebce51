"""How objects are copied with changes, and how they travel to other processes."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from typing import Self

Kind = TypeVar("Kind")


class Pickled:
    """An object that is pickled without its cached properties, which are computed again when used.

    So what is compiled from formulas need not travel. Functions of the user's are pickled by their
    names: a model with a lambda in it is refused, in pickle's words.
    """

    def __getstate__(self) -> dict[str, Any]:
        kind = type(self)
        return {
            name: value
            for name, value in vars(self).items()
            if not isinstance(getattr(kind, name, None), cached_property)
        }

    def remade(self, **attributes: Any) -> Self:
        """A copy with other attributes, of which all cached properties are computed again."""
        other = object.__new__(type(self))
        vars(other).update(self.__getstate__(), **attributes)
        return other


def changed(thing: Kind, **attributes: Any) -> Kind:
    """A copy of an object with other attributes; what is derived from the rest is shared."""
    other = object.__new__(type(thing))
    vars(other).update(vars(thing), **attributes)
    return other
