"""From a designed filter to one ECMAScript module."""

from __future__ import annotations

import math
import os
import re
from typing import Any

from seedslib.base.atomic import write_whole
from seedslib.extra.c.header import to_c
from seedslib.extra.js.translation import Translation

_HELPERS = {
    "isInfinite": "const isInfinite = (x) => x === Infinity || x === -Infinity;",
    "exp2": "const exp2 = (x) => 2 ** x;",
    "copy": "function copy(to, from, n) { for (let i = 0; i < n; i++) H[to + i] = H[from + i]; }",
    "move": """\
function move(to, from, n) {
  if (to < from) for (let i = 0; i < n; i++) H[to + i] = H[from + i];
  else for (let i = n - 1; i >= 0; i--) H[to + i] = H[from + i];
}""",
    "fill": "function fill(at, x, n) { for (let i = 0; i < n; i++) H[at + i] = x; }",
    "erf": """\
function erf(x) { // a series near zero, a continued fraction farther out
  if (!(Math.abs(x) > 2)) {
    let term = x, sum = x;
    for (let k = 1; k < 100 && Math.abs(term) > 1e-17 * Math.abs(sum); k++) {
      term *= 2 * x * x / (2 * k + 1);
      sum += term;
    }
    return 2 / Math.sqrt(Math.PI) * Math.exp(-x * x) * sum;
  }
  return x > 0 ? 1 - tail(x) : tail(-x) - 1;
}""",
    "erfc": "const erfc = (x) => x > 2 ? tail(x) : 1 - erf(x);",
    "tail": """\
function tail(x) {
  let f = x;
  for (let k = 200; k > 0; k--) f = x + k / 2 / f;
  return Math.exp(-x * x) / Math.sqrt(Math.PI) / f;
}""",
}
_NEEDS = {"erfc": ("erf", "tail"), "erf": ("tail",)}

_STATE = """\
let held = null; // the state whose numbers are where the functions work

// Estimate and what is remembered; see the comment at the top.
export class State {
  constructor(own = null) { this.own = own; }
  copy() { return new State(part(this, 0, @SIZE)); }
@PARTS}

function part(state, from, size) { // a plain array is made quickest
  const found = [];
  if (held === state) for (let i = 0; i < size; i++) found.push(H[@S + from + i]);
  else for (let i = 0; i < size; i++) found.push(state.own[from + i]);
  return found;
}

function release() {
  if (held !== null) held.own = part(held, 0, @SIZE);
  held = null;
}

export function init() {
  release();
  @INIT;
  return held = new State();
}

function hold(state) {
  if (held === state) return;
  release();
  for (let i = 0, own = state.own; i < @SIZE; i++) H[@S + i] = own[i];
  held = state;
}

function shown(y) {
  if (y.length !== @M) throw new RangeError(`y: wanted @M numbers, got ${y.length}`);
  for (let i = 0; i < @M; i++) H[@Y + i] = y[i];
}
"""

_PLACES = {"s": ("f_state",), "y": ("F_MEASUREMENT",), "out": ("F_ESTIMATE", "F_STATE")}
"""What the exported functions work on lies at these places."""

_ROOTS = ("init", "step", "predict", "correct", "forecast")

_RULES = """\
One ECMAScript module without dependencies. init() gives a state; step(state, y), or step(state, \
t, y) where the filter carries its law, takes in a measurement and returns OK, or why it refused; \
the state is then as before. y is an array; a component is NaN where it is missing. With modes an \
indicator comes last. state.mean, state.cov (row by row), state.loglik and, where there are any, \
state.mode and state.prob are what was found. run(state, [times,] ys) takes in a whole record. \
The lines are those of the C that to_c writes, and \
the numbers differ by rounding alone. All numbers are in one array."""


def to_js(filter: Any, path: str | os.PathLike[str] | None = None) -> str:
    """Write a filter as one ECMAScript module without dependencies.

    It is the C of `to_c`, translated line by line, and there for the same filters. It exports
    ``init()``, ``step(state, [t,] y[, indicator])`` and, as the C does, ``forecast(state, t)``,
    ``predict(state, t)`` and ``correct(state, y)``, the codes that they return and the class
    ``State`` with ``mean``, ``cov`` (row by row), ``loglik``, ``mode``, ``prob`` and ``copy()``.
    A step changes its state.

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
    >>> from seedslib.extra import to_js
    >>> from seedslib.filters import extended_kalman
    >>> from seedslib import zoo
    >>> "export function step" in to_js(extended_kalman(zoo.van_der_pol()))
    True
    """
    text = to_c(filter, name="f")
    if "#define F_INPUTS " in text:
        raise ValueError("filter: wanted a model without inputs, the module's step is told none")
    made = Translation(text, *(f"f_{name}" for name in _ROOTS), places=_PLACES)
    about = text[: text.index(" * Use: declare")] + _comment(_RULES)
    state, m = made.structs["f_state"], made.macros["F_MEASUREMENT"]
    size = sum(part.size(made.structs) for part in state.values())
    rows = made.macros.get("F_ESTIMATE", made.macros["F_STATE"])
    marks = {
        "@PARTS": _parts(made),
        "@SIZE": size,
        "@S": made.places["s"],
        "@Y": made.places["y"],
        "@M": m,
        "@O": made.places["out"],
        "@INIT": made.calls["f_init"],
    }
    wanted = set(made.called)
    for name, more in _NEEDS.items():
        wanted |= set(more) if name in wanted else set()
    helpers = [code for name, code in _HELPERS.items() if name in wanted]
    codes = re.findall(r"^#define F_(OK|END|INFINITE|PARTLY|TIME|RANGE|STRAY) (\d)", text, re.M)
    interface = _STATE + _verbs(text, made, rows)
    for mark, value in marks.items():
        interface = interface.replace(mark, str(value))
    parts = [
        about,
        *(f"export const {name} = {code};" for name, code in codes),
        f"\nconst H = new Float64Array({made.size});",
        f"H.set([{_listed(made.numbers)}]);\n",
        *helpers,
        *made.lines,
        interface,
    ]
    module = "\n".join(parts)
    if path is not None:
        write_whole(path, module.encode("ascii"))
    return module


def _comment(rules: str) -> str:
    import textwrap

    return "\n".join(f" * {line}" for line in textwrap.wrap(rules, 96)) + "\n */"


def _listed(numbers: list[float]) -> str:
    """Numbers that are read back exactly."""
    words = [
        str(int(x))
        if float(x).is_integer() and abs(x) < 1e15 and (x or math.copysign(1, x) > 0)
        else repr(float(x)).replace("inf", "Infinity")
        for x in numbers
    ]
    return ",\n".join(",".join(words[k : k + 12]) for k in range(0, len(words), 12))


def _parts(made: Translation) -> str:
    lines, place = "", 0
    for name, kind in made.structs["f_state"].items():
        size = kind.size(made.structs)
        if name in ("mean", "cov", "prob"):
            lines += f"  get {name}() {{ return part(this, {place}, {size}); }}\n"
        elif name in ("loglik", "mode"):
            value = f"held === this ? H[@S + {place}] : this.own[{place}]"
            lines += f"  get {name}() {{ return {value}; }}\n"
        place += size
    return lines


def _verbs(text: str, made: Translation, rows: int) -> str:
    """The exported functions that the C has."""
    timed = "t, " * ("double t, const double *y" in text)
    told = ", indicator" * ("int indicator" in text)
    found = [
        f"export function step(state, {timed}y{told}) {{\n  shown(y);\n  hold(state);\n"
        f"  return {made.calls['f_step']};\n}}"
    ]
    found.append(_run(made, timed, told))
    for name, given in (("predict", "t"), ("correct", "y")):
        if f" f_{name}(" in text:
            first = "  shown(y);\n" if given == "y" else ""
            found.append(
                f"export function {name}(state, {given}) {{\n{first}  hold(state);\n"
                f"  return {made.calls[f'f_{name}']};\n}}"
            )
    if " f_forecast(" in text:
        found.append(
            "// The estimate at a time up to the next measurement; null where it is out of reach.\n"
            "export function forecast(state, t) {\n  hold(state);\n"
            f"  return {made.calls['f_forecast']} === 0 ? H.slice(@O, @O + {rows}) : null;\n}}"
        )
    return "\n" + "\n\n".join(found) + "\n"


def _run(made: Translation, timed: str, told: str) -> str:
    """The function that takes in a whole record."""
    places, place = {}, 0
    for name, kind in made.structs["f_state"].items():
        places[name] = place
        place += kind.size(made.structs)
    n = made.structs["f_state"]["mean"].size(made.structs)
    given = f"{'times, ' * bool(timed)}ys{', indicators' * bool(told)}"
    each = "t = times[k], " * bool(timed) + "indicator = indicators[k], " * bool(told)
    return f"""\
// Room for what `run` finds, to be used again.
export function rows(count) {{
  const [mean, cov, loglik] = [{n}, {n * n}, 1].map((size) => new Float64Array(count * size));
  return {{ mean, cov, loglik }};
}}

// A record, its measurements one behind the other: all means, covariances and log-likelihoods.
export function run(state, {given}, into = rows(ys.length / @M)) {{
  const count = ys.length / @M, {{ mean, cov, loglik }} = into;
  hold(state);
  for (let k = 0; k < count; k++) {{
    for (let i = 0; i < @M; i++) H[@Y + i] = ys[k * @M + i];
    const {each}code = {made.calls["f_step"]};
    if (code !== OK) throw new RangeError(`measurement ${{k}}: refused with code ${{code}}`);
    for (let i = 0; i < {n}; i++) mean[k * {n} + i] = H[@S + {places["mean"]} + i];
    for (let i = 0; i < {n * n}; i++) cov[k * {n * n} + i] = H[@S + {places["cov"]} + i];
    loglik[k] = H[@S + {places["loglik"]}];
  }}
  return into;
}}"""
