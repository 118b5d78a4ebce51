"""Commands: tables of all shapes, outputs over inputs, absurd options, models that misbehave."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from functools import cache, partial
from pathlib import Path

import numpy as np

from attempts.judge import Attempt, Crashed, Refused, command, told
from seedslib.commands.cli import main

SEED = 4711
TABLES = 700
MODEL = "from seedslib.models import LinearSystem\nsystem = LinearSystem(1, .5, 1, 2, 1, 3)\ntimes = [0, 1, 2]\n"
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
WANTED = [1.0 + 3 / 5 * 0.5]  # the Kalman filter's first estimate by hand
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


def attempts() -> list[Attempt]:
    """All of them."""
    found = []
    for k, text in enumerate(tables()):
        found.append(Attempt(f"table {k}: {text!r}"[:120], partial(filtered, text), written))
    for k, content in enumerate(binaries()):
        found.append(Attempt(f"table of bytes {k}", partial(filtered, content), written))
    found.append(Attempt("a good table", partial(filtered, GOOD), first_right, legal=True))
    for arguments in options():
        found.append(Attempt(" ".join(arguments)[:150], partial(here, arguments), written))
    for arguments in overwriting():
        found.append(Attempt(f"over its input: {' '.join(arguments)}", partial(spared, arguments)))
    for name, source in models().items():
        found.append(Attempt(f"model: {name}", partial(modelled, source)))
    for what, arguments in refused().items():
        found.append(Attempt(what, partial(here, arguments)))
    for what, shell in processes().items():
        found.append(Attempt(what, partial(shelled, shell), right_code))
    return found


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


def filtered(text: str | bytes) -> int:
    prepared()
    Path("d.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return command(main, FILTER)


@cache
def design() -> bytes:
    command(main, DESIGN)
    return Path("f.npz").read_bytes()


def prepared() -> None:
    Path("m.py").write_text(MODEL)
    Path("d.csv").write_text(GOOD)
    Path("f.npz").write_bytes(design())


def here(arguments: tuple[str, ...]) -> int:
    prepared()
    return command(main, arguments)


def written(code: int) -> bool:
    """Where nothing was refused: each row has finite numbers, or the code is 1 and a line said it."""
    if code == 1:
        return True
    if not Path("x.csv").exists():
        return Path("g.npz").exists()
    rows = Path("x.csv").read_text().splitlines()
    cells = [cell for row in rows[1:] for cell in row.split(",")[1:] if cell]
    return len(rows) > 1 and bool(np.isfinite(np.array(cells, dtype=float)).all())


def first_right(code: int) -> bool:
    """The estimate after the first measurement, by hand: 1 + 3/(3 + 2) (1.5 - 1)."""
    rows = [row.split(",") for row in Path("x.csv").read_text().splitlines()]
    return code == 0 and float(rows[1][rows[0].index("x1")]) == WANTED[0]


NUMBERS = (
    "-1",
    "0",
    "nan",
    "inf",
    "1e400",
    "x",
    "",
    "1.5",
    "99999999999999999999",
    "0x10",
    "1_0",
    "١",
    "None",
)


def options() -> list[tuple[str, ...]]:
    """Absurd values of each option; few of them are legal."""
    found = []
    for name in ("--paths", "--nodes", "--seed", "--workers", "--components", "--cycle"):
        for value in NUMBERS:
            if (name, value) in TOO_MUCH:
                continue
            found.append((*DESIGN[:-2], name, value, "--out", "g.npz"))
    words = (
        "",
        "x",
        "estimates",
        "estimates=",
        "estimates=-1",
        "estimates=nan",
        "estimates=1e9",
        "measurements=1_0",
        ":",
        "=",
        ",",
        "affine:3",
        "polynomial:-1,2",
        "polynomial:1e9",
        "gauss-hermite:0",
        "gauss-hermite:x",
        "gauss-hermite:9999999999",
        "unscented:a,b,c",
        "unscented:0,0,0",
        "__import__('os')",
        "../x",
        "@d.csv",
        "@none.csv:t",
        "0:1:0",
        "0:1:-1",
        "1:0:1",
        "0:inf:1",
        "nan",
        "0,0",
        "2,1",
        "0:1",
        "y=0:1:1",
        "y=1:0:9",
        "y=0:1:nan",
        "q=0:1:9",
        "1.5",
        "0.5,0.5,0.5",
        "-1",
    )
    for name in (
        "--memory",
        "--linearization",
        "--predictor",
        "--times",
        "--availability",
        "--measured",
        "--table",
        "--stationary",
    ):
        for word in words:
            found.append((*DESIGN[:-2], f"{name}={word}", "--out", "g.npz"))
    for name in ("--lag", "--forecast", "--every", "--level", "--seed", "--until"):
        for value in NUMBERS:
            if (name, value) not in TOO_MUCH:
                found.append((*FILTER, name, value))
                found.append((*FILTER, "--smooth", name, value))
    for name in (
        "--time",
        "--columns",
        "--inputs",
        "--unit",
        "--epoch",
        "--set",
        "--kind",
        "--model",
    ):
        for value in (
            "",
            "x",
            "=",
            "y1=",
            "t",
            "y1",
            "y1=t",
            "y1=y1",
            "a=b,c=d",
            "m.py",
            "d.csv",
            "\n",
            "1",
            "KalmanFilter",
            "__import__('os')",
            "extended_kalman:x",
        ):
            found.append((*FILTER, f"{name}={value}"))
    return found


TOO_MUCH = {
    ("--workers", "99999999999999999999"),
    ("--paths", "99999999999999999999"),
    ("--nodes", "99999999999999999999"),
    ("--forecast", "99999999999999999999"),
}
"""Requests without a limit are another matter."""


def overwriting() -> list[tuple[str, ...]]:
    """Outputs that are inputs, by their names and by other names of theirs."""
    found = []
    for name in ("m.py", "./m.py", "../" + "HERE/m.py", "link", "hard"):
        found.append((*DESIGN[:-1], name))
        found.append((*FILTER[:-1], name))
    for name in ("d.csv", "./d.csv", "f.npz", "./f.npz"):
        found.append(("filter", "f.npz", "d.csv", "--model", "m.py", "--out", name))
        found.append(("filter", "f.npz", "d.csv", "--model=m.py", f"--out={name}"))
    return found


def spared(arguments: tuple[str, ...]) -> int:
    """A command whose output is one of its inputs, which must stay as they are."""
    prepared()
    Path("link").symlink_to("m.py")
    os.link("m.py", "hard")
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    try:
        return command(main, [a.replace("HERE", Path.cwd().name) for a in arguments])
    finally:
        if {path.name: path.read_bytes() for path in Path().iterdir()} != before:
            raise Crashed("an input was overwritten")


def models() -> dict[str, str]:
    """Model files that are none."""
    leave = {
        s: f"import sys, os\n{s}\n"
        for s in (
            "sys.exit(3)",
            "raise SystemExit('no')",
            "exit(3)",
            "quit()",
            "raise KeyError('k')",
            "raise ValueError",
            "1/0",
            "raise Exception()",
            "raise GeneratorExit",
            "raise StopIteration",
            "assert False",
            "import nothing_of_this_name",
            "def f(): f()\nf()",
            "raise UnicodeDecodeError('utf-8', b'', 0, 1, 'x')",
            "x = [",
            "raise ExceptionGroup('g', [ValueError()])",
        )
    }
    values = {
        f"system = {v}": f"system = {v}\n"
        for v in (
            "None",
            "1",
            "'x'",
            "[]",
            "object",
            "lambda: None",
            "lambda: 1/0",
            "lambda x: x",
            "type",
            "{}",
            "print",
        )
    }
    times = {
        f"times = {v}": MODEL + f"times = {v}\n"
        for v in (
            "[]",
            "[1, 0]",
            "'x'",
            "None",
            "[float('nan')]",
            "[[0, 1]]",
            "object()",
            "1",
            "[0, float('inf')]",
            "[-1, 0]",
            "{}",
        )
    }
    return leave | values | times | {"empty": "", "bytes": "\x00", "no text": "\udcff"}


def modelled(source: str) -> int:
    prepared()
    Path("m.py").write_bytes(source.encode(errors="surrogateescape"))
    return command(main, DESIGN)


def refused() -> dict[str, tuple[str, ...]]:
    """What there is not, or not of this kind."""
    places = {
        "no such file": "none",
        "a folder": ".",
        "a device": "/dev/null",
        "no name": "",
        "too long": "x" * 5000,
        "NUL": "a\x00b",
    }
    found = {}
    for what, place in places.items():
        found[f"design, model: {what}"] = ("design", place, *DESIGN[2:])
        found[f"filter, model: {what}"] = ("filter", place, *FILTER[2:])
        found[f"filter, table: {what}"] = ("filter", "m.py", place, *FILTER[3:])
        if what not in ("no such file", "a device"):
            found[f"filter, out: {what}"] = (*FILTER[:-1], place)
            found[f"design, out: {what}"] = (*DESIGN[:-1], place)
    found |= {
        "out in no folder": (*FILTER[:-1], "none/x.csv"),
        "no command": (),
        "no such command": ("x",),
        "option without value": FILTER[:-1],
        "unknown option": (*FILTER, "--x"),
        "two tables": (*FILTER, "d.csv"),
        "table as filter": ("filter", "d.csv", "d.csv", "--out", "x.csv"),
        "filter without model": ("filter", "f.npz", "d.csv", "--out", "x.csv"),
        "filter as table": ("filter", "m.py", "f.npz", *FILTER[3:]),
    }
    return found


def processes() -> dict[str, str]:
    """What only a process of its own shows: closed pipes, full disks, folders and files read only."""
    python = f"{sys.executable} -m seedslib"
    run = f"{python} {' '.join(FILTER)}"
    made = f"{python} {' '.join(DESIGN)}"
    return {
        "pipe closed": f"{made} | head -c 0; exit ${{PIPESTATUS[0]}}",
        "stdout closed": f"{made} >&-",
        "stderr closed": f"{run} --level 7 2>&-",
        "both closed": f"{made} >&- 2>&-",
        "full device for stdout": f"{made} > /dev/full",
        "full device for the result": f"{run[: -len('x.csv')]}/dev/full",
        "file as large as allowed": f"cp f.npz g.npz; ulimit -f 1; {made[: -len('f.npz')]}g.npz; code=$?; cmp f.npz g.npz || exit 99; exit $code",
        "memory limit": f"ulimit -v 600000; {made}",
        "no home": f"env -i PATH=$PATH PYTHONPATH=$PYTHONPATH {run}",
        "other language": f"LC_ALL=C PYTHONUTF8=0 {run}",
    }


def shelled(shell: str) -> int:
    prepared()
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True)
    if done.returncode == 99:
        raise Crashed("the old file is gone")
    if done.returncode < 0:
        raise Crashed(f"signal {-done.returncode}")
    lines = done.stderr.strip().splitlines()
    if done.returncode == 2 and not lines and "2>&-" in shell:
        raise Refused("command: wanted another, got nothing to say it to")
    return told(done.returncode, lines)


def right_code(code: int) -> bool:
    return code == 0
