"""A figure with sliders as HTML: its data as JSON, its first picture drawn ahead."""

from __future__ import annotations

import html
import json
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

STATIC = Path(__file__).resolve().parents[2] / "_static"
SCRIPTS = ("live_filters.js", "live.js")
LARGEST = 100_000
"""Bytes of a page's fragments, with the scripts."""

_DRAW = """
const { live } = require(process.argv[1]);
const { data, given } = JSON.parse(require('fs').readFileSync(0, 'utf8'));
const { charts, said } = live.KINDS[data.kind](data, given);
console.log(JSON.stringify([charts.join(''), said]));
"""


@dataclass(frozen=True)
class Slider:
    """One thing that moves: its name in the data, its label, its values, the first one shown."""

    name: str
    label: str
    values: Sequence[float]
    first: int = 0
    modules: bool = False


@dataclass(frozen=True)
class Figure:
    """What one fragment says.

    Parameters
    ----------
    name : str
        Identifier; the fragment's file has this name.
    kind : {"filters", "table", "law"}
        Which function of ``live.js`` answers.
    sliders : sequence of Slider
    caption : str
        Plain text below the figure.
    data : mapping
        What that function reads, for JSON.
    again : bool
        Whether there is a button for new paths.
    """

    name: str
    kind: str
    sliders: Sequence[Slider]
    caption: str
    data: Mapping[str, Any] = field(default_factory=dict)
    again: bool = False


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


def unpooled(data: Mapping[str, Any]) -> dict[str, str]:
    """The texts of `pooled`."""
    lines, found = data["lines"], {}
    for name, runs in data["modules"].items():
        pairs = zip(runs[::2], runs[1::2], strict=True)
        found[name] = "\n".join(line for at, n in pairs for line in lines[at : at + n])
    return found


def told(figure: Figure) -> dict[str, Any]:
    """The data of a figure as its script reads them."""
    sliders = [
        {"name": s.name, "values": list(s.values), "modules": s.modules} for s in figure.sliders
    ]
    return {"kind": figure.kind, "sliders": sliders, **figure.data}


def drawn(figure: Figure, node: str = "node") -> tuple[str, str]:
    """The first charts as SVG and the sentence below them, by the page's own script under node."""
    text = json.dumps({"data": told(figure), "given": [s.first for s in figure.sliders]})
    done = subprocess.run(
        [node, "-e", _DRAW, str(STATIC / "live.js")],
        input=text,
        capture_output=True,
        text=True,
        check=True,
    )
    charts, said = json.loads(done.stdout)
    return charts, said


def fragment(figure: Figure, node: str = "node") -> str:
    """The figure as HTML; without scripts the first picture and sentence stay."""
    charts, said = drawn(figure, node)
    # "<" only occurs inside strings: escaped, no text can end the element.
    data = json.dumps(told(figure), separators=(",", ":")).replace("<", "\\u003c")
    name = f"live-{figure.name}"
    again = '<button type="button">New paths</button>\n' if figure.again else ""
    controls = "\n".join(_control(name, i, slider) for i, slider in enumerate(figure.sliders))
    return (
        f'<figure class="live" id="{name}" aria-labelledby="{name}-caption">\n'
        f'<div class="live-controls">\n{controls}\n{again}</div>\n'
        f'<div class="live-charts">{charts}</div>\n'
        f'<p class="live-said" aria-live="polite">{html.escape(said)}</p>\n'
        "<noscript><p>Scripts are off: this is the picture at the first setting.</p></noscript>\n"
        f'<figcaption id="{name}-caption">{html.escape(figure.caption)}</figcaption>\n'
        f'<script type="application/json">{data}</script>\n</figure>\n'
    )


def data_of(text: str) -> dict[str, Any]:
    """The data of a fragment."""
    start = text.index('<script type="application/json">') + len('<script type="application/json">')
    data: dict[str, Any] = json.loads(text[start : text.index("</script>", start)])
    return data


def _control(name: str, i: int, slider: Slider) -> str:
    word = f"{slider.values[slider.first]:g}"
    return (
        f'<div><label for="{name}-{i}">{html.escape(slider.label)}</label> '
        f'<input type="range" id="{name}-{i}" min="0" max="{len(slider.values) - 1}" step="1" '
        f'value="{slider.first}" aria-valuetext="{word}" disabled> '
        f'<output for="{name}-{i}">{word}</output></div>'
    )
