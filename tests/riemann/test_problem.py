"""The Riemann problem on the circle, against solutions that are known in closed form."""

import warnings

import mpmath
import numpy as np
import pytest

from seedslib.riemann import circle, solve_riemann, winding


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
    np.testing.assert_allclose(found.plus, 1 / (t - 2) + np.polyval(p[::-1], t), atol=2e-14)
    wanted = (np.polyval(p[::-1], t) - 1 / (t - 0.5)) / t**2
    np.testing.assert_allclose(found.minus, wanted, atol=2e-14)
    common = solve_riemann(t**2, np.zeros((128, 2)), p, at_infinity=side)
    np.testing.assert_allclose(common.plus[:, 1], np.polyval(p[::-1], t), atol=1e-13)


def test_a_pole_at_infinity_is_measured_for_each_right_side():
    """G = t^-2: Phi- = -t² g; 3 / t³ fits, .5 / t leaves a pole, however small."""
    t = circle(32)
    found = solve_riemann(t**-2.0, np.stack([3 / t**3, 1e-9 * (3 / t**3 + 0.5 / t)], axis=1))
    np.testing.assert_allclose(found.conditions, [[0, 0.5e-9], [0, 0]], atol=1e-15)
    assert (found.index, found.constants, found.solvable) == (-2, 0, False)
    np.testing.assert_allclose(found.minus[:, 1] * 1e9, -3 / t - 0.5 * t, atol=1e-13)
    finite = solve_riemann(t**-2.0, 3 / t**3 + 0.5 / t**2, at_infinity="finite")
    assert (len(finite.conditions), finite.solvable) == (1, True)
    assert solve_riemann(1 / t, 3 / t**2 + 2e-9 / t).solvable
    assert not solve_riemann(1 / t, 3 / t**2 + 4e-9 / t).solvable


@pytest.mark.parametrize("nodes", [8, 16])
def test_each_side_takes_its_own_frequencies(nodes):
    rng = np.random.default_rng(3)
    modes = rng.standard_normal((nodes, 2)) + 1j * rng.standard_normal((nodes, 2))
    found = quietly(np.ones(nodes), np.fft.ifft(modes, axis=0) * nodes)
    np.testing.assert_allclose(frequencies(found.plus)[: nodes // 2], modes[: nodes // 2])
    np.testing.assert_allclose(frequencies(found.minus)[nodes // 2 :], -modes[nodes // 2 :])


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


def test_errors_fall_geometrically():
    errors = []
    for nodes in (16, 32, 64, 128):
        found = quietly(*known(circle(nodes)))
        errors.append(np.abs(found.plus - 1 / (circle(nodes) - 1 / 0.7)).max())
    assert errors == pytest.approx([7.2e-2, 5.1e-3, 1.8e-5, 2.0e-10], rel=0.03)
    with pytest.warns(UserWarning, match="more nodes"):
        solve_riemann(*known(circle(16)))


def test_turns_of_a_phase_are_counted_up_to_nine_tenths_of_half_a_turn():
    for turns in (-8, 8):
        assert winding(circle(18) ** turns) == turns
    assert winding(np.r_[2e-12, np.ones(20)]) == 0
    large = solve_riemann(np.exp(2j * 690 * circle(4096).imag), np.zeros(4096))
    assert (large.index, large.plus.any()) == (0, False)
    moderate = np.exp(2j * 5 * circle(512).imag)  # the phase turns forth and back
    plus = np.exp(0.5 * circle(512))
    np.testing.assert_allclose(solve_riemann(moderate, plus).plus, plus, atol=1e-9)
