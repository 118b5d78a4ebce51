"""What abuse has found: numbers, names and files that were taken, or refused without a sentence."""

import numpy as np
import pytest
import sympy as sp

from bookkit.parameters import explain
from bookkit.recording import plain
from seedslib.base import Axis, Parameter, correct, interpolate
from seedslib.base.symbols import as_expression
from seedslib.filters import assumed_density, cubature_kalman, extended_kalman
from seedslib.gaussian import (
    approximate_errors,
    cubature,
    gauss_hermite,
    mean_square_errors,
    unscented,
)
from seedslib.linearization import Moments
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, van_loan
from seedslib.models.codegen import compile_array
from seedslib.models.kinds import UnknownModel

X, V, W = sp.symbols("x v w")
TIMES, Y = np.arange(3.0), np.array([[0.5], [1.0], [0.25]])


def discrete(f=X / 2):
    return DiscreteSystem(
        StochasticMap((X,), [f + V], Noise((V,))), StochasticMap((X,), [X + W], Noise((W,))),
        [0.0], [[1.0]],
    )  # fmt: skip


def diffusion(drift=-X, state=X, **given):
    return JumpDiffusion(
        (state,), [drift], [[1]], [state + W], Noise((W,)), [0.0], [[1.0]], **given
    )


GAINS = Moments(np.zeros(1), np.ones((1, 1)), np.ones((1, 1)))
MASKED = np.ma.masked_equal([[0.5, -9.0], [0.5, 0.5]], -9.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: diffusion(step="0.5"), "step: wanted a number, got '0.5'"),
        (lambda: diffusion(step=[0.5, 1.0]), "step: wanted a number"),
        (lambda: diffusion().simulate(TIMES, 2, 1, step={}), "step: wanted a number"),
        (lambda: diffusion().simulate(TIMES, 2, -1), "seed: wanted a whole number from 0 on"),
        (lambda: extended_kalman(diffusion(), step=b"1"), "step: wanted a number"),
        (lambda: extended_kalman(diffusion(), rtol=-1.0), "rtol: wanted a nonnegative number"),
        (
            lambda: extended_kalman(discrete()).run(TIMES, [[1], [1, 2], [3]]),
            "measurements: ",
        ),
        (lambda: correct([0.0], [[1.0]], [[1.0], [1.0, 2.0]], GAINS), "y: wanted an array"),
        (lambda: correct([0.0], [[1.0]], [None], GAINS), "y: wanted real numbers"),
        (lambda: Axis(b"1", 2.0, 3), "low, high: wanted numbers"),
        (lambda: interpolate([[0.0, 1.0]], [Axis(0, 1, 3)], [0.5]), "table: wanted shape"),
        (lambda: interpolate([[0.0, 1.0, 2.0]], [Axis(0, 1, 3)], [np.nan]), "points.0.: wanted"),
        (lambda: van_loan([[-1.0]], [[-1.0]], 0.5), "diffusion: wanted a positive semidefinite"),
        (lambda: van_loan([[-1.0]], [[1.0]], -0.5), "step: wanted a nonnegative number"),
        (lambda: unscented(2, [1.0]), "kappa: wanted"),
        (lambda: cubature([2]), "n: wanted a whole number"),
        (lambda: Parameter("p", "1"), "value: wanted a number"),
        (lambda: as_expression("f", sp.Lambda(X, X)), "f: wanted SymPy expressions"),
        (lambda: approximate_errors(sp.hyper([1], [2], X), [X]), "f: wanted functions with NumPy"),
        (
            lambda: mean_square_errors(X**100, [X])([0.5], [[1.0]], [[0.5]]),
            "f: wanted a poly",
        ),
        (lambda: compile_array((X,), MASKED), "expressions: wanted numbers everywhere"),
        (lambda: UnknownModel(1, 1, "x"), "modes: wanted 0 to 128, got 'x'"),
        (lambda: plain("total", 10**400), "total: wanted a finite number"),
    ],
)
def test_is_refused_in_a_sentence(call, message):
    with pytest.raises((TypeError, ValueError), match=f"^{message}"):
        call()


def test_equal_keys_are_not_equal_counts():
    """A rule kept for 3 was handed out for 3.0."""
    gauss_hermite(2, 3)
    with pytest.raises(TypeError, match="order: wanted"):
        gauss_hermite(2, 3.0)


@pytest.mark.parametrize("name", ["sin", "numpy", "exp"])
def test_a_symbol_that_is_called_like_a_function(name):
    def value(symbol):
        f = sp.sin(symbol) + sp.sqrt(1 + symbol**2) + sp.pi * sp.exp(-symbol)
        return compile_array(((symbol,),), [f])(np.array([[0.5, 2.0]]))

    np.testing.assert_array_equal(value(sp.Symbol(name)), value(sp.Symbol("q")))


@pytest.mark.parametrize("drift", [X**100, sp.exp(X**2)])
def test_a_single_record_overflows_as_many_do(drift):
    """Python's numbers raise where arrays go on to infinity."""
    found = assumed_density(diffusion(drift, step=0.25)).run(TIMES, Y)
    assert found.diverged.any()


def test_a_delta_has_code():
    found = compile_array(((X,),), [sp.KroneckerDelta(X, 1)])(np.array([[0.0, 1.0]]))
    np.testing.assert_array_equal(found, [[0.0, 1.0]])


def test_positive_numbers_are_of_any_kind():
    from seedslib.base.checks import as_positive

    values = 2, np.float32(2), np.array(2.0), sp.Integer(2), np.int8(2)
    assert [as_positive("n", v) for v in values] == [2.0] * 5
    assert as_positive("n", np.inf, infinite=True) == np.inf
    assert as_positive("n", 0, zero=True) == 0.0


def test_nodes_are_looked_at_where_there_are_none():
    from seedslib.design import synthesize
    from seedslib.designed import Memory
    from seedslib.linearization import Taylor

    with pytest.raises(TypeError, match="nodes: wanted a whole number"):
        synthesize(discrete(), Memory(1), Taylor(), TIMES, paths=50, seed=1, nodes="x")
    assert cubature_kalman(discrete()).run(TIMES, Y).mean.shape == (3, 1)


def test_a_fault_of_anything_can_be_told():
    class Deep:
        def errors(self, **_):
            deep = []
            for _ in range(100_000):
                deep = [deep]
            return [{"loc": ("a",), "msg": "Wanted less", "type": "x", "input": deep}]

    assert explain(Deep()) == "a = a list that is nested too deep: wanted less"
