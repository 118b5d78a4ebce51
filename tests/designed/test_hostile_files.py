"""Small files that ask for much, or say a thing twice, are refused in a sentence and at once."""

import json
import resource
import time
import zipfile

import numpy as np
import pytest

from seedslib import zoo
from seedslib.commands.cli import main
from seedslib.design import grid_synthesis, synthesize
from seedslib.designed import Memory, load, save
from seedslib.linearization import Taylor


@pytest.fixture
def plain(tmp_path):
    path = tmp_path / "f.npz"
    made = synthesize(zoo.linear_gaussian(), Memory(1), Taylor(), [0, 1, 2], exact_moments=True)
    save(made, path)
    return path


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    path = tmp_path_factory.mktemp("files") / "t.npz"
    axes = {"x": (-6, 6, 25), "z": (-6, 6, 9), "y": (-14, 14, 29)}
    save(grid_synthesis(zoo.scalar_switching(), Memory(1, log_odds=False), [0, 1], **axes), path)
    return path


@pytest.fixture
def table(kept, tmp_path):
    path = tmp_path / "t.npz"
    path.write_bytes(kept.read_bytes())
    return path


INFINITE = float("inf")


@pytest.mark.parametrize(
    "changes",
    [
        {"components": INFINITE},
        {"components": 10**30},
        {"memory": {"class": "Memory", "estimates": INFINITE}},
        {"memory": {"class": "Memory", "estimates": 10**30}},
        {"components": -INFINITE},
        {"predictor": {"class": "Polynomial", "mean_degree": INFINITE, "cov_degree": 1}},
        {"linearization": {"class": "GaussHermite", "order": INFINITE}},
        {"linearization": {"class": "GaussHermite", "order": 10**9}},
        {"linearization": {"class": "GaussHermite", "order": 10**4}},
    ],
)
def test_infinite_sizes_of_a_plain_filter(plain, changes, header):
    header(plain, **changes)
    with pytest.raises(ValueError, match=r"^f\.npz: "):
        load(plain, zoo.linear_gaussian())


@pytest.mark.parametrize(
    "changes",
    [
        {"modes": 10**9},
        {"modes": INFINITE},
        {"modes": 0},
        {"modes": -1},
        {"measurement_size": 10**9},
        {"state_size": INFINITE},
        {"indicators": 10**12},
        {"indicators": -1},
        {"axes": [{"class": "Labels", "count": INFINITE}]},
        {"axes": [{"class": "Labels", "count": 10**12}]},
        {"axes": [{"class": "Axis", "low": -1.0, "high": 1.0, "count": INFINITE}]},
        {"axes": [{"class": "Axis", "low": -1.0, "high": 1.0, "count": 10**12}]},
    ],
)
def test_sizes_beyond_reason_of_a_table(table, changes, header):
    assert load(table).order == 2
    if "axes" in changes:
        with np.load(table) as archive:
            steps = json.loads(archive["header"].tobytes().decode())["filter"]["steps"]
        steps[0]["shown"] |= changes
        header(table, steps=steps)
    else:
        header(table, "sizes", **changes)
    start = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=r"^t\.npz: the file contradicts itself"):
        load(table)
    assert time.perf_counter() - start < 2.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kilobytes


def test_on_the_command_line_it_is_one_line(table, header, capsys, tmp_path):
    header(table, "sizes", modes=INFINITE)
    (tmp_path / "d.csv").write_text("t,y1\n0,1\n")
    arguments = ["filter", table, tmp_path / "d.csv", "--out", tmp_path / "x.csv"]
    assert main([str(part) for part in arguments]) == 2
    told = capsys.readouterr().err
    assert "modes: wanted 0 to 128, got inf" in told
    assert told.count("\n") == 1


def test_an_array_larger_than_anything(plain):
    """A shape of 1e20 in the header of an array."""
    with zipfile.ZipFile(plain) as archive:
        members = {entry.filename: archive.read(entry) for entry in archive.infolist()}
    dimensions = b"(100000000000000000000,), }"
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': " + dimensions
    text += b" " * (117 - len(text)) + b"\n"
    members["times.npy"] = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
    with zipfile.ZipFile(plain, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    with pytest.raises(ValueError, match=r"f\.npz: damaged or cut short"):
        load(plain, zoo.linear_gaussian())


def test_many_members_are_weighed_together(plain):
    with zipfile.ZipFile(plain, "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(100):
            archive.writestr(f"{k}.npy", np.random.default_rng(0).bytes(1000) + bytes(50_000))
    assert 100_000 < plain.stat().st_size < 5_000_000
    with pytest.raises(ValueError, match="5100000 bytes in a file of"):
        load(plain, zoo.linear_gaussian())


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("name", ["header", "times"])
def test_two_members_of_one_name(plain, name):
    with zipfile.ZipFile(plain) as archive:
        content = archive.read(f"{name}.npy")
    with zipfile.ZipFile(plain, "a") as archive:
        archive.writestr(f"{name}.npy", content)
    with pytest.raises(ValueError, match=f"two members called {name}"):
        load(plain, zoo.linear_gaussian())
