"""Commands: tables of all shapes, outputs over inputs, absurd options, models that misbehave."""

from __future__ import annotations

import os
import subprocess
from functools import cache, partial
from pathlib import Path

import numpy as np

from attempts.judge import Attempt, Crashed, Refused, command, told
from attempts.lines import models, options, overwriting, processes, refused
from attempts.tables import DESIGN, FILTER, GOOD, MODEL, binaries, tables
from seedslib.commands.cli import main

WANTED = [1.0 + 3 / 5 * 0.5]  # the Kalman filter's first estimate by hand


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
    """Each row has finite numbers, or the code is 1 and a line said why."""
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


def modelled(source: str) -> int:
    prepared()
    Path("m.py").write_bytes(source.encode(errors="surrogateescape"))
    return command(main, DESIGN)


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
