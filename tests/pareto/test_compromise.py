"""The point of a segment whose largest relative loss is least."""

import mpmath
import numpy as np
import pytest

from seedslib.pareto import compromise

SEGMENTS = {  # criteria, segment, minimisers
    "square, cube": ((lambda x: x**2, lambda x: (1 - x) ** 3), (0, 1), (0, 1)),
    "two squares": ((lambda x: x**2, lambda x: (x - 3) ** 2), (-5, 5), (0, 3)),
    "exponential, hyperbola": (
        (mpmath.exp, lambda x: 1 / (mpmath.mpf("0.1") + x)),
        (0, 2),
        (0, 2),
    ),
    "quartic, cosh": (
        (lambda x: (x - 1) ** 2 + (x - 1) ** 4 / 10, lambda x: mpmath.cosh(x - 3)),
        (-2, 6),
        (1, 3),
    ),
}


@pytest.mark.parametrize("name", SEGMENTS)
def test_equal_losses_on_a_segment_against_forty_digits(name):
    criteria, (lower, upper), minimisers = SEGMENTS[name]
    with mpmath.workdps(40):
        (f, g), (a, b) = criteria, map(mpmath.mpf, minimisers)
        gap = lambda x: (f(x) - f(a)) / (f(b) - f(a)) - (g(x) - g(b)) / (g(a) - g(b))  # noqa: E731
        root = mpmath.findroot(gap, (a, b), solver="anderson", tol=1e-60)
        loss, root = float((f(root) - f(a)) / (f(b) - f(a))), float(root)
    found = compromise([lambda x, c=c: float(c(x)) for c in criteria], lower, upper)
    assert found.x == pytest.approx(root, abs=1e-12)
    assert found.balanced == pytest.approx(root, abs=1e-12)
    np.testing.assert_allclose(found.losses, loss, atol=1e-12)
    np.testing.assert_allclose(found.minimizers, minimisers, atol=1e-10)
    assert found.worst == found.losses.max()


def test_criteria_of_any_shape_against_a_fine_scan():
    """Waves, steps and plateaus with features wider than the spacing of the scan."""
    rng, grid = np.random.default_rng(1), np.linspace(-2.0, 2.0, 8001)
    for trial in range(12):
        if trial % 2:
            knots, levels = np.linspace(-2, 2, 9), rng.integers(-2, 3, (2, 9)).astype(float)
            criteria = [lambda x, k=knots, y=y: np.interp(x, k, y) for y in levels]
        else:
            size, speed, phase = rng.normal(size=(2, 4)), rng.uniform(0.5, 6, 4), rng.uniform(0, 6)
            criteria = [
                lambda x, c=c, w=speed, p=phase: np.sin(np.asarray(x)[..., None] * w + p) @ c
                for c in size
            ]
        found = compromise(criteria, -2.0, 2.0)
        values = np.stack([c(grid) for c in criteria], axis=1)
        assert (found.utopia <= values.min(axis=0) + 1e-9 * np.ptp(values, axis=0)).all()
        if (found.losses < 1e-7).all():  # one point is best for both
            np.testing.assert_allclose(found.values, values.min(axis=0), atol=1e-5)
            continue
        worst = ((values - found.utopia) / (found.nadir - found.utopia)).max(axis=1)
        assert worst.min() - 0.01 < found.worst <= worst.min() + 1e-7
        no_worse = (values <= found.values + 1e-12).all(axis=1)
        assert not (no_worse & (values < found.values - 1e-5).any(axis=1)).any()


def test_of_several_balances_the_least_is_taken():
    found = compromise([np.cos, lambda x: np.sin(x) + 0.1 * x], 0.0, 9.0, scan=41)
    x = np.linspace(0.0, 9.0, 90001)
    values = np.stack([np.cos(x), np.sin(x) + 0.1 * x])
    low, ends = values.min(axis=1), values.argmin(axis=1)
    losses = (values - low[:, None]) / (values[:, ends].max(axis=1) - low)[:, None]
    assert found.x == pytest.approx(x[losses.max(axis=0).argmin()], abs=2e-4)
    np.testing.assert_allclose(found.minimizers, x[ends], atol=2e-4)


def test_plateaus_are_searched_for_what_is_best_for_the_other_criterion():
    """Weak efficiency: x = .5 balances, x = .6 costs the same in I1 and less in I2."""
    flat = lambda x: np.interp(x, [0, 0.4, 0.6, 1], [0, 0.5, 0.5, 1])  # noqa: E731
    found = compromise([flat, lambda x: 1 - x], 0.0, 1.0)
    assert found.balanced == pytest.approx(0.5, abs=1e-12)
    assert found.x == pytest.approx(0.6, abs=1e-9)
    np.testing.assert_allclose(found.values, [0.5, 0.4], atol=1e-9)
    ends = compromise([lambda x: x, lambda x: max(0.0, 0.6 - x)], 0.0, 1.0)
    assert ends.x == pytest.approx(0.3, abs=1e-12)
    assert ends.minimizers[1] == pytest.approx(0.6, abs=1e-12)
    both = compromise([flat, lambda x: np.interp(x, [0, 0.3, 0.7, 1], [1, 0.5, 0.5, 0])], 0.0, 1.0)
    assert both.x == pytest.approx(0.3, abs=1e-9)
    np.testing.assert_allclose(both.losses, [0.375, 0.5], atol=1e-9)


def test_kinks_and_smooth_minima_are_located():
    tilted = lambda x: abs(x - 0.77) + 0.1 * max(x - 0.77, 0.0)  # noqa: E731
    found = compromise([lambda x: abs(x - 0.31), tilted], 0.0, 1.0)
    assert found.x == pytest.approx(0.54, abs=1e-7)
    for centre in (1.1, 2.9):
        smooth = compromise([lambda x, c=centre: x - c * np.log(x), lambda x: x], 0.1, 3.7)
        assert smooth.minimizers[0] == pytest.approx(centre, abs=1e-9)


def test_a_jump_over_the_balance_and_an_ideal_point_are_named():
    found = compromise([lambda x: x + (x > 0.5), lambda x: 1 - x], 0.0, 1.0)
    assert found.balanced is None
    np.testing.assert_allclose(found.losses, [0.25, 0.5], atol=1e-12)
    ideal = compromise([lambda x: (x - 0.3) ** 2, lambda x: abs(x - 0.3)], 0.0, 1.0)
    assert ideal.x == pytest.approx(0.3, abs=1e-7)
    np.testing.assert_allclose(ideal.losses, 0.0, atol=1e-7)
    large = compromise([lambda x: 1e12 + x, lambda x: 1e12 + 1e3 * (1 - x)], 0.0, 1.0)
    assert large.x == pytest.approx(0.5, abs=1e-3)


def test_three_criteria_on_a_line():
    found = compromise(lambda x: (x**2, (x - 1) ** 2, (x - 0.5) ** 2), -1.0, 2.0)
    assert found.x == pytest.approx(0.5, abs=1e-9)
    np.testing.assert_allclose(found.losses, [0.25, 0.25, 0.0], atol=1e-9)
    assert found.balanced is None
