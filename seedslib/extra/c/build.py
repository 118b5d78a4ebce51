"""C to a library of this machine, kept by content in the user's cache."""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-shared", "-fPIC")


def compiler() -> list[str] | None:
    """Command of a C compiler: ``CC``, cc, gcc, clang, or the one of the package ziglang."""
    named = os.environ.get("CC", "").split()
    for command in (named, ["cc"], ["gcc"], ["clang"]):
        if command and (found := shutil.which(command[0])):
            return [found, *command[1:]]
    if importlib.util.find_spec("ziglang") is not None:
        # for any processor of this kind, as the others do: a cache may be shared
        return [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]
    return None


def cache_folder() -> Path:
    """Where libraries are kept: ``XDG_CACHE_HOME``, or the user's own cache."""
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(base) if base else Path.home() / ".cache") / "seedslib"


def library(text: str) -> Path | None:
    """Path of the library made of a C text, made at most once; None without a compiler.

    A library appears under its name when it is whole, so that several processes may want it at
    the same time.

    Raises
    ------
    RuntimeError
        The compiler refuses the text.
    """
    command = compiler()
    if command is None:
        return None
    described = "\n".join([*command, *FLAGS, sys.platform, platform.machine(), text])
    name = hashlib.sha256(described.encode()).hexdigest()[:32]
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        wanted = folder / f"{name}{'.dll' if os.name == 'nt' else '.so'}"
        if not (wanted.exists() and _loads(wanted)):
            _make(command, text, wanted)
    except OSError:  # a home that cannot be written to
        wanted = Path(tempfile.mkdtemp(prefix="seedslib")) / f"{name}.so"
        _make(command, text, wanted)
    return wanted


def _loads(path: Path) -> bool:
    try:
        ctypes.CDLL(str(path))
    except OSError:
        return False
    return True


def _make(command: list[str], text: str, wanted: Path) -> None:
    with tempfile.TemporaryDirectory(dir=wanted.parent) as folder:
        source, made = Path(folder) / "filter.c", Path(folder) / wanted.name
        source.write_text(text)
        last = [] if os.name == "nt" else ["-lm"]
        line = [*command, *FLAGS, str(source), "-o", str(made), *last]
        done = subprocess.run(line, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"compiler: {' '.join(line)} failed: {done.stderr.strip()[:2000]}")
        os.replace(made, wanted)
