"""The Riemann problem on the circle, against solutions that are known in closed form."""

import warnings

import mpmath
import numpy as np
import pytest

from seedslib.riemann import circle, solve_riemann, solve_rotations, winding


def example(t, index):
    return t**index * np.exp(0.4 * t - 0.3 / t + 0.2j) * (1 - 0.5 / t) / (1 - 0.3 * t)


def frequencies(values):
    return np.fft.fft(values, axis=0) / len(values)


def quietly(*args, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return solve_riemann(*args, **more)


@pytest.mark.parametrize("nodes", [201, 512])
@pytest.mark.parametrize("index", range(-3, 4))
def test_a_known_pair_is_recovered_with_its_free_constants(index, nodes):
    """Odd and even numbers of nodes; several right sides at once, each with its constants."""
    t = circle(nodes)
    g = example(t, index)
    plus, minus = np.exp(0.5 * t), 1 / (t - 0.3)
    p = np.array([0.3, -1.1, 0.7j])[: max(index, 0)]
    right = np.stack([plus - g * minus, plus, -g * minus, 0 * t], axis=1).reshape(nodes, 2, 2)
    scales = np.array([[1.0, 2.0], [-3.0, 0.5]])
    found = solve_riemann(g, right, np.multiply.outer(p, scales) if index > 0 else None)
    assert found.index == index == winding(g)
    assert (found.constants, found.conditions.shape) == (max(index, 0), (max(-index, 0), 2, 2))
    assert found.solvable
    assert max(found.defect, found.residual) < 1e-13
    np.testing.assert_allclose(found.plus, g[:, None, None] * found.minus + right, atol=1e-12)
    half = (nodes + 1) // 2
    assert np.abs(frequencies(found.plus)[half:]).max() <= 1e-13
    assert np.abs(frequencies(found.minus)[:half]).max() <= 1e-13
    if index <= 0:
        for j, (one, two) in enumerate(
            [(plus, minus), (plus, 0 * t), (0 * t, minus), (0 * t, 0 * t)]
        ):
            np.testing.assert_allclose(found.plus.reshape(nodes, 4)[:, j], one, atol=1e-13)
            np.testing.assert_allclose(found.minus.reshape(nodes, 4)[:, j], two, atol=1e-13)
        inner, outer = np.array([0.3 + 0.2j, -0.9, 0.0]), np.array([2j, -1.1 + 0.1j])
        np.testing.assert_allclose(found.inside(inner)[:, 0, 0], np.exp(0.5 * inner), atol=1e-12)
        np.testing.assert_allclose(found.outside(outer)[:, 0, 0], 1 / (outer - 0.3), atol=1e-11)
    else:  # the homogeneous solution is X+ P, X+ known in closed form
        x, plain = np.exp(0.4 * t + 0.2j) / (1 - 0.3 * t), solve_riemann(g, right)
        wanted = np.multiply.outer(x * np.polyval(p[::-1], t), scales)
        np.testing.assert_allclose(found.plus - plain.plus, wanted, atol=1e-12)


def test_conditions_are_the_moments_by_adaptive_quadrature():
    t = circle(512)
    right = np.exp(0.3 * t) / (t - 1.6) + 1 / (t - 0.4) + 0.5 * t.real
    found = solve_riemann(example(t, -3), right)
    assert not found.solvable
    with mpmath.workdps(20):
        for j, got in enumerate(found.conditions, start=1):

            def density(angle, j=j):
                z = mpmath.expj(angle)
                g = mpmath.exp(0.3 * z) / (z - 1.6) + 1 / (z - 0.4) + 0.5 * mpmath.cos(angle)
                x = mpmath.exp(0.4 * z + 0.2j) / (1 - 0.3 * z)
                return g / x * z**j / (2 * mpmath.pi)

            wanted = complex(mpmath.quad(density, mpmath.linspace(0, 2 * mpmath.pi, 9)))
            assert got == pytest.approx(wanted, abs=1e-14)


@pytest.mark.parametrize("finite", [False, True])
def test_a_rational_problem_is_solved_exactly(finite):
    """G = t², g = 1/(t - 1/2) + 1/(t - 2): Phi+ = 1/(t - 2) + P, Phi- = (P - 1/(t - 1/2)) / t²."""
    t, p = circle(128), [2.0, -1.0, 3.0][: 2 + finite]
    side = "finite" if finite else "zero"
    found = solve_riemann(t**2, 1 / (t - 0.5) + 1 / (t - 2), p, at_infinity=side)
    assert found.constants == 2 + finite
    z = np.array([0.2 - 0.3j])
    np.testing.assert_allclose(found.inside(z), 1 / (z - 2) + np.polyval(p[::-1], z), atol=1e-14)
    z = np.array([1.5 + 1j])
    wanted = (np.polyval(p[::-1], z) - 1 / (z - 0.5)) / z**2
    np.testing.assert_allclose(found.outside(z), wanted, atol=1e-14)
    common = solve_riemann(t**2, np.zeros((128, 2)), p, at_infinity=side)
    np.testing.assert_allclose(common.plus[:, 1], np.polyval(p[::-1], t), atol=1e-13)


def test_a_pole_at_infinity_is_measured_for_each_right_side():
    """G = t^-2: Phi- = -t² g; 3 / t³ fits, .5 / t leaves a pole, however small."""
    t = circle(32)
    found = solve_riemann(t**-2.0, np.stack([3 / t**3, 1e-9 * (3 / t**3 + 0.5 / t)], axis=1))
    np.testing.assert_allclose(found.conditions, [[0, 0.5e-9], [0, 0]], atol=1e-15)
    assert (found.index, found.constants, found.solvable) == (-2, 0, False)
    assert found.defect == pytest.approx(0.5 / 3.5, rel=1e-12)
    np.testing.assert_allclose(found.minus[:, 1] * 1e9, -3 / t - 0.5 * t, atol=1e-13)
    finite = solve_riemann(t**-2.0, 3 / t**3 + 0.5 / t**2, at_infinity="finite")
    assert (len(finite.conditions), finite.solvable, finite.defect <= 1e-15) == (1, True, True)
    assert solve_riemann(1 / t, 3 / t**2 + 2e-9 / t).solvable
    assert not solve_riemann(1 / t, 3 / t**2 + 4e-9 / t).solvable


@pytest.mark.parametrize("nodes", [8, 16])
def test_frequencies_off_the_circle_are_power_series(nodes):
    rng = np.random.default_rng(3)
    modes = rng.standard_normal((nodes, 2)) + 1j * rng.standard_normal((nodes, 2))
    found = quietly(np.ones(nodes), np.fft.ifft(modes, axis=0) * nodes)
    inner, outer = np.array([0.7 - 0.6j, 0.1j]), np.array([1.2 + 0.3j, -2.0])
    plus = sum(modes[k] * inner[:, None] ** k for k in range(nodes // 2))
    minus = -sum(modes[-k] * outer[:, None] ** -k for k in range(1, nodes // 2))
    np.testing.assert_allclose(found.inside(inner), plus, rtol=1e-13)
    np.testing.assert_allclose(found.outside(outer), minus, rtol=1e-13)
    np.testing.assert_allclose(found.inside(0.1j), plus[1:], rtol=1e-13)


@pytest.mark.parametrize(("mode", "seen"), [(29, False), (30, True), (34, True), (35, False)])
def test_the_tail_is_the_largest_of_the_last_sixteenth(mode, seen):
    """Of the right side relative to the largest; of the logarithm of G absolute below one."""
    t = circle(64)
    found = quietly(np.ones(64), 5.0 + 2e-3 * t**mode)
    assert found.tail == pytest.approx(4e-4 if seen else 0.0, abs=1e-15)
    found = quietly(np.exp(0.5 + 2e-5 * t**mode), np.ones(64))
    assert found.tail == pytest.approx(2e-5 if seen else 0.0, abs=3e-10)


def known(t):
    g = np.exp(0.4 * t) * (1 - 0.5 / t) / (1 - 0.3 * t)
    return g, 1 / (t - 1 / 0.7) - g / (t - 0.6)


def test_errors_fall_geometrically_and_callables_are_sampled_until_resolved():
    errors = []
    for nodes in (16, 32, 64, 128):
        found = quietly(*known(circle(nodes)))
        errors.append(np.abs(found.plus - 1 / (circle(nodes) - 1 / 0.7)).max())
    assert errors == pytest.approx([7.2e-2, 5.1e-3, 1.8e-5, 2.0e-10], rel=0.03)
    found = solve_riemann(lambda t: known(t)[0], lambda t: known(t)[1])
    assert found.tail <= 1e-14
    np.testing.assert_allclose(found.plus, 1 / (circle(len(found.plus)) - 1 / 0.7), atol=1e-14)
    with pytest.warns(UserWarning, match="more nodes"):
        coarse = solve_riemann(lambda t: known(t)[0], lambda t: known(t)[1], nodes=16)
    assert len(coarse.plus) == 16
    assert len(solve_riemann(lambda t: t**100, lambda t: t).plus) == 256  # nodes for the index
    noisy = solve_riemann(
        lambda t: np.exp(0.5 * t),
        lambda t: 1 / (t - 1.3) + 1e-12 * np.sin(1e7 * np.angle(t) ** 2),
    )
    assert len(noisy.plus) == 512  # a tail that has stopped falling will not fall further
    assert 1e-14 < noisy.tail < 1e-11


def test_turns_of_a_phase_are_counted_up_to_nine_tenths_of_half_a_turn():
    for turns in (-8, 8):
        assert winding(circle(18) ** turns) == turns
    assert winding(np.r_[2e-12, np.ones(20)]) == 0
    large = solve_riemann(np.exp(2j * 690 * circle(4096).imag), np.zeros(4096))
    assert (large.index, large.plus.any()) == (0, False)
    moderate = np.exp(2j * 5 * circle(512).imag)  # the phase turns forth and back
    plus = np.exp(0.5 * circle(512))
    np.testing.assert_allclose(solve_riemann(moderate, plus).plus, plus, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_rotated_arguments_split_into_scalar_problems(count):
    t = circle(256 * count)
    s = t**count
    g = np.array([3 * s * np.exp(0.2 * s), 0.5 + 0.2 / s, 0.3 * s + 0.1j])[:count]
    right = 1 / (t - 2) + np.exp(0.2 / t) + 0.3 * t**2
    plain = solve_rotations(g, right)[0]
    for constants in (None, [[1.0], [2j], [-0.5]][:count]):
        plus, minus, problems = solve_rotations(g, right, constants)
        turned = sum(g[j] * np.roll(minus, -256 * j) for j in range(count))
        np.testing.assert_allclose(plus, turned + right, atol=1e-12)
        assert np.abs(frequencies(plus)[128 * count :]).max() <= 1e-13
        assert np.abs(frequencies(minus)[: 128 * count]).max() <= 1e-13
        assert [(p.constants, p.index) for p in problems] == [(1, 1)] * count
        assert (np.abs(plus - plain).max() > 0.1) == (constants is not None)
