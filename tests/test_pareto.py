import mpmath
import numpy as np
import pytest
from scipy.optimize import brentq, ridder, toms748

from seedslib.pareto import bisect, choose, compromise

SEGMENTS = {  # criteria, segment, minimisers, root and loss as printed to twelve digits
    "square against cube": (
        (lambda x: x**2, lambda x: (1 - x) ** 3), (0, 1), (0, 1), 0.4301597090019, 0.1850373752,
    ),
    "two squares": (
        (lambda x: x**2, lambda x: (x - 3) ** 2), (-5, 5), (0, 3), 1.5, 0.25,
    ),
    "exponential against hyperbola": (
        (mpmath.exp, lambda x: 1 / (mpmath.mpf("0.1") + x)), (0, 2), (0, 2),
        0.5438073744690, 0.1130922605,
    ),
    "quartic against cosh": (
        (lambda x: (x - 1) ** 2 + (x - 1) ** 4 / 10, lambda x: mpmath.cosh(x - 3)), (-2, 6), (1, 3),
        2.000214701370, 0.1965205995,
    ),
}  # fmt: skip

# squared errors of a filter that keeps the J oldest innovations, J = 0..10
TRUNCATION = [
    1.938729, 1.879386, 1.869233, 1.866560, 1.865813, 1.865606, 1.865440, 1.864595, 1.862608,
    1.860317, 1.858970,
]  # fmt: skip


def in_floats(criteria):
    return [lambda x, c=c: float(c(x)) for c in criteria]


def exact_root(criteria, minimisers):
    with mpmath.workdps(40):
        (f, g), (a, b) = criteria, map(mpmath.mpf, minimisers)
        gap = lambda x: (f(x) - f(a)) / (f(b) - f(a)) - (g(x) - g(b)) / (g(a) - g(b))  # noqa: E731
        root = mpmath.findroot(gap, (a, b), solver="anderson", tol=1e-60)
        return float(root), float((f(root) - f(a)) / (f(b) - f(a)))


@pytest.mark.parametrize("name", SEGMENTS)
def test_segment_against_forty_digits_and_the_printed_root(name):
    criteria, (lower, upper), minimisers, printed, printed_loss = SEGMENTS[name]
    root, loss = exact_root(criteria, minimisers)
    assert root == pytest.approx(printed, abs=1e-10)
    assert loss == pytest.approx(printed_loss, abs=1e-10)
    found = compromise(in_floats(criteria), lower, upper)
    assert found.x == pytest.approx(root, abs=1e-12)
    assert found.balanced == pytest.approx(root, abs=1e-12)
    np.testing.assert_allclose(found.losses, loss, atol=1e-12)
    np.testing.assert_allclose(found.minimizers, minimisers, atol=1e-10)
    assert (found.status, found.efficiency, found.balanced_efficiency) == (
        "equal losses", "full", "full",
    )  # fmt: skip
    assert found.unimodal
    assert found.worst == found.losses.max()


@pytest.mark.parametrize("name", SEGMENTS)
def test_segment_against_brute_force(name):
    criteria, (lower, upper), *_ = SEGMENTS[name]
    criteria = in_floats(criteria)
    found = compromise(criteria, lower, upper)
    grid = np.linspace(lower, upper, 20001)
    values = np.array([[c(x) for x in grid] for c in criteria])
    at = values.argmin(axis=1)
    utopia, nadir = values.min(axis=1), values[:, at].max(axis=1)
    worst = ((values.T - utopia) / (nadir - utopia)).max(axis=1)
    assert abs(grid[worst.argmin()] - found.x) <= 2 * (grid[1] - grid[0])
    assert worst.min() == pytest.approx(found.worst, abs=1e-3)
    np.testing.assert_allclose(found.utopia, utopia, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "calls"),
    list(
        zip(
            SEGMENTS, [(8, 9, 12, 40), (3, 3, 4, 42), (10, 12, 16, 41), (7, 7, 10, 41)], strict=True
        )
    ),
)
def test_calls_of_brackets_against_bisection(name, calls):
    criteria, _, (a, b), root, _ = SEGMENTS[name]
    f, g = in_floats(criteria)
    count = 0

    def gap(x):
        nonlocal count
        count += 1
        return (f(x) - f(a)) / (f(b) - f(a)) - (g(x) - g(b)) / (g(a) - g(b))

    got = []
    for method in (brentq, toms748, ridder):
        count = 0
        assert method(gap, a, b, xtol=1e-12) == pytest.approx(root, abs=1e-10)
        got.append(count)
    halvings = int(np.ceil(np.log2((b - a) / 1e-12)))
    # the number of calls of a SciPy routine is its own affair: within two of the numbers seen
    assert np.abs(np.array([*got, halvings]) - calls).max() <= 2
    trace = bisect([f, g], a, b, tolerance=1e-15, steps=halvings)
    assert trace.x == pytest.approx(root, abs=1e-10)
    assert trace.converged == (name == "two squares")  # its first midpoint is the root


def test_gap_is_minus_one_and_plus_one_at_the_minimisers():
    for criteria, (lower, upper), *_ in SEGMENTS.values():
        criteria = in_floats(criteria)
        found = compromise(criteria, lower, upper)
        for x, wanted in zip(found.minimizers, (-1.0, 1.0), strict=True):
            losses = (np.array([c(x) for c in criteria]) - found.utopia) / (
                found.nadir - found.utopia
            )
            assert losses[0] - losses[1] == pytest.approx(wanted, abs=1e-14)
    # the largest value of all in the place of M_1 would not do: "two squares" on its whole segment
    first, _ = in_floats(SEGMENTS["two squares"][0])
    assert (first(3) - first(0)) / (first(-5) - first(0)) < 0.5


def test_random_monotone_criteria_have_a_root():
    # continuous, opposite monotone: a root exists, is unique, and is the least largest loss
    rng = np.random.default_rng(5)
    for _ in range(40):
        knots = np.r_[0.0, np.sort(rng.random(6)), 1.0]
        up = np.r_[0.0, np.cumsum(rng.random(7))]
        down = np.r_[np.cumsum(rng.random(7))[::-1], 0.0]
        criteria = [
            lambda x, k=knots, y=up: np.interp(x, k, y),
            lambda x, k=knots, y=down: np.interp(x, k, y),
        ]
        found = compromise(criteria, 0.0, 1.0)
        assert found.status == "equal losses"
        assert found.unimodal
        assert np.ptp(found.losses) <= 1e-12
        trace = bisect(criteria, 0.0, 1.0)
        assert trace.converged
        assert abs(trace.x - found.x) <= 1e-10


def loss_gap(criteria, low, high):
    """Δ of two criteria with the minimisers `low` and `high`."""
    f, g = criteria
    return lambda x: (f(x) - f(low)) / (f(high) - f(low)) - (g(x) - g(high)) / (g(low) - g(high))


def test_gap_vanishes_in_a_connected_set_of_the_plane():
    """CB-T2: on a path in a ring, which the straight segment leaves; not in two pieces."""
    rng = np.random.default_rng(9)
    polar = np.stack(np.meshgrid(np.linspace(1, 2, 15), np.linspace(0, 1.5 * np.pi, 91)))
    polar = polar.reshape(2, -1)
    empty = 0

    def at(p):
        return p[0] * np.array([np.cos(p[1]), np.sin(p[1])])

    for _ in range(10):
        criteria = []
        for angle in (0.6, 4.2):
            centre, wave = at((1.5, angle)) + rng.uniform(-0.2, 0.2, 2), rng.normal(size=2)
            criteria.append(
                lambda p, c=centre, w=wave: ((at(p).T - c) ** 2).sum(-1) + 0.2 * np.sin(at(p).T @ w)
            )
        low, high = (polar[:, c(polar).argmin()] for c in criteria)
        gap = loss_gap(criteria, low, high)
        assert (gap(low), gap(high)) == pytest.approx((-1.0, 1.0))
        path = bisect(criteria, low, high, tolerance=1e-11)
        assert path.converged
        assert abs(gap(path.x)) <= 1e-11
        assert 1 <= path.x[0] <= 2
        assert 0 <= path.x[1] <= 1.5 * np.pi
        pieces = [gap(polar[:, part]) for part in (polar[1] < 1.6, polar[1] > np.pi)]
        empty += all(piece.max() < 0 or piece.min() > 0 for piece in pieces)
    assert empty > 5  # no zero in two pieces of the ring


def halve(gap, low, high, steps, right_half=True):
    """|Δ| at both ends of the nested segments."""
    ends = [(gap(low), gap(high))]
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if (gap(middle) < 0) == right_half else (low, middle)
        ends.append((gap(low), gap(high)))
    return np.abs(ends)


@pytest.mark.parametrize("name", SEGMENTS)
def test_both_ends_settle_and_the_bound_never_grows(name):
    """CB-T3, CB-T4: the bound over the segment; its first value survives the first halving."""
    criteria, _, (low, high), *_ = SEGMENTS[name]
    gap = loss_gap(in_floats(criteria), low, high)
    ends = halve(gap, low, high, 50)
    bound = ends.max(axis=1)
    assert bound[:2] == pytest.approx([1.0, 1.0])  # so it is not smaller on each next segment
    assert (np.diff(bound) <= 1e-12).all()
    for eps in (1e-3, 1e-6, 1e-9):
        first = int(np.flatnonzero((ends > eps).any(axis=1)).max()) + 1
        assert first < 45
        assert (ends[first:] <= eps).all()
    trace = bisect(in_floats(criteria), low, high, tolerance=1e-15, steps=20)
    grid = np.linspace(0, 1, 33)
    a, b = float(low), float(high)
    for r, middle in enumerate(trace.points[:12]):
        over = max(abs(gap(a + u * (b - a))) for u in grid)  # Δ is monotone: the ends bound it
        assert over == pytest.approx(bound[r], abs=1e-12)
        a, b = (middle, b) if trace.gaps[r] < 0 else (a, middle)
    astray = halve(gap, low, high, 50, right_half=False)
    assert astray[-1].max() > 0.1


def solutions(values):
    """Which rows solve (18), which (19), and which are efficient among them."""
    below = values[None] <= values[:, None] + 1e-12  # [i, j]: j is no worse than i
    first, second = (
        np.array([
            value[k] <= values[row[:, 1 - k], k].min() + 1e-12
            for value, row in zip(values, below, strict=True)
        ])
        for k in (0, 1)
    )  # fmt: skip
    better = (values[None] < values[:, None] - 1e-9).any(axis=2)
    return first, second, ~(below.all(axis=2) & better).any(axis=1)


def test_or_and_and_in_the_plane_and_on_a_line():
    """CB-T5: both problems together are efficiency; one is enough only where both are strict."""
    axis = np.linspace(0, 1, 21)
    plane = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    first, second, truth = solutions(plane)
    at = int(np.flatnonzero((plane == [0, 0.5]).all(axis=1))[0])
    assert (first[at], second[at], truth[at]) == (True, False, False)
    np.testing.assert_array_equal(first & second, truth)
    assert truth.sum() == 1
    assert (first | second).sum() == 41
    grid = np.linspace(0, 1, 201)
    for criteria in ((grid**2, (1 - grid) ** 3), (grid, np.exp(grid)), (grid**3, -np.exp(grid))):
        first, second, truth = solutions(np.stack(criteria, axis=1))
        np.testing.assert_array_equal(first | second, truth)
        np.testing.assert_array_equal(first & second, truth)
    flat = np.stack([np.interp(grid, [0, 0.4, 0.6, 1], [0, 0.5, 0.5, 1]), 1 - grid], axis=1)
    first, second, truth = solutions(flat)
    np.testing.assert_array_equal(first & second, truth)
    assert (first & ~truth).any()


def test_convex_criteria_on_a_line():
    # largest of random lines plus a parabola, against a scan
    rng = np.random.default_rng(6)
    grid = np.linspace(-2.0, 2.0, 2001)
    for _ in range(40):
        slopes, offsets, tops = (
            rng.normal(size=(2, 5)),
            rng.normal(size=(2, 5)),
            rng.uniform(-1, 1, 2),
        )
        criteria = [
            lambda x, s=s, o=o, c=c: np.max(s * np.asarray(x)[..., None] + o, -1) + (x - c) ** 2
            for s, o, c in zip(slopes, offsets, tops, strict=True)
        ]
        found = compromise(criteria, -2.0, 2.0)
        assert (found.status, found.efficiency, found.unimodal) == ("equal losses", "full", True)
        low, high = sorted(found.minimizers)
        assert low < found.x < high
        values = np.stack([c(grid) for c in criteria], axis=1)
        worst = ((values - found.utopia) / (found.nadir - found.utopia)).max(axis=1)
        assert found.worst <= worst.min() + 1e-12
        assert abs(grid[worst.argmin()] - found.x) <= 2 * (grid[1] - grid[0])
        better = (values <= found.values - 1e-12).all(axis=1)
        assert not better.any()


def test_gap_of_bisection_does_not_fall_at_every_step():
    trace = bisect([lambda x: x**2, lambda x: (1 - x) ** 3], 0.0, 1.0)
    np.testing.assert_allclose(
        np.abs(trace.gaps[:4]), [0.125, 0.359375, 0.103515625, 0.013427734375], atol=1e-15
    )
    # at x = 1/2, 1/4, 3/8, 7/16 exactly: x^2 - (1 - x)^3
    assert np.abs(trace.gaps[1]) > np.abs(trace.gaps[0])
    assert trace.converged
    widths = np.abs(trace.points - 0.4301597090019)
    assert (widths <= 0.5 ** np.arange(1, len(widths) + 1) + 1e-12).all()


def test_equal_losses_can_be_weakly_efficient():
    # x = .5 solves problem (18) but not (19): x = .6 costs the same in I1 and less in I2
    criteria = [lambda x: np.interp(x, [0, 0.4, 0.6, 1], [0, 0.5, 0.5, 1]), lambda x: 1 - x]
    found = compromise(criteria, 0.0, 1.0)
    assert found.balanced == pytest.approx(0.5, abs=1e-12)
    assert found.balanced_efficiency == "weak"
    assert found.x == pytest.approx(0.6, abs=1e-9)
    np.testing.assert_allclose(found.values, [0.5, 0.4], atol=1e-9)
    assert (found.status, found.efficiency) == ("minimax", "full")
    grid = np.linspace(0, 1, 10001)
    first, second = np.array([[c(x) for c in criteria] for x in grid]).T
    assert first[second <= 0.5 + 1e-12].min() >= 0.5  # (18) holds at x = .5
    assert second[first <= 0.5].min() == pytest.approx(0.4, abs=1e-9)  # (19) does not


def test_minimisers_on_a_plateau_are_chosen_by_the_other_criterion():
    criteria = [lambda x: x, lambda x: max(0.0, 0.6 - x)]
    found = compromise(criteria, 0.0, 1.0)
    assert found.x == pytest.approx(0.3, abs=1e-12)
    assert found.minimizers[1] == pytest.approx(0.6, abs=1e-12)
    # the upper end minimises the second criterion too, and would give another answer
    assert bisect(criteria, 0.0, 1.0).x == pytest.approx(0.375, abs=1e-12)
    # two separate global minima of one criterion
    double = compromise([lambda x: (x * x - 1) ** 2, lambda x: (x - 0.8) ** 2], -2.0, 2.0)
    assert double.minimizers[0] == pytest.approx(1.0, abs=1e-10)


def test_both_losses_flat_around_the_balance():
    criteria = [
        lambda x: np.interp(x, [0, 0.4, 0.6, 1], [0, 0.5, 0.5, 1]),
        lambda x: np.interp(x, [0, 0.3, 0.7, 1], [1, 0.5, 0.5, 0]),
    ]
    found = compromise(criteria, 0.0, 1.0)
    assert not found.unimodal
    np.testing.assert_allclose(found.losses, [found.losses[0], 0.5], atol=1e-9)
    assert found.worst == pytest.approx(0.5, abs=1e-9)
    assert found.x == pytest.approx(0.3, abs=1e-9)  # leftmost: least I1 at equal I2
    assert found.losses[0] == pytest.approx(0.375, abs=1e-9)


def test_kinks_are_located_to_all_digits():
    found = compromise(
        [lambda x: abs(x - 0.31), lambda x: abs(x - 0.77) + 0.1 * max(x - 0.77, 0.0)], 0.0, 1.0
    )
    assert found.x == pytest.approx(0.54, abs=1e-12)


def test_several_equal_points_the_least_is_taken():
    criteria = [lambda x: np.sin(7 * x) + x, lambda x: np.cos(5 * x) - x]
    found = compromise(criteria, 0.0, 3.0)
    assert not found.unimodal
    grid = np.linspace(0, 3, 200001)
    values = np.array([c(grid) for c in criteria])
    utopia, nadir = values.min(axis=1), values[:, values.argmin(axis=1)].max(axis=1)
    worst = ((values.T - utopia) / (nadir - utopia)).max(axis=1)
    assert found.worst == pytest.approx(worst.min(), abs=3e-5)
    assert found.x == pytest.approx(grid[worst.argmin()], abs=3e-5)


def test_random_waves_and_steps_against_a_fine_scan():
    # criteria of any shape, with features wider than the spacing of the scan (1/8)
    rng = np.random.default_rng(1)
    grid = np.linspace(-2.0, 2.0, 8001)
    for trial in range(40):
        if trial % 2:
            knots = np.linspace(-2, 2, 9)
            levels = rng.integers(-2, 3, (2, 9)).astype(float)  # plateaus, also of both at once
            criteria = [lambda x, k=knots, y=y: np.interp(x, k, y) for y in levels]
        else:
            size, speed, phase = (
                rng.normal(size=(2, 4)),
                rng.uniform(0.5, 6, 4),
                rng.uniform(0, 6, 4),
            )
            criteria = [
                lambda x, c=c, w=speed, p=phase: np.sin(np.asarray(x)[..., None] * w + p) @ c
                for c in size
            ]
        found = compromise(criteria, -2.0, 2.0)
        values = np.stack([c(grid) for c in criteria], axis=1)
        spread = np.ptp(values, axis=0)
        assert (found.utopia <= values.min(axis=0) + 1e-9 * spread).all()
        if found.status == "ideal point":
            np.testing.assert_allclose(found.values, values.min(axis=0), atol=1e-5)
            continue
        worst = ((values - found.utopia) / (found.nadir - found.utopia)).max(axis=1)
        assert found.worst <= worst.min() + 1e-9
        assert found.efficiency == "full"


def test_jump_over_the_balance_is_said():
    found = compromise([lambda x: x + (x > 0.5), lambda x: 1 - x], 0.0, 1.0)
    assert (found.status, found.balanced, found.unimodal) == ("no bracket", None, False)
    np.testing.assert_allclose(found.losses, [0.25, 0.5], atol=1e-12)


def test_one_point_best_for_all():
    found = compromise([lambda x: (x - 0.3) ** 2, lambda x: abs(x - 0.3)], 0.0, 1.0)
    assert found.status == "ideal point"
    assert found.x == pytest.approx(0.3, abs=1e-9)
    np.testing.assert_array_equal(found.losses, 0.0)
    box = compromise([lambda z: z @ z, lambda z: 2 * z @ z], [-1.0, -1.0], [2.0, 2.0])
    assert box.status == "ideal point"


def test_units_of_the_criteria_do_not_matter():
    plain = compromise([lambda x: x**2, lambda x: (1 - x) ** 3], 0.0, 1.0)
    scaled = compromise([lambda x: 1e-15 * x**2, lambda x: 1e9 * (1 - x) ** 3 + 1e9], 0.0, 1.0)
    assert scaled.x == pytest.approx(plain.x, abs=1e-12)


def test_three_criteria_cannot_be_equal_on_a_line():
    found = compromise(lambda x: (x**2, (x - 1) ** 2, (x - 0.5) ** 2), -1.0, 2.0)
    assert found.x == pytest.approx(0.5, abs=1e-9)
    np.testing.assert_allclose(found.losses, [0.25, 0.25, 0.0], atol=1e-9)
    assert (found.status, found.balanced, found.efficiency) == ("minimax", None, "full")


PLANE = (
    lambda z: z[0] ** 2 + 10 * z[1] ** 2,
    lambda z: 10 * (z[0] - 1) ** 2 + (z[1] - 1) ** 2,
)


def test_in_the_plane_equal_losses_on_the_segment_are_dominated():
    segment = bisect(PLANE, [0.0, 0.0], [1.0, 1.0])
    np.testing.assert_allclose(segment.x, [0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(segment.losses[-1], 0.25, atol=1e-12)
    assert [c(segment.x) for c in PLANE] == pytest.approx([2.75, 2.75])
    found = compromise(PLANE, [-1.0, -1.0], [2.0, 2.0])
    # stationarity with multipliers 1/2: x = 10 (1 - x), 10 y = 1 - y
    np.testing.assert_allclose(found.x, [10 / 11, 1 / 11], atol=1e-7)
    np.testing.assert_allclose(found.values, 10 / 11, atol=1e-8)
    np.testing.assert_allclose(found.nadir, 11, atol=1e-8)
    np.testing.assert_allclose(found.losses, 1 / 12.1, atol=1e-9)
    assert (found.status, found.efficiency) == ("equal losses", "full")


def test_three_criteria_in_the_plane():
    third = lambda z: (z[0] + 1) ** 2 + (z[1] - 2) ** 2  # noqa: E731
    found = compromise([*PLANE, third], [-3.0, -3.0], [3.0, 3.0])
    np.testing.assert_allclose(found.nadir, [41, 41, 5], atol=1e-7)
    np.testing.assert_allclose(found.x, [-0.1227532, 1.1227532], atol=1e-7)
    np.testing.assert_allclose(found.losses, 0.30782478, atol=1e-8)
    assert (found.status, found.efficiency) == ("equal losses", "full")
    with mpmath.workdps(30):
        equal = lambda x, y, t: [  # noqa: E731
            c((x, y)) - t * m for c, m in zip([*PLANE, third], (41, 41, 5), strict=True)
        ]
        x, y, loss = mpmath.findroot(equal, (-0.1, 1.1, 0.3))
    np.testing.assert_allclose(found.x, [float(x), float(y)], atol=1e-8)
    assert found.worst == pytest.approx(float(loss), abs=1e-9)


def test_box_against_a_scan_of_random_quadratics():
    rng = np.random.default_rng(2)
    axis = np.linspace(-1.0, 1.0, 161)
    points = np.array(np.meshgrid(axis, axis)).reshape(2, -1)
    for _ in range(5):
        roots, centres = rng.standard_normal((3, 2, 2)), rng.uniform(-0.8, 0.8, (3, 2))
        forms = [r @ r.T + 0.1 * np.eye(2) for r in roots]
        criteria = [
            lambda z, a=a, c=c: (z - c) @ a @ (z - c) for a, c in zip(forms, centres, strict=True)
        ]
        found = compromise(criteria, [-1.0, -1.0], [1.0, 1.0])
        shifted = points[:, None] - centres.T[:, :, None]
        values = np.einsum("akn,kab,bkn->kn", shifted, np.array(forms), shifted)
        table = np.array([[c(x) for c in criteria] for x in centres])
        worst = (values / table.max(axis=0)[:, None]).max(axis=0)
        assert found.efficiency == "full"
        assert found.worst <= worst.min() + 1e-9
        assert found.worst == pytest.approx(worst.min(), abs=0.03)


def test_second_stage_removes_weak_efficiency_in_a_box():
    criteria = [
        lambda z: z[0] ** 2,
        lambda z: (z[0] - 1) ** 2,
        lambda z: (z[0] - 0.5) ** 2 + (z[1] - 0.3) ** 2,
    ]
    found = compromise(criteria, [-1.0, -1.0], [2.0, 2.0])  # the bound .25 leaves z[1] free
    np.testing.assert_allclose(found.x, [0.5, 0.3], atol=1e-4)
    np.testing.assert_allclose(found.losses, [0.25, 0.25, 0.0], atol=1e-5)
    assert found.efficiency == "full"


def brute_choice(values):
    below = values[:, None] <= values[None]
    beaten = (below.all(axis=2) & ~below.transpose(1, 0, 2).all(axis=2)).any(axis=0)
    keep = np.flatnonzero(~beaten)
    low = values[keep].min(axis=0)
    ends = values[keep][(values[keep] == low).any(axis=1)].max(axis=0)
    scale = np.where(ends > low, ends - low, np.inf)
    losses = (values - low) / scale
    return min(keep, key=lambda i: (losses[i].max(), losses[i].sum(), i))


def test_monotone_lists_bisection_equals_brute_force():
    rng = np.random.default_rng(3)
    for trial in range(2000):
        n = int(rng.integers(1, 40))
        falling, rising = np.sort(rng.random(n))[::-1], np.sort(rng.random(n))
        if trial % 2:  # with ties
            falling, rising = falling.round(1), rising.round(1)
        table = np.c_[falling, rising]
        whole = choose(table)
        halved = choose([falling.__getitem__, rising.__getitem__], range(n))
        assert whole.index == brute_choice(table)
        np.testing.assert_array_equal(table[halved.index], table[whole.index])
        np.testing.assert_allclose(halved.losses, whole.losses, atol=1e-15)
        assert whole.efficiency == halved.efficiency == "full"
        assert halved.unimodal
        if trial % 2 == 0:
            assert halved.evaluations <= np.ceil(np.log2(max(n, 2))) + 6


def test_orders_of_a_filter_by_error_and_cost():
    cost = np.arange(11.0)
    found = choose(np.c_[TRUNCATION, cost])
    assert found.index == 2
    np.testing.assert_allclose(found.losses, [0.12867, 0.2], atol=1e-5)
    losses = (np.array(TRUNCATION) - TRUNCATION[-1]) / (TRUNCATION[0] - TRUNCATION[-1])
    np.testing.assert_allclose(losses[:4], [1, 0.25597, 0.12867, 0.09515], atol=2e-5)
    halved = choose([TRUNCATION.__getitem__, lambda j: j], range(11))
    assert (halved.x, halved.index) == (2, 2)
    assert halved.evaluations < 11


def test_useless_choices_move_the_compromise_and_are_dropped_if_dominated():
    table = np.c_[TRUNCATION, np.arange(11.0)]
    longer = np.r_[table, [[TRUNCATION[-1] - 1e-9, 60.0]]]  # buys nothing, stretches the cost
    assert choose(longer).index > choose(table).index
    assert choose(longer).sensitivity != ()
    dominated = np.r_[table, [[TRUNCATION[-1], 60.0]]]
    assert choose(dominated).index == choose(table).index
    noisy = choose(longer, errors=np.c_[np.full(12, 1e-6), np.zeros(12)])
    assert noisy.index == choose(table).index


def test_noise_of_draws_is_paired():
    rng = np.random.default_rng(8)
    common = 0.05 * rng.standard_normal((400, 1, 1))  # shared by all choices: it cancels
    own = 0.01 * rng.standard_normal((400, 11, 1))
    cost = np.broadcast_to(np.arange(11.0)[:, None], (400, 11, 1))
    draws = np.concatenate([np.array(TRUNCATION)[:, None] + common + own, cost], axis=2)
    found = choose(draws)
    assert found.index in found.inseparable
    assert set(found.inseparable) <= {1, 2, 3}
    # independent errors of the size of the whole scatter separate less
    errors = draws.std(axis=0, ddof=1) / 20
    assert len(choose(draws.mean(axis=0), errors=errors).inseparable) >= len(found.inseparable)


def test_inseparable_choices_hold_the_true_one():
    # losses (.5, .3) against (.3, .49): the noise decides which is chosen, in a third of the
    # repetitions wrongly, but the set must contain the true one in at least 95 %
    rng = np.random.default_rng(9)
    exact = np.c_[[1.0, 0.5, 0.3, 0.15, 0.0], [0.0, 0.3, 0.49, 0.8, 1.0]]
    truth, hits, right, repetitions = choose(exact).index, 0, 0, 400
    errors = np.c_[np.full(5, 0.02), np.zeros(5)]
    for _ in range(repetitions):
        found = choose(exact + errors * rng.standard_normal((5, 2)), errors=errors)
        hits += truth in found.inseparable
        right += truth == found.index
    assert truth == 2
    assert right / repetitions < 0.8
    assert hits / repetitions >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / repetitions)


def test_ideal_and_single_choices():
    assert choose([[1.0, 2.0]]).status == "ideal point"
    assert choose([[3.0, 2.0], [1.0, 1.0]], "ab").x == "b"
    assert choose([lambda j: -j, lambda j: -2 * j], range(9)).index == 8
    assert choose([[1.0, 0.0, 5.0], [0.0, 1.0, 5.0], [0.6, 0.6, 5.0]]).index == 2


X, Y = (lambda x: x), (lambda x: -x)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: compromise([X, Y], 1.0, 1.0), ValueError, "upper"),
        (lambda: compromise([X, Y], 0.0, np.inf), ValueError, "upper"),
        (lambda: compromise([X, Y], [0.0, 0.0], [1.0]), ValueError, "upper"),
        (lambda: compromise([X], 0.0, 1.0), ValueError, "criteria: wanted at least two"),
        (lambda: compromise(lambda x: [x], 0.0, 1.0), ValueError, "at least two"),
        (lambda: compromise([X, 3], 0.0, 1.0), TypeError, "criteria"),
        (lambda: compromise(3, 0.0, 1.0), TypeError, "criteria"),
        (lambda: compromise([X, lambda x: np.nan], 0.0, 1.0), ValueError, "finite.*x = 0"),
        (lambda: compromise([X, Y], 0.0, 1.0, scan=3), ValueError, "scan"),
        (lambda: bisect([X, Y], 1.0, 0.0), ValueError, "start"),
        (lambda: bisect([X, Y], 0.0, [1.0]), ValueError, "end"),
        (lambda: bisect([X, Y], 0.0, 1.0, tolerance=0.0), ValueError, "tolerance"),
        (lambda: bisect([X, Y], 0.0, 1.0, steps=0), ValueError, "steps"),
        (lambda: bisect([X, Y, X], 0.0, 1.0), ValueError, "criteria: wanted two"),
        (lambda: choose(np.zeros((0, 2))), ValueError, "criteria"),
        (lambda: choose([[1.0], [2.0]]), ValueError, "criteria"),
        (lambda: choose([[1.0, np.inf]]), ValueError, "criteria"),
        (lambda: choose(5), ValueError, "criteria"),
        (lambda: choose([[1.0, 2.0]], [1, 2]), ValueError, "choices"),
        (lambda: choose([X, Y]), ValueError, "choices"),
        (lambda: choose([X, Y], [1, 2], errors=[[0, 0], [0, 0]]), ValueError, "errors"),
        (lambda: choose([[1.0, 2.0]], errors=[[-1.0, 0.0]]), ValueError, "errors"),
        (lambda: choose(np.zeros((9, 2, 2)), errors=np.zeros((2, 2))), ValueError, "errors"),
        (lambda: choose(np.zeros((5, 2, 2))), ValueError, "draws"),
        (lambda: choose([X, Y, X], [1, 2]), ValueError, "criteria: wanted two"),
    ],
)
def test_bad_input_is_named(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_noisy_criteria_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="common random numbers"):
        compromise([X, lambda x: -x + rng.standard_normal()], 0.0, 1.0)


def test_noise_that_spares_the_end_point_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="common random numbers"):
        compromise([lambda x: x + (rng.normal() if x > 0.3 else 0.0), Y], 0.0, 1.0)


def test_large_offset_is_no_lack_of_range():
    found = compromise([lambda x: 1e12 + x, lambda x: 1e12 + 1 - x], 0.0, 1.0)
    assert found.status != "ideal point"
    assert found.x == pytest.approx(0.5, abs=1e-3)


def test_choices_may_be_unhashable_and_monotony_is_looked_at():
    found = choose([lambda z: z[0], lambda z: -z[0]], [[1], [2], [3]])
    assert found.x == [2]
    assert not choose([lambda j: (j - 5) ** 2, lambda j: j], list(range(11))).unimodal


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: compromise(lambda x: [x, -x][: 2 if x < 0.7 else 1] + [0] * (x >= 0.7) * 2, 0, 1),
         ValueError, "criteria: wanted 2 values as before, got 3"),
        (lambda: compromise([lambda x: 1e308 * x, lambda x: -x], -1, 1), ValueError, "1e[+]300"),
        (lambda: choose([[1e308, -1e308], [-1e308, 1e308]]), ValueError, "criteria.*1e[+]300"),
        (lambda: bisect([X, Y], 0.0, 1.0, steps=2.5), TypeError, "steps"),
        (lambda: bisect([X, Y], 0.0, 1.0, tolerance="a"), TypeError, "tolerance"),
        (lambda: choose([[1, 2], [2, 1]], {1, 2}), TypeError, "choices"),
        (lambda: choose([X, 3], [1, 2]), TypeError, "criteria"),
    ],
)  # fmt: skip
def test_what_would_overflow_or_break_is_named(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_ranges_too_small_to_invert_count_as_none():
    found = compromise([lambda x: x**2, lambda x: 1 - x], 0.0, 1e-160)
    assert found.status == "ideal point"
