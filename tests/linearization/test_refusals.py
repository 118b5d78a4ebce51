"""What each linearization refuses: the type of the error and what it names."""

import numpy as np
import pytest
import sympy

from seedslib.filters import CovarianceFilter
from seedslib.gaussian import NoClosedForm
from seedslib.linearization import (
    Cubature,
    ExactGaussian,
    GaussHermite,
    Matrices,
    Taylor,
    Unscented,
)
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, y, v = sympy.symbols("x y v", real=True)
NOISE = Noise((v,))
HEAVY = Noise((v,), sample=lambda rng, count: rng.laplace(size=(1, count)))
STEP = (1 + sympy.erf(x + v)) / 2
BRANCH = StochasticMap((x,), [x + v], NOISE, weight=0.3)
ARRAYS = StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, Noise(1))


def branch(weight, value=x + v, noise=NOISE):
    return StochasticMap((x,), [value], noise, weight=weight)


def filter_of(value, size=1.0, rule=None):
    sensor = StochasticMap((x, y), [value + v], NOISE)
    system = DiscreteSystem(StochasticMap((x, y), [x, y]), sensor, [0, 0], np.diag([1.0, size**2]))
    return CovarianceFilter(system, rule or ExactGaussian())


OTHER = StochasticMap((y,), [y], weight=0.5)
REFUSALS = [
    (lambda: Taylor().moments(BRANCH), ValueError, "map"),
    (lambda: ExactGaussian().moments(BRANCH), ValueError, "map"),
    (lambda: Cubature().moments(BRANCH), ValueError, "map"),
    (
        lambda: ExactGaussian().row([BRANCH, OTHER]),
        ValueError,
        "map",
    ),
    (lambda: Matrices().moments(StochasticMap((x,), [x])), TypeError, "map"),
    (lambda: Unscented(kappa=-2).rule(2), ValueError, "kappa"),
    (lambda: GaussHermite(0), ValueError, "order"),
    (lambda: filter_of(x, rule="exact"), TypeError, "linearization"),
    # no closed form: the message names a rule that takes the map
    (lambda: Taylor().moments(ARRAYS), NoClosedForm, "GaussHermite"),
    (lambda: ExactGaussian().moments(ARRAYS), NoClosedForm, "GaussHermite"),
    (lambda: ExactGaussian().weighted(ARRAYS), NoClosedForm, "GaussHermite"),
    (lambda: ExactGaussian().moments(StochasticMap((x,), [sympy.tanh(x)])), NoClosedForm, "tanh"),
    (lambda: ExactGaussian().moments(StochasticMap((x,), [sympy.erf(x)])), NoClosedForm, "erf"),
    (
        lambda: ExactGaussian().moments(StochasticMap((x,), [abs(x), sympy.cos(x)])),
        NoClosedForm,
        "GaussHermite",
    ),
    (lambda: Taylor().weighted(branch(STEP)), NoClosedForm, "GaussHermite"),
    (
        lambda: ExactGaussian().weighted(branch((1 + sympy.erf(x)) * STEP / 2)),
        NoClosedForm,
        "GaussHermite",
    ),
    (
        lambda: ExactGaussian().weighted(branch((1 + sympy.erf(x)) / 2, sympy.sin(x) + v)),
        NoClosedForm,
        "GaussHermite",
    ),
    (lambda: ExactGaussian().weighted(branch(STEP, noise=HEAVY)), NoClosedForm, "GaussHermite"),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_refusal_names_what_is_wrong_or_what_to_use(call, error, name):
    with pytest.raises(error) as caught:
        call()
    assert name in str(caught.value)


def test_small_units_are_taken_where_no_product_of_them_is_too_small():
    """Where a known component has no scale, and where a product of large ones is."""
    assert filter_of(x * y**2, 1e-5) is not None
    assert filter_of(x + y, 1e-160) is not None
    assert filter_of(x * y**2, 0.0) is not None
