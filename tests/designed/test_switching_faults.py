"""What once went wrong in filters of switching systems, or easily might."""

import pickle
import warnings

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base.semidefinite import mended
from seedslib.design import synthesize
from seedslib.designed import Memory, SwitchingFilter, finite_memory, large_order
from seedslib.filters import KnownModeFilter
from seedslib.filters.mixture import mix
from seedslib.linearization import Cubature, ExactGaussian, Taylor, Unscented
from seedslib.models import Noise, StochasticMap, SwitchingSystem

pytestmark = pytest.mark.filterwarnings("ignore:paths. .* too few paths of their own")

X, V, W = sympy.symbols("x v w", real=True)


def jump_linear(modes, n, m, *, exact=True, unit=1.0, noise_free=False, cov0=1.0, seed=1):
    """Random jump-linear system; without noise, its last state and measurement have none."""
    rng = np.random.default_rng(seed)
    x, v, w = (
        sympy.Matrix(sympy.symbols(f"{s}1:{k + 1}")) for s, k in zip("xvw", (n, n, m), strict=True)
    )
    moves, shown = [], []
    for _ in range(modes):
        turn = 0.7 * np.linalg.qr(rng.standard_normal((n, n)))[0]
        push = 0.3 * rng.standard_normal((n, n)) + 0.3 * np.eye(n)
        blur = np.diag(rng.uniform(0.3, 1.5, m))
        if noise_free:
            push[-1], blur[-1] = 0.0, 0.0
        drive, show = rng.standard_normal(n), rng.standard_normal((m, n))
        moves.append(list(_sum(turn, x) + unit * (_sum(push, v) + sympy.Matrix(drive.tolist()))))
        shown.append(list(_sum(show, x) + unit * _sum(blur, w)))
    switch = rng.dirichlet(np.full(modes, 2.0), modes)
    told = np.eye(modes) if exact else rng.dirichlet(np.ones(modes), modes)
    initial = [(1 / modes, np.zeros(n), cov0 * unit**2 * np.eye(n))] * modes
    return SwitchingSystem(
        list(x), moves, Noise(list(v)), switch.tolist(), shown, Noise(list(w)), initial,
        indicator=told.tolist(),
    )  # fmt: skip


def _sum(numbers, symbols):
    return sympy.Matrix(numbers.tolist()) * symbols


@pytest.mark.parametrize(
    ("modes", "n", "m", "unit"),
    [(2, 1, 1, 1e-6), (2, 1, 1, 1e6), (3, 1, 3, 1e-6), (1, 2, 1, 1.0), (2, 3, 2, 1.0)],
)
@pytest.mark.parametrize("noise_free", [False, True])
def test_exact_indicator_is_the_kalman_filter_in_any_unit(modes, n, m, unit, noise_free):
    """Without a warning: a variance of zero, or of 1e-12, is as good as any other."""
    system = jump_linear(modes, n, m, unit=unit, noise_free=noise_free, cov0=float(not noise_free))
    data = system.simulate(3.0 + 0.7 * np.arange(13), 20, 7)
    best = KnownModeFilter(system, Taylor()).run(
        data.times, data.measurements, modes=data.modes, indicators=data.indicators
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = SwitchingFilter(system, Taylor()).run(
            data.times, data.measurements, indicators=data.indicators
        )
    np.testing.assert_array_equal(found.modes, data.modes)
    np.testing.assert_allclose(found.mean, best.mean, atol=1e-12 * np.abs(best.mean).max())


def test_noisy_indicator_puts_the_filters_in_their_order():
    """The optimal filter's normal form before memory of estimates before memory of measurements."""
    system, times = jump_linear(3, 2, 2, exact=False, seed=5), np.arange(13.0)
    data = system.simulate(times, 1000, 7)
    filters = [SwitchingFilter(system, Taylor())] + [
        synthesize(system, memory, Taylor(), times, paths=4000, seed=3)
        for memory in (large_order(1), finite_memory(1))
    ]
    error, wrong = [], []
    for filter in filters:
        found = filter.run(times, data.measurements, indicators=data.indicators)
        error.append(np.square(found.mean - data.states)[5:].sum(axis=1).mean())
        wrong.append((found.modes != data.modes)[5:].mean())
    assert error == sorted(error)
    assert wrong == sorted(wrong)
    assert error[2] < 4 * error[0]


def test_designs_do_not_depend_on_the_unit():
    times, found = np.arange(5.0), []
    for unit in (1.0, 1e-30, 1e30):
        system = jump_linear(2, 2, 1, exact=False, unit=unit)
        data = system.simulate(times, 50, 7)
        filter = synthesize(system, Memory(2, 1), Taylor(), times, paths=2000, seed=3)
        found.append(filter.run(times, data.measurements, indicators=data.indicators).mean / unit)
    np.testing.assert_allclose(found[1], found[0], atol=1e-11)
    np.testing.assert_allclose(found[2], found[0], atol=1e-11)


def test_mended_covariances():
    """Each item alone and in its own units; semidefinite ones pass, NaN stays."""
    tiny, bad = np.diag([1e-40, 1e40]), np.array([[1.0, 2.0], [2.0, 1.0]])
    singular = np.outer([3.0, 1e-5], [3.0, 1e-5])
    lost = np.array([[1.0, np.nan], [np.nan, 1.0]])
    cov = np.stack([tiny, bad, singular, np.zeros((2, 2)), lost, 1e-20 * bad], axis=-1)
    found, count = mended(cov)
    assert count == 2
    for k in (0, 3, 4):
        np.testing.assert_array_equal(found[..., k], cov[..., k])
    np.testing.assert_allclose(found[..., 2], singular, rtol=1e-12)
    np.testing.assert_allclose(found[..., 1], np.full((2, 2), 1.5), rtol=1e-11)
    np.testing.assert_allclose(found[..., 5], 1e-20 * found[..., 1], rtol=1e-12)
    assert np.linalg.eigvalsh(found[..., 1])[0] > 0


def test_rounding_of_a_posterior_is_no_fault():
    """A variance of -1e-17 where it was one is zero; -0.1 is a fault."""
    found, count = mended(np.array([[[-1e-17, -0.1, 0.5]]]), np.ones((1, 3)))
    assert count == 1
    np.testing.assert_allclose(found[0, 0], [0.0, 1e-12, 0.5], rtol=1e-9)


def test_parts_of_negative_mass_count_for_nothing():
    mass, mean = np.array([0.5, -0.25, 0.25]), np.array([[1.0, 50.0, 4.0]])
    found = mix(mass, mean, np.array([[[1.0, -7.0, 1.0]]]))
    assert found.mass == pytest.approx(0.75)
    assert found.mean[0] == pytest.approx(2.0)
    assert found.cov[0, 0] == pytest.approx(1.0 + 2.0)


@pytest.mark.parametrize("system", [zoo.dependent_switching(), zoo.scalar_switching("A2")])
def test_rules_with_negative_weights_lose_no_path(system):
    data = system.simulate(np.arange(12.0), 400, 3)
    with pytest.warns(UserWarning, match="covariances: eigenvalues of"):
        found = SwitchingFilter(system, Unscented(alpha=0.3, beta=2.0, kappa=0.0)).run(
            data.times, data.measurements, indicators=data.indicators, covariances=True
        )
    assert not found.diverged.any()
    assert found.cov.min() >= 0
    np.testing.assert_allclose(found.mode_prob.sum(axis=1), 1.0, rtol=1e-12)
    assert np.sqrt(np.square(found.mean - data.states).mean()) < np.sqrt(
        np.square(data.states).mean()
    )


def cubic(indicator):
    return SwitchingSystem(
        (X,), [[X**3 + V], [X / 2 + V]], Noise((V,)), [[0.9, 0.1], [0.5, 0.5]], [[X + W]] * 2,
        Noise((W,)), [(0.5, [0], [[1]])] * 2,
        indicator=[[0.9, 0.1], [0.2, 0.8]] if indicator else None,
    )  # fmt: skip


@pytest.mark.parametrize("indicator", [False, True])
def test_lost_paths_are_marked_and_leave_the_others_alone(indicator):
    filter, times = SwitchingFilter(cubic(indicator), Taylor()), np.arange(12.0)
    y = np.zeros((12, 1, 3))
    y[:, 0, 1] = 1e110
    shown = np.zeros((12, 3), dtype=int) if indicator else None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = filter.run(times, y, indicators=shown, covariances=True)
        whole = filter.run(times, y[..., :1], indicators=None if shown is None else shown[:, :1])
    np.testing.assert_array_equal(found.diverged, [False, True, False])
    np.testing.assert_array_equal(found.mean[..., 0], whole.mean[..., 0])


@pytest.mark.filterwarnings("ignore:held out:UserWarning")
def test_lost_paths_of_a_design_are_left_out():
    """States beyond 3 leave the range of numbers, and so do points of the filter there."""

    def moves(t, x, v):
        return np.where(np.abs(x) > 3.0, np.inf, x / 2 + v)

    system = SwitchingSystem.from_maps(
        [[StochasticMap.from_functions(1, 1, moves, Noise(1))]],
        [[StochasticMap.from_functions(1, 1, lambda t, x, w: x + w, Noise(1))]],
        [(1, [0], [[1]])],
    )
    with pytest.warns(UserWarning, match="design paths diverged and were left out"):
        filter = synthesize(system, large_order(1), Cubature(), np.arange(5.0), paths=4000, seed=1)
    assert 0 < filter.design.diverged < 400
    assert f"{filter.design.diverged} diverged paths left out" in str(filter)
    assert all(np.isfinite(part[..., 0]).all() for fit in filter.fits for part in fit)
    all_lost = SwitchingSystem(
        (X,), [[1e120 * (X**2 + 1)]], Noise((V,)), [[1]], [[X + W]], Noise((W,)), [(1, [0], [[1]])]
    )
    with pytest.raises(ValueError, match="paths: wanted"):
        synthesize(all_lost, large_order(1), Taylor(), np.arange(4.0), paths=100, seed=1)


def test_used_systems_and_filters_travel():
    for system in (zoo.dependent_switching(), zoo.manoeuvring_target()):
        data = system.simulate(np.arange(4.0), 30, 1)
        for branch in (b for row in system.readings for b in row):
            branch.log_density(0.0, data.measurements[0], data.states[0])
        copy = pickle.loads(pickle.dumps(system))
        again = copy.simulate(data.times, 30, 1)
        np.testing.assert_array_equal(again.measurements, data.measurements)
    for filter in (
        SwitchingFilter(system, Taylor()),
        synthesize(system, large_order(1), Taylor(), data.times, paths=2000, seed=1),
    ):
        copy = pickle.loads(pickle.dumps(filter))
        a, b = (
            f.run(data.times, data.measurements, indicators=data.indicators) for f in (copy, filter)
        )
        np.testing.assert_array_equal(a.mean, b.mean)


def test_rules_are_compiled_once_for_a_system():
    system = zoo.steady_target()
    one, other = (SwitchingFilter(system, Taylor()) for _ in range(2))
    assert one.rules is other.rules
    assert SwitchingFilter(zoo.steady_target(), Taylor()).rules is not one.rules
    assert SwitchingFilter(system, Unscented()).rules is not one.rules


@pytest.mark.parametrize("make", [zoo.steady_target, zoo.manoeuvring_target])
def test_no_paths_give_no_estimates(make):
    system = make()
    shown = np.zeros((3, 0), dtype=int) if system.indicators else None
    for filter in (
        SwitchingFilter(system, Taylor()),
        synthesize(system, Memory(1), Taylor(), np.arange(3.0), paths=3000, seed=1),
    ):
        found = filter.run(np.arange(3.0), np.zeros((3, 1, 0)), indicators=shown)
        assert found.mean.shape == (3, 2, 0)
        assert found.modes.shape == (3, 0)


def test_fits_of_others_forecast_but_do_not_compare():
    class Foreign:
        def __init__(self, fit):
            self.forecast = fit.forecast

    system, times = zoo.manoeuvring_target("noisy"), np.arange(5.0)
    data = system.simulate(times, 5, 1)
    made = synthesize(system, Memory(1, 1), Taylor(), times, paths=2000, seed=1)
    foreign = SwitchingFilter(
        system, Taylor(), made.memory, times=times, fits=[Foreign(fit) for fit in made.fits]
    )
    a, b = (
        f.run(times, data.measurements, indicators=data.indicators).mean for f in (made, foreign)
    )
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("system", "memory", "message"),
    [
        (zoo.steady_target(), Memory(1, log_odds=True), "memory: wanted several modes"),
        (zoo.scalar_switching(), Memory(1, indicators=1), "memory: wanted no indicators"),
    ],
)
def test_designs_refuse_to_remember_what_is_not_there(system, memory, message):
    with pytest.raises(ValueError, match=message):
        synthesize(system, memory, Taylor(), np.arange(3.0), paths=500, seed=1)


@pytest.mark.parametrize("option", [{"components": 1}, {"horizon": 4.0}, {"measured_nodes": True}])
def test_options_of_other_systems_are_not_passed_over(option):
    with pytest.raises(ValueError, match=f"{next(iter(option))}: wanted none for a switching"):
        synthesize(
            zoo.steady_target(), Memory(1), Taylor(), np.arange(3.0), paths=500, seed=1, **option
        )


@pytest.mark.parametrize("paths", [8192, 8193])
def test_paths_do_not_depend_on_their_block(paths):
    system = zoo.scalar_switching("A1H")
    data = system.simulate(np.arange(3.0), 8194, 1)
    filter = SwitchingFilter(system, ExactGaussian())
    whole = filter.run(data.times, data.measurements)
    found = filter.run(data.times, data.measurements[..., :paths], workers=2)
    np.testing.assert_array_equal(found.mean, whole.mean[..., :paths])
    alone = filter.run(data.times, data.measurements[..., paths])
    np.testing.assert_allclose(alone.mean, whole.mean[..., paths], rtol=1e-12)
