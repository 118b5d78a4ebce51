"""Files written whole or not at all: a reader never sees half of one, a full disk costs nothing."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """A new file, open for writing bytes, that takes the place of an old one when all is there.

    The bytes go to a file beside it, are forced to the disk, and the name is then moved over; when
    anything fails on the way, the old file is as it was and nothing is left beside it. The
    permissions are those of the old file, or what the process gives to new ones. Through a link
    the file behind it is replaced; what is no file, such as a pipe, is written to as it is.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    OSError
        No such folder, no room on the disk, no permission.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        with path.open("wb") as file:
            yield file
        return
    path = Path(os.path.realpath(path))
    if path.exists() and not os.access(path, os.W_OK):
        # a rename would not ask: it is the folder that it writes to
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    partial = path.with_name(f".{path.name[:40]}.{secrets.token_hex(6)}.part")
    try:
        # made anew, so that nobody's link or file of this name is followed; the umask holds
        with partial.open("xb") as file:
            if path.exists():
                shutil.copymode(path, partial)
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file by `replacing`."""
    with replacing(path) as file:
        file.write(content)
