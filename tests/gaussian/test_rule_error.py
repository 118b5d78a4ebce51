"""The expansion by quadrature says how far its own rule may be wrong."""

import warnings

import numpy as np
import pytest
import sympy as sp

from seedslib.gaussian import approximate_errors, hermite_expansion, mean_square_errors

x, y = sp.symbols("x y", real=True)
KINKS = (abs(x), sp.sign(x), sp.Max(x, 0), sp.exp(-8 * x**2), sp.sin(9 * x))


@pytest.mark.parametrize(
    ("f", "symbols"),
    [*((f, [x]) for f in KINKS), (sp.sqrt(x**2 + y**2), [x, y]), (sp.Max(x, y), [x, y])],
    ids=str,
)
@pytest.mark.parametrize("mean", [0.0, 0.3, 1.0])
def test_the_exact_error_lies_within_the_bounds_and_the_error_of_the_rule(f, symbols, mean):
    """`lower` alone was above the exact error, or `upper` below it, without a word."""
    law = [mean] * len(symbols), 2 * np.eye(len(symbols)), 0.5 * np.eye(len(symbols))
    exact = mean_square_errors(f, symbols)(*law).optimal
    with pytest.warns(UserWarning, match="the quadrature rule of 80 nodes may miss"):
        expansion = hermite_expansion(f, symbols, *law)
    lower, upper = expansion.lower()[0, 0], expansion.upper()[0, 0]
    rule = expansion.rule_error[0, 0]
    assert lower - rule <= exact <= upper + rule
    with pytest.warns(UserWarning, match="the quadrature rule"):
        approximate_errors(f, symbols)(*law)


def test_a_smooth_function_has_no_error_of_the_rule_and_no_warning():
    law = [0.3], [[2.0]], [[0.5]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for f in (sp.sin(x), sp.exp(x)):
            expansion = hermite_expansion(f, [x], *law)
            assert expansion.rule_error[0, 0] < 1e-12 * expansion.upper()[0, 0]
        assert not hermite_expansion(x**3, [x], *law).rule_error.any()
        known = hermite_expansion(abs(x), [x], [1.0], [[0.0]], [[0.0]])
    assert not known.rule_error.any()
