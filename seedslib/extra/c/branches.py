"""C of the moments of a switching system's branches: moves with their switches, readings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from seedslib.designed.finite_order import law_symbols
from seedslib.designed.switching.rules import SwitchingRules
from seedslib.extra.c.source import function
from seedslib.extra.c.tape import Scalar, Tape
from seedslib.extra.c.traced import told_of, told_on
from seedslib.linearization.formulas import BranchFormulas, Names, mentions
from seedslib.linearization.moments import TINY
from seedslib.models.codegen import compile_components
from seedslib.models.maps import StochasticMap
from seedslib.models.switching import Branch


def check_branches(rules: SwitchingRules, linearization: Any, system: Any) -> None:
    """Raise TypeError or ValueError where moments of branches are no formulas."""
    if not hasattr(linearization, "formulas"):
        raise TypeError(
            "linearization: wanted formulas, Taylor or ExactGaussian, to write modes in C, got "
            f"{linearization!r}"
        )
    if rules.printed:
        raise ValueError("normalisation: wanted 'consistent' for C, got 'printed'")
    if not system.symbolic:
        raise ValueError("system: wanted symbolic expressions to write in C, got array functions")


def moves_source(system: Any, linearization: Any, split: bool) -> str:
    """C of ``@name_move_(i, t, law, out)``: masses and moments of the next state in mode i.

    `out` holds for each next mode, and for each value of the indicator where forecasts are
    split, the mass, the mean and the covariance on and below the diagonal.
    """
    text, lines = "", []
    for i in range(system.modes):
        row = system.branches[i]
        if system.drives == "new":  # the mode has switched before, and stays
            row = [Branch(system.dynamics[i]) if l == i else None for l in range(system.modes)]
        found, place = _Writer(system, linearization), 0
        common = not split and all(branch is None or branch.constant for branch in row)
        for branch, readings in zip(row, system.readings, strict=True):
            for reading in readings if split else (None,):
                if branch is None or (split and reading is None):
                    found.store([0.0], place)
                elif common:
                    found.add(found.plain(branch), place, _moved)
                else:
                    map = _seen(branch.map, reading) if split else branch.map
                    found.add(found.branch(map), place, _moved)
                place += 1 + _law_size(system.state_size)
        head = f"void @name_move_{i}_(double t, const double *law, double *out@ALSO)"
        text += function(head, found.body("@UNUSED"))
        lines.append(f"    if (i == {i}) @name_move_{i}_(t, law, out@WITH);")
    head = "void @name_move_(int i, double t, const double *law, double *out@ALSO)"
    return text + function(head, lines)


def switches_source(system: Any, linearization: Any) -> str:
    """C of ``@name_switch_(i, t, law, out)``: as `moves_source`, of a state that stands still."""
    text, lines, size = "", [], 1 + _law_size(system.state_size)
    for i, row in enumerate(system.branches):
        found, still = _Writer(system, linearization), [branch and branch.still for branch in row]
        common = all(branch is None or branch.constant for branch in still)
        for l, branch in enumerate(still):
            if branch is None:
                found.store([0.0], l * size)
            else:
                each = found.plain(branch) if common else found.branch(branch.map)
                found.add(each, l * size, _moved)
        head = f"void @name_switch_{i}_(double t, const double *law, double *out@ALSO)"
        text += function(head, found.body("@UNUSED"))
        lines.append(f"    if (i == {i}) @name_switch_{i}_(t, law, out@WITH);")
    head = "void @name_switch_(int i, double t, const double *law, double *out@ALSO)"
    return text + function(head, lines)


def readings_source(system: Any, linearization: Any) -> str:
    """C of ``@name_read_(i, shown, t, law, out)``: what mode i shows with a value of the indicator.

    `out` holds the mass and the joint law of state and measurement: the mean, and the covariance
    on and below the diagonal. -1 is an indicator that is missing, or that there is not.
    """
    text, lines = "", []
    for i, sensor in enumerate(system.sensors):
        cases = [(-1, Branch(sensor))]
        cases += [*enumerate(system.readings[i])] if system.indicators else []
        for j, reading in cases:
            place = f"    if (i == {i} && shown == {j}) "
            if reading is None:
                lines.append(f"{place}out[0] = 0.0;")
                continue
            found, own = _Writer(system, linearization), f"@name_read_{i}_{j + 1}_"
            plain = reading.constant
            found.add(found.plain(reading) if plain else found.branch(reading.map), 0, _shown)
            text += function(f"void {own}(double t, const double *law, double *out)", found.body())
            lines.append(f"{place}{own}(t, law, out);")
    head = "void @name_read_(int i, int shown, double t, const double *law, double *out)"
    return text + function(head, lines)


class _Writer:
    """C of moments of branches in one function of time and law: mean, then covariance."""

    def __init__(self, system: Any, linearization: Any) -> None:
        self.system, self.linearization, self.names = system, linearization, Names()
        self.mean, self.lower, self.cov = law_symbols(system.state_size)
        self.wanted: list[tuple[Any, bool, int]] = []
        self.kept: dict[str, Any] = {}

    def plain(self, branch: Branch) -> BranchFormulas:
        """Moments of a branch whose probability does not depend on the state."""
        mean = list(self.mean)
        found = self.linearization.formulas(branch.whole, mean, self.cov)
        return BranchFormulas(branch.map.weight_expression, mean, self.cov, *found)

    def branch(self, map: StochasticMap) -> BranchFormulas:
        """Moments of any branch."""
        return self.linearization.branch(map, list(self.mean), self.cov, self.names)

    def store(self, values: Sequence[Any], place: int) -> None:
        """Numbers to be stored from a place on."""
        self.kept.update({f"out[{place + k}]": value for k, value in enumerate(values)})

    def add(self, moments: Any, place: int, choose: Any) -> None:
        """Mass and moments of a branch to be stored from a place on."""
        varies = mentions(self.names.meaning(moments.mass), {*self.mean, *self.lower})
        for k, expression in enumerate([moments.mass, *choose(moments)]):
            self.wanted.append((expression, varies and k == 0, place + k))

    def body(self, unused: str = "") -> list[str]:
        """Lines of the function; a move is told how long it takes."""
        n, tape = self.system.state_size, Tape()
        law = tape.inputs("law[{}]", _law_size(n))
        evaluate = compile_components(
            (self.system.time, self.mean, self.lower),
            [e for e, _, _ in self.wanted],
            self.names.table,
        )
        with told_on(tape, told_of(self.system)):
            found = evaluate(tape.inputs("t")[()], list(law[:n]), list(law[n:]))
        for value, (_, varies, place) in zip(found, self.wanted, strict=True):
            if varies and isinstance(value, Scalar):  # rounding may make none negative
                value = tape.node("{0} < {1} ? 0.0 : {0}", value, float(TINY))
            self.store([value], place)
        return [f"    (void)t; (void)law;{unused}", *tape.body(self.kept)]


def _moved(moments: Any) -> list[Any]:
    cov = moments.spread
    return [*moments.value, *(cov[i, j] for i in range(len(moments.value)) for j in range(i + 1))]


def _shown(moments: Any) -> list[Any]:
    """Joint law of state and measurement."""
    n, m = len(moments.mean), len(moments.value)
    joint = [moments.cov[i, j] for i in range(n) for j in range(i + 1)]
    for k in range(m):
        joint += [moments.cross[i, k] for i in range(n)]
        joint += [moments.spread[k, j] for j in range(k + 1)]
    return [*moments.mean, *moments.value, *joint]


def _law_size(n: int) -> int:
    return n * (n + 3) // 2


def _seen(move: StochasticMap, reading: Any) -> StochasticMap:
    """Move to the next state together with what the indicator will show there, (6.19)."""
    there = dict(zip(reading.map.state, move.expressions, strict=True))
    weight = move.weight_expression * reading.probability_expression.subs(there, simultaneous=True)
    return StochasticMap(move.state, move.expressions, move.noise, weight, time=move.time)
