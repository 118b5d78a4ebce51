"""The commands write over none of the files that they read."""

import os

import pytest

from seedslib.commands.cli import main

MODEL = """
import sympy
from seedslib.models import JumpDiffusion, Noise

x, v = sympy.symbols("x v")
system = JumpDiffusion((x,), [-x], [[1]], [x + v], Noise((v,)), [1], [[1]], step=0.05)
times = [0, 0.5]
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.py").write_text(MODEL)
    (tmp_path / "data.csv").write_text("t,y1\n0,1\n0.5,2\n")
    return tmp_path


DESIGN = ["design", "model.py", "--memory", "estimates=1", "--paths", "400", "--nodes", "0"]
FILTER = ["filter", "f.npz", "data.csv", "--model", "model.py"]


@pytest.fixture
def filter(folder):
    assert main([*DESIGN, "--out", "f.npz"]) == 0
    return folder / "f.npz"


def names(folder, target):
    """The file by its name, by other spellings, by links."""
    (folder / "sub").mkdir()
    (folder / "soft").symlink_to(target)
    (folder / "softer").symlink_to("soft")
    os.link(folder / target, folder / "hard")
    return [
        target,
        f"./{target}",
        f"sub/../{target}",
        str(folder / target),
        "soft",
        "softer",
        "hard",
    ]


def test_a_design_does_not_replace_its_model(folder, capsys, refused):
    for name in names(folder, "model.py"):
        told = refused(capsys, main, *DESIGN, "--out", name)
        assert f"out: wanted another file than the model model.py, got {name}" in told
    assert (folder / "model.py").read_text() == MODEL


@pytest.mark.parametrize(
    ("target", "what"),
    [("data.csv", "measurements"), ("f.npz", "filter"), ("model.py", "model")],
)
def test_estimates_do_not_replace_what_they_are_made_of(
    folder, filter, capsys, refused, target, what
):
    before = (folder / target).read_bytes()
    for name in names(folder, target):
        told = refused(capsys, main, *FILTER, "--out", name)
        assert f"out: wanted another file than the {what} {target}, got {name}" in told
    assert (folder / target).read_bytes() == before


def test_other_files_may_be_written_again(folder, filter, capsys, refused):
    for _ in range(2):
        assert main([*DESIGN, "--out", "f.npz"]) == 0
        assert main([*FILTER, "--out", "x.csv"]) == 0
    assert sorted(os.listdir(folder)) == ["data.csv", "f.npz", "model.py", "x.csv"]
    told = refused(capsys, main, *FILTER, "--out", "none/x.csv")
    assert "out: no such folder as none" in told
    assert "out: wanted a file, got the folder ." in refused(capsys, main, *FILTER, "--out", ".")
    assert "No such file" in refused(
        capsys, main, "filter", "g.npz", "data.csv", "--model", "model.py", "--out", "x.csv"
    )
