"""Tables of measurements, random and the same ones each time."""

from __future__ import annotations

import random

import numpy as np

SEED = 4711
TABLES = 700
MODEL = (
    "from seedslib.models import LinearSystem\n"
    "system = LinearSystem(1, .5, 1, 2, 1, 3)\ntimes = [0, 1, 2]\n"
)
CELLS = (
    "",
    "NA",
    "nan",
    "NaN",
    "1e999",
    "-inf",
    "inf",
    "x",
    "1_0",
    "0x1",
    "1,5",
    "2026-01-02",
    "1e308",
    "-1e308",
    "5e-324",
    "1d3",
    "+1",
    "١",
    "1 000",
    "'1'",
    '"2"',
    '"',
    "=1+1",
    "True",
    "None",
    "1j",
    "\x00",
    "1e",
    ".",
    "-",
    "--1",
    "1.2.3",
    "nan(1)",
    "0",
    "1",
    "-0.0",
    "3.5",
    "2",
    "1e-300",
)
HEADS = (
    "t,y1",
    "t;y1",
    "y1",
    "t,y1,y1",
    "a b",
    "t\ty1",
    "T,Y1",
    "t,y2",
    "y1,t",
    "",
    "t,,y1",
    "t,y1,z",
)
GOOD = "t,y1\n0,1.5\n1,-0.25\n2,2\n"


FILTER = ("filter", "m.py", "d.csv", "--kind", "KalmanFilter", "--out", "x.csv")
DESIGN = (
    "design",
    "m.py",
    "--memory",
    "estimates=1",
    "--paths",
    "50",
    "--nodes",
    "0",
    "--out",
    "f.npz",
)


def tables() -> list[str]:
    """Random tables, the same ones each time."""
    draw = random.Random(SEED)
    found = []
    for _ in range(TABLES):
        mark = draw.choice(",,,,;\t")
        head = draw.choice(HEADS) if draw.random() < 0.6 else f"t{mark}y1"
        lines = [head]
        for k in range(draw.randrange(6)):
            first = str(k) if draw.random() < 0.7 else draw.choice(CELLS)
            count = 1 if draw.random() < 0.8 else draw.randrange(4)
            lines.append(mark.join([first, *(draw.choice(CELLS) for _ in range(count))]))
        found.append(
            draw.choice(("\n", "\n", "\r\n", "\r")).join(lines) + draw.choice(("\n", "", "\n\n"))
        )
    return found


def binaries() -> list[bytes]:
    rng = np.random.default_rng(SEED)
    good = GOOD.encode()
    odd = [
        b"\xff\xfe" + GOOD.encode("utf-16-le"),
        GOOD.encode("utf-16"),
        b"\xef\xbb\xbf" + good,
        bytes(1000),
        b"PK\x03\x04",
        b"t,y1\n" + b"0," * 100_000 + b"\n",
        b't,y1\n0,"' + b"x" * 200_000,
        b"\n" * 10_000,
    ]
    flips = []
    for _ in range(300):
        where, value = int(rng.integers(len(good))), int(rng.integers(256))
        flips.append(good[:where] + bytes([value]) + good[where + 1 :])
    return odd + flips + [rng.bytes(60) for _ in range(60)]
