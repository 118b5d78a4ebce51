"""Corrections whose parts have batch axes of their own, against the formulas item by item."""

import itertools

import numpy as np
import pytest
import sympy

from seedslib.base import correct
from seedslib.base.correction import joint_shape
from seedslib.base.semidefinite import ABSOLUTE
from seedslib.linearization import Moments

N, M = 3, 3
SHAPES = ((), (3,), (2, 1))
RANGE = np.array([2.0, -1.0, 3.0])


def parts(rng, shapes, kind):
    """Mean, covariance, y, E y, cov(x, y), cov y with batches of these shapes."""
    mean, cov, y, predicted, cross, spread = shapes
    root = rng.standard_normal((*cov, N, N))
    noisy = rng.standard_normal((*spread, M, M))
    spreads = noisy @ np.swapaxes(noisy, -1, -2) + 0.3 * np.eye(M)
    found = [
        rng.standard_normal((N, *mean)), np.moveaxis(root @ np.swapaxes(root, -1, -2), (-2, -1),
                                                     (0, 1)),
        rng.standard_normal((M, *y)), rng.standard_normal((M, *predicted)),
        rng.standard_normal((N, M, *cross)), np.moveaxis(spreads, (-2, -1), (0, 1)),
    ]  # fmt: skip
    if "singular" in kind:
        # innovations in the range of cov y, which has rank one in all items or in the first
        found[2], found[3] = (
            RANGE.reshape(M, *(1,) * len(batch)) * rng.standard_normal(batch)
            for batch in (y, predicted)
        )
        flat = found[5].reshape(M, M, -1)
        flat[..., 0] = 1.7 * np.outer(RANGE, RANGE)
        found[5] = flat.reshape(found[5].shape)
    if "missing" in kind:
        flat = found[2].reshape(M, -1)
        flat[1, 0] = np.nan
        flat[:, 1:2] = np.nan
        found[2] = flat.reshape(found[2].shape)
    return found


def formulas(mean, cov, y, predicted, cross, spread):
    """The textbook, with the pseudo-inverse and the density on the range."""
    kept = np.isfinite(y)
    e, C, S = (y - predicted)[kept], cross[:, kept], spread[np.ix_(kept, kept)]
    values, vectors = np.linalg.eigh(S)
    vectors, values = vectors[:, values > 1e-9], values[values > 1e-9]
    inverse = vectors / values @ vectors.T
    loglik = -0.5 * (e @ inverse @ e + np.log(2 * np.pi * values).sum())
    return mean + C @ inverse @ e, cov - C @ inverse @ C.T, loglik


def draws(count):
    rng = np.random.default_rng(7)
    every = list(itertools.product(range(3), repeat=6))
    return [tuple(SHAPES[k] for k in every[i]) for i in rng.choice(len(every), count, False)]


@pytest.mark.parametrize("kind", ["regular", "missing", "singular", "singular missing"])
def test_any_part_may_carry_a_batch(kind):
    rng = np.random.default_rng(11)
    for shapes in draws(36):
        given = parts(rng, shapes, kind)
        mean, cov, y, *moments = given
        found = correct(mean, cov, y, Moments(*moments))
        gains = np.broadcast_shapes(*shapes[4:])
        batch = np.broadcast_shapes(shapes[0], *shapes[2:4], gains)
        of_cov = np.broadcast_shapes(shapes[1], gains)
        present = np.isfinite(y).reshape(M, -1)
        if not (present.all(axis=1) | ~present.any(axis=1)).all():
            depth = max(len(batch), len(of_cov))  # axes of y stand where those of the mean do
            of_cov = np.broadcast_shapes(of_cov, (1,) * (depth - len(shapes[2])) + shapes[2])
        assert found[0].shape == (N, *batch)
        assert found[1].shape == (N, N, *of_cov)
        assert found[2].shape == batch
        whole = np.broadcast_shapes(batch, of_cov)
        cores = (1, 2, 1, 1, 2, 2, 1, 2, 0)
        spread_out = [
            np.broadcast_to(_aligned(part, core, len(whole)), part.shape[:core] + whole)
            for part, core in zip((*given, *found), cores, strict=True)
        ]
        for i in np.ndindex(whole):
            one = [part[(..., *i)] for part in spread_out]
            for got, want in zip(one[6:], formulas(*one[:6]), strict=True):
                np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-10)
        again = correct(mean, None, y, Moments(*moments), rows=2)
        np.testing.assert_array_equal(again[0], found[0][:2])
        np.testing.assert_array_equal(again[2], found[2])


def _aligned(part, core, depth):
    short = depth - (part.ndim - core)
    return part.reshape(*part.shape[:core], *(1,) * short, *part.shape[core:])


@pytest.mark.parametrize(
    "shapes",
    [(), ((),), ((3,), ()), ((), (3,), (3,)), ((2, 1), (), (3,)), ((1,), (4,)), ((4,), (1,)),
     ((0,), (1,))],
)  # fmt: skip
def test_joint_shapes_are_those_of_numpy(shapes):
    assert joint_shape(*shapes) == np.broadcast_shapes(*shapes)


def test_shapes_that_do_not_fit_have_no_joint_one():
    with pytest.raises(ValueError, match="shape mismatch"):
        joint_shape((2,), (), (3,))


@pytest.mark.parametrize("copies", [1, 2])
def test_a_variance_up_to_the_least_is_none(copies):
    """Nothing is learned from a sensor of such a variance; from one above it, all it says."""
    ones = np.ones((copies, copies))
    for variance, told in ((ABSOLUTE, False), (4 * ABSOLUTE, True)):
        cross = np.full((1, copies), 0.5 * variance)
        y = np.full(copies, np.sqrt(variance))
        mean, _, loglik = correct(
            [3.0], [[1.0]], y if told else 0 * y, Moments(0 * y, cross, variance * ones)
        )
        assert mean[0] == pytest.approx(3.0 + 0.5 * np.sqrt(variance) * told)
        assert loglik == pytest.approx(
            -0.5 * (1.0 + np.log(2 * np.pi * copies * variance)) if told else 0.0
        )


def test_one_number_in_symbols():
    m, p, y, h, c, s = sympy.symbols("m p y h c s")
    mean, cov, loglik = correct([m], [[p]], [y], ([h], [[c]], [[s]]))
    assert sympy.simplify(mean[0] - m - c * (y - h) / s) == 0
    assert sympy.simplify(cov[0, 0] - p + c**2 / s) == 0
    assert sympy.simplify(2 * loglik + (y - h) ** 2 / s + sympy.log(2 * sympy.pi * s)) == 0


@pytest.mark.parametrize("periods", [(), ((1, 4.0),)])
def test_a_component_on_a_circle_takes_the_shortest_way(periods):
    y = np.array([1.0, 3.9])
    mean, _, _ = correct(np.zeros(2), np.eye(2), y, Moments(np.zeros(2), np.eye(2), 2 * np.eye(2)),
                         periods=periods)  # fmt: skip
    np.testing.assert_allclose(mean, [0.5, -0.05 if periods else 1.95])


def given(**change):
    plain = {"mean": np.zeros(2), "cov": np.eye(2), "y": np.zeros(3)}
    moments = {"mean": np.zeros(3), "cross": np.ones((2, 3)), "spread": np.eye(3)}
    for name, part in change.items():
        (moments if name in moments and name != "mean" else plain)[name] = part
    moments["mean"] = moments.pop("predicted", moments["mean"])
    return {**plain, "moments": tuple(moments.values())}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean": np.zeros((0, 2))}, r"mean: wanted shape \(n, \*batch\), got \(0, 2\)"),
        ({"mean": 0.0}, r"mean: wanted shape \(n, \*batch\), got \(\)"),
        ({"y": 0.0}, r"y: wanted shape \(m, \*batch\), got \(\)"),
        ({"y": np.zeros((2, 5))}, r"y: wanted shape \(3, \*batch\), got \(2, 5\)"),
        ({"cov": np.zeros((2, 3))}, r"cov: wanted shape \(2, 2, \*batch\), got \(2, 3\)"),
        ({"cov": np.zeros(2)}, r"cov: wanted shape \(2, 2, \*batch\), got \(2,\)"),
        ({"cross": np.zeros((3, 2))}, r"moments.cross: wanted shape \(2, 3, \*batch\)"),
        ({"spread": np.zeros((3, 2))}, r"moments.cov: wanted shape \(3, 3, \*batch\)"),
        ({"rows": True}, "rows: wanted a whole number from 1 to 2, got True"),
        ({"rows": 1.5}, "rows: wanted a whole number from 1 to 2, got 1.5"),
        ({"rows": -1}, "rows: wanted a whole number from 1 to 2, got -1"),
        ({"y": np.array([[0.0, 1.0], [2.0, -np.inf], [1.0, 2.0]])}, r"got -inf at index \(1, 1\)"),
    ],
)
def test_what_does_not_fit_is_named(change, message):
    with pytest.raises(ValueError, match=message):
        correct(**given(**change))


def test_rows_may_be_a_whole_number_of_any_kind():
    for rows in (1.0, np.int64(1)):
        found = correct(**given(rows=rows))
        assert found[0].shape == (1,)
        assert found[1].shape == (1, 1)
    assert correct(**given(rows=2))[0].shape == (2,)


@pytest.mark.parametrize("name", ["mean", "cov", "y"])
def test_every_argument_has_to_be_numeric(name):
    words = np.array(given()[name], dtype=str)
    with pytest.raises(TypeError, match=f"^{name}: wanted real numbers, got an array of dtype"):
        correct(**{**given(), name: words})


@pytest.mark.parametrize(("k", "name"), [(0, "mean"), (1, "cross"), (2, "cov")])
def test_every_moment_has_to_be_numeric(k, name):
    moments = list(given()["moments"])
    moments[k] = moments[k].astype(complex)
    with pytest.raises(TypeError, match=f"^moments.{name}: wanted real numbers"):
        correct(**{**given(), "moments": tuple(moments)})
    moments[k] = moments[k].real.astype(bool)
    with pytest.raises(TypeError, match=f"^moments.{name}: wanted real numbers, .* bool"):
        correct(**{**given(), "moments": tuple(moments)})
