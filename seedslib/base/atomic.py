"""Files written whole or not at all: a reader never sees half of one, a full disk costs nothing."""

from __future__ import annotations

import os
import secrets
from pathlib import Path


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file that takes the place of an old one when all is there.

    The bytes go to a file beside it, and the name is then moved over; when anything fails on the
    way, the old file is as it was and nothing is left beside it.

    Parameters
    ----------
    path : path-like
    content : bytes

    Raises
    ------
    OSError
        No such folder, no room on the disk, no permission.
    """
    path = Path(path)
    partial = path.with_name(f".{secrets.token_hex(6)}.part")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
