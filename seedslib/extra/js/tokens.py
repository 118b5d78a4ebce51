"""What the exported C is made of: tokens, types, and the layout of its numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

NUMBERS = {"double", "float", "int", "signed", "char", "size_t", "void"}
"""Words of types of numbers, or of none."""

_TOKEN = re.compile(
    r"\s+|/\*.*?\*/|(?P<number>(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?F?)"
    r"|(?P<word>[A-Za-z_]\w*)|(?P<sign>->|\+\+|--|<<|>>|[<>=!+\-*/]=|&&|\|\||[-+*/%<>=!&|?:;,.(){}\[\]])",
    re.DOTALL,
)


@dataclass(frozen=True)
class Type:
    """A number, or an array or an address of numbers or structures.

    Attributes
    ----------
    kind : {"number", "array", "address", "struct"}
    dims : tuple of int
        Of an array its lengths; of an address those of what it points at.
    struct : str
        Name of the structure, empty for numbers.
    whole : bool
        Whether the numbers are integers.
    """

    kind: str = "number"
    dims: tuple[int, ...] = ()
    struct: str = ""
    whole: bool = False

    @property
    def item(self) -> Type:
        """What an index gives."""
        dims = self.dims[1:] if self.kind == "array" else self.dims
        if dims:
            return replace(self, kind="array", dims=dims)
        return replace(self, kind="struct" if self.struct else "number", dims=())

    def size(self, structs: dict[str, dict]) -> int:
        """Places that it takes."""
        if self.kind == "address":
            return 1
        one = (
            sum(part.size(structs) for part in structs[self.struct].values()) if self.struct else 1
        )
        return one * math.prod(self.dims if self.kind == "array" else ())


def tokens(text: str) -> Iterator[tuple[str, str]]:
    """Kind and text of each token of a C text without its preprocessor.

    Raises
    ------
    ValueError
        Something that exported filters do not have.
    """
    place = 0
    while place < len(text):
        found = _TOKEN.match(text, place)
        if found is None:
            raise ValueError(f"source: wanted exported C, got {text[place : place + 30]!r}")
        place = found.end()
        if found.lastgroup:
            yield found.lastgroup, found.group()


def preprocessed(text: str) -> tuple[dict[str, float], str]:
    """Macros with numbers, and the text without lines of the preprocessor."""
    found = re.findall(r"^#define (\w+) ([\d.]+(?:e[+-]?\d+)?)(?: .*)?$", text, re.M)
    macros = {name: int(word) if word.isdigit() else float(word) for name, word in found}
    return macros, re.sub(r"^#.*$", "", text, flags=re.M)
