"""What differs between two designed filters: choices, coefficients, predicted errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seedslib.base.clock import Clock
from seedslib.designed.file_tables import UnknownModel, probed
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.identity import difference, probe_points
from seedslib.evaluation import switching_designs
from seedslib.evaluation.coefficients import relative_differences
from seedslib.models.words import model_text

ROWS = 12
"""Times that are printed at most."""


class Change(NamedTuple):
    """A choice that differs: its name, and what it is in the first and in the second design."""

    name: str
    first: str
    second: str


class PredictedDifference(NamedTuple):
    """Predicted root-mean-square errors of two designs at the times that both predict.

    Attributes
    ----------
    times : ndarray, shape (S,)
    first, second : ndarray, shape (S, c)
        Root-mean-square errors of the components that both estimate.
    difference : ndarray, shape (S, c)
        Second minus first.
    error : ndarray, shape (S, c)
        Its standard error, the root of the sum of the two squares, as for designs on different
        paths; of designs on the same paths it is too large.
    z : ndarray, shape (S, c)
        Difference by its standard error; NaN where the errors of both are exact.
    """

    times: np.ndarray
    first: np.ndarray
    second: np.ndarray
    difference: np.ndarray
    error: np.ndarray
    z: np.ndarray


@dataclass(frozen=True, eq=False)
class DesignDifference:
    """What differs between two designs; `diff` makes it, and it prints itself.

    Attributes
    ----------
    names : tuple of str
        The two designs in a line each.
    changes : tuple of Change
        Choices that differ: memory, forecast, linearization, times, model, paths.
    same : tuple of str
        Names of the choices that do not.
    times : ndarray, shape (K,)
        Measurement times of both designs.
    coefficients : dict of str to ndarray, shape (K,)
        Relative differences at those times by the kind of coefficient, |A - B| / max(|A|, |B|)
        in the Frobenius norm, from 0 to 2; NaN where shapes differ or there are none. Functions
        are compared at the nodes of the first table, each node alike. Those of the forecasts at
        the nodes after a measurement are taken together.
    comparable : bool
        Whether every coefficient of either design has its like in the other.
    predicted : PredictedDifference
    modes : PredictedDifference or None
        Of switching systems: the predicted part of wrong modes.
    """

    names: tuple[str, str]
    changes: tuple[Change, ...]
    same: tuple[str, ...]
    times: np.ndarray
    coefficients: dict[str, np.ndarray]
    comparable: bool
    predicted: PredictedDifference
    modes: PredictedDifference | None = None

    @property
    def equal(self) -> bool:
        """Whether nothing differs."""
        return (
            self.comparable
            and not self.changes
            and not any(np.nan_to_num(part).any() for part in self.coefficients.values())
            and not self.predicted.difference.any()
            and not (self.modes is not None and self.modes.difference.any())
        )

    def __str__(self) -> str:
        lines = [f"first   {self.names[0]}", f"second  {self.names[1]}"]
        if self.equal:
            return "\n".join([*lines, "nothing differs"])
        width = max((len(change.name) for change in self.changes), default=0)
        lines += [f"  {c.name:{width}}  {c.first}  |  {c.second}" for c in self.changes]
        lines.append(f"  the same: {', '.join(self.same) or 'nothing'}")
        lines += self._coefficient_lines()
        lines += _predicted_lines("root-mean-square errors", self.predicted)
        if self.modes is not None:
            lines += _predicted_lines("part of wrong modes", self.modes)
        return "\n".join(lines)

    def _coefficient_lines(self):
        shown = {n: part for n, part in self.coefficients.items() if np.isfinite(part).any()}
        if not shown:
            return ["no coefficients that could be compared"]
        tables = ", of tables over all nodes of the first, likely or not" * ("output" in shown)
        lines = [f"coefficients, relative difference{tables}"]
        width = max(9, *(len(name) for name in shown))
        head = "  ".join(f"{name:>{width}}" for name in shown)
        lines.append(f"  {'':12}  {head}")
        for j in _some(len(self.times)):
            cells = (f"{part[j]:.3g}" if np.isfinite(part[j]) else "" for part in shown.values())
            row = "  ".join(f"{cell:>{width}}" for cell in cells)
            lines.append(f"  {f't = {self.times[j]:g}':12}  {row}".rstrip())
        return lines


def _predicted_lines(name, p):
    if not len(p.times):
        return [f"no time at which both predict their {name}"]
    lines = [f"predicted {name}, second minus first"]
    for j in _some(len(p.times)):
        row = "  ".join(
            f"{a:.4f} to {b:.4f} ({d:+.4f}{_in_errors(e, z)})"
            for a, b, d, e, z in zip(*(part[j] for part in p[1:]), strict=True)
        )
        lines.append(f"  {f't = {p.times[j]:g}':12}  {row}")
    return lines


def diff(first, second) -> DesignDifference:
    """Compare two designed filters by what they hold; nothing is simulated.

    Errors on held-out paths are not compared: they follow from coefficients, model and seed, which
    are.

    Parameters
    ----------
    first, second : FiniteOrderFilter, or SwitchingFilter and SwitchingTableFilter
        Of any kind: regressions, tables, learned functions; both of systems with modes, or
        neither.

    Returns
    -------
    DesignDifference
        To be printed, or to be read.

    Raises
    ------
    TypeError
        Something that is no designed filter of finite order.
    """
    switching = isinstance(first, switching_designs.FILTERS)
    kinds = switching_designs.FILTERS if switching else FiniteOrderFilter
    wanted = "filter of a switching system" if switching else "FiniteOrderFilter"
    for name, given in (("first", first), ("second", second)):
        if not isinstance(given, kinds):
            raise TypeError(f"{name}: wanted a {wanted}, got {type(given).__name__}")
        if switching:
            switching_designs.require_design(name, given)
    if switching:
        one, two = (switching_designs.choices(d, _grid) for d in (first, second))
        model = [Change(*words) for words in switching_designs.model_changes(first, second)]
        differences = switching_designs.relative_differences
    else:
        one, two, model = _choices(first), _choices(second), _model_changes(first, second)
        differences = relative_differences
    changes, same = [], []
    for name in {**one, **two}:
        if one.get(name) == two.get(name):
            same.append(name)
        else:
            changes.append(Change(name, one.get(name, "none"), two.get(name, "none")))
    changes += model
    if not model:
        same.append("model")
    a, b = _common(first.times, second.times)
    coefficients: dict[str, np.ndarray] = {}
    comparable = True
    for j, (k, q) in enumerate(zip(a, b, strict=True)):
        for name, apart in differences(first, k, second, q).items():
            coefficients.setdefault(name, np.full(len(a), np.nan))[j] = apart
            comparable &= bool(np.isfinite(apart))
    names = (repr(first).strip("<>"), repr(second).strip("<>"))
    if switching:
        errors = (switching_designs.predicted_errors(d) for d in (first, second))
        predicted, modes = (_predicted(*pair) for pair in zip(*errors, strict=True))
    else:
        predicted, modes = _predicted(first.predicted, second.predicted), None
    return DesignDifference(
        names, tuple(changes), tuple(same), first.times[a], coefficients, comparable, predicted,
        modes,
    )  # fmt: skip


def _choices(designed) -> dict[str, str]:
    """What was chosen for a design, in words that are equal where the choices are."""
    made = designed.design
    paths = "exact" if made.exact else f"{made.paths} paths of seed {made.entropy}"
    if made.spawn_key:
        paths += f", stream {made.spawn_key}"
    return {
        "kind": type(designed).__name__,
        "memory": str(designed.memory),
        "forecast": str(designed.predictor),
        "linearization": _named(designed.linearization),
        "components": str(designed.components),
        "measured nodes": "yes" if designed.measured_nodes else "no",
        "between": designed.between,
        "measurement times": _grid(designed.times),
        "nodes": _grid(np.concatenate([*designed.node_times, np.empty(0)])),
        "designed on": paths,
    }


def _named(thing):
    """A linearization of one's own may have no words but its name."""
    plain = type(thing).__repr__ is object.__repr__
    return type(thing).__name__ if plain else str(thing)


def _grid(times):
    """Times in words: spelled out where they are few or uneven."""
    if len(times) <= 1:
        return ", ".join(f"{t:.12g}" for t in times) or "none"
    steps = np.diff(times)
    even = np.ptp(steps) <= Clock(times).tolerance
    if even or len(times) > ROWS:
        by = f"by {steps[0]:.9g}" if even else f"unevenly, sum {times.sum():.12g}"
        return f"{len(times)} from {times[0]:.9g} to {times[-1]:.9g} {by}"
    return ", ".join(f"{t:.12g}" for t in times)


def _model_changes(first, second) -> list[Change]:
    one, two = first.system, second.system
    if one is two:
        return []
    if isinstance(one, UnknownModel) or isinstance(two, UnknownModel):
        words = ("unknown" if isinstance(s, UnknownModel) else "known" for s in (one, two))
        return [Change("model", *words)]
    if one.state_size != two.state_size:
        return [Change("state components", str(one.state_size), str(two.state_size))]
    points = probe_points(one, float(first.times[0]), first.horizon)
    with np.errstate(all="ignore"):
        reason = difference(probed(one, points), probed(two, points), points)
    if not reason:  # the same model, however it is written
        return []
    a, b = model_text(one), model_text(two)
    texts = [
        Change(f"model ({name})", a.get(name, "none"), b.get(name, "none"))
        for name in {**a, **b}
        if a.get(name) != b.get(name)
    ]
    return [Change("model", "as designed", reason), *texts]


def _common(one, two) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the times that are in both grids, in the first and in the second."""
    if not (len(one) and len(two)):
        return np.empty(0, dtype=int), np.empty(0, dtype=int)
    rows = Clock(one).rows(two)
    at = np.flatnonzero(rows >= 0)
    return at, rows[at]


def _predicted(one, two) -> PredictedDifference:
    a, b = _common(one.times, two.times)
    c = min(one.rms.shape[1], two.rms.shape[1])
    first, second = one.rms[a, :c], two.rms[b, :c]
    apart, error = second - first, np.hypot(one.error[a, :c], two.error[b, :c])
    z = np.divide(apart, error, out=np.full(apart.shape, np.nan), where=error > 0)
    return PredictedDifference(one.times[a], first, second, apart, error, z)


def _some(count):
    """Numbers of at most `ROWS` rows, evenly chosen."""
    return range(count) if count <= ROWS else np.linspace(0, count - 1, ROWS).astype(int)


def _in_errors(error, z):
    return f" ± {error:.4f}, z = {z:+.1f}" if np.isfinite(z) else ", exact"
