"""A picture of estimates with their bands.

It wants matplotlib, draws into axes of yours or new ones, and returns the axes; ``plt.show()`` or
``axes[0].figure.savefig(...)`` is the caller's. Lines differ by colour and dash; the colours
stand out from white, and any two of them are far apart, also for the colour-blind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_count, optional
from seedslib.filters.base import Estimates

COLOURS = "#0042b4", "#a85400", "#007a5e", "#9e2b78", "#2b7bba", "#5f3200", "#111111"
DASHES = "-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 3))


def plot_estimates(
    times: ArrayLike,
    estimates: Estimates,
    *,
    truth: ArrayLike | None = None,
    measurements: Mapping[int, ArrayLike] | None = None,
    names: Sequence[str] | None = None,
    level: float = 0.95,
    record: int = 0,
    axes: Any = None,
) -> np.ndarray:
    """One panel for each component: mean, interval and what is known beside; then the modes.

    Parameters
    ----------
    times : array_like, shape (K+1,)
        Numbers or dates.
    estimates : Estimates
    truth : array_like, shape (K+1, n, *batch), optional
    measurements : mapping of int to array_like, shape (K+1, *batch), optional
        What sensors show of a component, by its number, as points in its panel.
    names : sequence of str, optional
        Of the components; ``x1, x2, ...`` by default.
    level : float
        Probability of the interval, which is there if the filter claims covariances.
    record : int
        Which of many records, counted through all batch axes.
    axes : sequence of Axes, optional
        One for each component, and one for the modes if there are any; new ones by default.

    Returns
    -------
    ndarray of Axes

    Raises
    ------
    ImportError
        matplotlib is not installed.
    TypeError, ValueError
        Another number of times, names or axes, a record or component that is not there.
    """
    times, mean = np.asarray(times), estimates.mean
    count, n = mean.shape[:2]
    if len(times) != count:
        raise ValueError(f"times: wanted {count}, got {len(times)}")
    names = [f"x{k + 1}" for k in range(n)] if names is None else list(names)
    if len(names) != n:
        raise ValueError(f"names: wanted {n}, got {len(names)}")
    record = as_count("record", record, 0, int(np.prod(mean.shape[2:])) - 1)
    measurements = {} if measurements is None else dict(measurements)
    if not set(measurements) <= set(range(n)):
        numbers = set(measurements)
        raise ValueError(f"measurements: wanted components from 0 to {n - 1}, got {numbers}")
    axes = _axes(axes, n + (estimates.mode_prob is not None))
    band = None if estimates.cov is None else _one(estimates.interval(level), record, 3)
    for k, (ax, name) in enumerate(zip(axes, names, strict=False)):
        if band is not None:
            low, high = np.where(np.isfinite(band[:, :, k]), band[:, :, k], np.nan)
            label = f"{100 * level:g} % interval"
            ax.fill_between(times, low, high, color=COLOURS[0], alpha=0.22, lw=0, label=label)
        if k in measurements:
            y = _one(measurements[k], record, 1)
            ax.plot(times, y, ".", color=COLOURS[1], ms=4, label="measured")
        if truth is not None:
            ax.plot(times, _one(truth, record, 2)[:, k], "k--", lw=1.2, label="truth")
        ax.plot(times, _one(mean, record, 2)[:, k], color=COLOURS[0], lw=1.6, label="estimate")
        ax.set_ylabel(name)
    if estimates.mode_prob is not None:
        for i, row in enumerate(_one(estimates.mode_prob, record, 2).T):
            color, dash = COLOURS[i % len(COLOURS)], DASHES[i % len(DASHES)]
            axes[-1].plot(times, row, color=color, ls=dash, lw=1.6, label=f"mode {i}")
        axes[-1].set(ylabel="probability", ylim=(-0.03, 1.03))
        axes[-1].legend(**_LEGEND)
    axes[0].legend(**_LEGEND)
    axes[-1].set_xlabel("t")
    return axes


_LEGEND: dict[str, Any] = {"frameon": False, "fontsize": "small"}


def _axes(given, count):
    """Panels, one below the other."""
    if given is not None:
        axes = np.atleast_1d(np.asarray(given, dtype=object)).ravel()
        if len(axes) != count:
            raise ValueError(f"axes: wanted {count}, got {len(axes)}")
        return axes
    with optional("plots"):
        from matplotlib import pyplot
    size = (6.4, 1.0 + (2.8 if count == 1 else 1.9 * count))
    axes = pyplot.subplots(
        count, 1, sharex=True, squeeze=False, figsize=size, layout="constrained"
    )[1][:, 0]
    for ax in axes:
        ax.grid(alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    return axes


def _one(part, record, axes):
    """One record of an array whose batch follows its first axes; it may be common to all."""
    part = np.asarray(part)
    flat = part.reshape(*part.shape[:axes], -1)
    return flat[..., record if flat.shape[-1] > 1 else 0]
