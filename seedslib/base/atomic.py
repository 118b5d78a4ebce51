"""Files written whole or not at all: a reader never sees half of one, a full disk costs nothing."""

from __future__ import annotations

import os
import secrets
import shutil
from pathlib import Path


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file that takes the place of an old one when all is there.

    The bytes go to a file beside it, are forced to the disk, and the name is then moved over; when
    anything fails on the way, the old file is as it was and nothing is left beside it. The
    permissions are those of the old file, or what the process gives to new ones. Through a link
    the file behind it is replaced.

    Parameters
    ----------
    path : path-like
    content : bytes

    Raises
    ------
    OSError
        No such folder, no room on the disk, no permission.
    """
    path = Path(os.path.realpath(path))
    partial = path.with_name(f".{path.name[:40]}.{secrets.token_hex(6)}.part")
    try:
        with partial.open("xb") as file:  # made anew: nobody's file of this name is followed
            if path.exists():
                shutil.copymode(path, partial)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
