"""Switching systems: what they refuse, and that simulated paths follow the model."""

import numpy as np
import pytest
import sympy
from scipy.integrate import quad

from seedslib import zoo
from seedslib.models import Noise, StochasticMap, SwitchingSystem

X, V, W = sympy.symbols("x v w", real=True)


def system(**changes):
    given = {
        "state": (X,),
        "dynamics": [[X / 2 + V], [X + V]],
        "noise": Noise((V,)),
        "switching": [[0.9, 0.1], [0.3, 0.7]],
        "sensor": [[X + W], [2 * X + W]],
        "sensor_noise": Noise((W,)),
        "initial": [(0.5, [0], [[1]]), (0.5, [1], [[2]])],
    }
    return SwitchingSystem(**{**given, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"switching": [[0.9, 0.2], [0.3, 0.7]]}, "switching of mode 0: wanted .* that sum"),
        ({"switching": [[1.2, -0.2], [0.3, 0.7]]}, "switching of mode 0: wanted .* of at"),
        ({"switching": [[0.9, 0.1]]}, "switching: wanted shape"),
        ({"switching": [[1 - X**2, X**2], [0.3, 0.7]]}, "switching of mode 0"),
        ({"switching": [[1 - W, W], [0.3, 0.7]]}, "switching: wanted known symbols, got w"),
        ({"indicator": [[0.5, 0.4], [0.5, 0.5]]}, "indicator of mode 0: wanted .* that sum"),
        ({"indicator": [[0.5, 0.5]]}, "indicator: wanted shape"),
        ({"initial": [(0.5, [0], [[1]])]}, "initial: wanted 2 modes, got 1"),
        ({"initial": [(0.5, [0], [[1]]), (0.6, [1], [[2]])]}, "initial: wanted .* that sum"),
        ({"initial": [(0.5, [0], [[-1]]), (0.5, [1], [[2]])]}, r"initial\[0\] cov"),
        ({"sensor": [[X + W]]}, "indicator|sensor"),
    ],
)  # fmt: skip
def test_bad_models_are_refused_by_name(changes, message):
    with pytest.raises(ValueError, match=message):
        system(**changes)


def test_initial_moments_are_those_of_the_mixture():
    made = system()
    np.testing.assert_allclose(made.mean0, [0.5])
    np.testing.assert_allclose(made.cov0, [[1.5 + 0.25]])


def test_paths_switch_by_the_old_mode_and_the_old_state():
    paths = 200_000
    model = zoo.scalar_switching()
    made = model.simulate([0.0, 1.0], paths, 3)
    x, old, new = made.states[0, 0], made.modes[0], made.modes[1]
    for mode, chance in (
        (0, 0.35 - 0.3 * np.exp(-(x**2) / 8)),
        (1, 0.9 - 0.5 * np.exp(-(x**2) / 2)),
    ):
        for near in (np.abs(x) < 0.3, np.abs(x) > 1.5):
            here = near & (old == mode)
            wanted = chance[here].mean()
            error = np.sqrt(wanted * (1 - wanted) / here.sum())
            assert abs((new[here] == 1).mean() - wanted) < 4 * error
    apart = made.states[1, 0] - np.where(old == 0, x + 1.8 * np.sin(x), 0.6 * x)
    assert abs(apart.mean()) < 4 * 0.5 / paths**0.5
    assert abs(apart.std() - 0.5) < 4 * 0.5 / (2 * paths) ** 0.5
    sensed = made.measurements[1, 0] - made.states[1, 0] - 2.0 * new
    assert abs(sensed.mean()) < 4 * 2 / paths**0.5


def test_dependent_noises_have_the_joint_law_of_the_model():
    """Switching and indicator against draws of the correlated normal pairs they stand for."""
    paths, rng = 200_000, np.random.default_rng(5)
    model = zoo.dependent_switching()
    made = model.simulate([0.0, 1.0], paths, 4)
    x, mode = made.states[0, 0], made.modes[0]
    alpha, beta, rho = np.array([1.2, -0.3]), np.array([-0.8, 0.5]), np.array([0.6, -0.4])
    drift, slope, size = np.array([0.2, -0.5]), np.array([0.9, 0.5]), np.array([0.6, 0.8])
    v = rng.standard_normal(paths)
    pair = rho[mode] * v + np.sqrt(1 - rho[mode] ** 2) * rng.standard_normal(paths)
    switched = pair > alpha[mode] + beta[mode] * x
    moved = drift[mode] + slope[mode] * x + size[mode] * v
    for mine, theirs in (
        (made.modes[1], switched),
        (made.modes[1] * made.states[1, 0], switched * moved),
        (made.modes[1] * made.states[1, 0] ** 2, switched * moved**2),
    ):
        error = np.hypot(mine.std(), theirs.std()) / paths**0.5
        assert abs(mine.mean() - theirs.mean()) < 4 * error
    tau, delta, rho = np.array([1, -0.2]), np.array([-0.7, 0.4]), np.array([0.5, -0.3])
    w = rng.standard_normal(paths)
    pair = rho[mode] * w + np.sqrt(1 - rho[mode] ** 2) * rng.standard_normal(paths)
    shown = pair > tau[mode] + delta[mode] * x
    noise = np.array([0.7, 0.5])[mode]
    residual = (
        made.measurements[0, 0] - np.array([0, 1])[mode] - np.array([1, 0.7])[mode] * x
        - np.array([0.1, -0.05])[mode] * x**2
    )  # fmt: skip
    for mine, theirs in (
        (made.indicators[0], shown),
        (made.indicators[0] * residual, shown * noise * w),
    ):
        error = np.hypot(mine.std(), theirs.std()) / paths**0.5
        assert abs(mine.mean() - theirs.mean()) < 4 * error


def test_branch_density_is_a_density():
    """Densities of all branches together integrate to one, those of each to its probability."""
    model = zoo.dependent_switching()
    x = np.array([0.7])
    for row in (*model.branches, *model.readings):
        total = 0.0
        for branch in row:

            def density(y, branch=branch):
                return float(np.exp(branch.log_density(0.0, np.array([y]), x)))

            mass = quad(density, -12, 14, points=[0.0, 1.0], epsabs=1e-11)[0]
            assert mass == pytest.approx(float(branch.probability(0.0, x)), abs=1e-9)
            total += mass
        assert total == pytest.approx(1.0, abs=1e-9)


def test_missing_measurement_leaves_the_probability_of_the_indicator():
    branch = zoo.dependent_switching().readings[0][1]
    x = np.array([[0.1, 0.9]])
    found = branch.log_density(0.0, np.array([[np.nan, np.nan]]), x)
    np.testing.assert_allclose(np.exp(found), branch.probability(0.0, x), rtol=1e-12)


def test_paths_do_not_depend_on_threads_or_on_how_many_follow():
    model = zoo.manoeuvring_target()
    one = model.simulate([0, 1, 2], 20_000, 7)
    two = model.simulate([0, 1, 2], 20_000, 7, workers=2)
    few = model.simulate([0, 1, 2], 100, 7)
    assert one.history is None
    for a, b, c in zip(one[:-1], two[:-1], few[:-1], strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a if a.ndim == 1 else a[..., :100], c)


def test_measured_times_only():
    made = zoo.manoeuvring_target().simulate([0, 1, 2], 10, 7, measured=[0, 2])
    assert np.isnan(made.measurements[1]).all()
    assert (made.indicators[1] == -1).all()
    assert (made.indicators[[0, 2]] >= 0).all()


def test_system_of_array_functions_is_the_symbolic_one():
    model, noise = system(), Noise(1)

    def move(i, l):
        return StochasticMap.from_functions(
            1, 1, lambda t, x, v: (0.5 + 0.5 * i) * x + v, noise,
            weight=lambda t, x, v: np.full(x.shape[1:], [[0.9, 0.1], [0.3, 0.7]][i][l]),
        )  # fmt: skip

    def show(i):
        return StochasticMap.from_functions(1, 1, lambda t, x, w: (1 + i) * x + w, Noise(1))

    other = SwitchingSystem.from_maps(
        [[move(i, l) for l in range(2)] for i in range(2)], [[show(i)] for i in range(2)],
        model.initial,
    )  # fmt: skip
    for a, b in zip(
        model.simulate([0, 1, 2], 50, 1), other.simulate([0, 1, 2], 50, 1), strict=True
    ):
        if a is not None:
            np.testing.assert_allclose(a, b, rtol=1e-13)


def test_unknown_names_of_examples():
    for name in ("scalar_switching", "manoeuvring_target"):
        with pytest.raises(ValueError, match="wanted one of"):
            getattr(zoo, name)("other")
