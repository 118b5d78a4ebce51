import warnings

import mpmath
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from seedslib.riemann import circle, solve_riemann, solve_rotations, wiener_gain, winding

TURN = np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
LATE = np.array([[0.1, 0.3], [-0.2, 0.1]])


def example(t, index):
    return t**index * np.exp(0.4 * t - 0.3 / t + 0.2j) * (1 - 0.5 / t) / (1 - 0.3 * t)


def frequencies(values):
    return np.fft.fft(values, axis=0) / len(values)


@pytest.mark.parametrize("index", range(-3, 4))
def test_index_residual_and_analyticity(index):
    t = circle(512)
    g, right = example(t, index), np.exp(0.3 * t) / (t - 1.6) + 1 / (t - 0.4) + 0.5 * t.real
    found = solve_riemann(g, right)
    assert found.index == index == winding(g)
    assert found.constants == max(index, 0)
    assert found.conditions.shape == (max(-index, 0),)
    np.testing.assert_allclose(found.plus, g * found.minus + right, atol=2e-14)
    assert found.residual <= 1e-14
    plus, minus = frequencies(found.plus), frequencies(found.minus)
    if index >= 0:
        assert found.solvable
        assert np.abs(plus[256:]).max() <= 1e-14
        assert np.abs(minus[:256]).max() <= 1e-14
        assert found.defect <= 1e-14
    else:
        assert not found.solvable
        assert np.abs(found.conditions) == pytest.approx(
            [0.99989, 0.29995, 0.11998][:-index], abs=5e-6
        )
        assert np.abs(minus[:256]).max() > 0.1  # the pole at infinity


@pytest.mark.parametrize("index", range(-3, 1))
def test_recovery_of_a_known_solution(index):
    t = circle(512)
    plus, minus = np.exp(0.5 * t), 1 / (t - 0.3)
    found = solve_riemann(example(t, index), plus - example(t, index) * minus)
    np.testing.assert_allclose(found.plus, plus, atol=1e-14)
    np.testing.assert_allclose(found.minus, minus, atol=1e-14)
    assert found.solvable
    assert np.abs(found.conditions).max(initial=0.0) <= 1e-14
    inner, outer = np.array([0.3 + 0.2j, -0.9, 0.0]), np.array([2j, -1.1 + 0.1j])
    np.testing.assert_allclose(found.inside(inner), np.exp(0.5 * inner), atol=1e-14)
    np.testing.assert_allclose(found.outside(outer), 1 / (outer - 0.3), atol=1e-13)


def test_conditions_are_the_moments_by_adaptive_quadrature():
    # c_{-j} = 1/(2 pi i) times the integral of g / X+ t^{j-1}, X+ known in closed form:
    # log G without t^kappa is analytic inside for .4 t - log(1 - .3 t) + .2i
    t = circle(512)
    right = np.exp(0.3 * t) / (t - 1.6) + 1 / (t - 0.4) + 0.5 * t.real
    found = solve_riemann(example(t, -3), right)
    with mpmath.workdps(25):
        for j, got in enumerate(found.conditions, start=1):

            def density(angle, j=j):
                z = mpmath.expj(angle)
                g = mpmath.exp(0.3 * z) / (z - 1.6) + 1 / (z - 0.4) + 0.5 * mpmath.cos(angle)
                x = mpmath.exp(0.4 * z + 0.2j) / (1 - 0.3 * z)
                return g / x * z**j / (2 * mpmath.pi)

            wanted = complex(mpmath.quad(density, mpmath.linspace(0, 2 * mpmath.pi, 9)))
            assert got == pytest.approx(wanted, abs=1e-14)


@pytest.mark.parametrize("index", [-1, 0, 2])
def test_finite_at_infinity(index):
    t = circle(768)
    g = t**index * np.exp(0.4 * t - 0.3 / t + 0.2j)
    right = np.exp(0.3 * t) / (t - 1.6) + 1 / (t - 0.4)
    constants = [1.0, 2.0, 3.0][: index + 1]
    found = solve_riemann(g, right, constants, at_infinity="finite")
    assert (found.index, found.constants, found.solvable) == (index, index + 1, True)
    assert found.conditions.shape == (0,)
    np.testing.assert_allclose(found.plus, g * found.minus + right, atol=2e-14)
    assert np.abs(frequencies(found.plus)[384:]).max() <= 1e-14
    assert np.abs(frequencies(found.minus)[1:384]).max() <= 1e-14


@pytest.mark.parametrize("finite", [False, True])
def test_rational_problem_solved_exactly(finite):
    # G = t^2, g = 1/(t - 1/2) + 1/(t - 2): X+ = 1, X- = t^-2, so Phi+ = 1/(t - 2) + P and
    # Phi- = t^-2 (P - 1/(t - 1/2))
    t = circle(128)
    p = [2.0, -1.0, 3.0][: 2 + finite]
    found = solve_riemann(
        t**2, 1 / (t - 0.5) + 1 / (t - 2), p, at_infinity="finite" if finite else "zero"
    )
    z = np.array([0.2 - 0.3j])
    np.testing.assert_allclose(found.inside(z), 1 / (z - 2) + np.polyval(p[::-1], z), atol=1e-14)
    z = np.array([1.5 + 1j])
    np.testing.assert_allclose(
        found.outside(z), (np.polyval(p[::-1], z) - 1 / (z - 0.5)) / z**2, atol=1e-14
    )


def test_free_constants_span_the_homogeneous_solutions():
    t = circle(256)
    g, right = example(t, 2), 1 / (t - 3)
    plain = solve_riemann(g, right)
    for p in ([1.0, 0.0], [0.0, 1.0]):
        moved = solve_riemann(g, right, p)
        homogeneous = moved.plus - plain.plus
        np.testing.assert_allclose(homogeneous, g * (moved.minus - plain.minus), atol=1e-13)
        assert np.abs(homogeneous).max() > 0.1
        assert np.abs(frequencies(homogeneous)[128:]).max() <= 1e-14


def test_several_right_sides_at_once():
    t = circle(256)
    right = np.stack([1 / (t - 0.4), np.exp(t), 1 / (t - 2)], axis=1)
    together = solve_riemann(example(t, 1), right, [[1.0, 2.0, 3.0]])
    for j in range(3):
        alone = solve_riemann(example(t, 1), right[:, j], [j + 1.0])
        np.testing.assert_allclose(together.plus[:, j], alone.plus, atol=1e-14)
        np.testing.assert_allclose(together.minus[:, j], alone.minus, atol=1e-14)
    points = np.array([0.1, 0.5j])
    assert together.inside(points).shape == (2, 3)


def known(t):
    g = np.exp(0.4 * t) * (1 - 0.5 / t) / (1 - 0.3 * t)
    return g, 1 / (t - 1 / 0.7) - g / (t - 0.6)


def test_geometric_convergence():
    errors = []
    for nodes in (16, 32, 64, 128, 256):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            found = solve_riemann(*known(circle(nodes)))
        errors.append(np.abs(found.plus - 1 / (circle(nodes) - 1 / 0.7)).max())
    assert errors[:4] == pytest.approx([7.2e-2, 5.1e-3, 1.8e-5, 2.0e-10], rel=0.03)
    assert errors[4] <= 1e-14
    # the nearest singularity is at 0.7 or 1 / 0.7: an error of about .7^(M/2)
    assert np.log(errors[3] / errors[2]) / 32 == pytest.approx(np.log(0.7), rel=0.05)


def test_callables_are_sampled_until_resolved():
    found = solve_riemann(lambda t: known(t)[0], lambda t: known(t)[1])
    assert found.tail <= 1e-14
    np.testing.assert_allclose(found.plus, 1 / (circle(len(found.plus)) - 1 / 0.7), atol=1e-14)
    close = solve_riemann(lambda t: (1 - 0.999 / t) * t**3, lambda t: 1 / (t - 2))
    assert (close.index, len(close.plus) >= 16384) == (3, True)
    with pytest.warns(UserWarning, match="more nodes"):
        coarse = solve_riemann(lambda t: known(t)[0], lambda t: known(t)[1], nodes=16)
    assert len(coarse.plus) == 16


def test_data_that_are_not_analytic_warn():
    t = circle(4096)
    with pytest.warns(UserWarning, match="Fourier"):
        found = solve_riemann(np.exp(np.abs(t.real)), np.abs(t.imag))
    assert found.residual <= 1e-13


Z = circle(16)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: solve_riemann(np.ones(4), np.ones(4)), ValueError, "coefficient.*M >= 8"),
        (lambda: solve_riemann(np.ones((16, 2)), np.ones(16)), ValueError, "coefficient"),
        (lambda: solve_riemann(np.ones(16), np.ones(8)), ValueError, "right.*16 nodes"),
        (lambda: solve_riemann(Z * np.nan, Z), ValueError, "coefficient.*finite"),
        (lambda: solve_riemann(Z - 1, Z), ValueError, "no zero on the circle"),
        (lambda: solve_riemann(Z**8, Z), ValueError, "phase"),
        (lambda: solve_riemann(Z, Z, [1.0, 2.0]), ValueError, "polynomial: wanted 1"),
        (lambda: solve_riemann(1 / Z, Z, [1.0]), ValueError, "polynomial: wanted 0"),
        (lambda: solve_riemann(Z, Z, at_infinity="pole"), ValueError, "at_infinity"),
        (lambda: solve_riemann(Z, Z, nodes=16), ValueError, "nodes"),
        (lambda: solve_riemann(Z, lambda t: t), TypeError, "right"),
        (lambda: solve_riemann("G", Z), TypeError, "coefficient"),
        (lambda: solve_riemann(lambda t: t - 1, lambda t: t), ValueError, "zero on the circle"),
        (lambda: solve_riemann(Z, 1 / (Z - 0.01)).inside(2.0), ValueError, "z: wanted"),
        (lambda: solve_riemann(1 / Z, 1 / (Z - 0.01)).outside(2.0), ValueError, "solvable"),
        (lambda: solve_rotations(np.ones((3, 32)), np.ones(32)), ValueError, "multiple of p"),
        (lambda: solve_rotations(np.ones((2, 16)), np.ones(8)), ValueError, "right"),
        (lambda: solve_rotations([Z, Z], Z), ValueError, "functions of t"),
        (lambda: solve_rotations([Z**2, 0 * Z], Z, [[1.0]]), ValueError, "polynomials"),
        (lambda: solve_rotations(Z, Z), ValueError, "coefficients"),
    ],
)
def test_bad_input_is_named(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_three_problems_by_rotation():
    t = circle(768)
    s = t**3
    g = np.array([3 * s * np.exp(0.2 * s), 0.5 + 0.2 / s, 0.3 * s + 0.1j])
    right = 1 / (t - 2) + np.exp(0.2 / t) + 0.3 * t**2
    for constants in (None, [[1.0], [2j], [-0.5]]):
        plus, minus, problems = solve_rotations(g, right, constants)
        residual = plus - right - sum(g[j] * np.roll(minus, -256 * j) for j in range(3))
        assert np.abs(residual).max() <= 1e-13
        assert np.abs(frequencies(plus)[384:]).max() <= 1e-14
        assert np.abs(frequencies(minus)[:384]).max() <= 1e-14
        assert [problem.constants for problem in problems] == [1, 1, 1]
        assert [3 * problem.index for problem in problems] == [3, 3, 3]  # in the variable t


def test_one_rotation_is_the_scalar_problem():
    t = circle(128)
    plus, minus, _ = solve_rotations(example(t, 0)[None], 1 / (t - 3))
    found = solve_riemann(example(t, 0), 1 / (t - 3))
    np.testing.assert_allclose([plus, minus], [found.plus, found.minus], atol=1e-14)


def riccati(a, c, w, r):
    """Augmented system and its steady Kalman filter: F, gain (N+1, n), variance, covariance."""
    last, n = len(a) - 1, a.shape[1]
    f, h, q = np.eye((last + 1) * n, k=-n), np.zeros((1, (last + 1) * n)), np.zeros((n, n))
    f[:n] = np.concatenate(a, axis=1)
    h[0, :n], q = c, np.zeros_like(f)
    q[:n, :n] = w
    p = solve_discrete_are(f.T, h.T, q, [[r]])
    s = (h @ p @ h.T).item() + r
    k = p @ h.T / s
    return f, h, k, s, p - s * k @ k.T


def test_wiener_is_kalman_autoregression():
    found = wiener_gain([[0.8]], [1.0], [[1.0]], 1.0)
    # Pi = .64 Pi / (Pi + 1) + 1 exactly
    p = float((mpmath.mpf("0.64") + mpmath.sqrt(mpmath.mpf("0.64") ** 2 + 4)) / 2)
    assert found.innovation == pytest.approx(p + 1, abs=2e-15)
    assert found.gain[0] == pytest.approx(p / (p + 1), abs=1e-15)
    assert found.cov[0, 0] == pytest.approx(p / (p + 1), abs=2e-15)  # R = 1: P = K
    assert (found.gain[0], found.innovation) == pytest.approx(
        (0.5780505936, 2.369952380), abs=5e-10
    )
    lags = np.arange(60)
    gain = p / (p + 1)
    np.testing.assert_allclose(
        found.impulse[:60, 0], (0.8 * (1 - gain)) ** lags * gain, rtol=0, atol=1e-15
    )


def test_wiener_is_kalman_second_order():
    f, w, c = np.array([[0.7, 0.5], [-0.4, 0.6]]), np.diag([0.0, 1.0]), np.array([1.0, 0.0])
    found = wiener_gain(f, c, w, 0.5, nodes=512)
    _, h, k, s, cov = riccati(f[None], c, w, 0.5)
    assert found.innovation == pytest.approx(s, abs=1e-14)
    np.testing.assert_allclose(found.gain, k[:, 0], atol=1e-14)
    np.testing.assert_allclose(found.cov, cov, atol=1e-14)
    closed, power = (np.eye(2) - k @ h) @ f, np.eye(2)
    for j in range(60):
        np.testing.assert_allclose(found.impulse[j], (power @ k)[:, 0], atol=2e-15)
        power = closed @ power


def test_wiener_beats_every_shorter_window():
    # the causal estimate from the last J measurements, by regression on exact covariances
    a, r = 0.8, 1.0
    variance = 1 / (1 - a**2)
    errors = []
    for window in (1, 2, 5, 20):
        lag = np.arange(window)
        cov = variance * a ** np.abs(lag[:, None] - lag) + r * np.eye(window)
        cross = variance * a**lag
        errors.append(variance - cross @ np.linalg.solve(cov, cross))
    found = wiener_gain([[a]], [1.0], [[1.0]], r)
    assert (np.diff(errors) < 0).all()
    assert errors[-1] == pytest.approx(found.cov[0, 0], abs=1e-12)


def delayed(radius, last):
    a = np.zeros((last + 1, 2, 2))
    a[0] = radius * TURN
    a[last] += LATE
    return a


@pytest.mark.parametrize(("last", "nodes"), [(1, 1024), (3, 1024), (10, 4096), (30, 8192)])
def test_delay_gains_against_riccati(last, nodes):
    a = delayed(0.6, last)
    c, w = np.array([1.0, 0.0]), np.diag([0.0, 1.0])
    _, _, k, s, cov = riccati(a, c, w, 1.0)
    for found in (wiener_gain(a, c, w, 1.0), wiener_gain(a, c, w, 1.0, nodes=nodes)):
        np.testing.assert_allclose(found.lag_gains, k.reshape(-1, 2), atol=2e-14)
        np.testing.assert_allclose(found.cov, cov[:2, :2], atol=2e-14)
        assert found.innovation == pytest.approx(s, abs=2e-14)
        np.testing.assert_array_equal(found.gain, found.lag_gains[0])
        np.testing.assert_allclose(found.impulse[0], found.gain, atol=1e-14)


def chandrasekhar(a, steps):
    """Gain after `steps` steps from a zero initial covariance, by the fast recursion.

    With a zero start the increment of the covariance has rank one: ``Y = (w, 0, ...)``, here for
    noise in the second component of variance 1, measurement of the first, R = 1.
    """
    last = len(a) - 1
    y, m = np.zeros((2 * (last + 1), 1)), np.array([[1.0]])
    y[1] = 1.0
    gain, s = np.zeros((2 * (last + 1), 1)), 1.0
    for _ in range(steps):
        eta = y[:1]  # P(k+1|k) - P(k|k-1) = Y M Y'
        moved = s + (eta @ m @ eta.T).item()
        following = (gain * s + y @ m @ eta.T) / moved
        shifted = np.zeros_like(y)
        carried = y - gain @ eta
        shifted[:2] = sum(a[d] @ carried[2 * d : 2 * d + 2] for d in (0, last))
        shifted[2:] = carried[:-2]
        y, m = shifted, m - m @ eta.T @ eta @ m / moved
        gain, s = following, moved
    return gain.reshape(-1, 2), s


def test_chandrasekhar_oracle_against_the_plain_recursion():
    a = delayed(0.6, 3)
    f, h, *_ = riccati(a, [1.0, 0.0], np.diag([0.0, 1.0]), 1.0)
    p, q = np.zeros((8, 8)), np.zeros((8, 8))
    q[1, 1] = 1.0
    for step in range(1, 30):
        p = f @ p @ f.T + q
        s = (h @ p @ h.T).item() + 1
        gain, variance = chandrasekhar(a, step)
        np.testing.assert_allclose(gain, (p @ h.T / s).reshape(-1, 2), atol=1e-14)
        assert variance == pytest.approx(s, abs=1e-14)
        p = p - p @ h.T @ h @ p / s


def test_long_delays_against_the_fast_recursion():
    c, w = [1.0, 0.0], np.diag([0.0, 1.0])
    found = wiener_gain(delayed(0.6, 100), c, w, 1.0, nodes=32768)
    gain, s = chandrasekhar(delayed(0.6, 100), 3000)
    np.testing.assert_allclose(found.lag_gains, gain, atol=2e-14)
    assert found.innovation == pytest.approx(s, abs=2e-14)


def test_very_long_delay_where_the_recursion_is_still_on_its_way():
    found = wiener_gain(delayed(0.6, 400), [1.0, 0.0], np.diag([0.0, 1.0]), 1.0, nodes=131072)
    after = [np.abs(chandrasekhar(delayed(0.6, 400), n)[0] - found.lag_gains).max()
             for n in (3000, 6000, 12000)]  # fmt: skip
    assert 1e-9 < after[0] < 1e-6
    assert after[1] < after[0] / 100
    assert after[2] <= 2e-14


@pytest.mark.parametrize("seed", range(12))
def test_stability_is_read_off_the_index(seed):
    rng = np.random.default_rng(seed)
    n, last = int(rng.integers(1, 4)), int(rng.integers(0, 5))
    a = rng.standard_normal((last + 1, n, n)) * rng.uniform(0.1, 0.6)
    c, w = rng.standard_normal(n), np.eye(n)
    f, _, k, _, cov = riccati(a, c, w, 1.0)
    outside = int((np.abs(np.linalg.eigvals(f)) > 1).sum())
    if outside:
        with pytest.raises(ValueError, match=rf"transition.*unit circle: {outside}\)"):
            wiener_gain(a, c, w, 1.0)
    else:
        found = wiener_gain(a, c, w, 1.0)
        np.testing.assert_allclose(found.lag_gains, k.reshape(-1, n), atol=1e-11)
        np.testing.assert_allclose(found.cov, cov[:n, :n], atol=1e-11)


def test_unstable_plants_are_refused_although_the_formulas_would_answer():
    # formally for F = 1.2: the mean of log S_y gives 2.0502, the innovation variance is 1.44 times
    t = circle(512)
    spectrum = 1 / np.abs(1 - 1.2 * t) ** 2 + 1
    formal = np.exp(np.log(spectrum).mean())
    p = float((mpmath.mpf("1.44") + mpmath.sqrt(mpmath.mpf("1.44") ** 2 + 4)) / 2)
    assert formal == pytest.approx(2.05016232, abs=5e-9)
    assert formal * 1.44 == pytest.approx(p + 1, abs=1e-13)
    assert p + 1 == pytest.approx(2.95223374, abs=5e-9)
    with pytest.raises(ValueError, match="transition: wanted a stable system"):
        wiener_gain([[1.2]], [1.0], [[1.0]], 1.0)
    with pytest.raises(ValueError, match="transition: wanted a stable system"):
        wiener_gain(delayed(0.8, 3), [1.0, 0.0], np.diag([0.0, 1.0]), 1.0)
    # an unstable mode that is neither driven nor seen leaves no trace in the spectra
    with pytest.raises(ValueError, match="transition: wanted a stable system"):
        wiener_gain(np.diag([0.5, 1.1]), [1.0, 0.0], np.diag([1.0, 0.0]), 1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transition": [[1.0]]}, "transition.*on the unit circle"),
        ({"transition": [[0.9999]], "nodes": 1024}, "nodes: wanted the spectra resolved"),
        ({"transition": [0.8]}, "transition"),
        ({"transition": [[0.8, 0.1]]}, "transition"),
        ({"sensor": [1.0, 0.0]}, "sensor"),
        ({"sensor": [[1.0], [1.0]]}, "sensor: wanted one measurement"),
        ({"state_noise": [[-1.0]]}, "state_noise"),
        ({"sensor_noise": 0.0}, "sensor_noise"),
        ({"lags": -1}, "lags"),
        ({"nodes": 2}, "nodes: wanted at least 8"),
    ],
)
def test_bad_filters_are_named(change, message):
    good = {"transition": [[0.8]], "sensor": [1.0], "state_noise": [[1.0]], "sensor_noise": 1.0}
    with pytest.raises(ValueError, match=message):
        wiener_gain(**{**good, **change})


def test_lightly_damped_systems_take_the_nodes_they_need():
    f = 0.9995 * np.array([[np.cos(0.01), np.sin(0.01)], [-np.sin(0.01), np.cos(0.01)]])
    found = wiener_gain(f, [1.0, 0.0], np.diag([0.0, 1.0]), 1.0)
    _, _, k, s, _ = riccati(f[None], [1.0, 0.0], np.diag([0.0, 1.0]), 1.0)
    assert found.nodes >= 2**15
    np.testing.assert_allclose(found.gain, k[:, 0], atol=1e-11)
    assert found.innovation == pytest.approx(s, rel=1e-11)
    with pytest.raises(TypeError, match="nodes"):
        wiener_gain(f, [1.0, 0.0], np.eye(2), 1.0, nodes=1e3)


def test_singular_noise_and_smoothing_lags():
    # no noise at all: the stationary state is zero, and so is the gain
    still = wiener_gain([[0.5]], [1.0], [[0.0]], 1.0)
    np.testing.assert_allclose([still.gain[0], still.cov[0, 0]], 0.0, atol=1e-15)
    # fixed-lag smoothing gains of an autoregression by augmentation
    found = wiener_gain([[0.8]], [1.0], [[1.0]], 1.0, lags=6)
    a = np.zeros((7, 1, 1))
    a[0] = 0.8
    np.testing.assert_allclose(found.lag_gains, riccati(a, [1.0], [[1.0]], 1.0)[2], atol=1e-14)


@pytest.mark.parametrize("index", [64, 100, -100, 128])
def test_index_beyond_the_first_nodes_is_not_aliased(index):
    found = solve_riemann(lambda t: t**index, lambda t: 1 / (t - 2))
    assert found.index == index
    with pytest.raises(ValueError, match="coefficient"):
        solve_riemann(lambda t: t**index, lambda t: 1 / (t - 2), nodes=32)


@pytest.mark.parametrize(("size", "message"), [(50, "residual"), (800, "below 700")])
def test_lost_digits_are_refused(size, message):
    with pytest.raises(ValueError, match=f"coefficient.*{message}"):
        solve_riemann(lambda t: np.exp(size * (t - 1 / t)), lambda t: 1 / (t - 2))


def test_each_right_side_is_judged_by_itself():
    t = circle(64)
    found = solve_riemann(1 / t, np.stack([1e12 + 0 * t, 1 / t], axis=1))
    assert not found.solvable
    with pytest.raises(ValueError, match="right"):
        solve_riemann(t, np.zeros((64, 0)))


def test_rotated_problems_warn_and_name_what_they_refuse():
    t = circle(48)
    jump = np.where((t**3).imag > 0, 0.5, 0.2)
    with pytest.warns(UserWarning, match="last Fourier coefficients"):
        solve_rotations(np.stack([2 + 0 * t, jump, 0 * t]), 1 / (t - 2))
    with pytest.raises(ValueError, match="coefficients"):
        solve_rotations(np.zeros((0, 0)), [])
    with pytest.raises(TypeError, match="polynomials"):
        solve_rotations(t[None], 1 / (t - 2), 5)


@pytest.mark.parametrize("noise", [1e-20, 1e-12, 1.0])
def test_small_error_beside_a_large_signal_keeps_its_digits(noise):
    f = 0.999
    found = wiener_gain([[f]], [1.0], [[1.0]], noise)
    with mpmath.workdps(60):
        r, a = mpmath.mpf(noise), mpmath.mpf(f)
        half = (1 - r + a**2 * r) / 2
        predicted = half + mpmath.sqrt(half**2 + r)
        exact = float(predicted * r / (predicted + r))
    assert found.cov[0, 0] == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sensor_noise": [1.0, 2.0]}, "sensor_noise: wanted one number"),
        ({"lags": 10**8}, "lags"),
        ({"sensor": [1e160]}, "state_noise, sensor"),
        ({"transition": 1.001 * np.eye(3), "sensor": [1.0, 1, 1], "state_noise": np.eye(3)}, "3"),
    ],
)
def test_filters_out_of_range_are_named(change, message):
    good = {"transition": [[0.8]], "sensor": [1.0], "state_noise": [[1.0]], "sensor_noise": 1.0}
    with pytest.raises(ValueError, match=message):
        wiener_gain(**{**good, **change})
