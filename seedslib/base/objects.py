"""How objects show themselves, and how they travel to other processes and back."""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property, partial
from typing import Any


class Shown:
    """An object that shows itself in one line: `_shown` names the attributes worth a word."""

    _shown: tuple[str, ...] = ()

    def __repr__(self) -> str:
        names = (name.replace("_", " ") for name in self._shown)
        parts = (f"{n} {getattr(self, a)}" for n, a in zip(names, self._shown, strict=True))
        return f"<{type(self).__name__}: {', '.join(parts)}>"


class Remade:
    """An object that is pickled as the arguments it was made of, and made of them again.

    What was compiled is compiled there. Functions among the arguments are pickled by their names:
    a model with a lambda in it is refused, in pickle's words.
    """

    def __new__(cls, *arguments: Any, **options: Any) -> Any:
        """Keep what the object is made of."""
        self = object.__new__(cls)
        self.__dict__["_made_of"] = arguments, options
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _remade, (type(self), *self.__dict__["_made_of"])


def by_fields(description: object, **changes: object) -> tuple[Any, ...]:
    """What ``__reduce__`` gives of a dataclass that is made again from its fields."""
    parts = {part.name: getattr(description, part.name) for part in fields(description)}
    return partial(type(description), **(parts | changes)), ()


def _remade(kind, arguments, options):
    return kind(*arguments, **options)


class Travelling:
    """A symbolic map or system is pickled as its expressions, which are compiled when needed.

    What is made when it is first used is left behind. Given array functions travel themselves.
    """

    _functions = ("_value", "_weight", "conditional", "drift", "diffusion", "intensity")

    def __getstate__(self) -> dict[Any, Any]:
        parts = vars(type(self)).items()
        made = {name for name, part in parts if isinstance(part, cached_property)}
        made.add("_increments")
        made = made.union(self._functions) if self.symbolic else made.difference(self._functions)
        return {name: part for name, part in self.__dict__.items() if name not in made}
