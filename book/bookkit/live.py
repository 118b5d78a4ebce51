"""Pictures of the book that can be dragged: data and filters of the library put into their pages.

``book/live/NAME.src.html`` holds the words and the script of a picture; `write` adds its data,
among them filters as `to_js` writes them, and still pictures, which the page's own script draws
under node. The result, ``book/live/NAME.html``, is put into a chapter as it stands.
"""

from __future__ import annotations

import base64
import csv
import json
import re
import subprocess
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from scipy.interpolate import RegularGridInterpolator

from seedslib import zoo
from seedslib.base.atomic import write_whole
from seedslib.design import affine_synthesis, grid_synthesis, stationary, synthesize
from seedslib.designed import Memory, finite_memory
from seedslib.export import to_js
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap, grid_chain

BOOK = Path(__file__).resolve().parents[1]
WIDTHS = {"wide": 680, "narrow": 330}
NODES, RUNS, TIMES = (-3.5, 3.5, 121), (88, 7, 21, 46, 3), 0.25 * np.arange(25)
WINDOWS = (2, 4, 8, 12, 25, 50, 100)


def write(root: Path) -> None:
    """Write ``book/live/*.html`` of the project at `root`; needs node, for the still pictures."""
    for name, make in PICTURES.items():
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            text = fragment(name, make())
        write_whole(root / "book" / "live" / f"{name}.html", text.encode())


def fragment(name: str, data: Mapping[str, Any]) -> str:
    """A picture as HTML with its data; without scripts a still picture stays."""
    text = (BOOK / "live" / f"{name}.src.html").read_text(encoding="utf-8")
    label = re.search(r'data-label="(.*?)"', text)[1]
    given = {"name": name, "script": script_of(text), "data": data, "label": label}
    command, told = ["node", BOOK / "_static" / "live.js"], json.dumps(given | {"widths": WIDTHS})
    done = subprocess.run(command, input=told, capture_output=True, text=True, check=True)
    stills = json.loads(done.stdout)
    drawn = "".join(f'<div class="{key}">{still["svg"]}</div>' for key, still in stills.items())
    for key, words in stills["wide"]["words"].items():
        text = text.replace(f'data-out="{key}"></', f'data-out="{key}">{words}</')
    # "<" only occurs inside strings: escaped, no text can end the element.
    code = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    for key, value in {"still": drawn, "data": code, **data.get("words", {})}.items():
        text = text.replace(f"<!--{key}-->", value)
    return text


def script_of(text: str) -> str:
    """The script of a picture, which the page and node run alike."""
    return re.search(r"<script>\n(.*?)</script>", text, re.DOTALL)[1]


def flip() -> dict[str, Any]:
    """Readings of the flip process, its transition, and three filters."""
    system, runs = zoo.flip_process(), []
    chain, fine = grid_chain(system, NODES), np.linspace(0.0, 6.0, 241)
    for seed in RUNS:  # as in the chapter: a step of 0.025 s, a reading every 0.25 s
        made = system.simulate(fine, paths=1, seed=seed, measured=np.arange(241) % 10 == 0)
        x, y = made.states[::2, 0, 0].round(2), made.measurements[::10, 0, 0].round(3)
        runs.append({"x": x.tolist(), "y": y.tolist()})
    reading = f"{runs[0]['y'][5]:.1f}".replace("-", "−")
    return {
        "times": TIMES.tolist(),
        "nodes": NODES,
        "transition": _packed(chain.transition(0.0, 0.25)[: NODES[2] // 2 + 1]),
        "start": _packed(chain.initial),
        "filters": {name: to_js(made) for name, made in flip_filters().items()},
        "runs": runs,
        "words": {"count": str(NODES[2]), "reading": reading},
    }


def flip_filters() -> dict[str, Any]:
    """The best function of measurement and last estimate, the best line, the extended filter."""
    system, memory, times = zoo.flip_process(), Memory(estimates=1), TIMES[:9]
    axes = {"x": NODES, "z": (-2.4, 2.4, 33), "y": (-4.0, 4.0, 41)}
    wide = {"x": NODES, "z": (-4, 4, 81), "y": (-8, 8, 81)}
    table = grid_synthesis(system, memory, times, **axes)
    line, _ = affine_synthesis(system, memory, ExactGaussian(), times, **wide)
    lasting = {"tolerance": 1.0, "paths": 200, "transient": 2}
    made = {"table": stationary(table, **lasting), "line": stationary(line, **lasting)}
    return made | {"ekf": extended_kalman(system)}


def body() -> dict[str, Any]:
    """The falling body: tangents of the windows, the extended filter, noise of the sensor."""
    windows, system = {}, zoo.falling_body()
    for count in WINDOWS:
        made, fall = zoo.falling_body(count), 0.5 / 100  # the fall of the first second
        tangent = made.dynamics_at(0.0)
        windows[count] = {
            "edges": made.regions.edges[1:-1].tolist(),
            "shift": (tangent.offset[1, :, 0] / fall).tolist(),
            "slope": (tangent.matrix[1, 0, :, 0] / fall).tolist(),
        }
    return {
        "times": list(range(11)),
        "prior": [system.mean0[0], system.cov0[0, 0] ** 0.5, 0.1, system.cov0[1, 1] ** 0.5],
        "sensor_noise": 1e-3,
        "windows": windows,
        "ekf": to_js(extended_kalman(system.discrete())),
        "noise": np.random.default_rng(1).standard_normal((6, 10)).round(4).tolist(),
    }


def design() -> dict[str, Any]:
    """Error of the best function of two numbers for the growth model, and its last step."""
    made = growth_filter()
    (table,), centres = made.steps[5].update.estimate, (np.arange(20) + 0.5) / 10 - 1
    axes = [axis.nodes for axis in made.steps[5].update.axes]
    points = np.stack(np.meshgrid(25 * centres, 15 * centres, indexing="ij"), axis=-1)
    surface = RegularGridInterpolator(axes, table)(points)
    return {"best": float(made.predicted.rms[5, 0]), "surface": _packed(surface)}


def growth_filter() -> Any:
    """The best function of reading and last estimate for the growth model with a plain sensor."""
    x, w, v = sympy.symbols("x w v", real=True)
    step = StochasticMap([x], [x / 2 + 25 * x / (1 + x**2) + 3 * w], Noise([w]))
    system = DiscreteSystem(step, StochasticMap([x], [x + 5 * v], Noise([v])), 0.0, 4.0)
    axes = {"x": (-32, 32, 321), "z": (-20, 20, 81), "y": (-45, 45, 121)}
    return grid_synthesis(system, Memory(estimates=1), np.arange(6), **axes)


def memory() -> dict[str, Any]:
    """Errors of filters with several memories above a reference, in per cent of the mean square."""
    told = "Kalman told the modes"
    rows = [
        ("position of an oscillator", "Kalman", _oscillator(), {}),
        ("two modes, ambiguous sensor", "Bayes", *_table("A2", "grid Bayes")),
        ("position of a target", told, *_table("B noisy", "known modes")),
    ]
    keys = ("name", "reference", "found", "best")
    return {"systems": [dict(zip(keys, row, strict=True)) for row in rows]}


def _oscillator() -> dict[str, list[float]]:
    """Excess for the position, by exact moments, with 1 to 4 positions or measurements."""
    system, times, found = zoo.linear_gaussian(), 0.5 * np.arange(21), {}

    def square(kept: Memory, parts: int) -> float:
        exact = {"components": parts, "exact_moments": True, "nodes": 0}
        made = synthesize(system, kept, Taylor(), times, **exact)
        return float(made.predicted.rms[-1, 0] ** 2)

    best = square(Memory(estimates=1), 2)
    for l in range(1, 5):
        found[_last("e", l)] = [100 * (square(Memory(estimates=l), 1) / best - 1), 0.0]
        found[_last("y", l)] = [100 * (square(finite_memory(l), 2) / best - 1), 0.0]
    return found


def _table(system: str, reference: str) -> tuple[dict[str, Any], dict[str, float]]:
    """Excess and its standard error by memory, Gaussian functions, and that of the best ones."""
    kept = {"soft FBP-G 1": "e1 c", "FBP-G 1 with indicator": "e1 j"}
    for l in range(1, 5):
        kept |= {f"FBP-G {l}": _last("e", l), f"FKP-G {l}": _last("y", l)}
    with (BOOK.parent / "benchmarks" / "switching_order.csv").open() as lines:
        rows = [row for row in csv.reader(lines) if row[0] == "error"]
    rows = {row[2]: (float(row[-2]), float(row[-1])) for row in rows if row[1] == system}
    base, doubt = rows[reference]
    found, best = {}, {}
    for name, (rms, error) in rows.items():
        excess, slope = 100 * ((rms / base) ** 2 - 1), 200 * rms / base**2
        if name in kept:
            found[kept[name]] = [excess, slope * np.hypot(error, rms * doubt / base)]
        elif name.startswith("exact FBP"):
            best[_last("e", int(name[-1]))] = excess
    return found, best


def _last(letter: str, count: int) -> str:
    """The last `count` estimates ("e") or measurements ("y"), as the page's script names them."""
    return " ".join(f"{letter}{k + 1}" for k in range(count))


def _packed(values: np.ndarray) -> str:
    """Numbers of four bytes as text of base 64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


PICTURES: dict[str, Callable[[], dict[str, Any]]] = {
    made.__name__: made for made in (flip, body, design, memory)
} | {"square": dict}
