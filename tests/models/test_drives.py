"""Switching systems whose new mode drives the step, and paths of a given course of modes."""

import pickle

import numpy as np
import pytest
import sympy
from scipy.stats import norm

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import SwitchingFilter, large_order, load, save
from seedslib.linearization import GaussHermite, Taylor
from seedslib.models import (
    Noise,
    PlaneModes,
    StochasticMap,
    SwitchingChain,
    SwitchingSystem,
    averaged_switching,
)

X, V, W = sympy.symbols("x v w", real=True)
SLOPE, STAY = (0.5, -0.8), (0.3 + 0.6 * sympy.exp(-(X**2) / 2), 0.9 - 0.5 * sympy.exp(-(X**2) / 8))
PUSH = (0.3, 2.0)


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
    return SwitchingSystem(**{**given, **changes}, drives=drives)


def stays(i, x):
    return 0.3 + 0.6 * np.exp(-(x**2) / 2) if i == 0 else 0.9 - 0.5 * np.exp(-(x**2) / 8)


def test_paths_move_as_the_new_mode_has_it_from_the_old_state():
    paths = 100_000
    made = system().simulate([0.0, 1.0], paths, 3)
    x, old, new = made.states[0, 0], made.modes[0], made.modes[1]
    for i in (0, 1):
        for near in (np.abs(x) < 0.5, np.abs(x) > 1.5):
            here = near & (old == i)
            wanted = stays(i, x[here]).mean()
            error = np.sqrt(wanted * (1 - wanted) / here.sum())
            assert abs((new[here] == i).mean() - wanted) < 4 * error
            for l in (0, 1):
                there = here & (new == l)
                apart = made.states[1, 0, there] - SLOPE[l] * x[there] - l
                assert abs(apart.mean()) < 4 * PUSH[l] / there.sum() ** 0.5
                assert abs(apart.std() / PUSH[l] - 1) < 4 / (2 * there.sum()) ** 0.5


def test_the_two_timings_are_one_where_all_modes_move_alike():
    common = {"dynamics": [[X / 2 + V]] * 2}
    old, new = (system(d, **common).simulate(range(6), 50, 1) for d in ("old", "new"))
    for one, two in zip(old[:4], new[:4], strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("drives", ["old", "new"])
def test_a_given_course_of_modes_is_followed(drives):
    """The same noises as without it; the modes are those given, whatever their probability."""
    course, model = np.array([1, 0, 0, 1, 1, 0]), system(drives, switching=[[1, 0], [0, 1]])
    made = model.simulate(range(6), 40, 7, modes=course)
    np.testing.assert_array_equal(made.modes, np.repeat(course[:, None], 40, axis=1))
    drive = course[1:] if drives == "new" else course[:-1]
    slope, push = np.array(SLOPE)[drive, None], np.array(PUSH)[drive, None]
    v = (made.states[1:, 0] - slope * made.states[:-1, 0] - drive[:, None]) / push
    quiet = system(drives, dynamics=[[V], [V]]).simulate(range(6), 40, 7)
    np.testing.assert_allclose(v, quiet.states[1:, 0], atol=1e-12)
    spread = np.where(course == 0, 1.0, 0.5)[:, None]
    w = (made.measurements - made.states)[:, 0] / spread
    noise = system(drives, sensor=[[W], [W]]).simulate(range(6), 40, 7).measurements[:, 0]
    np.testing.assert_allclose(w, noise, atol=1e-12)


def test_each_path_may_have_a_course_of_its_own():
    courses = np.random.default_rng(0).integers(0, 2, (5, 30))
    model = system()
    made = model.simulate(range(5), 30, 2, modes=courses)
    alike = model.simulate(range(5), 30, 2, modes=courses[:, 4])
    np.testing.assert_array_equal(made.states[..., 4], alike.states[..., 4])
    few = model.simulate(range(5), 7, 2, modes=courses[:, :7])
    np.testing.assert_array_equal(made.states[..., :7], few.states)
    free = model.simulate(range(5), 30, 2)
    again = model.simulate(range(5), 30, 2, modes=free.modes)
    np.testing.assert_array_equal(again.states, free.states)
    start = model.simulate([0.0], 4000, 2, modes=np.ones((1, 4000), int)).states
    assert abs(start.mean() - 1) < 4 * np.sqrt(2 / 4000)


@pytest.mark.parametrize(
    ("modes", "kind", "message"),
    [
        ([0, 1], ValueError, r"modes: wanted shape \(3, 4\), got \(2, 4\)"),
        ([0, 1, 2], ValueError, "modes: wanted numbers from 0 to 1"),
        ([0, -1, 1], ValueError, "modes: wanted numbers from 0 to 1"),
        ([0.0, 1.0, 1.0], TypeError, "modes: wanted whole numbers"),
        (np.zeros((3, 5), int), ValueError, r"modes: wanted shape \(3, 4\)"),
    ],
)
def test_bad_courses_are_refused(modes, kind, message):
    with pytest.raises(kind, match=message):
        system().simulate(range(3), 4, 1, modes=modes)


def test_no_course_where_the_noise_decides():
    with pytest.raises(ValueError, match="modes: wanted none, for the switching depends on"):
        zoo.dependent_switching().simulate(range(3), 4, 1, modes=[0, 0, 1])


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="drives: wanted 'old' or 'new', got 'both'"):
        system("both")
    dependent = [[1 / (1 + sympy.exp(-V)), 1 / (1 + sympy.exp(V))], [0.5, 0.5]]
    system("old", switching=dependent)
    with pytest.raises(ValueError, match="switching of mode 0: wanted probabilities without the"):
        system("new", switching=dependent)


def slow(t, x, v):
    return 0.5 * x + 0.3 * v


def fast(t, x, v):
    return -0.8 * x + 1 + 2.0 * v


def stay_slow(t, x, v):
    return stays(0, x[0])


def leave_slow(t, x, v):
    return 1 - stays(0, x[0])


def stay_fast(t, x, v):
    return stays(1, x[0])


def leave_fast(t, x, v):
    return 1 - stays(1, x[0])


def arrays(**options):
    noise = Noise((V,))

    def move(value, weight):
        return StochasticMap.from_functions(1, 1, value, noise, weight=weight)

    table = [
        [move(slow, stay_slow), move(fast, leave_slow)],
        [move(slow, leave_fast), move(fast, stay_fast)],
    ]
    readings = [[StochasticMap((X,), [X + W / s], Noise((W,)))] for s in (1, 2)]
    return SwitchingSystem.from_maps(
        table, readings, [(0.5, [0], [[1]]), (0.5, [1], [[2]])], **options
    )


def test_maps_of_array_functions_share_a_column():
    model, written = arrays(drives="new"), system()
    one, two = (each.simulate(range(5), 30, 1) for each in (model, written))
    np.testing.assert_allclose(one.states, two.states, rtol=1e-13)
    np.testing.assert_array_equal(one.modes, two.modes)
    runs = [
        SwitchingFilter(each, GaussHermite(5)).run(range(5), two.measurements)
        for each in (model, written, pickle.loads(pickle.dumps(model)))
    ]
    # points in the plane of state and noise in the place of points on the line of the state
    np.testing.assert_allclose(runs[0].mean, runs[1].mean, rtol=1e-9)
    np.testing.assert_array_equal(runs[0].mean, runs[2].mean)
    with pytest.raises(ValueError, match="maps of one value in mode 0, got several"):
        arrays()


def test_weights_of_arrays_that_look_at_the_noise_are_refused():
    noise = Noise((V,))

    def move(weight):
        return StochasticMap.from_functions(1, 1, slow, noise, weight=weight)

    table = [[move(lambda t, x, v: norm.cdf(v[0])), move(lambda t, x, v: norm.cdf(-v[0]))]] * 2
    readings = [[StochasticMap((X,), [X + W], Noise((W,)))]] * 2
    law = [(0.5, [0], [[1]])] * 2
    SwitchingSystem.from_maps(table, readings, law)
    with pytest.raises(ValueError, match="switching of mode 0: wanted probabilities without"):
        SwitchingSystem.from_maps(table, readings, law, drives="new")


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_the_chain_switches_at_the_node_and_moves_as_the_new_mode(scale):
    """Wide noise: densities on the nodes; narrow noise: the moments of each column."""
    moves = [[SLOPE[i] * X + i / 4 + scale * PUSH[i] * V] for i in (0, 1)]
    chain = SwitchingChain(system(dynamics=moves), (-12.0, 12.0, 121))
    nodes = np.linspace(-12, 12, 121)
    found = chain.transition(0.0, 1.0).reshape(2, 121, 2, 121)
    np.testing.assert_allclose(found.sum(axis=(0, 1)), 1, rtol=1e-12)
    for i in (0, 1):
        chance = [1 - stays(i, nodes)] * 2
        chance[i] = stays(i, nodes)
        for l in (0, 1):
            np.testing.assert_allclose(found[l, :, i].sum(axis=0), chance[l], rtol=1e-12)
            inside = np.abs(nodes) < 2
            there = nodes @ found[l, :, i] / chance[l]
            wanted = SLOPE[l] * nodes + l / 4
            # a narrow law falls into the cell that it is in
            room = 0.02 if scale == 1.0 else 0.101
            np.testing.assert_allclose(there[inside], wanted[inside], atol=room)
            if scale == 1.0:
                density = norm.pdf(nodes[:, None], wanted, PUSH[l])
                np.testing.assert_allclose(
                    found[l, :, i], chance[l] * density / density.sum(axis=0), rtol=1e-10
                )


def test_averaged_switching_keeps_the_timing():
    model = system()
    averaged = averaged_switching(model, np.arange(40.0), 2000, 1)
    assert averaged.drives == "new"
    assert averaged.dynamics[1].expressions[0] == model.dynamics[1].expressions[0]
    data = model.simulate(np.arange(40.0), 2000, 1)
    later = data.modes[20:] == 0
    share = stays(0, data.states[20:, 0][later]).mean()
    assert averaged.branches[0][0].probability(0.0, np.zeros(1)) == pytest.approx(share, rel=1e-12)


@pytest.mark.filterwarnings("ignore")
def test_the_two_are_told_apart(tmp_path):
    """In words, and by a file: even where the laws are one, the filters are not."""
    assert "drives new" in repr(system())
    assert "drives" not in repr(system("old"))
    assert "drives" in system()._repr_html_()
    common, path = {"dynamics": [[sympy.sin(X) + V]] * 2}, tmp_path / "f.npz"
    for changes in ({}, common):
        new, old = system("new", **changes), system("old", **changes)
        for one, other in ((new, old), (old, new)):
            save(synthesize(one, large_order(1), Taylor(), range(3), paths=500, seed=1), path)
            assert load(path, one).system is one
            with pytest.raises(ValueError, match="drive by the new mode is there in only one"):
                load(path, other)


def test_a_chain_on_the_plane_moves_as_the_new_mode_too():
    """Moments of the next state in each mode against those of the map."""
    a, b, p, q = sympy.symbols("a b p q", real=True)
    moves = [[a / 2 + p, b - a / 4 + q], [1 - a / 2 + p, b / 2 + q]]
    stay = 0.4 + 0.5 * sympy.exp(-(a**2))
    model = SwitchingSystem(
        (a, b), moves, Noise((p, q), cov=[[0.3, 0], [0, 0.3]]), [[stay, 1 - stay], [0.2, 0.8]],
        [[a + W]] * 2, Noise((W,)), [(1.0, [0, 0], np.eye(2)), (0.0, [0, 0], np.eye(2))],
        drives="new",
    )  # fmt: skip
    chain = PlaneModes(model, [(-5, 5, 31), (-5, 5, 31)])
    point = int(np.argmin(((chain.nodes - np.array([[1.0], [0.5]])) ** 2).sum(axis=0)))
    law = np.zeros((2 * chain.nodes.shape[1], 1))
    law[point] = 1.0  # in mode 0
    later = chain.move(law, 0.0, 1.0).reshape(2, -1)
    here = chain.nodes[:, point]
    chance = 0.4 + 0.5 * np.exp(-(here[0] ** 2))
    np.testing.assert_allclose(later.sum(axis=1), [chance, 1 - chance], rtol=1e-9)
    for l, wanted in enumerate(
        ([here[0] / 2, here[1] - here[0] / 4], [1 - here[0] / 2, here[1] / 2])
    ):
        mean = chain.nodes @ later[l] / later[l].sum()
        np.testing.assert_allclose(mean, wanted, atol=1e-6)
