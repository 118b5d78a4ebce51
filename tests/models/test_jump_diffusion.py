import numpy as np
import pytest
import sympy
from scipy.linalg import expm

from seedslib import zoo
from seedslib.models import JumpDiffusion, Noise, StochasticMap

x, y, v, z, t, s = sympy.symbols("x y v z t s")


def scalar(drift=0, diffusion=0, **options):
    """One-dimensional system with a sensor that only adds noise."""
    settings = {"mean0": [1.0], "cov0": [[0.0]], "step": 0.01} | options
    return JumpDiffusion((x,), [drift], [[diffusion]], [x + v], Noise((v,)), **settings)


# Closed forms of the models


def test_mean_velocity_and_spread_of_the_kicked_oscillator():
    system = zoo.kicked_duffing(0.5, 0.2, (0.2, 0.3), (0.5, 3.0))
    x1, x2 = system.state
    rate = 0.2 + 0.3 * x1**2
    velocity, spread = system.moment_expressions
    assert sympy.expand(velocity[0] - x2) == 0
    expected = x1 - x1**3 - 0.5 * x2 + 0.5 * rate
    assert sympy.expand(sympy.nsimplify(velocity[1] - expected)) == 0
    assert spread[0, 0] == spread[0, 1] == 0
    assert sympy.expand(sympy.nsimplify(spread[1, 1] - (0.04 + 9.25 * rate))) == 0


def test_mean_velocity_and_spread_of_the_flip_process():
    system = zoo.flip_process()
    (q,) = system.state
    rate = 0.3 + 0.2 * q**2
    velocity, spread = system.moment_expressions
    assert sympy.expand(sympy.nsimplify(velocity[0] - (q - q**3 - 2 * q * rate))) == 0
    expected = 0.25 + rate * (4 * q**2 + 0.09)
    assert sympy.expand(sympy.nsimplify(spread[0, 0] - expected)) == 0


def test_readings_of_the_van_der_pol_oscillator():
    systems = {letter: zoo.van_der_pol(letter) for letter in "ABCDEFGHIJKLM"}
    default = systems["A"]
    x1, x2 = default.state
    stiffness = sympy.pi**2 / 100
    assert sympy.expand(default.drift_expressions[1] + stiffness * x1 - 2 * x2 * (1 - x1**2)) == 0
    assert default.diffusion_expressions.tolist() == [[0], [x1]]
    assert systems["B"].diffusion_expressions[1, 0] == x2
    assert systems["C"].diffusion_expressions[1, 0] == 1
    assert systems["G"].cov0[0, 0] == pytest.approx(0.0225)
    assert systems["H"].sensor.noise.cov[0, 0] == 0.1
    assert systems["M"].drift_expressions[1].subs({x1: 1, x2: 0}) == -1
    with pytest.raises(ValueError, match="reading: wanted a letter"):
        zoo.van_der_pol("Z")


# Laws of the simulated paths


@pytest.mark.parametrize("scheme", ["euler", "heun"])
def test_linear_system_has_its_exact_moments(scheme):
    system = zoo.linear_gaussian()
    run = system.simulate([0.0, 1.0], 40_000, 5, step=0.02, scheme=scheme)
    drift = np.array([[0, 1], [-1, -0.4]])
    phi = expm(drift)
    grid = np.linspace(0, 1, 2001)
    columns = np.array([expm(drift * (1 - u))[:, 1] for u in grid])
    spread = np.trapezoid(columns[:, :, None] * columns[:, None, :], grid, axis=0)
    cov = phi @ phi.T + spread
    error = 4 * np.sqrt(2 / 40_000)
    np.testing.assert_allclose(
        run.states[1].mean(axis=1), phi @ [1, -0.5], atol=4 * np.sqrt(cov.max() / 40_000) + 0.005
    )
    np.testing.assert_allclose(np.cov(run.states[1]), cov, atol=cov.max() * error + 0.015)
    residual = run.measurements[1, 0] - run.states[1, 0]
    np.testing.assert_allclose(residual.var(), 0.25, atol=0.25 * error)


def test_frozen_state_has_the_exact_law_of_the_first_jump():
    """With X ~ N(0, 1) and intensity X² the chance of no jump up to t is (1 + 2 t)^(-1/2)."""
    count = sympy.Symbol("count")
    system = JumpDiffusion(
        (x, count), [0, 0], [[0], [0]], [x + v], Noise((v,)), [0, 0], [[1, 0], [0, 0]],
        intensity=x**2, jump=[0, 1], step=0.001,
    )  # fmt: skip
    times = [0.0, 0.5, 1.0]
    paths = 40_000
    none = (system.simulate(times, paths, 3).states[:, 1] == 0).mean(axis=1)
    for got, time in zip(none[1:], times[1:], strict=True):
        want = (1 + 2 * time) ** -0.5
        assert abs(got - want) < 4 * np.sqrt(want * (1 - want) / paths)


def test_flip_process_at_time_one():
    """Moments of a fine grid solution of the Kolmogorov-Feller equation."""
    x1 = zoo.flip_process().simulate([0.0, 1.0], 60_000, 11).states[1, 0]
    for power, want in ((1, 0.30208), (2, 0.86930), (4, 1.03817)):
        sample = x1**power
        # the second term is the bias of the Euler step 0.0025
        assert abs(sample.mean() - want) < 4 * sample.std() / np.sqrt(len(x1)) + 0.003
    assert abs((x1 < 0).mean() - 0.33358) < 4 * np.sqrt(0.2223 / len(x1)) + 0.002


def test_jumps_are_drawn_at_the_state_before_them():
    """A jump of -X sends the path to its own increment only."""
    system = scalar(intensity=400, jump=[-x], step=0.001, mean0=[5.0])
    with pytest.warns(UserWarning, match=r"about 0\.2 of the jumps would come second"):
        final = system.simulate([0.0, 0.5], 200, 0).states[1, 0]
    assert (final == 0).all()


@pytest.mark.parametrize("scheme", ["euler", "heun"])
def test_both_schemes_are_ito(scheme):
    """For dX = X dW the Itô mean stays 1; the Stratonovich mean would be exp(1/2)."""
    end = scalar(diffusion=x).simulate([0.0, 1.0], 40_000, 9, scheme=scheme).states[1, 0]
    assert abs(end.mean() - 1) < 4 * end.std() / np.sqrt(len(end))


def test_heun_is_of_second_order_without_noise():
    exact = np.exp(-1.0)
    errors = [
        abs(scalar(drift=-x).simulate([0, 1], 1, 0, step=h, scheme="heun").states[1, 0, 0] - exact)
        for h in (0.1, 0.05)
    ]
    assert 3.5 < errors[0] / errors[1] < 4.5


def test_time_dependent_drift():
    clock = sympy.Symbol("clock")
    for symbol, options in ((t, {}), (clock, {"time": clock})):
        system = scalar(drift=2 * symbol, **options)
        end = system.simulate([0.0, 2.0], 1, 0, step=1e-3).states[1, 0, 0]
        assert end == pytest.approx(5.0, abs=2.1e-3)


# What the numbers may depend on


@pytest.mark.parametrize("name", ["van_der_pol", "kicked_duffing"])
def test_paths_depend_neither_on_threads_nor_on_how_many_follow(name):
    system = getattr(zoo, name)()
    times = [0.0, 0.3, 0.5]
    whole = system.simulate(times, 9000, 7)
    for paths, workers in ((9000, 2), (8500, 1), (3, 1), (1, 1)):
        part = system.simulate(times, paths, 7, workers=workers)
        np.testing.assert_array_equal(part.states, whole.states[..., :paths])
        np.testing.assert_array_equal(part.measurements, whole.measurements[..., :paths])
    assert not np.array_equal(system.simulate(times, 3, 8).states, whole.states[..., :3])


def test_advance_keeps_the_batch_shape_and_its_argument():
    system = zoo.kicked_duffing()
    states = np.ones((2, 4, 3))
    moved = system.advance(states, 0.0, 0.1, np.random.default_rng(0))
    assert moved.shape == (2, 4, 3)
    assert (states == 1).all()
    flat = system.advance(states.reshape(2, 12), 0.0, 0.1, np.random.default_rng(0))
    np.testing.assert_array_equal(moved.reshape(2, 12), flat)


def test_array_functions_give_the_paths_of_the_symbolic_system():
    symbolic = zoo.kicked_duffing()
    numeric = JumpDiffusion.from_functions(
        lambda t, x: np.stack([x[1], x[0] - x[0] ** 3 - 0.5 * x[1]]),
        lambda t, x: np.stack([np.zeros_like(x[:1]), np.full_like(x[:1], 0.2)]),
        StochasticMap.from_functions(
            2, 1, lambda t, x, v: (x[0] * (1 + 0.2 * v[0]) + v[1])[None], Noise(2)
        ),
        [1, 0],
        0.1 * np.eye(2),
        intensity=lambda t, x: 0.2 + 0.2 * x[0] ** 2,
        jump=StochasticMap.from_functions(
            2, 2, lambda t, x, z: np.stack([0 * x[0], 0.5 + 3 * z[0]]), Noise(1)
        ),
    )
    a, b = (q.simulate([0.0, 0.5, 1.0], 50, 4) for q in (symbolic, numeric))
    np.testing.assert_allclose(a.states, b.states, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(a.measurements, b.measurements, rtol=1e-10, atol=1e-12)
    states = np.random.default_rng(0).standard_normal((2, 5))
    none = np.empty((0, 5))
    for one, two in (
        (symbolic.drift_map, numeric.drift_map),
        (symbolic.spread_map, numeric.spread_map),
    ):
        np.testing.assert_allclose(
            one.value(0, states, none), two.value(0, states, none), rtol=1e-9
        )
    np.testing.assert_allclose(symbolic.intensity(0, states), numeric.intensity(0, states))
    with pytest.raises(ValueError, match="heun wants a symbolic system"):
        numeric.simulate([0.0, 1.0], 2, 0, scheme="heun")


def test_jump_without_closed_moments_is_averaged_by_nodes():
    system = scalar(intensity=1, jump=[sympy.sqrt(1 + z**2)], marks=Noise((z,)))
    assert not system.drift_map.symbolic
    got = system.drift_map.value(0, np.zeros((1, 1)), np.empty((0, 1)))
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    want = np.sqrt(1 + nodes**2) @ weights / weights.sum()
    assert got[0, 0] == pytest.approx(want, abs=2e-3)


def test_initial_law_may_be_given():
    system = scalar(initial=lambda rng, count: rng.uniform(0, 2, (1, count)), cov0=[[1 / 3]])
    start = system.simulate([0.0], 10_000, 0).states[0, 0]
    assert start.min() >= 0
    assert start.max() <= 2
    assert start.mean() == pytest.approx(1, abs=4 / np.sqrt(30_000))
    assert not system.law.gaussian
    assert scalar().law.gaussian


# Bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"drift": s * x}, "drift: wanted known symbols, got s; see parameters"),
        ({"intensity": 1}, "jump, intensity: wanted both or neither"),
        ({"jump": [x]}, "jump, intensity: wanted both or neither"),
        ({"intensity": 1, "jump": [x, x]}, r"jump: wanted shape \(1\), got \(2,\)"),
        ({"intensity": 1, "jump": [z]}, "jump: wanted known symbols, got z"),
        ({"mean0": [0, 0]}, r"mean0: wanted shape \(1\), got \(2,\)"),
        ({"cov0": [[-1]]}, "cov0: wanted a positive semidefinite"),
        ({"step": 0}, "step: wanted a positive number"),
    ],
)
def test_bad_declarations(options, message):
    with pytest.raises(ValueError, match=message):
        scalar(**options)


def test_bad_shapes_of_drift_and_diffusion():
    with pytest.raises(ValueError, match=r"drift: wanted shape \(2\)"):
        JumpDiffusion((x, y), [x], [[0], [0]], [x + v], Noise((v,)), [0, 0], np.eye(2))
    with pytest.raises(ValueError, match=r"diffusion: wanted shape \(2, any\)"):
        JumpDiffusion((x, y), [x, y], [0, 0], [x + v], Noise((v,)), [0, 0], np.eye(2))
    with pytest.raises(TypeError, match="drift: wanted SymPy expressions"):
        JumpDiffusion((x,), ["x +"], [[0]], [x + v], Noise((v,)), [0], [[1]])
    with pytest.raises(ValueError, match=r"drift: wanted shape \(1, 3\)"):
        JumpDiffusion.from_functions(
            lambda t, x: x[0], lambda t, x: np.ones((1, 1, x.shape[1])),
            StochasticMap((x,), [x + v], Noise((v,))), [0.0], [[1.0]],
        )  # fmt: skip


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scheme": "milstein"}, "scheme: wanted one of euler, heun, got 'milstein'"),
        ({"step": -1.0}, "step: wanted a positive number, got -1"),
    ],
)
def test_bad_options_of_simulation(options, message):
    with pytest.raises(ValueError, match=message):
        scalar().simulate([0.0, 1.0], 2, 0, **options)


@pytest.mark.parametrize(("rate", "got"), [(-1, "-1"), (1 / (1 - x), "inf|zoo|nan")])
def test_bad_intensities_are_found_when_they_occur(rate, got):
    system = scalar(intensity=rate, jump=[1])
    with (
        np.errstate(divide="ignore"),
        pytest.raises(
            ValueError, match=f"intensity: wanted finite nonnegative numbers, got ({got})"
        ),
    ):
        system.simulate([0.0, 1.0], 2, 0)


def test_time_must_go_forward():
    with pytest.raises(ValueError, match="stop: wanted a time after 1, got 1"):
        scalar().advance(np.ones((1, 2)), 1.0, 1.0, np.random.default_rng(0))


def test_parameters_are_put_in():
    system = scalar(drift=s * x, parameters={s: 3})
    assert system.drift_expressions[0] == 3 * x
    assert system.drift(0.0, np.array([[2.0, 1.0]])).tolist() == [[6, 3]]
