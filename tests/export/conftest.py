"""A C compiler that is quick, and a cache of the tests' own."""

import shutil

import pytest


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    """The folder where compiled filters are kept, empty at first."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder / "seedslib"


@pytest.fixture
def quick(cache, monkeypatch):
    """`compiled` with a compiler that leaves the code as it is, whatever it is asked for."""
    script = cache.parent / "cc"
    script.write_text(f'#!/bin/sh\nexec {shutil.which("cc")} "$@" -O0\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
