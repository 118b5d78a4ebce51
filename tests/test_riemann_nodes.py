"""Nodes, frequencies and refusals of the Riemann problem: numbers that can be told by hand."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from seedslib.riemann import circle, solve_riemann, solve_rotations, wiener_gain, winding
from seedslib.riemann.problem import judge

LATE = {"transition": [[[0.3]], [[0.2]]], "sensor": [1.3], "state_noise": [[0.7]]}


def quietly(*args, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return solve_riemann(*args, **more)


@pytest.mark.parametrize(
    ("nodes", "mode", "seen"),
    [
        (64, 29, False), (64, 30, True), (64, 34, True), (64, 35, False), (16, 6, False),
        (16, 7, True), (16, 9, True), (16, 10, False), (96, 45, True), (96, 44, False),
    ],
)  # fmt: skip
def test_the_tail_is_the_largest_of_the_last_sixteenth(nodes, mode, seen):
    t = circle(nodes)
    found = quietly(np.ones(nodes), 5.0 + 2e-3 * t**mode)
    assert found.tail == pytest.approx(4e-4 if seen else 0.0, abs=1e-15)
    # of the logarithm of G it is absolute below one, relative above
    found = quietly(np.exp(0.5 + 2e-5 * t**mode), np.ones(nodes))
    assert found.tail == pytest.approx(2e-5 if seen else 0.0, abs=3e-10)


@pytest.mark.parametrize("nodes", [8, 16])
def test_frequencies_on_either_side(nodes):
    rng = np.random.default_rng(3)
    modes = rng.standard_normal((nodes, 2, 3)) + 1j * rng.standard_normal((nodes, 2, 3))
    half = nodes // 2
    found = quietly(np.ones(nodes), np.fft.ifft(modes, axis=0) * nodes)
    inner, outer = np.array([0.7 - 0.6j, 0.1j]), np.array([1.2 + 0.3j, -2.0])
    plus = sum(modes[k] * inner[:, None, None] ** k for k in range(half))
    minus = -sum(modes[-k] * outer[:, None, None] ** -k for k in range(1, half))
    np.testing.assert_allclose(found.inside(inner), plus, rtol=1e-13)
    np.testing.assert_allclose(found.outside(outer), minus, rtol=1e-13)
    np.testing.assert_allclose(found.inside(0.1j), plus[1:], rtol=1e-13)


@pytest.mark.parametrize("nodes", [201, 300])
@pytest.mark.parametrize("index", [-2, 0, 3])
def test_odd_and_even_numbers_of_nodes(nodes, index):
    t = circle(nodes)
    g = t**index * np.exp(0.3 * t - 0.2j / t + 0.4)
    plus, minus = np.exp(0.5j * t), t**-4.0 / (t - 0.3)
    p = np.array([0.3, -1.1, 0.7j])[: max(index, 0)]
    found = solve_riemann(g, plus - g * minus)
    np.testing.assert_allclose(found.plus - g * found.minus, plus - g * minus, atol=1e-13)
    homogeneous = solve_riemann(g, np.zeros(nodes), p)
    np.testing.assert_allclose(
        homogeneous.plus, np.exp(0.3 * t + 0.4) * np.polyval(p[::-1], t), atol=1e-13
    )
    if index > 0:
        large = solve_riemann(g, np.zeros(nodes), 1e9 * p)
        assert 0.0 < large.residual <= 1e-14
        assert 0.0 < large.defect <= 1e-14
    else:
        # of a pair one may be zero but for rounding
        for one, two in ((plus, 0 * t), (0 * t, minus)):
            half = solve_riemann(g, one - g * two)
            np.testing.assert_allclose(half.plus, one, atol=1e-13)
            np.testing.assert_allclose(half.minus, two, atol=1e-13)
            assert max(half.defect, half.residual) <= 1e-13
        np.testing.assert_allclose(found.plus, plus, atol=1e-13)
        np.testing.assert_allclose(found.minus, minus, atol=1e-13)
    assert found.defect <= 1e-13


def test_a_pole_at_infinity_is_measured():
    # G = t^-2: Phi- = -t^2 g where g has negative powers alone; 3 / t^3 fits, .5 / t is a pole
    t = circle(32)
    found = solve_riemann(t**-2.0, 3 / t**3 + 0.5 / t)
    np.testing.assert_allclose(found.conditions, [0.5, 0.0], atol=1e-15)
    assert (found.index, found.constants, found.solvable) == (-2, 0, False)
    assert found.defect == pytest.approx(0.5 / 3.5, rel=1e-12)
    np.testing.assert_allclose(found.minus, -3 / t - 0.5 * t, atol=1e-14)
    finite = solve_riemann(t**-2.0, 3 / t**3 + 0.5 / t**2, at_infinity="finite")
    np.testing.assert_allclose(finite.conditions, [0.0], atol=1e-15)
    assert (finite.constants, finite.solvable, finite.defect <= 1e-15) == (0, True, True)
    # one right side of two fails
    both = solve_riemann(t**-2.0, np.stack([3 / t**3, 3 / t**3 + 0.5 / t], axis=1))
    assert both.conditions.shape == (2, 2)
    assert not both.solvable
    # each right side is measured by itself, however small it is
    small = solve_riemann(t**-2.0, np.stack([3 / t**3, 1e-9 * (3 / t**3 + 0.5 / t)], axis=1))
    assert small.defect == pytest.approx(0.5 / 3.5, rel=1e-12)
    assert not small.solvable


def test_a_condition_vanishes_relative_to_the_moments():
    t = circle(32)
    assert solve_riemann(1 / t, 3 / t**2 + 2e-9 / t).solvable
    assert not solve_riemann(1 / t, 3 / t**2 + 4e-9 / t).solvable
    assert solve_riemann(1 / t, np.zeros(32)).solvable


def test_constants_of_several_right_sides():
    t = circle(128)
    right = np.stack([1 / (t - 2), 1 / (t - 3), 0 * t, 1 / t, t, 2 * t], axis=1).reshape(128, 2, 3)
    p = np.arange(1.0, 13.0).reshape(2, 2, 3)
    plain, moved = solve_riemann(t**2, right), solve_riemann(t**2, right, p)
    np.testing.assert_allclose(moved.plus - plain.plus, p[0] + p[1] * t[:, None, None], atol=1e-13)
    common = solve_riemann(t**2, right, [0.3, -2.0])
    np.testing.assert_allclose(
        common.plus - plain.plus, np.broadcast_to((0.3 - 2 * t)[:, None, None], right.shape),
        atol=1e-13,
    )  # fmt: skip
    for wrong in (p[:, :1], p[0], p[..., None], 1.0):
        with pytest.raises((TypeError, ValueError), match="polynomial"):
            solve_riemann(t**2, right, wrong)


def test_exponentials_have_a_range():
    t = circle(4096)  # log G = i a sin has the projections a t / 2 and a / 2 t
    assert not solve_riemann(np.exp(2j * 690 * t.imag), np.zeros(4096)).plus.any()
    with pytest.raises(ValueError, match="projections below 700, got 710"):
        solve_riemann(np.exp(2j * 710 * t.imag), np.zeros(4096))


def test_the_winding_number_near_its_limits():
    assert winding(np.r_[2e-12, np.ones(20)]) == 0
    with pytest.raises(ValueError, match="zero on the circle"):
        winding(np.r_[0.5e-12, np.ones(20)])
    with pytest.raises(ValueError, match="zero on the circle"):
        winding(np.zeros(20))
    for turns in (-8, 8):
        assert winding(circle(18) ** turns) == turns  # steps of .889 pi
    with pytest.raises(ValueError, match="phase steps"):
        winding(circle(22) ** 10)  # .909 pi


def test_functions_are_sampled_on_twice_the_nodes_until_their_tail_is_enough():
    asked = []

    def symbol(t):
        asked.append(len(t))
        return np.exp(0.5 * t)

    def noise(t):
        return 1 / (t - 1.3) + 1e-12 * np.sin(1e7 * np.angle(t) ** 2)

    assert len(solve_riemann(symbol, lambda t: 1 / (t - 1.3)).plus) == 512
    assert asked == [64, 129, 128, 257, 256, 513, 512, 1025]
    # a tail that has stopped falling will not fall further
    found = solve_riemann(symbol, noise)
    assert len(found.plus) == 512
    assert 1e-14 < found.tail < 1e-11
    # too few nodes for the index are doubled, or refused where they were asked for
    assert len(solve_riemann(lambda t: t**100, lambda t: t).plus) == 256
    with pytest.raises(ValueError, match="index is uncertain"):
        solve_riemann(lambda t: t**100, lambda t: t, nodes=200)
    # 56 turns on 64 nodes look like eight the other way round
    with pytest.raises(ValueError, match="index -8 with 64 nodes and 56 with 129"):
        solve_riemann(lambda t: t**56, lambda t: t, nodes=64)
    for nodes in (8, 24):
        assert len(solve_riemann(lambda t: 2 + 0 * t, lambda t: t, nodes=nodes).plus) == nodes
    with pytest.raises(ValueError, match="nodes: wanted at least 8"):
        solve_riemann(symbol, noise, nodes=7)


@pytest.mark.parametrize(("ratio", "nodes"), [(0.09, 256), (0.1, 256), (0.11, 128)])
def test_a_tail_that_falls_to_a_tenth_is_worth_more_nodes(ratio, nodes):
    first = 2.0**-34  # exact in every transform

    def right(t):
        tail = {64: first, 128: ratio * first}.get(len(t), 0.0)
        return np.stack([np.ones(len(t)), tail * (-1.0) ** np.arange(len(t))], axis=1)

    assert len(solve_riemann(lambda t: np.ones(len(t)), right).plus) == nodes


def test_what_is_judged():
    found = solve_riemann(circle(32), 1 / (circle(32) - 9))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        judge(replace(found, residual=0.9e-8, defect=0.9e-8, tail=1e-10))
        judge(replace(found, defect=0.5, solvable=False))
    for change in (
        {"residual": 2e-8},
        {"residual": 2e-8, "tail": 1e-10},
        {"defect": 2e-8},
        {"residual": 2e-8, "solvable": False},
    ):
        with pytest.raises(ValueError, match="residual of 2e-08"):
            judge(replace(found, **change))
        with pytest.warns(UserWarning, match="32 nodes"):
            judge(replace(found, **{**change, "tail": 2e-10}))


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.filterwarnings("ignore:riemann:UserWarning")
def test_rotations_of_few_nodes(count):
    t = circle(8 * count)
    g = np.array([1.5 + 0.2 * t**count, 0.3 + 0 * t, 0.1j * t**-count])[:count]
    right = 0.4 * t + 1.1 / t + 0.6
    plus, minus, problems = solve_rotations(g * (1 + 1e-12 * t), right)
    turned = sum(g[j] * np.roll(minus, -8 * j) for j in range(count))
    np.testing.assert_allclose(plus, turned + right, atol=1e-10)
    assert [len(problem.plus) for problem in problems] == [8] * count
    with pytest.raises(ValueError, match=rf"t\^{count}.*of coefficient 1 under"):
        solve_rotations(g + [[0.0], [1e-9], [0.0]][:count] * t, right)
    with pytest.raises(ValueError, match="multiple of p, at least 8 p"):
        solve_rotations(g[:, : 7 * count], right[: 7 * count])


@pytest.mark.parametrize(
    ("last", "size", "lags", "nodes"),
    [(0, 1, None, 256), (0, 3, 20, 512), (1, 2, 40, 1024), (2, 3, 10, 512)],
)
def test_nodes_of_a_filter_are_a_power_of_two(last, size, lags, nodes):
    a = np.zeros((last + 1, size, size))
    a[-1] += 0.3 * np.eye(size)
    found = wiener_gain(a, 0.4 + np.arange(size), np.diag(1.0 + np.arange(size)), 0.9, lags=lags)
    assert found.nodes == nodes
    assert found.impulse.shape == (nodes // 2, size)
    assert found.lag_gains.shape == ((last if lags is None else lags) + 1, size)


@pytest.mark.parametrize("nodes", [None, 301])
def test_one_delay_against_the_iterated_equation(nodes):
    found = wiener_gain(**LATE, sensor_noise=0.4, lags=2, nodes=nodes)
    f, h = np.array([[0.3, 0.2, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([1.3, 0.0, 0.0])
    p = np.eye(3)
    for _ in range(200):
        p = f @ p @ f.T
        p[0, 0] += 0.7
        gain, variance = p @ h / (h @ p @ h + 0.4), h @ p @ h + 0.4
        p = p - variance * np.outer(gain, gain)
    np.testing.assert_allclose(found.lag_gains[:, 0], gain, rtol=1e-12)
    assert found.innovation == pytest.approx(variance, rel=1e-12)
    assert found.cov.item() == pytest.approx(p[0, 0], rel=1e-12)
    estimate, impulse = np.zeros(3), []
    for k in range(30):  # the answer to one measurement at time 0
        estimate = f @ estimate
        estimate = estimate + gain * ((k == 0) - h @ estimate)
        impulse.append(estimate[0])
    np.testing.assert_allclose(found.impulse[:30, 0], impulse, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(found.impulse[60:], 0.0, atol=1e-13)


def test_a_filter_takes_the_tail_that_was_asked_for():
    law = {"sensor": [1.0], "state_noise": [[1.0]], "sensor_noise": 1.0}
    assert wiener_gain([[0.8]], **law).nodes == 512
    coarse = wiener_gain([[0.8]], **law, nodes=256)
    assert coarse.nodes == 256
    assert coarse.tail == pytest.approx(0.8**120, rel=0.01, abs=0.0)
    with pytest.raises(ValueError, match=r"spectra resolved, got a tail of .* with 128 nodes"):
        wiener_gain([[0.8]], **law, nodes=128)
    with pytest.raises(ValueError, match="nodes: wanted at least 40"):
        wiener_gain([[0.8]], **law, lags=19, nodes=39)
    assert wiener_gain([[0.1]], **law, lags=19, nodes=40).nodes == 40
    with pytest.raises(ValueError, match="lags: wanted at most 1048576 nodes"):
        wiener_gain([[0.8]], **law, lags=2**19)


def test_a_row_is_a_sensor_and_bad_numbers_are_named():
    row = wiener_gain(**{**LATE, "sensor": [[1.3]]}, sensor_noise=[[0.4]])
    assert row.innovation == wiener_gain(**LATE, sensor_noise=0.4).innovation
    good = {**LATE, "sensor_noise": 0.4}
    for name, wrong in (("transition", [[np.nan]]), ("sensor", [np.nan]), ("state_noise", [["a"]]),
                        ("sensor_noise", np.nan), ("sensor", [[1.0, 2.0]]), ("lags", 1.5),
                        ("nodes", 2.5), ("sensor_noise", [1.0, 2.0]), ("transition", [[]]),
                        ("transition", np.zeros((1, 0, 0)))):  # fmt: skip
        with pytest.raises((TypeError, ValueError), match=f"^{name}: "):
            wiener_gain(**{**good, name: wrong})
    for name, wrong in (("coefficient", "x"), ("right", "x"), ("polynomial", "x")):
        data = {"coefficient": circle(8), "right": circle(8), "polynomial": [1.0], name: wrong}
        with pytest.raises(TypeError, match=f"^{name}: "):
            solve_riemann(**data)
    with pytest.raises(TypeError, match=r"^z: "):
        solve_riemann(circle(32), 1 / (circle(32) - 9)).inside("x")
    with pytest.raises(TypeError, match=r"^coefficients: "):
        solve_rotations("x", circle(8))
    with pytest.raises(TypeError, match=r"^right: "):
        solve_rotations(np.ones((1, 8)), "x")
