"""The programs of `benchmarks`, as modules: tests run parts of what they wrote again."""

import importlib.util
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def load(name, folder=BENCHMARKS):
    """A program by its name; it is executed, but its `main` is not."""
    spec = importlib.util.spec_from_file_location(f"{name} program", folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
