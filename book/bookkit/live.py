"""Pictures of the book that can be dragged: data and filters of the library put into their pages.

``book/live/NAME.src.html`` holds the words and the script of a picture; `write` adds its data, among
them filters as `to_js` writes them, and still pictures, which the page's own script draws under node.
The result, ``book/live/NAME.html``, is put into a chapter as it stands.
"""

from __future__ import annotations

import base64
import json
import re
import subprocess
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from seedslib import zoo
from seedslib.base.atomic import write_whole
from seedslib.design import affine_synthesis, grid_synthesis, stationary
from seedslib.designed import Memory
from seedslib.export import to_js
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian
from seedslib.models import grid_chain

BOOK = Path(__file__).resolve().parents[1]
WIDTHS = {"wide": 680, "narrow": 330}
NODES, RUNS, TIMES = (-3.5, 3.5, 121), (88, 7, 21, 46, 3), 0.25 * np.arange(25)

_HEAD = '<link rel="stylesheet" href="../_static/live.css">\n<script src="../_static/live.js"></script>\n'
_DRAW = """
const live = require(process.argv[1]), { name, script, data, label, widths } = JSON.parse(require('fs').readFileSync(0, 'utf8'));
new Function('live', 'document', script)({ ...live, attach() {} }, { currentScript: { closest() {} } });
const made = Object.entries(widths).map(([key, W]) => [key, live.still(live.pictures[name](data), W, label)]);
console.log(JSON.stringify(Object.fromEntries(made)));
"""


def write(root: Path) -> None:
    """Write ``book/live/*.html``; needs node, for the still pictures.

    Parameters
    ----------
    root : Path
        Folder of the project.
    """
    for name, make in PICTURES.items():
        text = fragment(name, make())
        write_whole(root / "book" / "live" / f"{name}.html", text.encode())


def fragment(name: str, data: Mapping[str, Any]) -> str:
    """A picture as HTML with its data; without scripts a still picture stays."""
    text = (BOOK / "live" / f"{name}.src.html").read_text(encoding="utf-8")
    label = re.search(r'data-label="(.*?)"', text)[1]
    given = {"name": name, "script": script_of(text), "data": data, "label": label, "widths": WIDTHS}
    command = ["node", "-e", _DRAW, str(BOOK / "_static" / "live.js")]
    done = subprocess.run(
        command, input=json.dumps(given), capture_output=True, text=True, check=True
    )
    stills = json.loads(done.stdout)
    drawn = "".join(f'<div class="{key}">{still["svg"]}</div>' for key, still in stills.items())
    for key, words in stills["wide"]["words"].items():
        text = re.sub(rf'(data-out="{key}">)(?=</)', lambda found, w=words: found[1] + w, text)
    # "<" only occurs inside strings: escaped, no text can end the element.
    code = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    for key, value in {"still": drawn, "data": code, **data.get("words", {})}.items():
        text = text.replace(f"<!--{key}-->", value)
    return _HEAD + text


def script_of(text: str) -> str:
    """The script of a picture, which the page and node run alike."""
    return re.search(r"<script>\n(.*?)</script>", text, re.DOTALL)[1]


def flip() -> dict[str, Any]:
    """Readings of the flip process, its transition, and three filters."""
    system = zoo.flip_process()
    chain = grid_chain(system, NODES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        filters = {name: to_js(made) for name, made in flip_filters().items()}
    fine = np.linspace(0.0, 6.0, 241)  # as in the chapter
    runs = [_run(system, fine, seed) for seed in RUNS]
    half = chain.transition(0.0, 0.25)[: NODES[2] // 2 + 1]
    return {
        "times": TIMES.tolist(),
        "nodes": NODES,
        "transition": _packed(half),
        "start": _packed(chain.initial),
        "filters": filters,
        "runs": runs,
        "words": {"count": str(NODES[2]), "reading": f"{runs[0]['y'][5]:.1f}".replace("-", "−")},
    }


def flip_filters() -> dict[str, Any]:
    """The best function of measurement and last estimate, the best line, the extended filter."""
    system, memory, times = zoo.flip_process(), Memory(estimates=1), TIMES[:9]
    table = grid_synthesis(
        system, memory, times, x=NODES, z=(-2.4, 2.4, 33), y=(-4.0, 4.0, 41), nodes=0
    )
    axes = {"x": NODES, "z": (-4, 4, 81), "y": (-8, 8, 81)}
    line = affine_synthesis(system, memory, ExactGaussian(), times, **axes)[0]
    lasting = {"tolerance": 1.0, "paths": 200, "transient": 2}
    return {
        "table": stationary(table, **lasting),
        "line": stationary(line, **lasting),
        "ekf": extended_kalman(system),
    }


def _run(system: Any, fine: np.ndarray, seed: int) -> dict[str, list[float]]:
    """A run of the library: states every 0.05 s, readings every 0.25 s."""
    made = system.simulate(fine, paths=1, seed=seed, measured=np.arange(fine.size) % 10 == 0)
    states, readings = made.states[::2, 0, 0], made.measurements[::10, 0, 0]
    return {"x": states.round(2).tolist(), "y": readings.round(3).tolist()}


def _packed(values: np.ndarray) -> str:
    """Numbers of four bytes as text of base 64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


PICTURES: dict[str, Callable[[], dict[str, Any]]] = {"flip": flip, "square": dict}
