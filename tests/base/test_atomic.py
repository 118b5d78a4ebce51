"""Files that are written whole or not at all."""

import os
import stat
import sys
import threading

import numpy as np
import pytest

from seedslib import zoo
from seedslib.base import atomic
from seedslib.base.atomic import replacing, write_whole
from seedslib.design import synthesize
from seedslib.designed import Memory, load, save
from seedslib.extra import to_c
from seedslib.filters import extended_kalman
from seedslib.linearization import Taylor


@pytest.fixture
def old(tmp_path):
    path = tmp_path / "kept"
    path.write_bytes(b"old")
    return path


def alone(path):
    return os.listdir(path.parent) == [path.name]


def test_a_file_is_replaced(old):
    write_whole(old, b"new\x00\n")
    assert old.read_bytes() == b"new\x00\n"
    assert alone(old)


def test_an_exception_on_the_way_leaves_the_old_file(old):
    def work():
        with replacing(old) as file:
            file.write(b"half of it")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert old.read_bytes() == b"old"
    assert alone(old)


@pytest.mark.parametrize("place", ["fsync", "replace"])
def test_a_disk_that_fails_at_the_end_leaves_the_old_file(old, monkeypatch, place):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic.os, place, full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(old, b"new")
    assert old.read_bytes() == b"old"
    assert alone(old)


def test_a_folder_that_is_missing_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_whole(tmp_path / "none" / "x", b"")
    with pytest.raises(IsADirectoryError):
        write_whole(tmp_path, b"")
    assert list(tmp_path.iterdir()) == []


def test_permissions_are_those_of_the_old_file_or_of_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "a", b"1")
        assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640
        (tmp_path / "a").chmod(0o604)
        write_whole(tmp_path / "a", b"2")
        assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o604
    finally:
        os.umask(before)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write to every file")
def test_a_file_that_may_not_be_written_is_not_replaced(old):
    old.chmod(0o444)
    with pytest.raises(PermissionError):
        write_whole(old, b"new")
    assert old.read_bytes() == b"old"


def test_through_a_link_the_file_behind_it_is_replaced(old, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(old.name)
    write_whole(link, b"new")
    assert link.is_symlink()
    assert old.read_bytes() == b"new"


def test_what_is_no_file_is_written_to(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    found = []
    reader = threading.Thread(target=lambda: found.append(pipe.read_bytes()))
    reader.start()
    write_whole(pipe, b"content")
    reader.join(10)
    assert found == [b"content"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_reader_beside_two_writers_sees_whole_files(old):
    contents = [bytes([k]) * 200_000 for k in range(2)]
    stop = threading.Event()

    def writing(content):
        while not stop.is_set():
            write_whole(old, content)

    write_whole(old, contents[0])
    writers = [threading.Thread(target=writing, args=(c,)) for c in contents]
    for writer in writers:
        writer.start()
    try:
        seen = {old.read_bytes() for _ in range(200)}
    finally:
        stop.set()
        for writer in writers:
            writer.join()
    assert seen <= set(contents)
    assert alone(old)


# What the library keeps in files


@pytest.fixture(scope="module")
def designs():
    system = zoo.linear_gaussian()
    return [
        synthesize(system, Memory(k), Taylor(), np.arange(k + 2.0), exact_moments=True, nodes=0)
        for k in (1, 9)
    ]


FULL = """
import resource, sys
import numpy as np
from seedslib import zoo
from seedslib.commands.estimates import write_estimates
from seedslib.commands.records import Record
from seedslib.design import synthesize
from seedslib.designed import Memory, save
from seedslib.extra import to_c
from seedslib.filters import Estimates, extended_kalman
from seedslib.linearization import Taylor

system = zoo.linear_gaussian()
record = Record(np.arange(900.0), np.ones((900, 1)), cells=["0"] * 900)
large = synthesize(system, Memory(9), Taylor(), np.arange(11.0), exact_moments=True, nodes=0)
works = {
    "f.npz": lambda: save(large, "f.npz"),
    "x.csv": lambda: write_estimates("x.csv", record, Estimates(np.ones((900, 2)))),
    "f.h": lambda: to_c(extended_kalman(system), "f.h"),
}
resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))
for name, work in works.items():
    try:
        work()
    except OSError as error:
        print(name, error.strerror)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a limit of Linux")
def test_a_full_disk_costs_no_design_no_record_no_header(designs, tmp_path, command):
    save(designs[0], tmp_path / "f.npz")
    to_c(extended_kalman(zoo.linear_gaussian()), tmp_path / "f.h")
    (tmp_path / "x.csv").write_text("t,x1\n")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    done = command(tmp_path, "-c", FULL)
    assert done.stdout.splitlines() == [f"{n} File too large" for n in ("f.npz", "x.csv", "f.h")]
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert load(tmp_path / "f.npz", zoo.linear_gaussian()).order == designs[0].order


def test_a_save_that_is_broken_off_leaves_the_old_design(designs, tmp_path, monkeypatch):
    save(designs[0], tmp_path / "f.npz")
    monkeypatch.setattr(atomic.os, "fsync", lambda _: (_ for _ in ()).throw(OSError(5, "I/O")))
    with pytest.raises(OSError, match="I/O"):
        save(designs[1], tmp_path / "f.npz")
    assert os.listdir(tmp_path) == ["f.npz"]
    assert load(tmp_path / "f.npz", zoo.linear_gaussian()).order == designs[0].order
