"""Models as input: names of symbols and functions, strings, functions without code, injections."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import sympy

from attempts.formulas import C_WORDS, INJECTIONS, JS_WORDS, OWN, PYTHON, TRAP, impossible
from attempts.judge import Attempt, Crashed, equal, sane
from attempts.roles import PLACES, STRINGS, twice
from attempts.targets import TIMES, Y
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
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap


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
