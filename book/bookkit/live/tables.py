"""Figures over committed tables, a law and the optimal function of the flip process."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bookkit.live.filters import flip_filters
from bookkit.live.fragment import Figure, Slider
from seedslib import zoo

_SWEEPS = Path(__file__).resolve().parents[3] / "sweeps"


def swept(
    name: str, axes: Sequence[str], columns: Mapping[str, tuple[str, str | None]]
) -> tuple[list[list[float]], list[dict[str, Any]]]:
    """Values of the axes of a table, and its columns over them.

    Parameters
    ----------
    name : str
        Stem of a file in ``sweeps``.
    axes : sequence of str
        The columns that were swept.
    columns : mapping of str to (str, str or None)
        For each label a column and the one with its standard error.

    Raises
    ------
    ValueError
        A point of the grid is missing or failed.
    """
    with (_SWEEPS / f"{name}.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    values = [sorted({float(row[axis]) for row in rows}) for axis in axes]
    at = {tuple(float(row[axis]) for axis in axes): row for row in rows if not row["problem"]}
    if len(at) != np.prod([len(part) for part in values]):
        raise ValueError(f"{name}: wanted every point of the grid, got {len(at)}")

    def over(column: str, given: tuple[float, ...] = ()) -> Any:
        if len(given) == len(axes):
            return float(f"{float(at[given][column]):.6g}")
        return [over(column, (*given, value)) for value in values[len(given)]]

    found = []
    for label, (column, error) in columns.items():
        curve = {"label": label, "values": over(column)}
        found.append(curve if error is None else curve | {"errors": over(error)})
    return values, found


def figures() -> list[Figure]:
    """All figures that read a table, a law or a function."""
    return [_law(), _function(), _delay(), _switching(), _interval(), _regions(), _growth()]


def _law() -> Figure:
    values, curves = swept("plugin_loss", ["a", "q", "r"], {"loss": ("steady_loss", None)})
    a, q, r = np.meshgrid(*values, indexing="ij")
    found = zip((q / (r * a**2)).ravel(), np.ravel(curves[0]["values"]), strict=True)
    ratios = [float(f"{10 ** (k / 20):.4g}") for k in range(-40, 61)]
    return Figure(
        "plugin_loss",
        "law",
        [Slider("ratio", "signal-to-noise ratio q/(r a²)", ratios, 40)],
        "Steady loss of the plug-in estimate of the power: the law 50 % / √(1 + q/(r a²)), and as "
        "dots the 27 signals and sensors of the sweep.",
        {
            "xlabel": "signal-to-noise ratio q/(r a²)",
            "ylabel": "loss, %",
            "logx": True,
            "dots": [[float(f"{x:.6g}"), y] for x, y in found],
            "zero": True,
        },
    )


def _function() -> Figure:
    system = zoo.flip_process()
    optimal, line = flip_filters().values()
    y, memory = np.arange(-4.0, 4.01, 0.25), [round(0.1 * k - 2, 1) for k in range(41)]
    exact, straight = [], []
    for u in memory:
        known = np.full((1, len(y)), u)
        mean = optimal.output(12, y[None], known).mean[0]
        exact.append([round(float(part), 5) for part in mean])
        forecast, cov = line.fits[11].forecast(known[:, :1])
        m, g, f = line.linearization.moments(system.sensor)(3.0, forecast, cov)
        mean = forecast[0] + (g[0, 0] / f[0, 0]) * (y - m[0])
        straight.append([round(float(part), 5) for part in mean])
    return Figure(
        "flip_function",
        "table",
        [
            Slider("memory", "remembered estimate u", memory, 30),
            Slider("y", "measurement y", y.tolist(), 8),
        ],
        "Flip process at the last of 13 measurements: what the filter says to a measurement y when "
        "it remembers u. The optimal function decides between two wells; the line can not.",
        {
            "x": y.tolist(),
            "xlabel": "measurement y",
            "ylabel": "estimate of x",
            "curves": [
                {"label": "optimal function", "values": exact},
                {"label": "line of theorem 2", "values": straight},
            ],
        },
    )


def _table(
    name: str,
    source: str,
    labels: Mapping[str, tuple[str, int]],
    columns: Mapping[str, tuple[str, str | None]],
    caption: str,
    **look: Any,
) -> Figure:
    """A figure over a sweep; the last of its sliders moves along the curves."""
    values, curves = swept(source, list(labels), columns)
    sliders = [
        Slider(axis, label, part, first)
        for (axis, (label, first)), part in zip(labels.items(), values, strict=True)
    ]
    xlabel = list(labels.values())[-1][0]
    data = {"x": values[-1], "xlabel": xlabel, "curves": curves, **look}
    return Figure(name, "table", sliders, caption, data)


def _delay() -> Figure:
    return _table(
        "delay",
        "delay_loss",
        {"delay": ("delay N, steps", 2), "damping": ("radius of the oscillator's own motion", 2)},
        {
            "paper's filter": ("printed_loss", None),
            "without past innovations": ("memoryless_loss", None),
            "best gains": ("greedy_loss", None),
        },
        "Kalman filter with delay: losses against the optimum, exact.",
        ylabel="loss, %",
        logy=True,
    )


def _switching() -> Figure:
    names = {
        "exact": "one estimate, exact",
        "aof_g": "IMM, Gaussian means",
        "fbp_g": "one estimate, Gaussian",
        "imm_ekf": "IMM, extended Kalman",
    }
    return _table(
        "switching_noise",
        "switching_noise",
        {
            "rate": ("factor of the switching probabilities", 2),
            "deviation": ("deviation of the sensor noise", 2),
        },
        {title: (f"more_{key}", f"more_error_{key}") for key, title in names.items()},
        "Scalar switching system: error above that of the Bayes filter; bars: two standard errors.",
        ylabel="error above Bayes, %",
        logx=True,
    )


def _interval() -> Figure:
    names = {
        "ekf": "extended Kalman",
        "fna": "assumed density",
        "fbp": "affine, order 1",
        "polynomial": "polynomial",
    }
    return _table(
        "interval",
        "jump_diffusion_interval",
        {
            "noise": ("deviation of the sensor noise", 1),
            "interval": ("interval between measurements", 2),
        },
        {title: (key, None) for key, title in names.items()},
        "Kicked Duffing oscillator: root-mean-square error of the position on 4096 common paths.",
        ylabel="root-mean-square error",
        logx=True,
    )


def _regions() -> Figure:
    return _table(
        "regions",
        "piecewise_regions",
        {"sensor_noise": ("sensor noise, rad", 1), "cells": ("number of windows", 2)},
        {"windows of the paper": ("paper_50", None), "even curvature": ("wide_50", None)},
        "Falling body at 50 km after ten seconds: distance from the exact posterior mean.",
        ylabel="distance, standard deviations",
        logx=True,
        logy=True,
    )


def _growth() -> Figure:
    return _table(
        "growth",
        "field_growth",
        {
            "process": ("deviation of the dynamics' noise", 0),
            "order": ("order: estimates remembered", 1),
            "sensor": ("deviation of the sensor noise", 1),
        },
        {"distance": ("far", "far_error")},
        "Growth model: mean square distance of the table's estimate from the conditional mean; "
        "bars are two standard errors.",
        ylabel="mean square distance",
        logx=True,
        zero=True,
    )
