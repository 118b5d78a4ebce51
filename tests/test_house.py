"""The house: what a room may import, one address for a public name, nothing private shared."""

import ast
import importlib
import io
import re
import tokenize
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = ROOT / "seedslib"
CORE = (
    "base", "gaussian", "models", "linearization", "filters", "designed", "design", "evaluation",
    "zoo", "commands",
)  # fmt: skip
WINGS = ("two_step", "delay", "piecewise", "pareto", "riemann")
ROOMS = (*CORE, *WINGS, "extra")
FILES = sorted(LIBRARY.rglob("*.py"))


def imports(path):
    """Modules and names that a file imports from the library, wherever it does."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            yield node.module, [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            yield from ((alias.name, []) for alias in node.names)


def room_of(module, names):
    """Rooms that an import reaches into."""
    parts = module.split(".")
    return set(names) & set(ROOMS) if parts == ["seedslib"] else {parts[1]}


def arrows(room):
    """Other rooms that the files of a room import from."""
    folder = LIBRARY / room
    return {
        there
        for path in FILES
        if folder in path.parents
        for module, names in imports(path)
        if module.split(".")[0] == "seedslib"
        for there in room_of(module, names)
    } - {room}


def declared(room):
    """What the opening lines of a room say that it may import."""
    opening = ast.get_docstring(ast.parse((LIBRARY / room / "__init__.py").read_text()))
    (line,) = re.findall(r"^May import: ([\w, ]+)\.$", opening, re.M)
    return set() if line == "none" else set(line.split(", "))


def listed(room):
    """Public names of a room with the modules they are in."""
    tree = ast.parse((LIBRARY / room / "__init__.py").read_text())
    blocks = [node for node in tree.body if isinstance(node, ast.If)]
    assert all(ast.unparse(block.test) == "TYPE_CHECKING" for block in blocks)
    for node in (node for block in blocks for node in block.body):
        for alias in node.names:
            assert alias.asname == alias.name, f"{room}: {alias.name} is not passed on by its name"
            yield alias.name, node.module


def test_these_are_the_rooms():
    assert {p.name for p in LIBRARY.iterdir() if (p / "__init__.py").is_file()} == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_what_its_opening_lines_say(room):
    assert arrows(room) == declared(room)


def test_layers_use_only_layers_before_them():
    for place, room in enumerate(CORE):
        assert declared(room) <= set(CORE[:place]), room


def test_wings_use_the_core_and_nothing_uses_them():
    used = {(room, there) for room in ROOMS for there in declared(room)}
    assert {(a, b) for a, b in used if b in WINGS or b == "extra"} == {("delay", "riemann")}


def test_the_library_knows_nothing_of_the_book():
    harness = {"bookkit", "IPython", "pydantic", "papermill", "nbformat", "jupytext"}
    extra = {"dask", "distributed", "cloudpickle", "matplotlib"}
    for path in FILES:
        tops = {module.split(".")[0] for module, _ in imports(path)}
        assert not tops & harness, path
        assert not tops & extra or LIBRARY / "extra" in path.parents, path


def test_nothing_private_is_shared():
    for path in [*FILES, *(ROOT / "book" / "bookkit").glob("*.py")]:
        assert not path.stem.startswith("_") or path.stem in ("__init__", "__main__"), path
        for module, names in imports(path):
            if module.split(".")[0] in ("seedslib", "bookkit"):
                assert not [name for name in names if name.startswith("_")], (path, module)


def test_a_public_name_has_one_address_and_lies_there():
    public = [(name, home, room) for room in ROOMS for name, home in listed(room)]
    assert [n for n, many in Counter(name for name, *_ in public).items() if many > 1] == [
        "examples"
    ]
    for name, home, room in public:
        assert home.split(".")[1] == room or (room, name) in {
            ("design", "Affine"), ("design", "Polynomial"), ("design", "Continuous"),
            ("design", "BoundedPolynomial"),
        }, f"{name} of {room} lies in {home}"  # fmt: skip
        value = getattr(importlib.import_module(f"seedslib.{room}"), name)
        assert getattr(value, "__module__", home) == home or isinstance(value, type(ast))


def test_readers_use_addresses_only():
    """Notebooks, pages and benchmarks import from rooms, never from modules inside them."""
    texts = [ROOT / "README.md", *(ROOT / "book").glob("*.md"), *(ROOT / "notebooks").glob("*.md")]
    for path in [*texts, *(ROOT / "benchmarks").glob("*.py")]:
        for module in re.findall(r"^\s*(?:from|import) (seedslib[\w.]*)", path.read_text(), re.M):
            assert module.count(".") < 2, f"{path.name}: {module}"


def test_a_door_without_its_source_says_what_it_wants(tmp_path, monkeypatch):
    room = tmp_path / "room"
    room.mkdir()
    (room / "__init__.py").write_text(
        "from seedslib.base.lazy import lazy_names\n__file__ += 'x'\nlazy_names(__name__)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match="room: its source is wanted"):
        importlib.import_module("room")


@pytest.mark.parametrize("room", ROOMS)
def test_the_one_list_is_read_at_run_time_as_it_stands(room):
    known = getattr(importlib.import_module(f"seedslib.{room}"), "__all__", [])
    assert known == sorted(name for name, _ in listed(room))


def test_no_folder_is_a_drawer():
    crowded = Counter(path.parent for path in FILES)
    assert {folder.name: n for folder, n in crowded.items() if n > 20} == {}


def code_lines(text):
    """Number of lines of a module that are neither docstring nor comment nor blank."""
    said = {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        for line in range(node.lineno, node.end_lineno + 1)
    }
    silent = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    lines = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in (*silent, tokenize.ENDMARKER)
        for line in range(token.start[0], token.end[0] + 1)
    }
    return len(lines - said)


def test_the_readme_knows_the_size_of_the_library():
    (told,) = re.findall(r"about ([\d,]+) lines of code", (ROOT / "README.md").read_text())
    size = sum(code_lines(path.read_text()) for path in FILES)
    assert abs(size - int(told.replace(",", ""))) <= 300, size
