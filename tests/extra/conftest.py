"""A C compiler that is quick, and a cache of the tests' own."""

import shutil

import pytest


@pytest.fixture(scope="module")
def cc(tmp_path_factory):
    """A C compiler that leaves the code as it is, whatever it is asked for."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler called cc")
    script = tmp_path_factory.mktemp("compiler") / "cc"
    script.write_text(f'#!/bin/sh\nexec {compiler} "$@" -O0\n')
    script.chmod(0o755)
    return str(script)


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    """The library compiles with `cc`, into a folder that is empty at first."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder / "seedslib"


@pytest.fixture
def quick(cc, monkeypatch):
    """`compiled` with the quick compiler."""
    monkeypatch.setenv("CC", cc)
