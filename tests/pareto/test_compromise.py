"""The point whose largest relative loss is least, on a segment and in a box."""

import mpmath
import numpy as np
import pytest

from seedslib.pareto import compromise

SEGMENTS = {  # criteria, segment, minimisers
    "square, cube": ((lambda x: x**2, lambda x: (1 - x) ** 3), (0, 1), (0, 1)),
    "two squares": ((lambda x: x**2, lambda x: (x - 3) ** 2), (-5, 5), (0, 3)),
    "exponential, hyperbola": (
        (mpmath.exp, lambda x: 1 / (mpmath.mpf("0.1") + x)), (0, 2), (0, 2),
    ),
    "quartic, cosh": (
        (lambda x: (x - 1) ** 2 + (x - 1) ** 4 / 10, lambda x: mpmath.cosh(x - 3)), (-2, 6), (1, 3),
    ),
}  # fmt: skip


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
    statuses = found.status, found.efficiency, found.balanced_efficiency, found.unimodal
    assert statuses == ("equal losses", "full", "full", True)
    assert (found.index, found.worst) == (None, found.losses.max())


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
        if found.status == "ideal point":
            np.testing.assert_allclose(found.values, values.min(axis=0), atol=1e-5)
            continue
        worst = ((values - found.utopia) / (found.nadir - found.utopia)).max(axis=1)
        assert worst.min() - 0.01 < found.worst <= worst.min() + 1e-9
        assert found.efficiency == "full"


def test_of_several_balances_the_least_is_taken():
    found = compromise([np.cos, lambda x: np.sin(x) + 0.1 * x], 0.0, 9.0, scan=41)
    x = np.linspace(0.0, 9.0, 90001)
    values = np.stack([np.cos(x), np.sin(x) + 0.1 * x])
    low, ends = values.min(axis=1), values.argmin(axis=1)
    losses = (values - low[:, None]) / (values[:, ends].max(axis=1) - low)[:, None]
    roots = x[:-1][np.diff(np.sign(losses[0] - losses[1])) != 0]
    best = roots[np.interp(roots, x, losses[0]).argmin()]
    assert len(roots) > 2
    assert found.balanced == pytest.approx(best, abs=2e-4)
    assert found.x == pytest.approx(x[losses.max(axis=0).argmin()], abs=2e-4)
    np.testing.assert_allclose(found.minimizers, x[ends], atol=2e-4)
    assert (found.unimodal, found.evaluations > 41) == (True, True)
    waves = compromise([lambda x: np.sin(7 * x) + x, lambda x: np.cos(5 * x) - x], 0.0, 3.0)
    assert not waves.unimodal


def test_of_two_equal_minima_and_balances_the_first_is_taken():
    """Both criteria are symmetric about zero."""
    found = compromise([lambda x: (x * x - 0.36) ** 2, lambda x: x * x], -2.0, 2.0)
    assert found.minimizers[0] == pytest.approx(-0.6, abs=1e-9)
    assert found.balanced < 0
    assert found.x == pytest.approx(found.balanced, abs=1e-12)
    double = compromise([lambda x: (x * x - 1) ** 2, lambda x: (x - 0.8) ** 2], -2.0, 2.0)
    assert double.minimizers[0] == pytest.approx(1.0, abs=1e-10)  # the second criterion decides


def test_plateaus_are_searched_for_what_is_best_for_the_other_criterion():
    """Weak efficiency: x = .5 balances, x = .6 costs the same in I1 and less in I2."""
    flat = lambda x: np.interp(x, [0, 0.4, 0.6, 1], [0, 0.5, 0.5, 1])  # noqa: E731
    found = compromise([flat, lambda x: 1 - x], 0.0, 1.0)
    assert found.balanced == pytest.approx(0.5, abs=1e-12)
    assert found.x == pytest.approx(0.6, abs=1e-9)
    np.testing.assert_allclose(found.values, [0.5, 0.4], atol=1e-9)
    assert (found.status, found.efficiency, found.balanced_efficiency) == (
        "minimax",
        "full",
        "weak",
    )
    ends = compromise([lambda x: x, lambda x: max(0.0, 0.6 - x)], 0.0, 1.0)
    assert ends.x == pytest.approx(0.3, abs=1e-12)
    assert ends.minimizers[1] == pytest.approx(0.6, abs=1e-12)
    both = compromise([flat, lambda x: np.interp(x, [0, 0.3, 0.7, 1], [1, 0.5, 0.5, 0])], 0.0, 1.0)
    assert not both.unimodal
    assert both.x == pytest.approx(0.3, abs=1e-9)
    np.testing.assert_allclose(both.losses, [0.375, 0.5], atol=1e-9)
    narrow = lambda x: max(abs(x - 2.63) - 1.65e-3, 0.0)  # noqa: E731
    found = compromise([narrow, lambda x: x], 1.0, 4.0, scan=5)  # from a thousandth on it counts
    assert found.minimizers[0] == pytest.approx(2.63 - 1.65e-3, abs=1e-9)
    for goal in (0.375, 0.625):  # no plateau reaches over a bump
        bumpy = lambda x: max(0.0, abs(x - 0.5) - 0.4) + max(0.0, 0.01 - abs(x - 0.375))  # noqa: E731
        found = compromise([bumpy, lambda x, g=goal: (x - g) ** 2], 0.0, 1.0, scan=17)
        away = abs(found.minimizers[0] - goal)
        assert away == pytest.approx(0.01 if goal < 0.5 else 0.0, abs=1e-7)


def test_kinks_and_smooth_minima_are_located_to_all_digits():
    tilted = lambda x: abs(x - 0.77) + 0.1 * max(x - 0.77, 0.0)  # noqa: E731
    found = compromise([lambda x: abs(x - 0.31), tilted], 0.0, 1.0)
    assert found.x == pytest.approx(0.54, abs=1e-12)
    for centre in (1.1, 2.9):
        smooth = compromise([lambda x, c=centre: x - c * np.log(x), lambda x: x], 0.1, 3.7)
        assert smooth.minimizers[0] == pytest.approx(centre, abs=1e-12)


def test_a_jump_over_the_balance_and_an_ideal_point_are_named():
    found = compromise([lambda x: x + (x > 0.5), lambda x: 1 - x], 0.0, 1.0)
    assert (found.status, found.balanced, found.unimodal) == ("no bracket", None, False)
    np.testing.assert_allclose(found.losses, [0.25, 0.5], atol=1e-12)
    ideal = compromise([lambda x: (x - 0.3) ** 2, lambda x: abs(x - 0.3)], 0.0, 1.0)
    box = compromise([lambda z: z @ z, lambda z: 2 * z @ z], [-1.0, -1.0], [2.0, 2.0])
    assert (ideal.status, box.status) == ("ideal point", "ideal point")
    assert ideal.x == pytest.approx(0.3, abs=1e-9)
    np.testing.assert_array_equal(ideal.losses, 0.0)
    large = compromise([lambda x: 1e12 + x, lambda x: 1e12 + 1e3 * (1 - x)], 0.0, 1.0)
    assert large.x == pytest.approx(0.5, abs=1e-3)


def test_three_criteria_on_a_line():
    found = compromise(lambda x: (x**2, (x - 1) ** 2, (x - 0.5) ** 2), -1.0, 2.0)
    assert found.x == pytest.approx(0.5, abs=1e-9)
    np.testing.assert_allclose(found.losses, [0.25, 0.25, 0.0], atol=1e-9)
    assert (found.status, found.balanced, found.efficiency) == ("minimax", None, "full")


PLANE = [lambda z: z[0] ** 2 + 10 * z[1] ** 2, lambda z: 10 * (z[0] - 1) ** 2 + (z[1] - 1) ** 2]
THIRD = lambda z: (z[0] + 1) ** 2 + (z[1] - 2) ** 2  # noqa: E731


def test_two_and_three_criteria_in_the_plane():
    """By stationarity with multipliers 1/2: x = 10 (1 - x), 10 y = 1 - y; and by mpmath."""
    found = compromise(PLANE, [-1.0, -1.0], [2.0, 2.0])
    np.testing.assert_allclose(found.x, [10 / 11, 1 / 11], atol=1e-7)
    np.testing.assert_allclose(found.nadir, 11, atol=1e-7)
    np.testing.assert_allclose(found.losses, 1 / 12.1, atol=1e-8)
    assert (found.status, found.efficiency) == ("equal losses", "full")
    three = compromise([*PLANE, THIRD], [-3.0, -3.0], [3.0, 3.0])
    with mpmath.workdps(30):
        x, y, loss = mpmath.findroot(
            lambda x, y, t: [
                c((x, y)) - t * m for c, m in zip([*PLANE, THIRD], (41, 41, 5), strict=True)
            ],
            (-0.1, 1.1, 0.3),
        )
    np.testing.assert_allclose(three.x, [float(x), float(y)], atol=1e-8)
    np.testing.assert_allclose(three.losses, float(loss), atol=1e-8)


def test_a_second_stage_removes_weak_efficiency_in_a_box():
    """The bound .25 of the first two criteria leaves the second coordinate free."""
    last = lambda z: (z[0] - 0.5) ** 2 + (z[1] - 0.3) ** 2  # noqa: E731
    found = compromise(
        [lambda z: z[0] ** 2, lambda z: (z[0] - 1) ** 2, last], [-1.0, -1.0], [2.0, 2.0]
    )
    np.testing.assert_allclose(found.x, [0.5, 0.3], atol=1e-4)
    np.testing.assert_allclose(found.losses, [0.25, 0.25, 0.0], atol=1e-5)
    assert found.efficiency == "full"


def test_random_quadratics_in_a_box_against_a_scan():
    rng, axis = np.random.default_rng(2), np.linspace(-1.0, 1.0, 161)
    points = np.array(np.meshgrid(axis, axis)).reshape(2, -1)
    for _ in range(2):
        roots, centres = rng.standard_normal((3, 2, 2)), rng.uniform(-0.8, 0.8, (3, 2))
        forms = [r @ r.T + 0.1 * np.eye(2) for r in roots]
        criteria = [
            lambda z, a=a, c=c: (z - c) @ a @ (z - c) for a, c in zip(forms, centres, strict=True)
        ]
        found = compromise(criteria, [-1.0, -1.0], [1.0, 1.0])
        gap = points[:, None] - centres.T[:, :, None]
        values = np.einsum("akn,kab,bkn->kn", gap, np.array(forms), gap)
        table = np.array([[c(x) for c in criteria] for x in centres])
        worst = (values / table.max(axis=0)[:, None]).max(axis=0)
        assert worst.min() - 0.03 < found.worst <= worst.min() + 1e-9
        assert found.efficiency == "full"
        np.testing.assert_allclose(found.minimizers, centres, atol=1e-6)


def test_the_better_of_two_wells_in_a_box_is_found():
    """From several starts: the centre lies on the way to the worse one."""
    wells = lambda z, tilt: float((z[0] + 1.2) ** 2 * (z[0] - 5.1) ** 2 + tilt * z[0])  # noqa: E731
    found = compromise([lambda z: wells(z, 0.4), lambda z: wells(z, -0.4)], [-3.0], [7.0])
    np.testing.assert_allclose(found.minimizers, [[-1.205], [5.105]], atol=2e-3)
