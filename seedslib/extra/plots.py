"""Pictures: estimates with their bands, filters compared, profiles of a likelihood.

They want matplotlib, draw into axes of yours or new ones, and return the axes; ``plt.show()`` or
``axes[0].figure.savefig(...)`` is the caller's. Lines differ by colour and dash; the colours
stand out from white, and any two of them are far apart, also for the colour-blind.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_count
from seedslib.base.parameters import Parameter
from seedslib.filters.estimates import Estimates

if TYPE_CHECKING:
    from seedslib.evaluation.fitting import Fit
    from seedslib.evaluation.results import Comparison

COLOURS = "#0042b4", "#ca8100", "#0ba86c", "#9e2b78", "#4798e3", "#5f3200", "#111111"
DASHES = "-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 3))


def plot_estimates(
    times: ArrayLike, estimates: Estimates, *, truth: ArrayLike | None = None,
    measurements: Mapping[int, ArrayLike] | None = None, names: Sequence[str] | None = None,
    level: float = 0.95, record: int = 0, axes: Any = None,
) -> np.ndarray:  # fmt: skip
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
    names = _named(names, n)
    record = as_count("record", record, 0, int(np.prod(mean.shape[2:])) - 1)
    shown = {} if measurements is None else dict(measurements)
    if not set(shown) <= set(range(n)):
        raise ValueError(f"measurements: wanted components from 0 to {n - 1}, got {set(shown)}")
    axes = _axes(axes, n + (estimates.mode_prob is not None))
    band = None if estimates.cov is None else _one(estimates.interval(level), record, 3)
    for k, (ax, name) in enumerate(zip(axes, names, strict=False)):
        if band is not None:
            low, high = np.where(np.isfinite(band[:, :, k]), band[:, :, k], np.nan)
            label = f"{100 * level:g} % interval"
            ax.fill_between(times, low, high, color=COLOURS[0], alpha=0.22, lw=0, label=label)
        if k in shown:
            y = _one(shown[k], record, 1)
            ax.plot(times, y, ".", color=COLOURS[1], ms=4, label="measured")
        if truth is not None:
            ax.plot(times, _one(truth, record, 2)[:, k], "k--", lw=1.2, label="truth")
        ax.plot(times, _one(mean, record, 2)[:, k], color=COLOURS[0], lw=1.6, label="estimate")
        ax.set_ylabel(name)
    if estimates.mode_prob is not None:
        for i, row in enumerate(_one(estimates.mode_prob, record, 2).T):
            axes[-1].plot(times, row, **_line(i), label=f"mode {i}")
        axes[-1].set(ylabel="probability", ylim=(-0.03, 1.03))
        axes[-1].legend(**_LEGEND)
    axes[0].legend(**_LEGEND)
    axes[-1].set_xlabel("t")
    return axes


def plot_comparison(
    comparison: Comparison, *, names: Sequence[str] | None = None, axes: Any = None
) -> np.ndarray:
    """Root-mean-square errors over time with two standard errors on either side.

    Filters see the same paths: `Comparison.difference` tells them apart where bands overlap.

    Parameters
    ----------
    comparison : Comparison
    names : sequence of str, optional
        Of the components; ``x1, x2, ...`` by default.
    axes : sequence of Axes, optional
        One for each component; new ones by default.

    Returns
    -------
    ndarray of Axes

    Raises
    ------
    ImportError
        matplotlib is not installed.
    ValueError
        Another number of names or axes.
    """
    n = next(iter(comparison.values())).rms.shape[1]
    names = _named(names, n)
    axes = _axes(axes, n)
    for k, (ax, name) in enumerate(zip(axes, names, strict=True)):
        for i, (label, row) in enumerate(comparison.items()):
            value, error = row.rms[:, k], 2 * row.rms_error[:, k]
            (line,) = ax.plot(row.times, value, **_line(i), label=label)
            color = line.get_color()
            ax.fill_between(row.times, value - error, value + error, color=color, alpha=0.2, lw=0)
        ax.set_ylabel(f"RMS error of {name}")
    axes[0].legend(**_LEGEND)
    axes[-1].set_xlabel("t")
    return axes


def plot_profile(
    fit: Fit,
    parameter: Parameter,
    points: Iterable[float],
    *,
    level: float = 0.95,
    axes: Any = None,
) -> np.ndarray:
    """Profile of the log-likelihood over one parameter, and where it is cut.

    The values above the cut are an interval of this probability for large samples: twice the
    fall of the log-likelihood has the chi-square law of one degree of freedom.

    Parameters
    ----------
    fit : Fit
    parameter : Parameter
    points : sequence of float
        Values of the parameter, see `Fit.profile`.
    level : float
    axes : sequence of one Axes, optional

    Returns
    -------
    ndarray of Axes
        One.

    Raises
    ------
    ImportError
        matplotlib is not installed.
    ValueError
        A level that is not between 0 and 1, and as `Fit.profile`.
    """
    from scipy.special import chdtri

    if not 0 < level < 1:
        raise ValueError(f"level: wanted a number between 0 and 1, got {level}")
    points = np.sort(np.array(list(points), dtype=float))
    fall = fit.profile(parameter, points) - fit.loglik
    (ax,) = axes = _axes(axes, 1)
    ax.plot(points, fall, **_line(0), label="profile")
    best = fit.values[fit.parameters.index(parameter)]
    ax.plot([best], [0.0], "o", color=COLOURS[1], label=f"maximum, {best:.4g}")
    cut = -0.5 * float(chdtri(1, 1.0 - level))
    ax.axhline(cut, **_line(2), label=f"cut for {100 * level:g} %")
    ax.set(xlabel=str(parameter), ylabel="log-likelihood less its maximum")
    ax.legend(**_LEGEND)
    return axes


_LEGEND: dict[str, Any] = {"frameon": False, "fontsize": "small"}


def _line(number):
    """Colour and dash of one line among others."""
    return {"color": COLOURS[number % len(COLOURS)], "ls": DASHES[number % len(DASHES)], "lw": 1.6}


def _named(names: Sequence[str] | None, count: int) -> list[str]:
    """Names of components, which are numbered where they have none."""
    names = [f"x{k + 1}" for k in range(count)] if names is None else list(names)
    if len(names) != count:
        raise ValueError(f"names: wanted {count}, got {len(names)}")
    return names


def _axes(given, count):
    """Panels, one below the other."""
    if given is not None:
        axes = np.atleast_1d(np.asarray(given, dtype=object)).ravel()
        if len(axes) != count:
            raise ValueError(f"axes: wanted {count}, got {len(axes)}")
        return axes
    try:
        from matplotlib import pyplot
    except ImportError:
        raise ImportError(
            'a picture wants matplotlib, which is not installed; pip install "seedslib[plots]"'
        ) from None
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
