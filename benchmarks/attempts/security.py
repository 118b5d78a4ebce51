"""Who can reach what: doors of a sweep, files that are made, what is imported to read a file."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import socket
import stat
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from attempts.commands import prepared
from attempts.judge import Attempt, command
from attempts.sockets import is_local, listening
from attempts.tables import DESIGN, FILTER
from seedslib.commands.cli import main
from seedslib.designed import load

HEAVY = ("requests", "distributed", "dask", "cloudpickle", "IPython", "papermill", "yaml")


def attempts() -> list[Attempt]:
    """All of them."""
    found = [
        Attempt(f"doors of a sweep of {n}", partial(doors, n), all_local, legal=True)
        for n in (1, 2)
    ]
    found.append(Attempt("an open door is seen", open_door, lambda seen: seen, legal=True))
    for mask in (0o000, 0o022, 0o077):
        for arguments in (DESIGN, FILTER):
            found.append(
                Attempt(
                    f"{arguments[0]} with umask {mask:o}",
                    partial(written, arguments, mask),
                    partial(modes, mask),
                    legal=True,
                )
            )
    for target in ("loose", "m.py", "none/x"):
        for arguments in (DESIGN, FILTER):
            found.append(
                Attempt(
                    f"{arguments[0]} to a link to {target}",
                    partial(linked, arguments, target),
                    spared,
                )
            )
    found.append(
        Attempt(
            "reading a design imports no more than it needs",
            imported,
            lambda names: names == [],
            legal=True,
        )
    )
    found.append(
        Attempt(
            "nothing is left in the folder for temporary files",
            scratch,
            lambda left: left == [],
            legal=True,
        )
    )
    return found


def doors(workers: int) -> list:
    """In a process of its own: workers of a sweep are started anew from it."""
    code = (
        "import os, sys; sys.path.insert(0, sys.argv[1])\n"
        "from attempts.sockets import family, listening\nfrom bookkit import sweeps\n"
        f"if __name__ == '__main__':\n"
        f"    with sweeps._client(None, {workers}) as client:\n"
        f"        client.wait_for_workers({workers})\n"
        "        print(*listening(family(os.getpid())))\n"
    )
    Path("doors.py").write_text(code)
    done = subprocess.run(
        [sys.executable, "doors.py", str(Path(__file__).parents[1])],
        capture_output=True,
        text=True,
        check=True,
    )
    return [ipaddress.ip_address(word) for word in done.stdout.split()]


def all_local(found: list) -> bool:
    return len(found) >= 2 and all(map(is_local, found))


def open_door() -> bool:
    with socket.socket() as door:
        door.bind(("0.0.0.0", 0))
        door.listen()
        return ipaddress.ip_address("0.0.0.0") in listening([os.getpid()])


def written(arguments, mask: int) -> Path:
    prepared()
    Path(arguments[-1]).unlink(missing_ok=True)
    before = os.umask(mask)
    try:
        command(main, arguments)
    finally:
        os.umask(before)
    return Path(arguments[-1])


def modes(mask: int, path: Path) -> bool:
    """As `open` would make it: readable by those whom the mask does not keep out, run by none."""
    return stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask


def linked(arguments, target: str) -> bytes:
    prepared()
    Path("loose").write_text("loose")
    out = Path("out")
    out.symlink_to(target)
    before = Path("m.py").read_bytes()
    command(main, (*arguments[:-1], "out"))
    assert Path("m.py").read_bytes() == before
    return Path("loose").read_bytes()


def spared(found: bytes) -> bool:
    """A link is followed or replaced; a model is never written over."""
    return True


def imported() -> list[str]:
    """What reading a table imports that can run, send or unpickle."""
    prepared()
    code = (
        "import sys\nfrom seedslib.designed import load\n"
        "try:\n    load('f.npz')\nexcept ValueError:\n    pass\n"
        f"print(*[m for m in {HEAVY} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.split()


def scratch() -> list[str]:
    prepared()
    before = set(os.listdir(tempfile.gettempdir()))
    command(main, DESIGN)
    command(main, FILTER)
    with contextlib.suppress(ValueError):
        load("f.npz")
    return [n for n in set(os.listdir(tempfile.gettempdir())) - before if "seedslib" in n]
