"""What differs between two designed filters: choices, coefficients, predicted errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from seedslib.base.clock import Clock, when
from seedslib.base.objects import Shown
from seedslib.designed.finite_order import FiniteOrderFilter
from seedslib.designed.outputs.filter import OutputFilter
from seedslib.designed.prediction import shown_rows
from seedslib.designed.switching.filter import SwitchingFilter
from seedslib.evaluation.choices import Change, choices, model_changes
from seedslib.evaluation.coefficients import relative_differences
from seedslib.models.kinds import switches


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


@dataclass(frozen=True, eq=False, repr=False)
class DesignDifference(Shown):
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

    _shown = "names", "equal"

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
        for j in shown_rows(len(self.times)):
            cells = (f"{part[j]:.3g}" if np.isfinite(part[j]) else "" for part in shown.values())
            row = "  ".join(f"{cell:>{width}}" for cell in cells)
            lines.append(f"  {f't = {when(self.times[j])}':12}  {row}".rstrip())
        return lines


def _predicted_lines(name, p):
    if not len(p.times):
        return [f"no time at which both predict their {name}"]
    lines = [f"predicted {name}, second minus first"]
    for j in shown_rows(len(p.times)):
        row = "  ".join(
            f"{a:.4f} to {b:.4f} ({d:+.4f}{_in_errors(e, z)})"
            for a, b, d, e, z in zip(*(part[j] for part in p[1:]), strict=True)
        )
        lines.append(f"  {f't = {when(p.times[j])}':12}  {row}")
    return lines


def diff(first: Any, second: Any) -> DesignDifference:
    """Compare two designed filters by what they hold; nothing is simulated.

    Errors on held-out paths are not compared: they follow from coefficients, model and seed, which
    are.

    Parameters
    ----------
    first, second : FiniteOrderFilter, SwitchingFilter, TableFilter or LearnedFilter
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
    switching = switches(getattr(first, "system", None))
    kinds = (SwitchingFilter if switching else FiniteOrderFilter) | OutputFilter
    wanted = "filter of a switching system" if switching else "FiniteOrderFilter"
    for name, given in (("first", first), ("second", second)):
        if not isinstance(given, kinds) or switches(given.system) != switching:
            raise TypeError(f"{name}: wanted a {wanted}, got {type(given).__name__}")
        if given.memory is None:
            raise TypeError(f"{name}: wanted a designed filter, got one without a memory")
    one, two, model = choices(first), choices(second), model_changes(first, second)
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
        for name, apart in relative_differences(first, k, second, q).items():
            coefficients.setdefault(name, np.full(len(a), np.nan))[j] = apart
            comparable &= bool(np.isfinite(apart))
    return DesignDifference(
        (repr(first).strip("<>"), repr(second).strip("<>")), tuple(changes), tuple(same),
        first.times[a], coefficients, comparable, _predicted(first, second, "rms", "error"),
        _predicted(first, second, "mode_rate", "mode_error") if switching else None,
    )  # fmt: skip


def _common(one, two) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the times that are in both grids, in the first and in the second."""
    if not (len(one) and len(two)):
        return np.empty(0, dtype=int), np.empty(0, dtype=int)
    rows = Clock(one).rows(two)
    at = np.flatnonzero(rows >= 0)
    return at, rows[at]


def _predicted(first, second, *names) -> PredictedDifference:
    """Predicted errors and their standard errors, each by the name of its field."""
    none = np.empty(0), np.empty((0, 1)), np.empty((0, 1))
    (times, *one), (there, *two) = (
        none if p is None else (p.times, *(getattr(p, name).reshape(len(p.times), -1)
                                           for name in names))
        for p in (first.predicted, second.predicted)
    )  # fmt: skip
    a, b = _common(times, there)
    c = min(one[0].shape[1], two[0].shape[1])
    before, after = one[0][a, :c], two[0][b, :c]
    apart, error = after - before, np.hypot(one[1][a, :c], two[1][b, :c])
    z = np.divide(apart, error, out=np.full(apart.shape, np.nan), where=error > 0)
    return PredictedDifference(times[a], before, after, apart, error, z)


def _in_errors(error, z):
    return f" ± {error:.4f}, z = {z:+.1f}" if np.isfinite(z) else ", exact"
