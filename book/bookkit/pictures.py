"""Small pictures of results, drawn from what notebooks recorded and from committed tables.

They stand in the page as SVG: letters and lines take the page's colours, in the dark theme too, and
no picture can be older than its numbers. Their width is that of a phone.
"""

from __future__ import annotations

import csv
import html
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

WIDTH, HEIGHT = 320, 136
LETTERS = 11.5


class Scale(NamedTuple):
    """Where a number stands in a picture: between two pixels, straight or by its logarithm."""

    low: float
    high: float
    start: float
    end: float
    log: bool = True

    def __call__(self, value: float) -> float:
        """The pixel of a number; one beyond the ends stands at the end."""
        low, high, value = (
            map(math.log10, (self.low, self.high, max(value, 1e-300)))
            if self.log
            else (self.low, self.high, value)
        )
        share = min(max((value - low) / (high - low), 0.0), 1.0)
        return self.start + share * (self.end - self.start)


def pictures(root: Path, recorded: Mapping[str, Any]) -> dict[str, str]:
    """SVG of each picture by its name in the pages, ``picture__power`` and so on.

    Parameters
    ----------
    root : Path
        The project's folder.
    recorded : mapping
        Values that notebooks recorded, named as in `bookkit.numbers.recorded`.
    """
    drawn = {
        "power": _power(recorded),
        "honest": _honest(recorded),
        "delay": _delay(recorded),
        "particles": _particles(recorded),
        "modes": _modes(recorded),
        "volatility": _volatility(recorded),
        "map": _map(root),
    }
    return {f"picture__{name}": f'<div class="picture">{svg}</div>' for name, svg in drawn.items()}


def _power(recorded: Mapping[str, Any]) -> str:
    x, y = Scale(0.1, 1000, 40, 306), Scale(0, 50, 104, 10, log=False)
    found = recorded["two_step_power__steady_loss"]
    grid = [10 ** (-1 + 4 * k / 60) for k in range(61)]
    curve = _path([(x(ratio), y(50 / math.sqrt(1 + ratio))) for ratio in grid])
    here = (50 / found) ** 2 - 1
    parts = [
        _axis(x(0.1), 104, x(1000)),
        *(_text(x(0.1) - 6, y(level) + 4, f"{level} %", "end") for level in (0, 50)),
        f'<path class="main" d="{curve}"/>',
        _dot(x(here), y(found)),
        _text(x(here) + 8, y(found) - 6, f"{found:.0f} % lost", bold=True),
        _text(40, 124, "blunt sensor"),
        _text(306, 124, "precise sensor", "end"),
    ]
    return _svg("The loss falls from 50 % to zero as the sensor gets more precise.", parts)


def _honest(recorded: Mapping[str, Any]) -> str:
    x, y = Scale(0, 10, 40, 306, log=False), Scale(0.5, 1e5, 104, 8)
    parts = [_axis(40, 104, 306), f'<path class="thin" d="M40 {y(1):.1f}H306"/>']
    parts += [_text(34, y(level) + 4, told, "end") for level, told in ((1, "1"), (1e4, "10⁴"))]
    for name, kind in (("ekf_tau5", "other"), ("tau5", "main")):
        values = [recorded[f"piecewise_filter__{name}_{k}"] for k in range(11)]
        curve = _path([(x(k), y(value)) for k, value in enumerate(values)])
        parts.append(f'<path class="{kind}" d="{curve}"/>')
    parts += [
        _text(176, 30, "extended Kalman filter", "end", style="other"),
        _text(306, 72, "piecewise-linear filter", "end", style="main"),
        _text(40, 124, "true over claimed variance, for 10 seconds"),
    ]
    return _svg("The ratio of one filter grows to 25 000, that of the other stays near 1.", parts)


def _delay(recorded: Mapping[str, Any]) -> str:
    x = Scale(1.78, 2.13, 20, 300, log=False)
    values = {
        name: recorded[f"delay_printed__{key}_last"]
        for name, key in (("claimed", "claimed"), ("best possible", "optimal"), ("real", "true"))
    }
    told = "mean-square error of the printed filter"
    parts = [_axis(10, 66, 310), _text(160, 124, told, "middle")]
    for place, (name, value) in enumerate(values.items()):
        up = place != 1
        parts += [
            _dot(x(value), 66, "main" if place == 1 else "other"),
            _text(x(value), 48 if up else 88, name, "middle", bold=True),
            _text(x(value), 32 if up else 104, f"{value:.3f}", "middle"),
        ]
    return _svg("The claimed error lies below the best possible one, the real error above.", parts)


def _particles(recorded: Mapping[str, Any]) -> str:
    x, y = Scale(0.1, 200, 40, 306), Scale(0.24, 0.31, 104, 14, log=False)
    places = {
        "table": ("table_cost", "vdp_table", "main", 9, 4, "start"),
        "200 particles": ("many_cost", "vdp_particles", "other", 30, -9, "end"),
        "assumed density": ("fna_cost", "vdp_fna", "other", 9, 4, "start"),
    }
    parts = [_axis(40, 104, 306), _text(46, 14, "error")]
    for name, (cost, error, kind, right, down, anchor) in places.items():
        at = [recorded[f"jump_diffusion_beyond__{key}"] for key in (cost, error)]
        told = f"{name}: {at[1]:.3f}"
        parts += [
            _dot(x(at[0]), y(at[1]), kind),
            _text(x(at[0]) + right, y(at[1]) + down, told, anchor, style=kind),
        ]
    for cost in (0.1, 1, 10, 100):
        parts.append(_text(x(cost), 118, f"{cost:g}", "middle"))
    parts.append(_text(306, 132, "microseconds a step", "end"))
    return _svg("A table is as accurate as 200 particles and far cheaper.", parts)


def _modes(recorded: Mapping[str, Any]) -> str:
    x = Scale(0, 3, 20, 300, log=False)
    least, most, soft = (
        recorded[f"switching_order__{key}"] for key in ("exact_least", "exact_most", "soft_gain")
    )
    parts = [
        _text(20, 20, "a second decision"),
        _bar("other", 28, x(0), x(least)),
        _bar("faint", 28, x(least), x(most)),
        _text(x(most) + 8, 41, f"{least:.1f} to {most:.1f} %"),
        _text(20, 70, "how certain the first one was"),
        _bar("main", 78, x(0), x(soft)),
        _text(x(soft) + 8, 91, f"{soft:.1f} %", bold=True),
        _text(20, 118, "error saved by remembering it"),
    ]
    return _svg("Certainty saves more than a second decision.", parts)


def _volatility(recorded: Mapping[str, Any]) -> str:
    x = Scale(10, 3000, 20, 250)
    parts = []
    for row, (told, key) in enumerate((("one number", "like_1"), ("two numbers", "like_2"))):
        value, y = recorded[f"field_volatility__{key}"], 14 + 46 * row
        parts += [
            _text(20, y + 6, f"memory of {told}"),
            _bar("main", y + 14, x(10), x(value)),
            _text(x(value) + 8, y + 27, f"{float(f'{value:.2g}'):.0f}", bold=True),
        ]
    parts.append(_text(20, 118, "particles with the same error (logarithmic)"))
    return _svg("A memory of one number is worth 300 particles, of two 3000.", parts)


GROWTH = {
    "EKF": ("extended", -9, 0, "end"),
    "CKF": ("cubature", 9, -1, "start"),
    "UKF augmented alpha 1": ("unscented, augmented", -30, 18, "start"),
    "Gauss-Hermite 10": ("Gauss-Hermite", 9, 8, "start"),
    "minimax four functions": ("minimax", 9, 12, "start"),
    "tables by phase": ("designed, one estimate", 8, 4, "start"),
    "bootstrap 1000": ("1000 particles", -8, -4, "end"),
    "Bayes": ("grid", 0, -9, "middle"),
}
REENTRY = {
    "extended": ("extended", -6, -9, "end"),
    "unscented": ("unscented", 9, 4, "start"),
    "Gauss-Hermite 3": ("Gauss-Hermite", 0, -10, "middle"),
    "minimax turned": ("minimax", -8, 14, "end"),
    "forecasts": ("designed", 8, -6, "start"),
    "bootstrap 100": ("100 particles, lost", -9, 5, "end"),
}


def _map(root: Path) -> str:
    """Error above the least against cost, on a problem with a blunt sensor and a precise one."""
    first = _read(root, "field_growth", "mse", GROWTH)
    second = _read(root, "field_reentry", "rmse", REENTRY)
    first = {name: (cost, math.sqrt(error)) for name, (cost, error) in first.items()}
    parts = [
        *_panel("A curved, blunt sensor: the growth model", "field_growth", first, GROWTH, 0),
        *_panel("Precise measurements: re-entry", "field_reentry", second, REENTRY, 254),
        _text(400, 516, "microseconds for a step", "end"),
    ]
    return (
        '<svg class="diagram" viewBox="0 0 420 524" role="group" '
        'aria-label="Two charts: error above the least against microseconds for a step">'
        + "".join(parts)
        + "</svg>"
    )


def _panel(
    title: str,
    page: str,
    rows: Mapping[str, tuple[float, float]],
    labels: Mapping[str, tuple[str, int, int, str]],
    top: float,
) -> list[str]:
    x, y = Scale(0.03, 200, 52, 400), Scale(0.005, 3000, top + 216, top + 36)
    least = min(error for _, error in rows.values())
    parts = [_link(page, _text(8, top + 14, title, bold=True)), _axis(52, top + 222, 404)]
    for level in (0.01, 1, 100):
        at = y(level)
        parts.append(f'<path class="thin" d="M52 {at:.1f}H404"/>')
        parts.append(_text(46, at + 4, f"{level:g} %", "end"))
    parts += [_text(x(cost), top + 237, f"{cost:g}", "middle") for cost in (0.1, 1, 10, 100)]
    for name, (cost, error) in rows.items():
        label, right, down, anchor = labels[name]
        kind = "main" if label.startswith("designed") else "other"
        at = x(cost), y(100 * (error / least - 1))
        told = _text(at[0] + right, at[1] + down, label, anchor, style=kind)
        parts.append(_link(page, _dot(*at, kind) + told))
    return parts


def _read(
    root: Path, table: str, column: str, wanted: Sequence[str] | Mapping[str, Any]
) -> dict[str, tuple[float, float]]:
    with (root / "benchmarks" / f"{table}.csv").open(newline="") as lines:
        return {
            row["row"]: (float(row["microseconds"]), float(row[column]))
            for row in csv.DictReader(lines)
            if row["row"] in wanted
        }


def _svg(told: str, parts: Sequence[str]) -> str:
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{html.escape(told)}">'
        + "".join(parts)
        + "</svg>"
    )


def _text(
    x: float, y: float, told: str, anchor: str = "start", *, bold: bool = False, style: str = ""
) -> str:
    weight = ' font-weight="600"' if bold else ""
    kind = f' class="{style}"' if style else ""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{LETTERS}" text-anchor="{anchor}"{weight}{kind}>'
        f"{html.escape(told)}</text>"
    )


def _dot(x: float, y: float, kind: str = "main") -> str:
    return f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="4.5"/>'


def _bar(kind: str, y: float, start: float, end: float) -> str:
    width = f"{end - start:.1f}"
    return f'<rect class="{kind}" x="{start:.1f}" y="{y}" width="{width}" height="16"/>'


def _axis(start: float, y: float, end: float) -> str:
    return f'<path class="axis" d="M{start:.1f} {y:.1f}H{end:.1f}"/>'


def _path(points: Sequence[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _link(page: str, inside: str) -> str:
    return f'<a href="../notebooks/{page}.html">{inside}</a>'
