"""Grids of sweeps, results of points that were tampered with, ledgers."""

from __future__ import annotations

import json
import random
from functools import partial
from pathlib import Path

import numpy as np

from attempts.judge import Attempt
from bookkit import kept
from bookkit.claims import read_ledger
from bookkit.grids import read_grid

SEED = 99
POINT = {"gain": 1.0, "count": 2}
ENTRY = kept.sealed(
    {"parameters": POINT, "values": {"total": 3.0, "terms": [1.0, 2.0]}, "problem": ""}
)
ODD = (
    None,
    True,
    -1,
    1.5,
    "x",
    "",
    [],
    {},
    [[]],
    [None],
    float("nan"),
    float("inf"),
    10**400,
    [1, [2]],
    {"a": 1},
    {"a": {"b": 1}},
    [{}],
    "NaN",
    [float("nan")],
    [True, 1.0],
    {"1": []},
)
TRAP = "!!python/object/apply:os.system ['touch pwned']"
GRIDS = (
    "",
    "x",
    "[]",
    "{}",
    "grid:",
    "grid: []",
    "grid: {}",
    "grid: {gain: []}",
    "grid: {gain: 1}",
    "grid: {gain: [[1]]}",
    "grid: {gain: [null]}",
    "grid: {1: [1]}",
    "grid: {gain: [{}]}",
    "grid: {gain: [1.0], gain: [2.0]}",
    "grid: {gain: [1]}\nmore: 1",
    "a: &a [*a]",
    "grid: &g {gain: [*g]}",
    "grid: {gain: [2026-01-02]}",
    "grid: {gain: [!!binary aGk=]}",
    "grid: {gain: [!!set {1}]}",
    f"grid: {{gain: [{TRAP}]}}",
    TRAP,
    "!!python/name:os.system",
    "grid: {gain: !!python/tuple [1]}",
    "grid: {? [1] : [1]}",
    "grid: {? {a: 1} : [1]}",
    "--- 1\n--- 2\n",
    "%YAML 9.9\n---\ngrid: {}",
    "grid: {gain: [1]}\nnotebook: [1]",
    "\t",
    "grid: {gain: [",
    "grid: 'gain'",
    "&a",
    "*a",
    "!x y",
    "? ",
    "- - - -",
    "grid: {gain: [1e999]}",
    "grid: {gain: [.nan]}",
    "\x00",
    "\ufeffgrid: {gain: [1]}",
    "grid: {<<: {gain: [1]}}",
    "grid: {<<: 1}",
    "grid: {gain: ['a\\nb']}",
    "grid: {'gain; import os': [1]}",
    "[" * 3000,
    "{a: " * 3000,
    "- " * 3000,
)
CLAIM = {
    "id": "TS-X1",
    "paper": "two-step",
    "origin": "stated",
    "place": "example 0",
    "statement": "It is 7.",
    "kind": "number",
    "notebook": "notebooks/tiny.md",
    "tests": ["tests/t.py::test"],
    "printed": 7,
    "tolerance": 1e-9,
    "verdict": "reproduced",
}


def attempts() -> list[Attempt]:
    """All of them."""
    found = []
    for k, text in enumerate(
        (*GRIDS, *mutated("grid: {gain: [1.0, 3.0], count: [2]}\nnotebook: n.md\n"))
    ):
        found.append(Attempt(f"grid {k}: {text[:60]!r}", partial(grid, text), a_grid))
    for k, text in enumerate(mutated(json.dumps([CLAIM]))):
        found.append(
            Attempt(f"ledger {k}", partial(ledger, text), lambda claims: isinstance(claims, list))
        )
    for name in CLAIM:
        for value in ODD:
            text = json.dumps([CLAIM | {name: value}])
            found.append(
                Attempt(
                    f"ledger, {name} = {value!r}"[:90],
                    partial(ledger, text),
                    lambda claims: len(claims) == 1,
                )
            )
    for text in GRIDS:
        found.append(
            Attempt(f"ledger: {text[:60]!r}", partial(ledger, text), lambda claims: claims == [])
        )
    found += points()
    return found


def points() -> list[Attempt]:
    """Results of a point: taken as they are, passed over so that it runs again, or refused."""
    found = [
        Attempt(
            "a point as it is",
            partial(point, json.dumps(ENTRY)),
            lambda entry: entry == ENTRY,
            legal=True,
        )
    ]
    for k, text in enumerate(mutated(json.dumps(ENTRY))):
        found.append(Attempt(f"point {k}", partial(point, text), as_it_was))
    for path in (
        ("parameters",),
        ("parameters", "gain"),
        ("values",),
        ("values", "total"),
        ("values", "terms"),
        ("problem",),
    ):
        for value in ODD:
            entry = json.loads(json.dumps(ENTRY))
            place = entry if len(path) == 1 else entry[path[0]]
            place[path[-1]] = value
            name = f"point, {'/'.join(path)} = {value!r}"[:90]
            found.append(Attempt(name, partial(point, json.dumps(entry)), as_it_was))
            again = json.dumps(kept.sealed(entry))
            found.append(Attempt(f"{name}, summed anew", partial(point, again), a_point))
    for text in (
        "",
        "[]",
        "1",
        "null",
        "NaN",
        '"x"',
        "[" * 100_000,
        '{"values": ' * 20_000,
        "\x00",
        "{}",
        json.dumps(ENTRY) * 2,
    ):
        found.append(Attempt(f"point: {text[:30]!r}", partial(point, text), a_point))
    return found


def mutated(text: str) -> list[str]:
    """Characters changed, left out, put in and swapped."""
    draw, found = random.Random(SEED), []
    for _ in range(120):
        k = draw.randrange(len(text))
        odd = draw.choice("[]{}:,-#&*!|>'\"%@`\x00\t\n\\0.eN~?é")
        found.append(
            draw.choice(
                (
                    text[:k] + odd + text[k + 1 :],
                    text[:k] + text[k + 1 :],
                    text[:k] + odd + text[k:],
                    text[:k],
                )
            )
        )
    return found


def grid(text: str):
    Path("g.yaml").write_text(text)
    try:
        return read_grid(Path("g.yaml")).points()
    finally:
        assert not Path("pwned").exists()


def a_grid(found: list[dict]) -> bool:
    """Points of names and plain values."""
    return bool(found) and all(
        isinstance(name, str) and isinstance(value, bool | int | float | str | list)
        for point in found
        for name, value in point.items()
    )


def ledger(text: str):
    Path("claims.yml").write_text(text)
    return read_ledger(Path("claims.yml"))


def point(text: str):
    Path("key.json").write_text(text)
    return kept.read_entry(Path(), "key", POINT)


def as_it_was(entry: dict | None) -> bool:
    """None, which is run again, or what the sweep has written."""
    return entry is None or entry == ENTRY


def a_point(entry: dict | None) -> bool:
    """None, which is run again, or finite numbers of this very point."""
    if entry is None:
        return True
    values = [
        np.ravel(np.array(v, dtype=float))
        for v in entry["values"].values()
        if not isinstance(v, str)
    ]
    return entry["parameters"] == POINT and all(np.isfinite(v).all() for v in values)
