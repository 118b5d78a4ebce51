from fractions import Fraction

import numpy as np
import pytest

from seedslib.gaussian.regions.twofold import Twofold, binary_scale, cross, determinant, two_product


def exact(number):
    return Fraction(float(number.hi)) + Fraction(float(number.lo))


def pairs(seed, count=200):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-12, 12, (2, count))
    values = rng.normal(size=(2, count)) * scale
    rest = values * rng.uniform(-1, 1, (2, count)) * 1e-17
    return (Twofold.of(v) + Twofold.of(r) for v, r in zip(values, rest, strict=True))


@pytest.mark.parametrize("operation", ["__add__", "__sub__", "__mul__", "__truediv__"])
def test_operations_keep_31_digits(operation):
    a, b = pairs(0)
    found = getattr(a, operation)(b)
    for k in range(a.hi.size):
        truth = getattr(exact(a[k]), operation)(exact(b[k]))
        assert abs(exact(found[k]) - truth) <= abs(truth) * Fraction(1, 10**31)


def test_cancellation_keeps_what_there_is():
    third = Twofold.of(np.array(1.0)) / Twofold.of(np.array(3.0))
    rest = third * Twofold.of(np.array(3.0)) - Twofold.of(np.array(1.0))
    assert abs(exact(rest)) < Fraction(1, 10**31)
    assert exact(Twofold.difference(np.array(1e16), np.array(0.3))) == 10**16 - Fraction(0.3)


def test_square_root():
    a, _ = pairs(1)
    a = a * a
    root = a.sqrt()
    for k in range(a.hi.size):
        assert abs(exact(root[k]) ** 2 / exact(a[k]) - 1) < Fraction(1, 10**31)
    assert Twofold.of(np.array(0.0)).sqrt().hi == 0.0


def test_products_and_determinants_are_exact_where_they_cancel():
    p, error = two_product(np.array(1.0 + 2.0**-30), np.array(1.0 - 2.0**-30))
    assert Fraction(float(p)) + Fraction(float(error)) == 1 - Fraction(1, 2**60)
    rho = 1 - 1e-14
    truth = 1 - Fraction(rho) ** 2
    found = determinant(np.array(1.0), np.array(rho), np.array(rho), np.array(1.0))
    assert abs(Fraction(float(found)) / truth - 1) < Fraction(1, 10**15)
    one, many = Twofold.of(np.array(1.0)), Twofold.of(np.array(rho))
    assert abs(exact(cross(one, many, many, one)) - truth) < Fraction(1, 10**30)


def test_binary_scale():
    values = np.array([0.0, 1e-320, 0.7, 1.0, 3.0, 1e300])
    scale = binary_scale(values)
    assert scale[0] == 1.0
    assert ((values[1:] / scale[1:] >= 0.5) & (values[1:] / scale[1:] < 1.0)).all()
    np.testing.assert_array_equal(np.frexp(scale)[0], 0.5)
