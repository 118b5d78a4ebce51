"""How a model is looked at: at which points, what its functions give there, and what is equal."""

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from seedslib.designed.identity import (
    POINTS,
    difference,
    probe,
    probe_arrays,
    probe_points,
    probe_values,
)
from seedslib.linearization import ExactGaussian, GaussHermite, Taylor
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap, SwitchingSystem

a, b, v, w, z, t = sympy.symbols("a b v w z t", real=True)
MEAN0, COV0 = [0.5, -2.0], [[4.0, 0.6], [0.6, 1.0]]
TELL = 1 / (2 + t + a**2)


def moved():
    return JumpDiffusion(
        (a, b), [b + t, -a * b], [[t, a], [0, 2]], [a * b + t * v + w], Noise((v, w)), MEAN0, COV0,
        intensity=1 + t + b**2, jump=[a * z, t + z], marks=Noise((z,), mean=0.5, cov=[[2.0]]),
        time=t,
    )  # fmt: skip


def stepped():
    return DiscreteSystem(
        StochasticMap((a, b), [b + t * v, a + v * b], Noise((v,), cov=[[3.0]]), time=t),
        StochasticMap((a, b), [a + 2 * w, b * t + w], Noise((w,)), time=t), MEAN0, COV0,
    )  # fmt: skip


def switching(drives="old"):
    return SwitchingSystem(
        (a,), [[t * a + v], [a**2 - t + 2 * v]], Noise((v,), cov=[[1.5]]),
        [[1 - TELL, TELL], [0, 1]], [[a + t + w], [3 * w - a]], Noise((w,)),
        [(0.25, [1.0], [[2.0]]), (0.75, [-1.0], [[0.5]])], drives=drives, time=t,
        indicator=[[TELL / 2, 1 - TELL / 2], [0.4, 0.6]],
    )  # fmt: skip


def test_points_are_spread_over_time_and_the_initial_law():
    """Within three deviations, or three units where the state is known, by irrational steps."""
    found = probe_points(moved(), 2.0, 6.0)
    assert found.shape == (3, POINTS) == (3, 12)
    k = np.arange(1, 13)
    assert_allclose(found[0], 2.0 + 4.0 * (k * np.sqrt(2) % 1), rtol=1e-13)
    assert_allclose(found[1], 0.5 + 2.0 * (6 * (k * np.sqrt(3) % 1) - 3), rtol=1e-12, atol=1e-12)
    assert_allclose(found[2], -2.0 + 6 * (k * np.sqrt(5) % 1) - 3, rtol=1e-12, atol=1e-12)
    names = sympy.symbols("q0:11")
    moves, shows = (StochasticMap(names, list(n), Noise(())) for n in (names, names[:1]))
    still = DiscreteSystem(moves, shows, np.zeros(11), np.zeros((11, 11)))
    many = probe_points(still, 0.0, 1.0)
    assert many.shape == (12, 12)
    assert_allclose(many[9], 6 * (k * np.sqrt(29) % 1) - 3, rtol=1e-12, atol=1e-12)
    assert_allclose(many[10], 6 * (k * np.sqrt(2) % 1) - 3, rtol=1e-12, atol=1e-12)


def test_what_is_seen_of_a_jump_diffusion():
    """Each function at each point, by hand."""
    points = probe_points(moved(), 0.0, 3.0)
    now, x, y = points
    seen = probe(moved(), points, ExactGaussian())
    nil = np.zeros_like(now)
    wanted = {
        "drift": [y + now, -x * y],
        "diffusion": [[now**2 + x**2, 2 * x], [2 * x, 4 + nil]],
        "intensity": 1 + now + y**2,
        "jump (mean)": [x / 2, now + 0.5],
        "jump (cov)": [[2 * x**2, 2 * x], [2 * x, 2 + nil]],
        "sensor (mean)": [x * y],
        "sensor (cov)": [[now**2 + 1]],
        "moments of the sensor (mean)": [x * y + 0.6],
        "moments of the sensor (cross)": [[4 * y + 0.6 * x], [0.6 * y + x]],
        # the variance of a product of two normal numbers
        "moments of the sensor (cov)": [
            [4 * y**2 + x**2 + 1.2 * x * y + 4 + 0.36 + now**2 + 1]
        ],
    }  # fmt: skip
    assert set(seen) == {*wanted, "mean0", "cov0"}
    for name, part in wanted.items():
        part = np.moveaxis(np.array(part), -1, 0)
        assert_allclose(seen[name], part, rtol=1e-11, atol=1e-11, err_msg=name)
    assert_array_equal(seen["mean0"], [MEAN0])
    assert_array_equal(seen["cov0"], [COV0])


def test_what_is_seen_of_a_system_in_discrete_time():
    """Without a linearization the sensor by any rule, and its likelihood."""
    points = probe_points(stepped(), 0.0, 3.0)
    now, x, y = points
    seen = probe(stepped(), points)
    nil = np.zeros_like(now)
    wanted = {
        "dynamics (mean)": [y, x],
        "dynamics (cov)": [[3 * now**2, 3 * now * y], [3 * now * y, 3 * y**2]],
        "sensor (mean)": [x, now * y],
        "sensor (cov)": [[4 + nil, 2 + nil], [2 + nil, 1 + nil]],
        "moments of the sensor (mean)": [x, now * y],
        "moments of the sensor (cross)": [[4 + nil, 0.6 * now], [0.6 + nil, now]],
        "moments of the sensor (cov)": [
            [8 + nil, 0.6 * now + 2], [0.6 * now + 2, now**2 + 1]
        ],
    }  # fmt: skip
    assert set(seen) - {"likelihood"} == {*wanted, "mean0", "cov0"}
    for name, part in wanted.items():
        part = np.moveaxis(np.array(part), -1, 0)
        assert_allclose(seen[name], part, rtol=1e-11, atol=1e-11, err_msg=name)
    known = probe(stepped(), points, Taylor())
    assert "likelihood" not in known


def test_the_likelihood_is_looked_at_up_to_two_deviations():
    """Log-densities of a normal measurement at its mean and one and two deviations from it."""
    system = DiscreteSystem(
        StochasticMap((a, b), [a, b], Noise(())),
        StochasticMap((a, b), [a * b + (1 + t) * v], Noise((v,)), time=t), MEAN0, COV0,
    )  # fmt: skip
    points = probe_points(system, 0.0, 3.0)
    found = probe(system, points)["likelihood"]
    apart = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    wanted = -0.5 * apart**2 - np.log((1 + points[0]) * np.sqrt(2 * np.pi))[:, None]
    assert_allclose(found, wanted, rtol=1e-12)


def test_what_is_seen_of_a_switching_system():
    """Of each branch its probability, and moments of its value weighed by it."""
    system = switching()
    points = probe_points(system, 0.0, 3.0)
    now, x = points
    seen = probe(system, points)
    tell, nil, one = 1 / (2 + now + x**2), np.zeros(12), np.ones(12)
    moves = [now * x, now * x, x**2 - now, x**2 - now]
    shows = [x + now, x + now, -x, -x]
    tables = {
        "switching": ([1 - tell, tell, nil, one], moves, [1.5, 1.5, 6.0, 6.0]),
        "readings": ([tell / 2, 1 - tell / 2, 0.4 * one, 0.6 * one], shows, [1.0, 1.0, 9.0, 9.0]),
    }
    for name, (prob, means, variances) in tables.items():
        assert seen[f"{name} (probability)"].shape == (12, 4)
        assert_allclose(seen[f"{name} (probability)"].T, prob, rtol=1e-12, atol=1e-14)
        found = seen[f"{name} (mean)"], seen[f"{name} (cov)"]
        assert found[0].shape == (12, 4, 1)
        assert found[1].shape == (12, 4, 1, 1)
        for k in range(4):
            assert_allclose(found[0][:, k, 0], prob[k] * means[k], rtol=1e-11, atol=1e-12)
            assert_allclose(found[1][:, k, 0, 0], prob[k] * variances[k], rtol=1e-11, atol=1e-12)
    assert_array_equal(seen["initial (probability)"], [[0.25, 0.75]])
    assert_array_equal(seen["initial (mean)"], [[[1.0], [-1.0]]])
    assert_array_equal(seen["initial (cov)"], [[[[2.0]], [[0.5]]]])
    assert len(seen) == 9
    other = probe(switching("new"), points)
    assert other.keys() - seen.keys() == {"drive by the new mode"}


def test_branches_whose_probability_depends_on_the_noise():
    """Averages of a weight of the noise, by nodes that are exact for it."""
    lean = v / (40 * (1 + t))
    system = SwitchingSystem(
        (a,), [[a + v]] * 2, Noise((v,)), [[0.5 - lean, 0.5 + lean]] * 2, [[a + w]] * 2,
        Noise((w,)), [(0.5, [0.3], [[1.0]])] * 2, time=t,
    )  # fmt: skip
    now, x = points = probe_points(system, 0.0, 2.0)
    seen, tilt = probe(system, points), 1 / (40 * (1 + now))
    for k, sign in enumerate((-1, 1, -1, 1)):
        assert_allclose(seen["switching (probability)"][:, k], 0.5, rtol=1e-12)
        first = x / 2 + sign * tilt
        assert_allclose(seen["switching (mean)"][:, k, 0], first, rtol=1e-12, atol=1e-13)
        # E (x + v)² / 2 + 2 x tilt, less the square of the first moment over the mass
        wanted = (x**2 + 1) / 2 + 2 * sign * x * tilt - first**2 / 0.5
        assert_allclose(seen["switching (cov)"][:, k, 0, 0], wanted, rtol=1e-10)


POINTS_OF = np.array([[0.0, 1.0, 4.0], [3.0, -8.0, 5.0]])
"""Over four units of time; the largest state is 8."""


def allowed(values, name, points=POINTS_OF):
    """Whether components of a quantity may differ by 0.999 and not by 1.001 of something."""

    def tell(room, place):
        for share in (0.999, 1.001):
            other = dict(values)
            other[name] = values[name].copy()
            other[name][place] += share * room
            assert (difference(values, other, points) == "") is (share < 1), (name, share)

    return tell


def test_a_mean_may_differ_by_a_billionth_of_its_size_and_deviation():
    """And by rounding of the mean, or of the state that it is computed from."""
    mean, var = np.array([[2.0], [-5.0], [1.0]]), np.array([[[9.0]], [[4.0]], [[1.0]]])
    for name, largest in (("sensor", 5.0), ("dynamics", 8.0), ("jump", 8.0)):
        values = {f"{name} (mean)": mean, f"{name} (cov)": var}
        tell = allowed(values, f"{name} (mean)")
        tell(1e-9 * (5 + 3) + 1e-14 * largest, (0, 0))
        lost = 1e-14 * largest
        room = 1e-9 * 9 + lost * 3 + (3 + lost) * lost
        allowed(values, f"{name} (cov)")(room, (2, 0, 0))
    values = {"moments of the sensor (mean)": mean, "moments of the sensor (cov)": var}
    room = 1e-9 * 9 + 5e-14 * 3 + (3 + 5e-14) * 5e-14 + 1e-14 * 25
    allowed(values, "moments of the sensor (cov)")(room, (1, 0, 0))


def test_rates_may_differ_by_what_they_add_up_to():
    """Over four units of time: a drift of 5 makes 20, a diffusion of 9 a deviation of 6."""
    values = {"drift": np.array([[2.0], [-5.0], [1.0]]), "diffusion": np.full((3, 1, 1), 9.0)}
    lost = 1e-14 * 20
    allowed(values, "drift")((1e-9 * (20 + 6) + lost) / 4, (1, 0))
    room = (1e-9 * 36 + lost * 6 + (6 + lost) * lost) / 4
    allowed(values, "diffusion")(room, (1, 0, 0))
    values = {"intensity": np.array([0.0, 3.0, 1.0])}
    allowed(values, "intensity")(3e-9 + 1e-14 / 4, (2,))
    # of one measurement there is one time, and a unit of it
    once = {"drift": np.array([[2.0], [-5.0], [1.0]]), "diffusion": np.full((3, 1, 1), 9.0)}
    allowed(once, "drift", 0 * POINTS_OF)(1e-9 * (5 + 3) + 5e-14, (1, 0))
    values = {"likelihood": np.array([[0.0], [3.0], [1.0]])}
    allowed(values, "likelihood")(3e-9 + 1e-9, (2, 0))
    values = {"switching (probability)": np.array([[0.0], [0.25], [0.5]])}
    allowed(values, "switching (probability)")(0.5e-9 + 1e-14, (2, 0))


def test_covariances_may_differ_by_the_deviations_of_their_components():
    """Each in its own units; with the state by the deviations of that."""
    cov = np.zeros((3, 2, 2))
    cov[:, 0, 0], cov[:, 1, 1] = 1e-6, 1e6
    values = {
        "moments of the sensor (mean)": np.zeros((3, 2)), "moments of the sensor (cov)": cov,
        "moments of the sensor (cross)": np.zeros((3, 1, 2)),
        "mean0": np.array([[2.0]]), "cov0": np.array([[[25.0]]]),
    }  # fmt: skip
    tell = allowed(values, "moments of the sensor (cov)")
    tell(1e-9 * 1e-6, (0, 0, 0))
    tell(1e-9, (1, 0, 1))
    tell(1e-9 * 1e6, (1, 1, 1))
    tell = allowed(values, "moments of the sensor (cross)")
    # rounding of the state, 8, beside its deviation, 5
    tell((5e-9 + 8e-14) * 1e-3, (0, 0, 0))
    tell((5e-9 + 8e-14) * 1e3, (0, 0, 1))
    tell = allowed(values, "cov0")
    lost = 8e-14
    tell(25e-9 + lost * 5 + (5 + lost) * lost, (0, 0, 0))
    allowed(values, "mean0")(1e-9 * (2 + 5) + lost, (0, 0))


def test_the_points_of_a_file_are_those_of_its_model():
    points = probe_points(moved(), 0.0, 3.0)
    values = probe(moved(), points, GaussHermite(3))
    arrays = probe_arrays(points, values)
    assert set(arrays) == {"probe_x"} | {f"probe_values/{name}" for name in values}
    again, kept = probe_values({**arrays, "times": np.zeros(2)}, 2)
    assert again is points
    assert kept.keys() == values.keys()
    assert all(kept[name] is values[name] for name in values)
    for bad, match in (
        ({"probe_x": points[:2]}, r"^probe_x of shape \(2, 12\)$"),
        ({"probe_x": points[:, :11]}, r"^probe_x of shape \(3, 11\)$"),
        ({"probe_x": np.where(points > 3, np.nan, points)}, r"^probe_x of shape \(3, 12\)$"),
        ({"probe_x": points.astype(np.float32)}, r"^probe_x of dtype float32$"),
        ({"probe_values/drift": values["drift"].astype(int)}, r"^drift of dtype int64$"),
    ):
        with pytest.raises(ValueError, match=match):
            probe_values({**arrays, **bad}, 2)
    with pytest.raises(KeyError):
        probe_values(values, 2)
