"""A recorded step as one ECMAScript module."""

from __future__ import annotations

import math
import os
from itertools import accumulate
from typing import Any

import numpy as np

from seedslib.base.atomic import write_whole
from seedslib.export.c import C, about, arguments, carries_cov, filled, shape
from seedslib.export.programs import recorded
from seedslib.filters.program import CODES, Program
from seedslib.tape.tape import Array, Loop, Number, Scalar, When


class JavaScript(C):
    """How ECMAScript spells a program: arrays are flat, the state is one."""

    def __init__(self, step: Program) -> None:
        super().__init__("")
        state = [a for a in step.arrays.values() if a.owner == "state"]
        ends = list(accumulate(math.prod(a.shape) for a in state))
        self.size = ends[-1]
        self.start = dict(zip((a.name for a in state), [0, *ends], strict=False))

    def constant(self, value: float) -> str:
        """See `C.constant`."""
        value = float(value)
        if value.is_integer() and abs(value) < 1e15 and repr(value) != "-0.0":
            return str(int(value))
        return repr(value).replace("inf", "Infinity").replace("nan", "NaN")

    def operation(self, operation: str, operands: tuple[Number, ...]) -> str:
        """See `C.operation`.

        Raises
        ------
        ValueError
            A function that ECMAScript does not have.
        """
        if operation == "lgamma":
            raise ValueError("formulas: wanted functions that ECMAScript has, got lgamma")
        return super().operation(operation, operands)

    def place(self, array: Array, index: tuple[Number, ...]) -> str:
        """See `C.place`."""
        if array.owner == "local" and not array.indexed:
            return self.variable(array, index)
        if not array.shape and array.owner == "argument":
            return array.name
        strides = np.cumprod([1, *array.shape[:0:-1]])[::-1].tolist()[: len(index)]
        fixed, terms = self.start[array.name] if array.owner == "state" else 0, []
        for x, stride in zip(index, strides, strict=True):
            if type(x) is not Scalar:
                fixed += int(x) * stride
            else:
                terms.append(f"{self.number(x)} * {stride}" if stride > 1 else self.number(x))
        name = "S" if array.owner == "state" else array.name
        return f"{name}[{' + '.join([*terms, str(fixed)] if fixed or not terms else terms)}]"

    def let(self, result: Scalar, text: str) -> str:
        """See `C.let`."""
        return f"const {result.name} = {text};"

    def store(self, array: Array, place: str, value: Number) -> str:
        """See `C.store`."""
        return f"{place} = {self.whole(value)};"

    def condition(self, statement: When | Loop) -> str:
        """See `C.condition`."""
        if isinstance(statement, When):
            return super().condition(statement)
        i = statement.index.name
        return f"for (let {i} = 0; {i} < {self.number(statement.operands[0])}; {i}++)"

    def refuse(self, condition: Number, code: str) -> str:
        """See `C.refuse`."""
        return f"if ({self.whole(condition)}) return {code};"

    def local(self, array: Array) -> list[str]:
        """See `C.local`."""
        if array.indexed:
            return [f"let {array.name} = new Float64Array({math.prod(array.shape)});"]
        places = (self.place(array, index) for index in np.ndindex(*array.shape))
        return [f"let {place} = 0;" for place in places]


def to_js(filter: Any, path: str | os.PathLike[str] | None = None) -> str:
    """Write a filter as one ECMAScript module without dependencies.

    It is the program of `to_c`, and there for the same filters. It exports ``init()``,
    ``step(state, [time,] y[, indicator][, held, u])``, of a filter that carries mean and
    covariance also ``predict(state, time[, held])`` and ``correct(state, y[, u])``, the codes
    that they return, ``run``, and the class ``State`` with ``mean``, ``cov`` (row by row),
    ``loglik``, ``mode``, ``prob`` and ``copy()``. A step changes its state.

    Parameters
    ----------
    filter : FiniteOrderFilter, TableFilter, SwitchingFilter or CovarianceFilter
    path : path_like, optional
        Where to write the module as well.

    Returns
    -------
    str
        The module, ASCII. Equal filters give equal text.

    Raises
    ------
    TypeError, ValueError
        As `to_c`; a function that ECMAScript does not have.

    Examples
    --------
    >>> from seedslib.export import to_js
    >>> from seedslib.filters import extended_kalman
    >>> from seedslib import zoo
    >>> "export function step" in to_js(extended_kalman(zoo.van_der_pol()))
    True
    """
    step = recorded(filter)
    writer, names = JavaScript(step), arguments(step)
    each = {"time": "times[k]", "indicator": "indicators[k]", "y": "y"}
    each |= {"held": _row(step, "k - (k > 0)"), "u": _row(step, "k")}
    record = {"time": "times", "indicator": "indicators", "y": "ys", "u": "inputs"}
    inputs = (", u", ", u, u") if step.inputs else ("", "")
    marks = {
        "CODES": "\n".join(f"export const {code} = {k};" for k, code in enumerate(CODES)),
        "TABLES": "\n".join(_tables(step, writer)),
        "SIZE": writer.size,
        "GETTERS": "\n".join(_getters(step, writer)),
        "START": "".join(_start(step, writer)),
        "GIVEN": ", ".join(names),
        "M": step.m,
        "N": step.rows,
        "LINES": "\n".join(writer.step(step)),
        "RECORD": ", ".join(record[name] for name in names if name != "held"),
        "EACH": ", ".join(each[name] for name in names),
        "INPUTS": inputs[0],
        "PASSED": inputs[1],
        **{f"AT_{name.upper()}": start for name, start in writer.start.items()},
    }
    marks["HALVES"] = filled("halves.mjs", marks) if carries_cov(step) else ""
    text = about(step, "JAVASCRIPT") + filled("module.mjs", marks)
    if path is not None:
        write_whole(path, text.encode("ascii"))
    return text


def _row(step: Program, k: str) -> str:
    size = len(step.inputs)
    return f"inputs.slice(({k}) * {size}, ({k}) * {size} + {size})"


def _tables(step: Program, writer: JavaScript) -> list[str]:
    result = []
    for a in step.arrays.values():
        if a.owner == "table":
            numbers = [writer.constant(value) for value in np.ravel(a.values).tolist()]
            lines = (",".join(numbers[k : k + 12]) for k in range(0, len(numbers), 12))
            listed = ",\n".join(lines)
            result.append(f"const {a.name} = Float64Array.from([{listed}]);")
    return result


def _getters(step: Program, writer: JavaScript) -> list[str]:
    result = []
    for name in ("mean", "cov", "loglik", "mode", "prob"):
        if name in step.arrays:
            size, start = math.prod(step.arrays[name].shape), writer.start[name]
            value = (
                f"part(this.S, {start}, {size})" if shape(step.arrays[name]) else f"this.S[{start}]"
            )
            result.append(f"  get {name}() {{ return {value}; }}")
    return result


def _start(step: Program, writer: JavaScript) -> list[str]:
    result = []
    for name, values in step.initial.items():
        numbers = ", ".join(writer.constant(value) for value in np.ravel(values).tolist())
        result.append(f"  state.S.set([{numbers}], {writer.start[name]});\n")
    return result
