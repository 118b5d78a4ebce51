import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from seedslib.models.propagation import distinct_steps, van_loan
from seedslib.two_step import LinearDiffusion

F = np.array([[0.0, 1.0], [-2.0, -0.3]])
G = np.array([[0.0], [1.5]])
H = np.array([[1.0, 0.5]])


def planar(**changes):
    known = {
        "drift": F,
        "noise_intensity": [[0.4]],
        "sensor": H,
        "sensor_intensity": [[0.2]],
        "mean0": [1.0, -1.0],
        "cov0": [[0.5, 0.1], [0.1, 0.3]],
        "noise_input": G,
    }
    return LinearDiffusion(**{**known, **changes})


def by_quadrature(system, step, nodes=60):
    """Noise covariance as the integral of exp(sF) GQG' exp(sF)'."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    known = system.matrices(0.0)
    moves = expm(0.5 * step * (1 + x)[:, None, None] * known.drift)
    return 0.5 * step * np.einsum("k,kij,jl,kml->im", w, moves, known.diffusion, moves)


@pytest.mark.parametrize("step", [1e-4, 0.3, 4.0])
def test_transition_against_quadrature(step):
    move, noise = planar().transition(0.2, 0.2 + step)
    np.testing.assert_allclose(move, expm(step * F), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(noise, by_quadrature(planar(), step), rtol=1e-11, atol=1e-20)


def test_a_very_long_step_of_a_stable_system_reaches_the_stationary_law():
    move, noise = van_loan(np.array([[-3.0]]), np.array([[2.0]]), 1e4)
    assert move[0, 0] == 0.0
    assert noise[0, 0] == pytest.approx(1 / 3, rel=1e-14)


def test_transition_with_time_varying_coefficients():
    system = planar(
        drift=lambda t: F * (1 + 0.5 * np.sin(t)), noise_intensity=lambda t: [[0.4 + t]]
    )

    def slope(t, y):
        drift = F * (1 + 0.5 * np.sin(t))
        move, noise = y.reshape(2, 2, 2)
        drive = (0.4 + t) * G @ G.T
        return np.stack([drift @ move, drift @ noise + noise @ drift.T + drive]).ravel()

    start = np.stack([np.eye(2), np.zeros((2, 2))]).ravel()
    exact = solve_ivp(slope, (0.5, 2.0), start, method="Radau", rtol=1e-11, atol=1e-13).y[:, -1]
    move, noise = system.transition(0.5, 2.0)
    np.testing.assert_allclose(np.stack([move, noise]).ravel(), exact, rtol=1e-8, atol=1e-10)


def test_constant_functions_of_time_agree_with_constants():
    varying = planar(sensor=lambda t: H, drift=lambda t: F)
    assert not varying.constant
    for ours, exact in zip(varying.transition(0, 1.5), planar().transition(0, 1.5), strict=True):
        np.testing.assert_allclose(ours, exact, rtol=1e-9, atol=1e-11)
    grid = np.array([0.3, 0.5, 1.1])
    ours, exact = (s.simulate(grid, 5, 3) for s in (varying, planar()))
    np.testing.assert_allclose(ours.states, exact.states, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(ours.increments, exact.increments, rtol=1e-7, atol=1e-9)


def test_simulated_law_of_state_and_increment():
    """Joint covariance of (x at both ends, dy) against the augmented linear system."""
    system, paths, step = planar(), 200_000, 0.7
    sample = system.simulate([0.0, step], paths, 11)
    drift = np.zeros((3, 3))
    drift[:2, :2], drift[2, :2] = F, H[0]
    x, w = np.polynomial.legendre.leggauss(40)
    moves = expm(0.5 * step * (1 + x)[:, None, None] * drift)
    drive = np.zeros((3, 3))
    drive[:2, :2], drive[2, 2] = 0.4 * G @ G.T, 0.2
    noise = 0.5 * step * np.einsum("k,kij,jl,kml->im", w, moves, drive, moves)
    move = expm(step * drift)[:, :2]
    mean = move @ system.mean0
    cov = move @ system.cov0 @ move.T + noise
    drawn = np.vstack([sample.states[1], sample.increments[0]])
    error = np.sqrt(np.diag(cov) / paths)
    assert np.all(np.abs(drawn.mean(axis=1) - mean) < 4 * error)
    spread = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / paths)
    assert np.all(np.abs(np.cov(drawn) - cov) < 4 * spread)
    cross = np.cov(np.vstack([sample.states[0], drawn]))[:2, 2:]
    spread = np.sqrt(np.outer(np.diag(system.cov0), np.diag(cov)) * 2 / paths)
    assert np.all(np.abs(cross - system.cov0 @ move.T) < 4 * spread)


def test_simulation_starts_at_the_first_time_of_the_grid():
    system = planar()
    sample = system.simulate([2.0, 2.5], 100_000, 5)
    move, noise = system.transition(0.0, 2.0)
    cov = move @ system.cov0 @ move.T + noise
    error = np.sqrt(np.diag(cov) / 100_000)
    assert np.all(np.abs(sample.states[0].mean(axis=1) - move @ system.mean0) < 4 * error)


def test_paths_do_not_depend_on_how_many_follow_in_later_blocks():
    few = planar().simulate([0.0, 0.1], 8192, 2)
    many = planar().simulate([0.0, 0.1], 8200, 2)
    np.testing.assert_array_equal(few.states, many.states[..., :8192])
    assert many.increments.shape == (1, 1, 8200)


def test_singular_prior_and_no_process_noise():
    still = LinearDiffusion(0, 0, 1, 1, [2.0], 0)
    sample = still.simulate([0.0, 1.0, 2.0], 7, 0)
    np.testing.assert_array_equal(sample.states, 2.0)


def test_uniform_grids_have_one_step_length():
    lengths, index = distinct_steps(np.linspace(0, 6, 3001))
    assert lengths.size == 1
    assert index.max() == 0
    lengths, _ = distinct_steps(np.array([0.0, 1.0, 1.5, 2.5]))
    assert sorted(lengths) == [0.5, 1.0]


def test_same_seed_same_paths_and_a_generator_is_accepted():
    root = np.random.SeedSequence(3)
    one, two = (planar().simulate([0.0, 0.5], 4, root) for _ in range(2))
    np.testing.assert_array_equal(one.states, two.states)
    three = planar().simulate([0.0, 0.5], 4, np.random.default_rng(3))
    assert three.states.shape == (2, 2, 4)
    with pytest.raises(TypeError, match="seed: wanted"):
        planar().simulate([0.0, 0.5], 4, None)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"drift": np.eye(3)}, "drift: wanted shape"),
        ({"drift": [[np.nan, 0], [0, 1]]}, "drift: wanted finite"),
        ({"noise_intensity": [[-1.0]]}, "noise_intensity: wanted a positive semidefinite"),
        ({"noise_input": np.eye(2)}, "noise_input: wanted shape"),
        ({"noise_input": None}, "noise_intensity: wanted shape"),
        ({"sensor": [[1.0, 2.0, 3.0]]}, "sensor: wanted shape"),
        ({"sensor_intensity": [[0.0]]}, "sensor_intensity: wanted a positive definite"),
        ({"sensor_intensity": np.eye(2)}, "sensor_intensity: wanted shape"),
        ({"cov0": [[1, 0.5], [0.4, 1]]}, "cov0: wanted a symmetric"),
        ({"cov0": [[1, 2], [2, 1]]}, "cov0: wanted a positive semidefinite"),
        ({"mean0": [0.0]}, "cov0: wanted shape"),
        ({"mean0": []}, "mean0: wanted at least one"),
        ({"mean0": [np.inf, 0]}, "mean0: wanted finite"),
        ({"drift": lambda t: np.eye(3)}, "drift: wanted shape"),
    ],
)
def test_bad_coefficients_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        planar(**changes)


@pytest.mark.parametrize("value", [[[1j, 0], [0, 1]], [["a", "b"], ["c", "d"]], [[1, 0], [1]]])
def test_coefficients_that_are_not_real_arrays(value):
    with pytest.raises(TypeError, match="drift"):
        planar(drift=value)


def test_a_function_of_time_is_checked_when_it_is_used():
    system = planar(drift=lambda t: F if t < 1 else np.full((2, 2), np.nan))
    with pytest.raises(ValueError, match="drift: wanted finite"):
        system.transition(0.0, 2.0)


@pytest.mark.parametrize("drift", [np.eye(2), lambda t: np.eye(2)])
def test_an_unstable_system_that_overflows_is_named(drift):
    with pytest.raises(ValueError, match=r"times: the (moments|equations)"):
        planar(drift=drift).simulate([0.0, 500.0], 2, 0)


@pytest.mark.parametrize("times", [[], [-1.0, 0.0], [0.0, 0.0], [1.0, 0.5], [[0.0, 1.0]]])
def test_bad_grids(times):
    with pytest.raises(ValueError, match="times"):
        planar().simulate(times, 3, 0)


def test_bad_counts_and_intervals():
    with pytest.raises(ValueError, match="paths: wanted at least 1"):
        planar().simulate([0.0, 1.0], 0, 0)
    with pytest.raises(TypeError, match="paths: wanted a whole number"):
        planar().simulate([0.0, 1.0], 2.5, 0)
    with pytest.raises(ValueError, match="wanted 0 <= start <= stop"):
        planar().transition(1.0, 0.5)
    assert np.array_equal(planar().transition(1.0, 1.0)[0], np.eye(2))


@pytest.mark.parametrize("unit", [1e-75, 1e6, 1e20, 1e75])
def test_the_unit_of_the_state_does_not_matter(unit):
    moves = [van_loan(F, s * s * np.eye(2), 3.0) for s in (1.0, unit)]
    np.testing.assert_allclose(moves[1][0], moves[0][0], rtol=1e-12)
    np.testing.assert_allclose(moves[1][1] / unit / unit, moves[0][1], rtol=1e-12)


def test_a_sensor_without_rows_is_refused():
    with pytest.raises(ValueError, match="sensor: wanted at least one row"):
        planar(sensor=np.zeros((0, 2)), sensor_intensity=np.zeros((0, 0)))
