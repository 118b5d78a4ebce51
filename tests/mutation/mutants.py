"""Mutants of a file: what the operators of mutmut make of it, each a piece of text replaced."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import libcst as cst
import yaml
from libcst import metadata
from mutmut.mutation.mutators import mutation_operators

ROOT = Path(__file__).resolve().parents[2]

ROOMS = {
    "correction": ("base/correction.py", "base/diffuse.py"),
    "semidefinite": ("base/semidefinite.py", "base/triangles.py"),
    "linearization": ("linearization",),
    "memory": ("designed/memory.py", "designed/arrivals.py", "designed/gaps.py"),
    "models": ("models",),
    "filters": ("filters",),
    "designed": ("designed",),
    "design": ("design",),
    "gaussian means": ("gaussian/means", "gaussian/quadrature.py"),
    "gaussian errors": ("gaussian/errors",),
    "gaussian regions": ("gaussian/regions",),
    "delay": ("delay",),
    "piecewise": ("piecewise",),
    "two-step": ("two_step",),
    "bisection": ("pareto",),
    "riemann": ("riemann",),
}
"""What is mutated, as files and folders of the library; a file belongs to the first that has it."""

UNTOUCHED = ("__repr__", "_repr_html_", "_repr_pretty_")
"""Functions that write for a reader: a mutant there changes words."""

NAMES_ALONE = {"operator_string", "operator_dict_arguments"}
"""Operators left out: they change sentences and names."""

NOTHING_COMPUTED = (
    cst.Raise, cst.Assert, cst.Annotation, cst.Decorator, cst.Import, cst.ImportFrom,
    cst.BaseString,
)  # fmt: skip
CALLS_LEFT_OUT = ("len", "isinstance", "errstate")
"""Calls that are left alone; the last one only says which warnings of NumPy are not wanted."""


@dataclass(frozen=True)
class Mutant:
    """A piece of text of one function, replaced.

    Attributes
    ----------
    file : str
        Below the library's folder.
    function : str
        Qualified name, empty at the level of the module.
    line : int
    end : int
        Lines of the piece, from 1.
    start : int
    stop : int
        Place of the piece in the text.
    operator : str
    after : str
        What stands there instead.
    key : str
        Names the mutant as long as its function is written as it is.
    """

    file: str
    function: str
    line: int
    end: int
    start: int
    stop: int
    operator: str
    after: str
    key: str

    def applied(self, text: str) -> str:
        """The file's text with this mutant in it."""
        return text[: self.start] + self.after + text[self.stop :]


class _Collector(cst.CSTVisitor):
    METADATA_DEPENDENCIES = (metadata.ByteSpanPositionProvider, metadata.PositionProvider)

    def __init__(self, file: str, text: str, module: cst.Module):
        super().__init__()
        self.file, self.data, self.module = file, text.encode(), module
        self.names: list[str] = []
        self.sources: list[str] = [""]
        self.seen: dict[tuple, int] = {}
        self.found: list[Mutant] = []

    def on_visit(self, node: cst.CSTNode) -> bool:
        if isinstance(node, NOTHING_COMPUTED) or _asserts(node):
            return False
        if isinstance(node, cst.If) and "TYPE_CHECKING" in self.module.code_for_node(node.test):
            return False
        if isinstance(node, cst.Call) and _called(node) in CALLS_LEFT_OUT:
            return False
        if isinstance(node, cst.Assign) and "__all__" in self.module.code_for_node(node.targets[0]):
            return False
        if isinstance(node, cst.FunctionDef | cst.ClassDef):
            self.names.append(node.name.value)
            if len(self.names) == 1 or isinstance(node, cst.FunctionDef):
                self.sources.append(self.module.code_for_node(node))
            else:
                self.sources.append(self.sources[-1])
            if node.name.value in UNTOUCHED:
                return False
        self._mutate(node)
        return True

    def on_leave(self, original_node: cst.CSTNode) -> None:
        if isinstance(original_node, cst.FunctionDef | cst.ClassDef):
            self.names.pop()
            self.sources.pop()

    def _mutate(self, node: cst.CSTNode) -> None:
        for kind, operator in mutation_operators:
            if not isinstance(node, kind) or operator.__name__ in NAMES_ALONE:
                continue
            for changed in operator(node):
                if _strict(node) and not _strict(changed):
                    continue
                self._add(node, changed, operator.__name__.removeprefix("operator_"))

    def _add(self, node: cst.CSTNode, changed: cst.CSTNode, operator: str) -> None:
        span = self.get_metadata(metadata.ByteSpanPositionProvider, node)
        where = self.get_metadata(metadata.PositionProvider, node)
        piece = self.data[span.start : span.start + span.length].decode()
        after = self.module.code_for_node(changed)
        before = self.module.code_for_node(node)
        if before.strip() != piece.strip() or after == before:
            return
        after = after if before == piece else after.strip()  # some spans have the space before
        name = ".".join(self.names)
        place = (name, operator, piece, after.strip())
        count = self.seen[place] = self.seen.get(place, -1) + 1
        # of the function's own text: a change elsewhere in the file leaves the name as it is
        parts = (self.file, name, self.sources[-1], operator, piece, after.strip(), str(count))
        key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:12]
        start = len(self.data[: span.start].decode())
        self.found.append(
            Mutant(
                self.file, name, where.start.line, where.end.line, start, start + len(piece),
                operator, after, key,
            )
        )  # fmt: skip


def _called(node: cst.Call) -> str:
    """Last name of what is called."""
    return node.func.attr.value if isinstance(node.func, cst.Attribute) else getattr(
        node.func, "value", ""
    )  # fmt: skip


def _asserts(node: cst.CSTNode) -> bool:
    """Whether this is the argument ``strict=True`` of a zip, an assertion."""
    return isinstance(node, cst.Arg) and node.keyword is not None and node.keyword.value == "strict"


def _strict(node: cst.CSTNode) -> bool:
    """Whether this is a call with the argument ``strict=True``."""
    return isinstance(node, cst.Call) and any(
        _asserts(arg) and arg.value.value == "True" for arg in node.args
    )


def mutants_of(file: str, library: Path = ROOT / "seedslib") -> list[Mutant]:
    """All mutants of a file, by key."""
    text = (library / file).read_text()
    wrapper = metadata.MetadataWrapper(cst.parse_module(text))
    collector = _Collector(file, text, wrapper.module)
    wrapper.visit(collector)
    return sorted(collector.found, key=lambda m: m.key)


def sound(m: Mutant, library: Path = ROOT / "seedslib") -> bool:
    """Whether the file with a mutant in it can be compiled."""
    try:
        compile(m.applied((library / m.file).read_text()), "mutant", "exec")
    except SyntaxError:
        return False
    return True


def planted(library: Path = ROOT / "seedslib") -> list[Mutant]:
    """The faults of faults.yml.

    Raises
    ------
    ValueError
        One whose text does not stand once in its file.
    """
    found = []
    for k, fault in enumerate(yaml.safe_load(Path(__file__).with_name("faults.yml").read_text())):
        text, before = (library / fault["file"]).read_text(), fault["before"]
        if text.count(before) != 1:
            raise ValueError(f"{fault['name']}: its text stands {text.count(before)} times")
        start = text.index(before)
        line = text.count("\n", 0, start) + 1
        found.append(
            Mutant(
                fault["file"], fault["name"], line, line + before.rstrip().count("\n"), start,
                start + len(before), "fault", fault["after"], f"fault {k:02}",
            )
        )  # fmt: skip
    return found


def sample(files: Iterable[str], skip: int, stop: int) -> list[Mutant]:
    """The sound mutants of some files from place `skip` to place `stop` by their keys.

    The keys are hashes, so that this is a random sample; and it stays, but for the functions that
    are edited.
    """
    every = sorted((m for file in files for m in mutants_of(file)), key=lambda m: m.key)
    return list(islice(filter(sound, every), skip, stop))


def files_of(room: str, library: Path = ROOT / "seedslib") -> list[str]:
    """Files of a room that compute, sorted."""
    taken: set[str] = set()
    for name, places in ROOMS.items():
        found = {
            str(path.relative_to(library))
            for place in places
            for path in (library.glob(place) if "." in place else (library / place).rglob("*.py"))
            if path.name != "__init__.py"
        } - taken  # fmt: skip
        if name == room:
            return sorted(found)
        taken |= found
    raise ValueError(f"room: got {room!r}, wanted one of {', '.join(ROOMS)}")


def fingerprint(file: str, library: Path = ROOT / "seedslib") -> str:
    """What the program of a file says, whatever its comments and its layout."""
    tree = ast.parse((library / file).read_text())
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()[:12]
