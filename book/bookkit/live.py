"""Figures with sliders in which exported filters run on new paths, from a file, with no network.

A figure is a fragment of HTML: its data as JSON, filters exported by `to_js` among them, and its
first picture drawn ahead by the page's own script under node.
"""

from __future__ import annotations

import html
import json
import subprocess
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import sympy

from seedslib import zoo
from seedslib.base.atomic import write_whole
from seedslib.design import affine_synthesis, grid_synthesis, stationary, synthesize
from seedslib.designed import SwitchingFilter, large_order
from seedslib.export import to_js
from seedslib.filters import extended_kalman
from seedslib.linearization import ExactGaussian, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

STATIC = Path(__file__).resolve().parents[1] / "_static"
PATHS = 1000
NOISES = (0.25, 0.5, 1.0, 2.0)
ORDERS = (1, 2, 4)
RATES = (0.2, 0.5, 1.0, 1.6)
MISSING = tuple(k / 10 for k in range(10))
FLIP = {"x": (-3.5, 3.5, 101), "z": (-2.4, 2.4, 25), "y": (-7.2, 7.2, 37)}

_DRAW = """
const { live } = require(process.argv[1]);
const { data, given } = JSON.parse(require('fs').readFileSync(0, 'utf8'));
const { charts, said } = live.KINDS[data.kind](data, given);
console.log(JSON.stringify([charts.join(''), said]));
"""


class Slider(NamedTuple):
    """One thing that moves: its name in the data, label, values, the position it begins at.

    `modules` says that there are other filters for each value.
    """

    name: str
    label: str
    values: Sequence[float]
    first: int = 0
    modules: bool = False


class Figure(NamedTuple):
    """A figure: its name, its slider, its caption, and the data that ``live.js`` reads."""

    name: str
    slider: Slider
    caption: str
    data: Mapping[str, Any]


def write(root: Path) -> None:
    """Write ``book/live/*.html``; needs node, for the first pictures.

    Parameters
    ----------
    root : Path
        Folder of the project.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for figure in figures():
            write_whole(root / "book" / "live" / f"{figure.name}.html", fragment(figure).encode())


def figures() -> Iterator[Figure]:
    """All figures, one after the other."""
    estimates = {str(order): f"{order} estimate{'s' * (order > 1)}" for order in ORDERS}
    yield _filters(
        "van_der_pol",
        Slider("noise", "standard deviation of the sensors", NOISES, 2, modules=True),
        "Van der Pol oscillator of the jump-diffusion paper, measured seven times as x₁² and x₂ "
        "with noise. 1000 paths are simulated in the page; four filters run on each. Above, errors "
        "of both components together after each measurement; below, x₁ of the first path.",
        dict(pair for k in range(len(NOISES)) for pair in van_der_pol_filters(k).items()),
        estimates | {"ekf": "extended Kalman"},
        times=[0.5 * k for k in range(7)],
        size=2,
        parts=[0, 1],
        state="x₁",
        timed=[f"ekf@{k}" for k in range(len(NOISES))],
    )
    matrix, root = linear_step()
    yield _filters(
        "dropouts",
        Slider("missing", "share of missing measurements", MISSING, 3),
        "Linear oscillator, its position measured every half second. The designed filters were "
        "told of no gaps; they put the expected value in the place of what is missing. The Kalman "
        "filter knows what was missing: it is the optimum.",
        linear_filters(),
        {key: estimates[key] for key in ("1", "4")} | {"kf": "Kalman"},
        plant="linear",
        times=[0.5 * k for k in range(25)],
        size=2,
        state="position",
        timed=["kf"],
        shown=0,
        options={"matrix": matrix.ravel().tolist(), "root": root[np.tril_indices(2)].tolist()},
    )
    yield _filters(
        "flip",
        Slider("missing", "share of missing measurements", MISSING, 0),
        "The process that flips from side to side, measured every quarter of a second. A table of "
        "the optimal function of measurement and last estimate, and the line of theorem 2 with the "
        "same memory.",
        {
            name: stationary(made, tolerance=1.0, paths=200, transient=1)
            for name, made in flip_filters().items()
        },
        {"table": "optimal function", "line": "line"},
        times=[0.25 * k for k in range(13)],
        shown=0,
    )
    yield _filters(
        "switching",
        Slider("rate", "factor of the switching probabilities", RATES, 2, modules=True),
        "Scalar system of two modes whose switching depends on the state. The designed filter "
        "remembers one estimate, the IMM filter a law for each mode; a filter of its own for each "
        "factor.",
        dict(pair for k in range(len(RATES)) for pair in switching_filters(k).items()),
        {"1": "designed, 1 estimate", "imm": "IMM, linearised"},
        times=list(range(21)),
        timed=[f"imm@{k}" for k in range(len(RATES))],
    )


def _filters(
    name: str,
    slider: Slider,
    caption: str,
    filters: Mapping[str, Any],
    labels: Mapping[str, str],
    **data: Any,
) -> Figure:
    """A figure of filters; `data` says what differs from a scalar state."""
    common = {"plant": name, "paths": PATHS, "size": 1, "parts": [0], "options": {}, "state": "x"}
    names = [{"key": key, "label": label} for key, label in labels.items()]
    modules = pooled({key: to_js(filter) for key, filter in filters.items()})
    data = {**common, "xlabel": "time", "timed": [], **data, "filters": names, **modules}
    return Figure(name, slider, caption, data)


def van_der_pol_filters(noise: int) -> dict[str, Any]:
    """The filters of one deviation of the sensor noise, by the names of their modules."""
    x1, x2, v1, v2 = sympy.symbols("x1 x2 v1 v2")
    system = JumpDiffusion(  # `zoo.van_der_pol` with another deviation of both sensors
        state=(x1, x2),
        drift=[x2, -((sympy.pi / 10) ** 2) * x1 + 2 * x2 * (1 - x1**2)],
        diffusion=[[0], [x1]],
        sensor=[x1**2 + v1, x2 + v2],
        noise=Noise((v1, v2), cov=NOISES[noise] ** 2 * np.eye(2)),
        mean0=[2, 0],
        cov0=0.15 * np.eye(2),
    )
    options = {"paths": 2000, "seed": 1, "nodes": 0}
    times = 0.5 * np.arange(7)
    designs = {
        f"{order}@{noise}": synthesize(
            system, large_order(order), ExactGaussian(), times, **options
        )
        for order in ORDERS
    }
    return designs | {f"ekf@{noise}": extended_kalman(system)}


def linear_filters() -> dict[str, Any]:
    """Stationary filters of the linear oscillator, from exact moments, and the Kalman filter."""
    system, times = zoo.linear_gaussian(), 0.5 * np.arange(24)
    designs = {}
    for order in (1, 4):
        design = synthesize(
            system, large_order(order), Taylor(), times, exact_moments=True, nodes=0
        )
        designs[str(order)] = stationary(design, tolerance=0.1, paths=200, transient=6)
    x1, x2, p, q, v = sympy.symbols("x1 x2 p q v")
    matrix, root = linear_step()
    steps = DiscreteSystem(
        StochasticMap((x1, x2), [*(matrix @ [x1, x2] + root @ [p, q])], Noise((p, q))),
        StochasticMap((x1, x2), [x1 + v], Noise((v,), cov=[[0.25]])),
        [1.0, -0.5],
        np.eye(2),
    )
    return designs | {"kf": extended_kalman(steps)}


def linear_step(interval: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Transition matrix of the linear oscillator and the Cholesky factor of its noise."""
    from scipy import linalg

    drift, noise = np.array([[0.0, 1.0], [-1.0, -0.4]]), np.diag([0.0, 1.0])
    block = np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]])
    whole = linalg.expm(block * interval)
    matrix = whole[2:, 2:].T
    return matrix, np.linalg.cholesky(matrix @ whole[:2, 2:])


def flip_filters() -> dict[str, Any]:
    """The optimal function of measurement and one estimate, on a grid, and theorem 2 beside it."""
    system, times = zoo.flip_process(), 0.25 * np.arange(13)
    return {
        "table": grid_synthesis(system, large_order(1), times, **FLIP, nodes=0),
        "line": affine_synthesis(system, large_order(1), ExactGaussian(), times, **FLIP)[0],
    }


def switching_filters(rate: int) -> dict[str, Any]:
    """Designed filter and IMM for one factor of the switching probabilities."""
    system = zoo.scalar_switching(rate=RATES[rate])
    design = synthesize(
        system, large_order(1), ExactGaussian(), np.arange(16.0), paths=4000, seed=1
    )
    return {
        f"1@{rate}": stationary(design, tolerance=0.2, paths=500, transient=4),
        f"imm@{rate}": SwitchingFilter(system, Taylor()),
    }


def pooled(modules: Mapping[str, str]) -> dict[str, Any]:
    """Texts by lines, each different line once, and each text as runs: first line and number."""
    lines: dict[str, int] = {}
    texts: dict[str, list[int]] = {}
    for name, text in modules.items():
        runs: list[int] = []
        for line in text.split("\n"):
            at = lines.setdefault(line, len(lines))
            if runs and at == runs[-2] + runs[-1]:
                runs[-1] += 1
            else:
                runs += [at, 1]
        texts[name] = runs
    return {"lines": list(lines), "modules": texts}


def fragment(figure: Figure) -> str:
    """The figure as HTML; without scripts the first picture and sentence stay."""
    data = {"kind": "filters", "sliders": [figure.slider._asdict()], **figure.data}
    done = subprocess.run(
        ["node", "-e", _DRAW, str(STATIC / "live.js")],
        input=json.dumps({"data": data, "given": [figure.slider.first]}),
        capture_output=True,
        text=True,
        check=True,
    )
    charts, sentence = json.loads(done.stdout)
    name, slider = f"live-{figure.name}", figure.slider
    word = f"{slider.values[slider.first]:g}"
    # "<" only occurs inside strings: escaped, no text can end the element.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<figure class="live" id="{name}" aria-labelledby="{name}-caption">\n'
        f'<div class="live-controls">\n<div><label for="{name}-0">{html.escape(slider.label)}'
        f'</label> <input type="range" id="{name}-0" min="0" max="{len(slider.values) - 1}" '
        f'step="1" value="{slider.first}" aria-valuetext="{word}" disabled> '
        f'<output for="{name}-0">{word}</output></div>\n'
        '<button type="button">New paths</button>\n</div>\n'
        f'<div class="live-charts">{charts}</div>\n'
        f'<p class="live-said" aria-live="polite">{html.escape(sentence)}</p>\n'
        "<noscript><p>Scripts are off: this is the picture at the first setting.</p></noscript>\n"
        f'<figcaption id="{name}-caption">{html.escape(figure.caption)}</figcaption>\n'
        f'<script type="application/json">{text}</script>\n</figure>\n'
    )
