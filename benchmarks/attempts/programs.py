"""Models as input: names of symbols and functions, strings, functions without code, injections."""

from __future__ import annotations

import builtins
import keyword
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import numpy as np
import sympy

from attempts.judge import Attempt, Crashed, equal, sane
from attempts.targets import TIMES, Y, linear_diffusion
from seedslib.base import Input, Parameter
from seedslib.extra import to_c, to_js
from seedslib.filters import assumed_density, extended_kalman, unscented_kalman
from seedslib.gaussian import (
    approximate_errors,
    classify,
    expectation,
    expectation_function,
    mean_square_errors,
    posterior_variance_function,
)
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem
from seedslib.two_step import AugmentedDiffusion, TwoStepEstimator

TRAP = "__import__('pathlib').Path('pwned').write_text('x')"
INJECTIONS = (
    TRAP,
    f"x)\n{TRAP}\n(",
    f"x; {TRAP}",
    f"x'''+{TRAP}+'''",
    f'x"+{TRAP}+"',
    f"[{TRAP}]",
    f"x\\n{TRAP}",
    "x */ int",
    'x; system("touch pwned");',
    "*/ #include <stdlib.h> /*",
    "x\n#define double int",
    "`;require('fs').writeFileSync('pwned','x');`",
    "</script><script>",
    "${1+1}",
    "x//",
    "x/*",
    "x#",
    "x\x00",
    "x\u2028y",
    "λ",
    "x y",
    "",
    " ",
    "1",
    "1x",
    "x.y",
    "x[0]",
    "x()",
    "-x",
    "x-1",
    "'",
    '"',
    "\\",
    "\n",
    "{}",
    "{0}",
    "%s",
)
C_WORDS = (
    "int",
    "for",
    "NAN",
    "INFINITY",
    "double",
    "float",
    "if",
    "while",
    "return",
    "static",
    "struct",
    "sin",
    "exp",
    "pow",
    "sqrt",
    "main",
    "memcpy",
    "errno",
    "M_PI",
    "filter_step",
    "filter_state",
    "isnan",
    "restrict",
    "asm",
    "__LINE__",
    "NULL",
    "unsigned",
    "BIG_OK",
)
JS_WORDS = (
    "var",
    "function",
    "let",
    "const",
    "this",
    "undefined",
    "NaN",
    "Infinity",
    "eval",
    "arguments",
    "await",
    "Math",
    "constructor",
    "__proto__",
)
OWN = (
    "numpy",
    "np",
    "math",
    "scipy",
    "u0_",
    "u1_",
    "u2_",
    "u4_",
    "x0",
    "x1",
    "t",
    "y",
    "h",
    "rng",
    "seed",
    "state",
    "noise",
    "mean",
    "cov",
    "_Dummy_1",
    "array",
    "select",
    "less",
    "I",
    "E",
    "pi",
    "S",
    "N",
    "O",
    "Q",
    "oo",
    "zoo",
    "nan",
)
PYTHON = (*keyword.kwlist, *keyword.softkwlist, *(n for n in dir(builtins) if n[0].islower()))


def attempts() -> list[Attempt]:
    """All of them."""
    found = []
    for name in dict.fromkeys((*INJECTIONS, *C_WORDS, *JS_WORDS, *OWN, *PYTHON)):
        for role in ("state", "noise", "parameter"):
            found.append(
                Attempt(
                    f"{role} called {name!r}"[:90],
                    partial(named, name, role),
                    as_plain,
                    legal=name != "t",
                )
            )
        found.append(
            Attempt(
                f"in C and JavaScript: {name!r}"[:90],
                partial(exported, name),
                as_plain_text,
                legal=name != "t",
            )
        )
    for name in INJECTIONS:
        if "\x00" in name:  # SymPy itself does not take it
            continue
        found.append(Attempt(f"function called {name!r}"[:90], partial(function_named, name)))
    for where, call in STRINGS.items():
        for text in (TRAP, "x", "1", "x**2", ""):
            found.append(Attempt(f"string as {where}: {text}"[:90], partial(safely, call, text)))
    for where, make in PLACES.items():
        for what, f in impossible():
            for rule in (extended_kalman, unscented_kalman, assumed_density):
                found.append(
                    Attempt(
                        f"{where}, {rule.__name__}: {what}"[:110], partial(run, rule, make, f), sane
                    )
                )
    for what, f in impossible():
        for call in (
            expectation_function,
            posterior_variance_function,
            mean_square_errors,
            approximate_errors,
        ):
            found.append(Attempt(f"{call.__name__}: {what}"[:110], partial(mean_of, call, f), sane))
        found.append(Attempt(f"classify: {what}", partial(classify, f, [X]), lambda value: True))
        found.append(
            Attempt(f"expectation: {what}", partial(expectation, f, [X], [0], sympy.eye(1)), finite)
        )
    for what, call in twice().items():
        found.append(Attempt(f"twice: {what}", call))
    return found


X, V, W, T = sympy.symbols("x v w t")


def named(name: str, role: str) -> object:
    """A filter of a model in which a symbol has a name, and estimates of a simulated record."""
    x, v, b = X, V, sympy.Symbol("b")
    if role == "state":
        x = sympy.Symbol(name)
    elif role == "noise":
        v = sympy.Symbol(name)
    else:
        b = sympy.Symbol(name)
    taken = {str(s) for s in (x, v, b)}
    w = W if "w" not in taken else sympy.Symbol("omega")
    if len(taken) < 3:  # another one has this name
        v, b, x = (
            s if str(s) == name and r == role else sympy.Symbol(f"{s}_other")
            for s, r in ((v, "noise"), (b, "parameter"), (x, "state"))
        )
    system = JumpDiffusion(
        (x,),
        [-b * sympy.sin(x) - sympy.sqrt(1 + x**2) + sympy.Max(x, sympy.pi) * sympy.exp(-(x**2))],
        [[1]],
        [x + v],
        Noise((v,)),
        [0.0],
        [[1.0]],
        parameters={b: 2},
        step=0.25,
    )
    seen = system.simulate(TIMES, 3, 1)
    del w
    found = extended_kalman(system).run(TIMES, seen.measurements)
    untouched()
    return found.mean, found.cov, seen.states


def as_plain(value: object) -> bool:
    """The same numbers as with a name like any other."""
    return equal(value, plain())


@cache
def plain() -> object:
    return named("q", "state")


def exported(name: str) -> tuple[str, str]:
    """C and JavaScript of a filter with symbols of this name, and the files as they would be."""
    x, w = sympy.Symbol(name), sympy.Dummy("w")
    system = DiscreteSystem(
        StochasticMap((x,), [x / 2 + sympy.sin(x) + V], Noise((V,))),
        StochasticMap((x,), [x**2 + w], Noise((w,))),
        [0.0],
        [[1.0]],
    )
    found = to_c(extended_kalman(system)), to_js(extended_kalman(system))
    untouched()
    return found


def as_plain_text(texts: tuple[str, str]) -> bool:
    """The very code of another name; only comments may tell the name."""
    return [code(text) for text in texts] == [code(text) for text in exported("q")]


def code(text: str) -> str:
    import re

    return re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.S)


def function_named(name: str) -> object:
    f = sympy.Function(name) if name.strip() else sympy.Function("f")
    return run(extended_kalman, PLACES["sensor"], f(X))


def untouched() -> None:
    if Path("pwned").exists():
        raise Crashed("text was executed")


def safely(call, text: str) -> object:
    try:
        return call(text)
    finally:
        untouched()


def run(rule, make, f) -> object:
    return rule(make(f)).run(TIMES, Y)


ALONE = (sympy.Lambda, sympy.MatrixExpr)
"""Nothing can be added to these."""


def moves(f):
    f = f + V if isinstance(f, sympy.Expr) and not isinstance(f, ALONE) else f
    return DiscreteSystem(
        StochasticMap((X,), [f], Noise((V,))),
        StochasticMap((X,), [X + W], Noise((W,))),
        [0.0],
        [[1.0]],
    )


def shows(f):
    f = f + W if isinstance(f, sympy.Expr) and not isinstance(f, ALONE) else f
    return DiscreteSystem(
        StochasticMap((X,), [X / 2 + V], Noise((V,))),
        StochasticMap((X,), [f], Noise((W,))),
        [0.0],
        [[1.0]],
    )


def drifts(f):
    return JumpDiffusion((X,), [f], [[1]], [X + W], Noise((W,)), [0.0], [[1.0]], step=0.25)


PLACES = {"dynamics": moves, "sensor": shows, "drift": drifts}


def impossible() -> Iterator[tuple[str, object]]:
    """Formulas that have no code, no value, no derivative, or no sense."""
    a, k = sympy.Symbol("a"), sympy.Symbol("k", integer=True)
    f = sympy.Function("f")
    formulas = [
        f(X),
        sympy.sign(X),
        sympy.Heaviside(X),
        sympy.floor(X),
        sympy.ceiling(X),
        sympy.Mod(X, 2),
        sympy.Sum(X**k, (k, 0, 3)),
        sympy.zoo,
        sympy.oo,
        -sympy.oo,
        sympy.nan,
        sympy.Integer(10) ** 400,
        X * 10**400,
        sympy.Float("1e400"),
        sympy.I,
        X * sympy.I,
        sympy.Product(X + k, (k, 1, 3)),
        sympy.Integral(X**2, X),
        sympy.Integral(a, (a, 0, X)),
        sympy.Derivative(f(X), X),
        sympy.Derivative(X**2, X),
        sympy.Limit(X / a, a, 1),
        a,
        sympy.zeta(X),
        sympy.gamma(X),
        sympy.loggamma(X),
        sympy.besselj(0, X),
        sympy.LambertW(X),
        sympy.DiracDelta(X),
        sympy.KroneckerDelta(X, 1),
        sympy.Piecewise((X, X > 0)),
        sympy.Piecewise((X, X > 0), (f(X), True)),
        sympy.Piecewise((1, sympy.Eq(X, 0)), (0, True)),
        sympy.Max(X, a),
        sympy.Min(X, 0),
        sympy.Abs(X),
        sympy.re(X),
        sympy.im(X),
        sympy.arg(X),
        sympy.conjugate(X),
        sympy.sqrt(X),
        sympy.log(X),
        1 / X,
        X**X,
        sympy.log(-1 - X**2),
        sympy.exp(sympy.exp(sympy.exp(X))),
        sympy.exp(X**2),
        X**100,
        sympy.exp(1000 * X),
        sympy.exp(-X - 1000),
        sympy.cot(X),
        sympy.tan(X),
        sympy.acos(X),
        sympy.factorial(X),
        sympy.binomial(X, 2),
        sympy.erfinv(X),
        sympy.Order(X),
        sympy.Wild("w") + X,
        sympy.Dummy("x"),
        sympy.Symbol("x", positive=True),
        sympy.Symbol("x", real=True),
        sympy.Matrix([X]),
        sympy.MatrixSymbol("A", 1, 1),
        sympy.Eq(X, 1),
        X > 0,
        sympy.true,
        sympy.S.EmptySet,
        sympy.Interval(0, 1),
        sympy.Lambda(X, X),
        sympy.Tuple(X),
        sympy.IndexedBase("a")[0],
        sympy.Float("nan"),
        float("nan"),
        float("inf"),
        1j,
        None,
        "x",
        b"x",
        [X],
        {X: 1},
        object(),
        np.array([X]),
        True,
        sympy.Rational(1, 10**400),
        sympy.Poly(X**2, X),
        sympy.CRootOf(X**5 - X + 1, 0),
        sympy.UnevaluatedExpr(X),
        sympy.Mul(0, sympy.Pow(X, -1, evaluate=False), evaluate=False),
        sympy.Add(X, X, evaluate=False),
        sympy.nextprime,
        sympy.Function,
        Input("u"),
        Parameter("p", 1.0),
        sympy.Id(X),
        sympy.hyper([1], [2], X),
    ]
    for k, formula in enumerate(formulas):
        yield f"{k} {formula!s}"[:60], formula


def mean_of(call, f) -> object:
    made = call(f, [X])
    law = ([0.5], [[1.0]])
    return (
        made(*law)
        if call in (expectation_function, posterior_variance_function)
        else made(*law, [[0.5]])
    )


def finite(value: object) -> bool:
    """A formula of no symbols has a finite value."""
    return getattr(value, "is_finite", True) is not False


def _two_modes(**given):
    good = {
        "dynamics": [[X + V], [X / 2 + V]],
        "switching": [[0.5, 0.5]] * 2,
        "sensor": [[X + W]] * 2,
        "indicator": None,
    }
    good |= given
    return SwitchingSystem(
        (X,),
        good["dynamics"],
        Noise((V,)),
        good["switching"],
        good["sensor"],
        Noise((W,)),
        [(0.5, [0], [[1]])] * 2,
        indicator=good["indicator"],
    )


STRINGS = {
    "drift": drifts,
    "dynamics": moves,
    "sensor": shows,
    "diffusion": lambda s: JumpDiffusion((X,), [-X], [[s]], [X + W], Noise((W,)), [0], [[1]]),
    "intensity": lambda s: JumpDiffusion(
        (X,), [-X], [[1]], [X + W], Noise((W,)), [0], [[1]], intensity=s, jump=[1]
    ),
    "jump": lambda s: JumpDiffusion(
        (X,), [-X], [[1]], [X + W], Noise((W,)), [0], [[1]], intensity=1, jump=[s]
    ),
    "parameter": lambda s: JumpDiffusion(
        (X,), [-X * V], [[1]], [X + W], Noise((W,)), [0], [[1]], parameters={V: s}
    ),
    "name of a parameter": lambda s: JumpDiffusion(
        (X,), [-X], [[1]], [X + W], Noise((W,)), [0], [[1]], parameters={s: 1}
    ),
    "state": lambda s: StochasticMap((s,), [X], Noise()),
    "noise": lambda s: Noise((s,)),
    "states": lambda s: StochasticMap(s, [X], Noise()),
    "time": lambda s: StochasticMap((X,), [X], Noise(), time=s),
    "weight": lambda s: StochasticMap((X,), [X + V], Noise((V,)), weight=s),
    "switching": lambda s: _two_modes(switching=[[s, 0.5], [0.5, 0.5]]),
    "indicator": lambda s: _two_modes(indicator=[[s, 0.5], [0.5, 0.5]]),
    "dynamics of a mode": lambda s: _two_modes(dynamics=[[s], [X + V]]),
    "sensor of a mode": lambda s: _two_modes(sensor=[[s], [X + W]]),
    "expectation": lambda s: expectation(s, [X], [0], [[1]]),
    "expectation_function": lambda s: expectation_function(s, [X]),
    "variables": lambda s: expectation_function(X, [s]),
    "classify": lambda s: classify(s, [X]),
    "errors": lambda s: mean_square_errors(s, [X]),
    "mean": lambda s: expectation(X, [X], [s], [[1]]),
    "covariance": lambda s: expectation(X**2, [X], [0], [[s]]),
    "approximate errors": lambda s: approximate_errors(s, [X]),
    "Noise.expectation": lambda s: Noise((V,)).expectation([s]),
    "TwoStepEstimator": lambda s: TwoStepEstimator(linear_diffusion(), s, variables=[X]),
    "AugmentedDiffusion": lambda s: AugmentedDiffusion(linear_diffusion(), s, [X], V),
    "bad value": lambda s: Parameter("p", s),
}


def twice() -> dict[str, object]:
    """One symbol in two roles."""
    noise = Noise((W,))
    return {
        "state and noise": lambda: JumpDiffusion(
            (X, V), [V, -X], [[0], [1]], [X + V], Noise((V,)), [0, 0], np.eye(2)
        ),
        "state and state": lambda: JumpDiffusion(
            (X, X), [X, -X], [[0], [1]], [X + W], noise, [0, 0], np.eye(2)
        ),
        "noise and noise": lambda: Noise((V, V)),
        "state and parameter": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], parameters={X: 5}
        ),
        "noise and parameter": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], parameters={W: 5}
        ),
        "state and time": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], time=X
        ),
        "noise and time": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], time=W
        ),
        "state and mark": lambda: JumpDiffusion(
            (X,), [-X], [[1]], [X + W], noise, [0], [[1]], intensity=1, jump=[X], marks=Noise((X,))
        ),
        "variables": lambda: expectation_function(X, [X, X]),
        "variable and parameter": lambda: expectation_function(X, [X], parameters=[X]),
        "state and noise of a map": lambda: StochasticMap((X,), [X], Noise((X,))),
        "modes": lambda: SwitchingSystem(
            (X,),
            [[X]] * 2,
            Noise((X,)),
            [[1, 0], [0, 1]],
            [[X + W]] * 2,
            noise,
            [(0.5, [0], [[1]])] * 2,
        ),
    }
