"""On which addresses processes listen, from the tables of Linux."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path

LISTENING = "0A"


def family(pid):
    """A process and all its descendants."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += family(int(child))
    return found


def listening(pids):
    """Addresses on which processes listen: inodes of their sockets, looked up in the tables."""
    inodes = set()
    for pid in pids:
        for file in Path(f"/proc/{pid}/fd").iterdir():
            try:
                name = os.readlink(file)
            except FileNotFoundError:
                continue
            if name.startswith("socket:["):
                inodes.add(name[8:-1])
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            cells = line.split()
            if cells[3] == LISTENING and cells[9] in inodes:
                packed = bytes.fromhex(cells[1].split(":")[0])
                words = [packed[i : i + 4][::-1] for i in range(0, len(packed), 4)]
                found.append(ipaddress.ip_address(b"".join(words)))
    return found


def is_local(address):
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback
