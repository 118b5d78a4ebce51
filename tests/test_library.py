"""The library as a whole: its public names, what its packages import, what importing it costs."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import seedslib

ROOT = Path(__file__).resolve().parents[1]
LAYERS = (
    "base",
    "tape",
    "gaussian",
    "models",
    "linearization",
    "filters",
    "designed",
    "evaluation",
    "design",
    "zoo",
    "commands",
)
"""Each uses only packages before it."""


def used_by(path):
    """Other packages of the library and of others that a file imports."""
    own = path.relative_to(ROOT / "seedslib").parts[0].removesuffix(".py")
    found = re.findall(
        r"^ *(?:from|import) (?:seedslib(?:\.| import ))?(\w+)", path.read_text(), re.M
    )
    return set(found) - {own}


@pytest.mark.parametrize("package", [*seedslib.__all__, "bookkit"])
def test_every_public_name_is_there_and_documented(package):
    module = importlib.import_module("bookkit" if package == "bookkit" else f"seedslib.{package}")
    for name in getattr(module, "__all__", ()):
        assert getattr(module, name).__doc__, f"{package}.{name} has no docstring"
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = module.no_such_name


@pytest.mark.parametrize("package", seedslib.__all__)
def test_a_package_imports_only_layers_below_it_and_nothing_of_the_book(package):
    folder = ROOT / "seedslib" / package
    files = [*folder.rglob("*.py")] or [folder.with_suffix(".py")]
    used = set().union(*map(used_by, files))
    allowed = set(LAYERS[: LAYERS.index(package)] if package in LAYERS else LAYERS)
    if package == "zoo":
        allowed |= {"delay", "piecewise"}
    assert used & set(seedslib.__all__) <= allowed
    assert not used & {"bookkit", "IPython", "papermill", "nbformat", "jupytext"}
    assert package == "extra" or not used & {"dask", "distributed", "matplotlib"}


def test_pages_import_from_packages_never_from_modules_inside_them():
    folders = ((ROOT / name).glob("*.md") for name in (".", "book", "notebooks"))
    for path in (path for folder in folders for path in folder):
        for module in re.findall(r"^\s*(?:from|import) (seedslib[\w.]*)", path.read_text(), re.M):
            assert module.count(".") < 2, f"{path.name}: {module}"


def test_importing_the_library_is_light():
    heavy = ["sympy", "scipy", "dask", "papermill", "matplotlib", "IPython", "pydantic"]
    code = f"import sys, seedslib; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
