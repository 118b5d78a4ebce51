"""Lines of commands: absurd values of options, models and files that are none."""

from __future__ import annotations

import sys

from attempts.tables import DESIGN, FILTER, MODEL

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
    """What only a process of its own shows: closed pipes, full disks, little memory."""
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
        "file as large as allowed": (
            f"cp f.npz g.npz; ulimit -f 1; {made[: -len('f.npz')]}g.npz; code=$?; "
            "cmp f.npz g.npz || exit 99; exit $code"
        ),
        "memory limit": f"ulimit -v 600000; {made}",
        "no home": f"env -i PATH=$PATH PYTHONPATH=$PYTHONPATH {run}",
        "other language": f"LC_ALL=C PYTHONUTF8=0 {run}",
    }
