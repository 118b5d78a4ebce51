"""Mutants of the library: drawn with mutmut's operators, kept as lines of text, found again."""

from __future__ import annotations

import ast
import contextlib
import csv
import random
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = ROOT / "seedslib"
HERE = Path(__file__).parent
FROZEN, FAULTS = HERE / "frozen.csv", HERE / "faults.yml"


@dataclass(frozen=True)
class Mutant:
    """Whole lines of one function, replaced.

    Attributes
    ----------
    package : str
    file : str
        Below the library's folder, when it was drawn.
    function : str
        Qualified name; empty at the level of the module. Of a planted fault, its description.
    line : int
        First line of `before`, when it was drawn.
    operator : str
        mutmut's name for the kind of change; ``fault`` for one planted by hand.
    before, after : str
        Whole lines; `before` stands once in the function.
    killed_by : str
        Test that failed with it when it was frozen.
    """

    package: str
    file: str
    function: str
    line: int
    operator: str
    before: str
    after: str
    killed_by: str = ""


def read(path: Path = FROZEN) -> list[Mutant]:
    """Mutants of a committed list."""
    with path.open(newline="") as file:
        return [Mutant(**{**row, "line": int(row["line"])}) for row in csv.DictReader(file)]


def write(mutants: Iterable[Mutant], path: Path = FROZEN) -> None:
    """Write a list by package, file and line."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in fields(Mutant)])
        writer.writerows(sorted(map(astuple, mutants)))


def faults() -> list[Mutant]:
    """The faults planted by hand."""
    return [
        Mutant(
            f["file"].split("/")[0].removesuffix(".py"),
            f["file"],
            f["name"],
            0,
            "fault",
            f["before"],
            f["after"],
        )
        for f in yaml.safe_load(FAULTS.read_text())
    ]


def files_of(package: str, library: Path = LIBRARY) -> list[str]:
    """Python files of a package, or the one of a module of this name."""
    paths = [*library.glob(f"{package}.py"), *(library / package).rglob("*.py")]
    return sorted(path.relative_to(library).as_posix() for path in paths)


def functions_of(text: str) -> Iterator[tuple[str, int, int]]:
    """Qualified name, first and last line of every function and class of a module."""

    def inside(node, names):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                within = (*names, child.name)
                yield ".".join(within), child.lineno, child.end_lineno
                yield from inside(child, within)
            else:
                yield from inside(child, names)

    yield from inside(ast.parse(text), ())


def located(mutant: Mutant, library: Path = LIBRARY) -> tuple[str, int, str] | None:
    """File, first line and the file's text with a mutant in it; None where it applies no more.

    The function is looked for in its file, then in the others of the package, so that files may
    be joined, renamed and edited elsewhere; last, the lines alone are looked for in the package.
    """
    files = files_of(mutant.package, library)
    files.sort(key=lambda name: name != mutant.file)
    texts = {name: (library / name).read_text() for name in files}
    for name, text in texts.items():
        lines = text.splitlines(keepends=True)
        for function, first, last in functions_of(text):
            part = "".join(lines[first - 1 : last])
            if function == mutant.function and part.count(mutant.before) == 1:
                start = sum(map(len, lines[: first - 1])) + part.index(mutant.before)
                return name, *_spoilt(mutant, text, start)
    counts = {name: text.count(mutant.before) for name, text in texts.items()}
    once = [name for name, count in counts.items() if count == 1]
    if once and (once[0] == mutant.file or sum(counts.values()) == 1):
        text = texts[once[0]]
        return once[0], *_spoilt(mutant, text, text.index(mutant.before))
    return None


def _spoilt(mutant: Mutant, text: str, start: int) -> tuple[int, str]:
    line = text.count("\n", 0, start) + 1
    return line, text[:start] + mutant.after + text[start + len(mutant.before) :]


def draw(package: str, seed: int, library: Path = LIBRARY) -> Iterator[Mutant]:
    """All mutants of a package that can be compiled, in an order drawn by a seed."""
    every = [m for name in files_of(package, library) for m in mutants_of(package, name, library)]
    random.Random(f"{package} {seed}").shuffle(every)
    for mutant in every:
        place = located(mutant, library)
        with contextlib.suppress(SyntaxError, ValueError):
            compile(place[2], mutant.file, "exec")
            yield mutant


def mutants_of(package: str, file: str, library: Path = LIBRARY) -> list[Mutant]:
    """What mutmut's operators make of the computing lines of a file.

    Messages, annotations, decorators, imports, strings and assertions are left alone.
    """
    import libcst as cst
    from libcst import metadata
    from mutmut.mutation.mutators import mutation_operators

    text = (library / file).read_text()
    data, lines = text.encode(), text.splitlines(keepends=True)
    spans = list(functions_of(text))
    module = metadata.MetadataWrapper(cst.parse_module(text))
    places = module.resolve(metadata.ByteSpanPositionProvider)
    silent = (
        cst.Raise,
        cst.Assert,
        cst.Annotation,
        cst.Decorator,
        cst.Import,
        cst.ImportFrom,
        cst.BaseString,
    )
    names_only = {"operator_string", "operator_dict_arguments"}
    mutants: dict[tuple[str, str], Mutant] = {}

    def add(node, changed, operator):
        place = places[node]
        start = len(data[: place.start].decode())
        piece = data[place.start : place.start + place.length].decode()
        before = module.module.code_for_node(node)
        after = module.module.code_for_node(changed)
        if before.strip() != piece.strip() or after == before:
            return
        if before.count("strict=True") > after.count("strict=True"):  # an assertion
            return
        after = after if before == piece else after.strip()  # some spans have the space before
        whole = text[:start] + after + text[start + len(piece) :]
        first = text.count("\n", 0, start)
        last = text.count("\n", 0, start + len(piece.rstrip()))
        inner = [s for s in spans if s[1] <= first + 1 <= s[2]]
        function, top, bottom = max(inner, key=lambda s: s[1], default=("", 1, len(lines)))
        if function.rpartition(".")[2] in ("__repr__", "_repr_html_", "_repr_pretty_"):
            return
        part = "".join(lines[top - 1 : bottom])
        while part.count("".join(lines[first : last + 1])) > 1 and first > top - 1:
            first -= 1  # lines above, until the piece of text is the only one of its kind
        old = "".join(lines[first : last + 1])
        if part.count(old) != 1:
            return
        ahead, behind = sum(map(len, lines[:first])), sum(map(len, lines[last + 1 :]))
        new = whole[ahead : len(whole) - behind]
        mutants[old, new] = Mutant(package, file, function, first + 1, operator, old, new)

    def visit(node):
        if isinstance(node, cst.Arg) and node.keyword and node.keyword.value == "strict":
            return
        if isinstance(node, silent) or (
            isinstance(node, cst.Call) and getattr(node.func, "value", "") in ("len", "isinstance")
        ):
            return
        if isinstance(node, cst.If) and "TYPE_CHECKING" in module.module.code_for_node(node.test):
            return
        if isinstance(node, cst.Assign) and "__all__" in module.module.code_for_node(node):
            return
        for kind, operator in mutation_operators:
            if isinstance(node, kind) and operator.__name__ not in names_only:
                for changed in operator(node):
                    add(node, changed, operator.__name__.removeprefix("operator_"))
        for child in node.children:
            visit(child)

    visit(module.module)
    return sorted(mutants.values(), key=astuple)
