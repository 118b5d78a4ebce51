"""Switching systems: the distribution of modes, states, measurements and indicators on simulated
paths."""

import warnings

import numpy as np
import pytest
import sympy
from scipy.integrate import quad
from scipy.stats import norm

from seedslib import zoo
from seedslib.base import Parameter
from seedslib.designed import SwitchingFilter
from seedslib.filters import GridBayesFilter, ParticleFilter
from seedslib.linearization import GaussHermite, Taylor, Unscented
from seedslib.models import (
    Noise,
    SwitchingSystem,
)
from systems import (
    COVS,
    INPUTS,
    MEANS,
    PROBABILITIES,
    TIMES,
    U,
    chances,
    switching_numbers,
    switching_system,
)

X, V, W, T = sympy.symbols("x v w t", real=True)
SLOPE, PUSH = (0.5, -0.8), (0.3, 2.0)
STAY = (0.3 + 0.6 * sympy.exp(-(X**2) / 2), 0.9 - 0.5 * sympy.exp(-(X**2) / 8))


def stays(i, x):
    return 0.3 + 0.6 * np.exp(-(x**2) / 2) if i == 0 else 0.9 - 0.5 * np.exp(-(x**2) / 8)


def system(drives="new", **changes):
    given = {
        "state": (X,),
        "dynamics": [[SLOPE[i] * X + i + PUSH[i] * V] for i in (0, 1)],
        "noise": Noise((V,)),
        "switching": [[STAY[0], 1 - STAY[0]], [1 - STAY[1], STAY[1]]],
        "sensor": [[X + W], [X + W / 2]],
        "sensor_noise": Noise((W,)),
        "initial": [(0.5, [0], [[1]]), (0.5, [1], [[2]])],
    }
    return SwitchingSystem(**given | changes, drives=drives)


# Distributions of the paths


@pytest.mark.parametrize("drives", ["old", "new"])
def test_paths_are_those_of_the_reference_system(drives):
    """Three modes, inputs, late and unequal steps: what the maps leave over is their noise.

    The noises are solved for from states, modes and measurements; their moments, and the parts of
    switches and of indicators in each mode, are those of the model.
    """
    paths = 20_000
    data = switching_system(drives).simulate(TIMES, paths, 2, inputs=INPUTS)
    numbers = switching_numbers()
    for i in range(3):
        here = data.modes[0] == i
        share = here.mean()
        assert abs(share - PROBABILITIES[i]) < 4.5 * np.sqrt(share / paths)
        error = 4.5 * np.sqrt(np.diagonal(COVS[i]) / here.sum())
        assert (np.abs(data.states[0][:, here].mean(axis=1) - MEANS[i]) < error).all()
        np.testing.assert_allclose(np.cov(data.states[0][:, here]), COVS[i], atol=0.15)
    for k, now in enumerate(TIMES):
        leave, tell = (np.array(part) for part in chances(now, INPUTS[U][k]))
        for i in range(3):
            here = data.modes[k] == i
            allowed = 4.5 * np.sqrt(0.25 / here.sum())
            shown = [(data.indicators[k, here] == j).mean() for j in range(2)]
            np.testing.assert_allclose(shown, tell[i], atol=allowed)
            mode = numbers.modes[i]
            left = data.measurements[k][:, here] - mode.H[k] @ data.states[k][:, here]
            root = np.linalg.cholesky(mode.R[k])
            noise = np.linalg.solve(root, left - mode.d[k][:, None])
            assert np.abs(noise.mean(axis=1)).max() < 4.5 / np.sqrt(here.sum())
            np.testing.assert_allclose(np.cov(noise), np.eye(2), atol=6.5 / np.sqrt(here.sum()))
            if k + 1 < len(TIMES):
                new = [(data.modes[k + 1, here] == l).mean() for l in range(3)]
                np.testing.assert_allclose(new, leave[i], atol=allowed)
                drive = data.modes[k + 1] == i if drives == "new" else here
                moved = data.states[k + 1][:, drive] - mode.F[k] @ data.states[k][:, drive]
                root = np.linalg.cholesky(mode.Q[k])
                noise = np.linalg.solve(root, moved - mode.b[k][:, None])
                assert np.abs(noise.mean(axis=1)).max() < 4.5 / np.sqrt(drive.sum())
                np.testing.assert_allclose(
                    np.cov(noise), np.eye(3), atol=6.5 / np.sqrt(drive.sum())
                )


@pytest.mark.parametrize("drives", ["old", "new"])
def test_switches_depend_on_the_old_state_and_mode(drives):
    paths = 50_000
    data = system(drives).simulate([0.0, 1.0], paths, 3)
    at, old, new = data.states[0, 0], data.modes[0], data.modes[1]
    for i in (0, 1):
        for near in (np.abs(at) < 0.5, np.abs(at) > 1.5):
            here = near & (old == i)
            wanted = stays(i, at[here]).mean()
            error = np.sqrt(wanted * (1 - wanted) / here.sum())
            assert abs((new[here] == i).mean() - wanted) < 4 * error
    drive = new if drives == "new" else old
    apart = data.states[1, 0] - np.where(drive == 0, SLOPE[0] * at, SLOPE[1] * at + 1)
    for i in (0, 1):
        noise = apart[drive == i]
        assert abs(noise.mean()) < 4 * PUSH[i] / np.sqrt(noise.size)
        assert noise.std() == pytest.approx(PUSH[i], rel=4 / np.sqrt(2 * noise.size))


def test_dependent_noises_have_the_joint_dist_of_correlated_pairs():
    """Switching and indicator against draws of the normal pairs that they stand for."""
    paths, rng = 100_000, np.random.default_rng(5)
    data = zoo.dependent_switching().simulate([0.0, 1.0], paths, 4)
    at, mode = data.states[0, 0], data.modes[0]
    alpha, beta, rho = np.array([[1.2, -0.3], [-0.8, 0.5], [0.6, -0.4]])[:, mode]
    v = rng.standard_normal(paths)
    switched = rho * v + np.sqrt(1 - rho**2) * rng.standard_normal(paths) > alpha + beta * at
    drift, slope, size = np.array([[0.2, -0.5], [0.9, 0.5], [0.6, 0.8]])[:, mode]
    moved = drift + slope * at + size * v
    tau, delta, rho = np.array([[1, -0.2], [-0.7, 0.4], [0.5, -0.3]])[:, mode]
    w = rng.standard_normal(paths)
    shown = rho * w + np.sqrt(1 - rho**2) * rng.standard_normal(paths) > tau + delta * at
    shift, slope, bend, size = np.array([[0, 1], [1, 0.7], [0.1, -0.05], [0.7, 0.5]])[:, mode]
    residual = data.measurements[0, 0] - shift - slope * at - bend * at**2
    later, told = data.modes[1], data.indicators[0]
    for mine, wanted in (
        (later, switched),
        (later * data.states[1, 0], switched * moved),
        (later * data.states[1, 0] ** 2, switched * moved**2),
        (told, shown),
        (told * residual, shown * size * w),
    ):
        error = np.hypot(mine.std(), wanted.std()) / np.sqrt(paths)
        assert abs(mine.mean() - wanted.mean()) < 4 * error


# Imposed courses of the modes


@pytest.mark.parametrize("drives", ["old", "new"])
def test_an_imposed_course_of_modes_is_followed_with_the_noises_of_the_seed(drives):
    course = np.array([1, 0, 0, 1, 1, 0])
    data = system(drives, switching=[[1, 0], [0, 1]]).simulate(range(6), 40, 7, modes=course)
    np.testing.assert_array_equal(data.modes, np.repeat(course[:, None], 40, axis=1))
    drive = course[1:] if drives == "new" else course[:-1]
    slope, push = np.array(SLOPE)[drive, None], np.array(PUSH)[drive, None]
    noise = (data.states[1:, 0] - slope * data.states[:-1, 0] - drive[:, None]) / push
    quiet = system(drives, dynamics=[[V], [V]]).simulate(range(6), 40, 7)
    np.testing.assert_allclose(noise, quiet.states[1:, 0], atol=1e-12)
    spread = np.where(course == 0, 1.0, 0.5)[:, None]
    noise = (data.measurements - data.states)[:, 0] / spread
    quiet = system(drives, sensor=[[W], [W]]).simulate(range(6), 40, 7)
    np.testing.assert_allclose(noise, quiet.measurements[:, 0], atol=1e-12)


def test_each_path_may_have_a_course_of_its_own():
    courses, model = np.random.default_rng(0).integers(0, 2, (5, 30)), system()
    data = model.simulate(range(5), 30, 2, modes=courses)
    alike = model.simulate(range(5), 30, 2, modes=courses[:, 4])
    np.testing.assert_array_equal(data.states[..., 4], alike.states[..., 4])
    free = model.simulate(range(5), 30, 2)
    again = model.simulate(range(5), 30, 2, modes=free.modes)
    np.testing.assert_array_equal(again.states, free.states)
    start = model.simulate([0.0], 4000, 2, modes=np.ones((1, 4000), int)).states
    assert abs(start.mean() - 1) < 4 * np.sqrt(2 / 4000)


# Maps and densities


def test_initial_moments_are_those_of_the_mixture():
    made, apart = switching_system(), MEANS - PROBABILITIES @ MEANS
    np.testing.assert_allclose(made.mean0, PROBABILITIES @ MEANS, rtol=1e-14)
    wanted = np.einsum("i,ijk->jk", PROBABILITIES, COVS) + (apart.T * PROBABILITIES) @ apart
    np.testing.assert_allclose(made.cov0, wanted, rtol=1e-13)


def test_densities_of_branches_integrate_to_their_probabilities():
    """Where the noise decides on the branch; with a missing measurement the probability is left."""
    model, at = zoo.dependent_switching(), np.array([0.7])
    for row in (*model.branches, *model.readings):
        total = 0.0
        for branch in row:

            def density(y, branch=branch):
                return float(np.exp(branch.log_density(0.0, np.array([y]), at)))

            mass = quad(density, -12, 14, points=[0.0, 1.0], epsabs=1e-11)[0]
            assert mass == pytest.approx(float(branch.probability(0.0, at)), abs=1e-9)
            total += mass
        assert total == pytest.approx(1.0, abs=1e-9)
    branch, nothing = model.readings[0][1], np.full((1, 2), np.nan)
    found = branch.log_density(0.0, nothing, np.array([[0.1, 0.9]]))
    wanted = branch.probability(0.0, np.array([[0.1, 0.9]]))
    np.testing.assert_allclose(np.exp(found), wanted, rtol=1e-12)


def test_density_of_a_measurement_with_its_indicator():
    """Modes, times and parameters of each path; a missing indicator says nothing."""
    a, tells = Parameter("a", 9.0), 1 / (1 + X**2)
    model = system(
        sensor=[[X + a * T + W], [2 * X + W / 2]],
        indicator=[[tells, 1 - tells], [0.3, 0.7]],
        time=T,
    )
    state = np.array([[0.4, 0.4, -0.2, 1.1, 0.7], [0, 0, 0, 1, 1]])
    shown = np.array([[1.3, 1.3, 0.2, 1.9, 2.2], [0, np.nan, 1, 1, np.nan]])
    own, first = np.array([0.5, -0.3, 0.2, 5.0, 5.0]), state[1] == 0
    middle = np.where(first, state[0] + own * 1.5, 2 * state[0])
    chance = np.where(first, 1 / (1 + state[0] ** 2), 0.3)
    told = np.where(shown[1] == 0, np.log(chance), np.log(1 - chance))
    wanted = norm.logpdf(shown[0], middle, np.where(first, 1.0, 0.5))
    wanted += np.where(np.isnan(shown[1]), 0.0, told)
    sensor = model.hybrid.sensor
    p = model.bind({a: own}).values()
    np.testing.assert_allclose(sensor.log_density(1.5, shown, state, p), wanted, rtol=1e-12)
    many = np.repeat(state[:, None], 4000, axis=1)
    drawn = sensor.sample(1.5, many, np.random.default_rng(4), p)
    assert np.abs(drawn[0].mean(axis=0) - middle).max() < 0.07
    assert np.abs((drawn[1] == 0).mean(axis=0) - chance).max() < 0.035


def test_a_switch_that_never_happens_has_no_branch_however_zero_is_written():
    for zero, one in ((0, 1), (0.0, 1.0), (sympy.Float(0), 1)):
        moves = system("old", switching=[[one, zero], [zero, one]]).branches
        assert [[b is None for b in row] for row in moves] == [[False, True], [True, False]]


# Probabilities that are none where the state goes


@pytest.mark.parametrize("drives", ["old", "new"])
def test_probabilities_out_of_range_are_refused_wherever_a_path_goes(drives):
    """p = x**2 / 100 beyond ten, where a walk of 200 steps is sooner or later."""
    chance = X**2 / 100
    leave = [[1 - chance, chance], [chance, 1 - chance]]
    walk = {"dynamics": [[X + V], [X + 2 * V]], "switching": leave}
    far, times, y = system(drives, **walk), range(200), np.full((200, 1), 12.0)
    for call in (
        lambda: far.simulate(times, 5, 1),
        lambda: ParticleFilter(far, 50).run(times, y),
        lambda: GridBayesFilter(far, (-20, 20, 161)).run(times, y),
    ):
        with pytest.raises(ValueError, match=r"^switching.*: wanted probabilities from 0 to 1"):
            call()
    for rule in (Taylor(), Unscented(), GaussHermite()):
        with pytest.warns(UserWarning, match="^switching: wanted probabilities from 0 to 1"):
            SwitchingFilter(far, rule).run(times, y)
    shows = system(drives, dynamics=[[X + V]] * 2, indicator=[[1 - chance, chance]] * 2)
    with pytest.raises(ValueError, match=r"^indicator: wanted probabilities from 0 to 1"):
        shows.simulate(times, 5, 1)
    inside = system(drives)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = inside.simulate(times, 20, 1)
        SwitchingFilter(inside, Taylor()).run(times, data.measurements)
