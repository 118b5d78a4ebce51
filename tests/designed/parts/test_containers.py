"""Files of designs byte by byte, and the trees of descriptions in their headers."""

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import seedslib
from seedslib.base.tables import Labels
from seedslib.designed import Memory
from seedslib.designed.archive import FORMAT, VERSION, read, write
from seedslib.designed.codec import known_class, packed, unpacked
from seedslib.designed.files import _linearization
from seedslib.designed.outputs.minimax import Minimax
from seedslib.designed.predictors import Affine, AffineFit, Polynomial
from seedslib.linearization import GaussHermite, Taylor, Unscented

ARRAYS = {
    "plain": np.arange(6.0).reshape(2, 3), "turned": np.arange(6.0).reshape(3, 2).T,
    "big": np.arange(3, dtype=">i4"), "bits": np.array([True, False]), "one": np.array(1.5),
    "none": np.empty((0, 2)), "small": np.arange(3, dtype=np.uint8),
}  # fmt: skip


def test_a_file_is_plain_arrays_in_their_order(tmp_path):
    """Neither compressed nor dated, and numpy reads them."""
    path = tmp_path / "a.npz"
    write(path, {"b": 1, "a": [2, None]}, ARRAYS)
    with zipfile.ZipFile(path) as archive:
        names = [entry.filename for entry in archive.infolist()]
        assert names == [f"{name}.npy" for name in ("header", *ARRAYS, "checksum")]
        whole = hashlib.sha256()
        for entry in archive.infolist():
            assert entry.date_time == (1980, 1, 1, 0, 0, 0)
            assert (entry.create_system, entry.compress_type) == (3, zipfile.ZIP_STORED)
            assert entry.external_attr == 0o600 << 16  # of its owner alone
            content = archive.read(entry)
            assert content[:8] == b"\x93NUMPY\x01\x00"
            if entry.filename != "checksum.npy":
                name = entry.filename.removesuffix(".npy")
                whole.update(f"{name} {len(content)} ".encode() + content)
    with np.load(path, allow_pickle=False) as archive:
        for name, array in ARRAYS.items():
            assert_array_equal(archive[name], array)
            assert archive[name].dtype == array.dtype.newbyteorder("<")
        assert archive["turned"].flags.f_contiguous
        assert archive["checksum"].tobytes() == whole.digest()
        text = archive["header"].tobytes().decode()
    header = {
        "format": FORMAT, "version": VERSION, "b": 1, "a": [2, None],
        "versions": {"seedslib": seedslib.__version__, "numpy": np.__version__},
    }  # fmt: skip
    assert text == json.dumps(header, sort_keys=True)
    found, arrays = read(path)
    assert found == header
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert_array_equal(arrays[name], array)
        assert arrays[name].flags.writeable
    assert arrays["turned"].flags.f_contiguous
    assert arrays["plain"].flags.c_contiguous
    again = tmp_path / "b.npz"
    write(again, {"a": [2, None], "b": 1}, ARRAYS)
    assert again.read_bytes() == path.read_bytes()


def altered(path, **changes):
    """The file with other members, None for none, summed up anew."""
    with zipfile.ZipFile(path) as archive:
        members = {e.filename.removesuffix(".npy"): archive.read(e) for e in archive.infolist()}
    del members["checksum"]
    members.update(changes)
    whole = hashlib.sha256()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            if content is not None:
                archive.writestr(f"{name}.npy", content)
                whole.update(f"{name} {len(content)} ".encode() + content)
        if "checksum" not in changes:
            archive.writestr("checksum.npy", npy(np.frombuffer(whole.digest(), np.uint8)))


def npy(array, version=(1, 0)):
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asarray(array), version=version, allow_pickle=True)
    return buffer.getvalue()


def head(text):
    return npy(np.frombuffer(text.encode(), np.uint8))


def test_files_that_are_read_again_and_files_that_are_not(tmp_path):
    path = tmp_path / "a.npz"
    good = {"x": np.arange(3.0)}
    damage, none = r"^a\.npz: damaged or cut short \(", r"^a\.npz: not a designed filter \("
    say = json.dumps({"format": FORMAT, "version": VERSION})
    for changes, message in (
        ({"x": npy(np.arange(3.0), version=(2, 0))}, damage + r"no array of version 1\.0\)$"),
        ({"x": npy(np.arange(3.0))[:60]}, damage + r"no array of version 1\.0\)$"),
        ({"x": npy(np.arange(3.0))[:-1]}, damage + r"23 bytes for shape \(3,\) of float64\)$"),
        ({"x": npy(np.arange(3.0)) + b"\0"}, damage + r"25 bytes for shape \(3,\) of float64\)$"),
        ({"x": npy(np.array(["abc"]))}, damage + r"12 bytes for shape \(1,\) of <U3\)$"),
        ({"x": npy(np.array([1j]))}, damage + r"16 bytes for shape \(1,\) of complex128\)$"),
        ({"x": npy(np.array([None]))}, damage),
        ({"header": None}, none + r"no header of one\)$"),
        ({"header": head("[1]")}, none + r"no header of one\)$"),
        ({"header": head("{}")}, none + r"no header of one\)$"),
        ({"header": head("{")}, none + r"no header of one\)$"),
        ({"header": head("[" * 100_000)}, none + r"no header of one\)$"),
        ({"header": head(json.dumps({"format": "x"}))}, rf"^a\.npz: not a {FORMAT} \(it says 'x'"),
        ({"header": head(json.dumps({"format": FORMAT}))},
         r"^a\.npz: wanted version 3 of the format, got None$"),
        ({"checksum": None}, r"^a\.npz: damaged or altered \("),
        ({"checksum": npy(np.zeros(32, np.uint8))}, r"^a\.npz: damaged or altered \("),
        ({}, None),
        ({"header": head(say)}, None),
    ):  # fmt: skip
        write(path, {}, good)
        altered(path, **changes)
        if message is None:
            assert_array_equal(read(path)[1]["x"], good["x"])
            continue
        with pytest.raises(ValueError, match=message):
            read(path)
    write(path, {"format": "another thing"}, good)
    with pytest.raises(ValueError, match=rf"^a\.npz: not a {FORMAT} \(it says 'another thing'\)$"):
        read(path)
    assert read(path, "another thing")[0]["format"] == "another thing"
    path.write_bytes(b"P" + b"x" * 50)
    with pytest.raises(ValueError, match=none + r"not an npz file\)$"):
        read(path)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "b.npz")


# Trees


def test_a_tree_and_its_arrays():
    """Descriptions by their fields, arrays by their paths, numbers of NumPy as numbers."""
    fit = AffineFit(np.eye(2), np.zeros(2), np.ones((2, 2)))
    thing = (Memory(1), [fit, (None, True, 2, 0.5, "word")], np.float64(0.25), np.int64(3), ())
    tree, arrays = packed(thing)
    array = {"class": "array"}
    assert tree == [
        {"class": "Memory", "estimates": 1, "measurements": 0, "indicators": 0, "log_odds": False},
        {"class": "list", "parts": [
            {"class": "AffineFit", "gain": array, "offset": array, "cov": array},
            [None, True, 2, 0.5, "word"],
        ]},
        0.25, 3, [],
    ]  # fmt: skip
    assert type(tree[2]) is float
    assert type(tree[3]) is int
    assert set(arrays) == {"1/0/gain", "1/0/offset", "1/0/cov"}
    assert arrays["1/0/gain"] is fit.gain
    back = unpacked(json.loads(json.dumps(tree)), arrays)
    assert back[0] == thing[0]
    assert type(back[1]) is list
    assert type(back[1][0]) is AffineFit
    assert back[1][0].cov is fit.cov
    assert back[1][1:] == [(None, True, 2, 0.5, "word")]
    assert back[2:] == (0.25, 3, ())
    alone, held = packed(np.arange(3))
    assert alone == array
    assert_array_equal(unpacked(alone, held), np.arange(3))


def test_fields_that_are_left_out_are_given_again():
    """Of the whole alone: parts of one name are kept."""

    class Pair(NamedTuple):
        one: object
        two: object

    known = {"Pair": Pair}
    tree, arrays = packed(Pair(Pair(1, np.ones(2)), 5), ("one",), known)
    assert tree == {"class": "Pair", "two": 5}
    assert arrays == {}
    tree, arrays = packed(Pair(7, Pair(1, np.ones(2))), ("one",), known)
    assert tree == {"class": "Pair", "two": {"class": "Pair", "one": 1, "two": {"class": "array"}}}
    assert set(arrays) == {"two/two"}
    back = unpacked(tree, arrays, known=known, one="given")
    assert back.one == "given"
    assert back.two.one == 1
    again = unpacked({**tree, "one": {"class": "nothing"}}, arrays, known=known, one=3)
    assert again.one == 3
    with pytest.raises(ValueError, match=r"^two is a 'Pair'$"):
        unpacked({"class": "Labels", "two": {"class": "Pair"}}, {})
    with pytest.raises(ValueError, match=r"^filter is a 'Pair'$"):
        unpacked(tree, arrays)
    with pytest.raises(KeyError):
        unpacked({"class": "array"}, {}, "somewhere")
    with pytest.raises(TypeError):
        unpacked({"class": "Memory", "more": 1}, {})


def test_what_is_no_description_is_refused_by_its_place():
    class Memory(NamedTuple):  # of one name, but another
        estimates: int

    for thing, message in (
        (object(), "filter: wanted a description or numbers, got object"),
        ((1, (2, Memory(1))), "1/1: wanted a description or numbers, got Memory"),
        (Minimax(None, min), "correction: wanted a description or numbers, got builtin_function"),
        ([np.array([None])], "0: wanted a description or numbers, got ndarray"),
        ({"a": 1}, "filter: wanted a description or numbers, got dict"),
    ):
        with pytest.raises(TypeError, match=f"^{message}"):
            packed(thing)
    assert known_class("Taylor") is Taylor
    assert known_class("Labels") is Labels
    assert known_class("Labels", {}) is known_class("os") is None
    for part in (Affine(), Polynomial(2, 1), Taylor(), Unscented(0.5, 2.0, 1.0), Labels(4)):
        assert unpacked(*packed(part)) == part


def test_linearizations_that_a_file_may_ask_for():
    """At most 256 nodes in a direction, and 2^22 together."""
    path = Path("a.npz")

    def asked(order, size):
        return _linearization(path, {"class": "GaussHermite", "order": order}, size)

    for order, size in ((256, 1), (256, 2), (161, 3)):
        assert asked(order, size) == GaussHermite(order)
    for order, size in ((257, 1), (162, 3), (256, 3)):
        with pytest.raises(ValueError, match=rf"^a\.npz: the file contradicts itself \(.*{order}"):
            asked(order, size)
    assert _linearization(path, {"class": "Taylor"}, 30) == Taylor()
    for tree in ({"class": "Memory"}, "Taylor", {}):
        with pytest.raises(ValueError, match=r"^a\.npz: its linearization .* is not the library's"):
            _linearization(path, tree, 1)
