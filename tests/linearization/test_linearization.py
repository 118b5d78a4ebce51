import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import correct
from seedslib.base.semidefinite import factor
from seedslib.filters import CovarianceFilter
from seedslib.gaussian import NoClosedForm
from seedslib.linearization import (
    Cubature,
    ExactGaussian,
    GaussHermite,
    Linearization,
    Moments,
    Taylor,
    Unscented,
    Weighted,
)
from seedslib.models import DiscreteSystem, Noise, StochasticMap

x, y, v, w = sympy.symbols("x y v w")
MODELS = ("van_der_pol", "kicked_duffing", "flip_process", "linear_gaussian")
RULES = (Taylor(), ExactGaussian(), Unscented(), Cubature(), GaussHermite())


def laws(n, count=6, seed=0):
    """Random means and covariances, shapes (n, count) and (n, n, count)."""
    rng = np.random.default_rng([seed, n])
    root = rng.standard_normal((n, n, count))
    return rng.standard_normal((n, count)), 0.4 * np.einsum("ik...,jk...->ij...", root, root)


def flatten(result):
    if isinstance(result, Weighted):
        return [result.mass, *result.state, *result.value]
    return [part for part in result if part is not None]


def assert_close(got, want, **tolerance):
    for a, b in zip(flatten(got), flatten(want), strict=True):
        a, b = np.broadcast_arrays(*(np.asarray(part) for part in (a, b)))
        np.testing.assert_allclose(a, b, **tolerance)


# Closed forms of the models, first against the printed formulas, then against quadrature


def symbols_of(system):
    n = system.state_size
    m = sympy.symbols(f"m1:{n + 1}", real=True)
    d = sympy.Matrix(n, n, lambda i, j: sympy.Symbol(f"D{min(i, j) + 1}{max(i, j) + 1}", real=True))
    return list(m), d


def vanishes(expression):
    return sympy.simplify(sympy.nsimplify(sympy.expand(expression))) == 0


@pytest.mark.parametrize(("rule", "exact"), [(ExactGaussian(), 1), (Taylor(), 0)])
def test_kicked_oscillator_as_printed(rule, exact):
    """Section 8.2; the linearised functions are those with D11 -> 0 in tau, A and mu."""
    system = zoo.kicked_duffing(0.5, 0.2, (0.2, 0.3), (0.5, 3.0), (0.2, 1.0))
    (m1, m2), d = symbols_of(system)
    e = exact * d[0, 0]
    rate = 0.2 + 0.3 * (m1**2 + e)
    tau = sympy.Matrix([m2, m1 - m1**3 - 3 * m1 * e - 0.5 * m2 + 0.5 * rate])
    slope = sympy.Matrix([[0, 1], [1 - 3 * m1**2 - 3 * e + 2 * 0.5 * 0.3 * m1, -0.5]])
    theta = sympy.Matrix([[0, 0], [0, 0.2**2 + (3.0**2 + 0.5**2) * rate]])
    velocity, change = rule.rate_formulas(system, [m1, m2], d)
    want = slope * d + d * slope.T + theta
    assert all(map(vanishes, velocity - tau))
    assert all(map(vanishes, change - want))
    h, cross, spread = rule.formulas(system.sensor, [m1, m2], d)
    assert vanishes(h[0] - m1)
    assert all(map(vanishes, cross - d[:, 0]))
    assert vanishes(spread[0] - (d[0, 0] + 0.2**2 * (m1**2 + e) + 1))


@pytest.mark.parametrize(("rule", "exact"), [(ExactGaussian(), 1), (Taylor(), 0)])
def test_flip_process_as_printed(rule, exact):
    """Section 8.3."""
    system = zoo.flip_process(0.5, (0.3, 0.2), 2.0, 0.3, (0.3, 0.5))
    (m,), cov = symbols_of(system)
    d = cov[0, 0]
    e = exact * d
    tau = m - (1 + 2 * 0.2) * (m**3 + 3 * m * e) - 2 * 0.3 * m
    slope = 1 - 2 * 0.3 - (1 + 2 * 0.2) * (3 * m**2 + 3 * e)
    theta = 0.25 + 0.3 * 0.09 + (0.3 * 4 + 0.2 * 0.09) * (m**2 + e)
    theta += 0.2 * 4 * (m**4 + 6 * m**2 * e + 3 * e**2)
    velocity, change = rule.rate_formulas(system, [m], cov)
    assert vanishes(velocity[0] - tau)
    assert vanishes(change[0] - (2 * slope * d + theta))
    assert vanishes(rule.formulas(system.sensor, [m], cov)[2][0] - (d + 0.09 * (m**2 + e) + 0.25))


def test_van_der_pol_as_derived():
    """Sections 8.1 and 6: h, G and F of (6.1), tau, A and Theta of (8.3)."""
    system = zoo.van_der_pol()
    (m1, m2), d = symbols_of(system)
    d11, d12 = d[0, 0], d[0, 1]
    h, cross, spread = ExactGaussian().formulas(system.sensor, [m1, m2], d)
    gain = sympy.Matrix([[2 * m1, 0], [0, 1]])
    assert all(map(vanishes, h - sympy.Matrix([m1**2 + d11, m2])))
    assert all(map(vanishes, cross - d * gain.T))
    want = gain * d * gain.T + sympy.diag(1 + 2 * d11**2, 1)
    assert all(map(vanishes, spread - want))
    cubic = m1**2 * m2 + m2 * d11 + 2 * m1 * d12
    tau = sympy.Matrix([m2, -(sympy.pi**2) / 100 * m1 + 2 * m2 - 2 * cubic])
    velocity, change = ExactGaussian().rate_formulas(system, [m1, m2], d)
    assert all(sympy.expand(part) == 0 for part in velocity - tau)
    slope = tau.jacobian([m1, m2])
    want = slope * d + d * slope.T + sympy.diag(0, m1**2 + d11)
    assert all(sympy.expand(part) == 0 for part in change - want)


@pytest.mark.parametrize("name", MODELS)
def test_exact_means_against_quadrature(name):
    system = getattr(zoo, name)()
    law = laws(system.state_size)
    for make in ("moments", "flow"):
        given = system.sensor if make == "moments" else system
        got, want = (
            getattr(rule, make)(given)(0.0, *law) for rule in (ExactGaussian(), GaussHermite(10))
        )
        assert_close(got, want, rtol=1e-10, atol=1e-10)


def test_exact_means_beyond_polynomials():
    """Sines, exponentials and noise inside them against 60 x 60 nodes."""
    curved = StochasticMap((x, y), [sympy.sin(x + v) * y, sympy.exp(-(x**2)) + w], Noise((v, w)))
    mean, cov = laws(2, 4)
    cov = cov / 4  # the rule converges slowly where exp(-x²) is narrow against the law of x
    got = ExactGaussian().moments(curved)(0.0, mean, cov)
    assert_close(got, GaussHermite(60).moments(curved)(0.0, mean, cov), rtol=1e-9, atol=1e-10)


# The approximations


@pytest.mark.parametrize("name", MODELS)
def test_taylor_against_finite_differences(name):
    """(7.1) with the noise Jacobian, by central differences of the sensor."""
    sensor = getattr(zoo, name)().sensor
    mean, cov = laws(sensor.state_size)
    got = Taylor().moments(sensor)(0.0, mean, cov)
    n, q = len(mean), sensor.noise.size
    step = 1e-6

    def value(dx, dv):
        noise = sensor.noise.mean[:, None] + np.outer(dv, np.ones(mean.shape[1]))
        return sensor.value(0.0, mean + np.asarray(dx)[:, None], noise)

    zero = np.zeros(q), np.zeros(n)
    c = np.stack(
        [(value(e, zero[0]) - value(-e, zero[0])) / (2 * step) for e in step * np.eye(n)], 1
    )
    cv = np.stack(
        [(value(zero[1], e) - value(zero[1], -e)) / (2 * step) for e in step * np.eye(q)], 1
    )
    spread = np.einsum("ij...,jk...,lk...->il...", c, cov, c)
    spread = spread + np.einsum("ij...,jk,lk...->il...", cv, sensor.noise.cov, cv)
    want = Moments(value(zero[1], zero[0]), np.einsum("ij...,kj...->ik...", cov, c), spread)
    assert_close(got, want, rtol=1e-7, atol=1e-7)


def test_taylor_equals_exact_means_of_a_linear_system():
    system = zoo.linear_gaussian()
    law = laws(2)
    assert_close(
        Taylor().moments(system.sensor)(0, *law), ExactGaussian().moments(system.sensor)(0, *law)
    )
    assert_close(Taylor().flow(system)(0, *law), ExactGaussian().flow(system)(0, *law))


def test_sigma_points_of_a_square():
    """Remark 3: cubature misses part of the variance of x², unscented(1, 0, 1) does not."""
    square = StochasticMap((x, y), [x**2 + v], Noise((v,)))
    mean, cov = laws(2)
    exact = ExactGaussian().moments(square)(0, mean, cov)
    cubature = Cubature().moments(square)(0, mean, cov)
    np.testing.assert_allclose(cubature.mean, exact.mean, rtol=1e-12)
    np.testing.assert_allclose(cubature.cross, exact.cross, rtol=1e-12, atol=1e-12)
    assert (cubature.cov < exact.cov - 1e-3).all()
    assert_close(Unscented(1, 0, 1).moments(square)(0, mean, cov), exact, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("rule", [Unscented(0.5, 2, 0), Unscented(), Cubature(), GaussHermite(3)])
@pytest.mark.parametrize("size", [1, 2, 4])
def test_points_have_the_first_two_moments(rule, size):
    points, weights, centred = rule.rule(size)
    assert weights.sum() == pytest.approx(1)
    np.testing.assert_allclose(points @ weights, 0, atol=1e-13)
    np.testing.assert_allclose(
        np.einsum("is,js,s->ij", points, points, centred), np.eye(size), atol=1e-12
    )


def test_unscented_without_reach_is_refused():
    with pytest.raises(ValueError, match="alpha, kappa: wanted"):
        Unscented(kappa=-2).rule(2)
    with pytest.raises(ValueError, match="order: wanted at least 1, got 0"):
        GaussHermite(0)


@pytest.mark.parametrize("rule", RULES)
def test_singular_covariance_is_legal(rule):
    sensor = zoo.van_der_pol().sensor
    mean = np.array([1.0, -0.5])
    got = rule.moments(sensor)(0, mean, np.array([[0.0, 0.0], [0.0, 0.3]]))
    np.testing.assert_allclose(got.mean, [1, -0.5], atol=1e-12)
    np.testing.assert_allclose(got.cross, [[0, 0], [0, 0.3]], atol=1e-12)
    np.testing.assert_allclose(got.cov, [[1, 0], [0, 1.3]], atol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_batches_of_any_shape(rule):
    system = zoo.van_der_pol()
    mean, cov = laws(2, 6)
    for f in (rule.moments(system.sensor), rule.flow(system)):
        whole = f(0, mean, cov)
        folded = f(0, mean.reshape(2, 2, 3), cov.reshape(2, 2, 2, 3))
        for a, b in zip(flatten(whole), flatten(folded), strict=True):
            wide = np.broadcast_to(a, (*a.shape[: b.ndim - 2], *a.shape[b.ndim - 2 :]))
            np.testing.assert_allclose(wide.reshape(b.shape), b, rtol=1e-14)
        one = f(0, mean[:, 1], cov[..., 1])
        for a, b in zip(flatten(whole), flatten(one), strict=True):
            np.testing.assert_allclose(
                a[..., 1] if a.ndim > b.ndim else a, b, rtol=1e-13, atol=1e-15
            )


def test_common_covariance_stays_common():
    system = zoo.linear_gaussian()
    mean, cov = laws(2, 5)
    for rule in (Taylor(), ExactGaussian()):
        got = rule.moments(system.sensor)(0, mean, cov[..., 0])
        assert got.mean.shape == (1, 5)
        assert got.cross.shape == (2, 1)
        assert got.cov.shape == (1, 1)


def test_spread_only_where_it_is_wanted():
    law = laws(2)
    for rule in RULES:
        assert rule.moments(zoo.van_der_pol().sensor, spread=False)(0, *law).cov is None


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", MODELS)
def test_rates_on_components_are_those_of_the_flow(rule, name):
    system = getattr(zoo, name)()
    mean, cov = laws(system.state_size)
    rows, columns = np.tril_indices(len(mean))
    components = [*mean, *cov[rows, columns]]
    got = rule.rate(system)(0.0, components)
    want = Linearization.rate(rule, system)(0.0, components)
    for a, b in zip(got, want, strict=True):
        np.testing.assert_allclose(np.broadcast_to(a, b.shape), b, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("rule", [Unscented(1, 0, 0), Cubature(), GaussHermite(7)])
def test_points_cover_the_noise_of_array_functions(rule):
    """The same sensor without its conditional moments: points in the joint space."""
    symbolic = zoo.kicked_duffing().sensor
    numeric = StochasticMap.from_functions(2, 1, symbolic.value, symbolic.noise)
    law = laws(2)
    got, want = (rule.moments(sensor)(0, *law) for sensor in (numeric, symbolic))
    np.testing.assert_allclose(got.mean, want.mean, rtol=1e-11)
    np.testing.assert_allclose(got.cross, want.cross, rtol=1e-10, atol=1e-12)
    if isinstance(rule, GaussHermite):
        assert_close(got, want, rtol=1e-10, atol=1e-12)
    known = StochasticMap.from_functions(
        2, 1, symbolic.value, symbolic.noise, mean=symbolic.conditional.mean,
        cov=symbolic.conditional.cov,
    )  # fmt: skip
    assert_close(rule.moments(known)(0, *law), want, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("rule", [Taylor(), ExactGaussian()])
def test_formulas_refuse_array_functions_and_offer_points(rule):
    numeric = StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, Noise(1))
    for make in (rule.moments, rule.transition, rule.weighted):
        with pytest.raises(NoClosedForm, match=r"got array functions; use Unscented.*GaussHermite"):
            make(numeric)


def test_exact_means_refuse_what_has_no_closed_form():
    rational = StochasticMap((x,), [1 / (1 + x**2) + v], Noise((v,)))
    with pytest.raises(NoClosedForm, match="GaussHermite, Unscented and Cubature take this map"):
        ExactGaussian().moments(rational)
    got = GaussHermite(30).moments(rational)(0, np.zeros((1, 1)), np.full((1, 1, 1), 0.01))
    np.testing.assert_allclose(got.mean, [[1 - 0.01 + 3e-4]], atol=2e-5)


# Branches of switching systems

BUMP = sympy.Rational(35, 100) - sympy.Rational(3, 10) * sympy.exp(-(x**2) / 8)
BRANCH = StochasticMap(
    (x,), [x + sympy.Rational(9, 5) * sympy.sin(x) + v / 2], Noise((v,)), weight=BUMP
)


@pytest.mark.parametrize("rule", [ExactGaussian(), GaussHermite(40)])
def test_branch_against_raw_moments_of_many_nodes(rule):
    """(6.35), (6.36) of the switching paper: the general form over 80 nodes."""
    law = laws(1)
    want = Linearization.weighted(GaussHermite(80), BRANCH)(0, *law)
    assert_close(rule.weighted(BRANCH)(0, *law), want, rtol=1e-8, atol=1e-9)
    assert_close(Linearization.weighted(rule, BRANCH)(0, *law), want, rtol=1e-8, atol=1e-9)


def test_branch_that_depends_on_its_noise():
    """Dependent noises (6.27): the weight and the value share v; joint nodes of (x, v)."""
    weight = sympy.exp(-((v - x / 2) ** 2) / 2)
    dependent = StochasticMap((x, y), [x + y * v, y**2 + w], Noise((v, w)), weight=weight)
    numeric = StochasticMap.from_functions(
        2, 2, dependent.value, dependent.noise, weight=dependent.weight
    )
    law = laws(2, 3)
    want = GaussHermite(24).weighted(numeric)(0, *law)
    assert_close(ExactGaussian().weighted(dependent)(0, *law), want, rtol=1e-7, atol=1e-7)
    assert_close(GaussHermite(30).weighted(dependent)(0, *law), want, rtol=1e-7, atol=1e-7)
    raw = Linearization.weighted(GaussHermite(24), numeric)(0, *law)
    assert_close(raw, want, rtol=1e-9, atol=1e-9)
    with pytest.raises(NoClosedForm, match="wanted a weight without noise"):
        Taylor().weighted(dependent)


@pytest.mark.parametrize("rule", RULES)
def test_constant_weight_leaves_the_plain_moments(rule):
    plain = StochasticMap((x, y), [x**2 + v, x * y], Noise((v,)))
    branch = StochasticMap((x, y), plain.expressions, plain.noise, weight=sympy.Rational(1, 4))
    law = laws(2)
    got, moments = rule.weighted(branch)(0, *law), rule.moments(plain)(0, *law)
    np.testing.assert_allclose(got.mass, 0.25)
    np.testing.assert_allclose(got.value.mean, moments.mean, rtol=1e-12)
    np.testing.assert_allclose(got.value.cross, moments.cross, rtol=1e-10, atol=1e-12)
    if not isinstance(rule, Unscented | Cubature):
        np.testing.assert_allclose(got.value.cov, moments.cov, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(got.state.mean, law[0], rtol=1e-12)
    np.testing.assert_allclose(
        np.broadcast_to(got.state.cov.T, law[1].T.shape).T, law[1], rtol=1e-10
    )


def test_far_from_the_origin_no_digits_are_lost():
    """Linear value, constant weight: the centred form keeps D though x is near 1e6."""
    branch = StochasticMap((x,), [x + v], Noise((v,)), weight=sympy.Rational(1, 2))
    got = ExactGaussian().weighted(branch)(0, np.array([[1e6]]), np.array([[[1e-4]]]))
    np.testing.assert_allclose(got.value.cov, 1 + 1e-4, rtol=1e-14)
    np.testing.assert_allclose(got.value.cross, 1e-4, rtol=1e-14)


def test_weighted_taylor_is_the_exact_mean_of_the_expansions():
    """(7.3) against the exact means of the product of weight and value, both expanded."""
    mean, cov = np.array([[0.9, -1.0, 2.0]]), np.array([[[0.1, 0.2, 0.3]]])
    got = Taylor().weighted(BRANCH)(0, mean, cov)
    for i in range(3):
        at = {x: mean[0, i]}
        weight = (BUMP + BUMP.diff(x) * (y - x)).subs(at).subs(y, x)
        flat = x + sympy.Rational(9, 5) * sympy.sin(x)
        value = (flat + flat.diff(x) * (y - x)).subs(at).subs(y, x) + v / 2
        expanded = StochasticMap((x,), [value], Noise((v,)), weight=weight)
        want = ExactGaussian().weighted(expanded)(0, mean[:, i], cov[..., i])
        for a, b in zip(flatten(got), flatten(want), strict=True):
            np.testing.assert_allclose(a[..., i], b, rtol=1e-10)


def test_guard_keeps_the_variance_of_weighted_taylor_positive():
    """Erratum E2: m = 0.9, D = 2 gives the variance -1.51 by (7.3) as printed."""
    m, d = 0.9, 2.0
    weight = float(BUMP.subs(x, m))
    slope = float(BUMP.diff(x).subs(x, m))
    stretch = 1 + 1.8 * np.cos(m)
    printed = stretch**2 * (d - (slope * d / weight) ** 2) + 0.25
    assert printed == pytest.approx(-1.51, abs=0.005)
    got = Taylor().weighted(BRANCH)(0, np.array([m]), np.array([[d]]))
    np.testing.assert_allclose(got.value.cov, stretch**2 * d + 0.25, rtol=1e-12)
    np.testing.assert_allclose(got.state.mean, m)


def test_branch_of_no_mass_is_nan_without_a_warning():
    closed = StochasticMap((x,), [x + v], Noise((v,)), weight=sympy.Integer(0))
    law = laws(1, 2)
    for rule in (ExactGaussian(), GaussHermite()):
        got = rule.weighted(closed)(0, *law)
        assert (np.asarray(got.mass) == 0).all()


def test_moments_refuse_a_branch():
    for rule in (Taylor(), ExactGaussian(), Cubature()):
        with pytest.raises(ValueError, match=r"got a branch; use weighted\(\)"):
            rule.moments(BRANCH)


# The two promises of the seam


class Lattice(Linearization):
    """A new linearization: a dense lattice over the state and the noise, `moments` alone."""

    def moments(self, map, spread=True):
        grid = np.linspace(-6, 6, 41)
        size = map.state_size + map.noise.size
        nodes = np.array(np.meshgrid(*[grid] * size)).reshape(size, -1)
        weights = np.exp(-0.5 * (nodes**2).sum(axis=0))
        weights /= weights.sum()

        def f(t, mean, cov):
            batch = np.shape(mean)[1:]
            root = factor(cov)
            root = root.reshape(*root.shape, *(1,) * (len(batch) + 2 - root.ndim))
            states = mean[:, None] + np.einsum("ij...,js->is...", root, nodes[: len(mean)])
            noise = nodes[len(mean) :].reshape(-1, len(weights), *(1,) * len(batch))
            values = map.value(t, states, np.broadcast_to(noise, noise.shape[:2] + batch))
            h = np.einsum("is...,s->i...", values, weights)
            centre, apart = values - h[:, None], states - mean[:, None]
            rule = "is...,js...,s->ij..."
            square = np.einsum(rule, centre, centre, weights) if spread else None
            return Moments(h, np.einsum(rule, apart, centre, weights), square)

        return f


def test_a_new_linearization_works_everywhere_at_once():
    lattice, exact = Lattice(), ExactGaussian()
    process = zoo.flip_process()
    times = 0.25 * np.arange(4)
    record = process.simulate(times, 4, 2).measurements
    options = {"step": 0.05}
    # the sensor has two noises, so the lattice is three-dimensional; truncation is its only error
    got, want = (
        CovarianceFilter(process, rule, **options).run(times, record) for rule in (lattice, exact)
    )
    np.testing.assert_allclose(got.mean, want.mean, atol=1e-5)
    np.testing.assert_allclose(got.cov, want.cov, atol=1e-5)
    steps = DiscreteSystem(
        StochasticMap((x,), [x + sympy.sin(x) + v / 2], Noise((v,))),
        StochasticMap((x,), [x + x**2 / 5 + w], Noise((w,))), [0.5], [[1.0]],
    )  # fmt: skip
    grid = np.arange(5.0)
    record = steps.simulate(grid, 6, 1).measurements
    got, want = (CovarianceFilter(steps, rule).run(grid, record) for rule in (lattice, exact))
    np.testing.assert_allclose(got.mean, want.mean, atol=1e-5)
    law = laws(1)
    assert_close(lattice.weighted(BRANCH)(0, *law), exact.weighted(BRANCH)(0, *law), atol=1e-5)


def switching_record(paths, steps, seed):
    """Modes, states and measurements of the benchmark A1H of the switching paper's review."""
    rng = np.random.default_rng(seed)
    mode, state, record = rng.random(paths) < 0.5, rng.standard_normal(paths), []
    for _ in range(steps):
        seen = np.where(mode, 2 + state, state) + 2 * rng.standard_normal(paths)
        record.append((mode, state, seen))
        chance = np.where(
            mode, 0.9 - 0.5 * np.exp(-(state**2) / 2), 0.35 - 0.3 * np.exp(-(state**2) / 8)
        )
        moved = np.where(mode, 0.6 * state, state + 1.8 * np.sin(state))
        state, mode = moved + 0.5 * rng.standard_normal(paths), rng.random(paths) < chance
    return (np.array(part) for part in zip(*record, strict=True))


def interacting_modes(rule, record):
    """Interacting-multiple-model filter from weighted moments and `correct` alone."""
    u = sympy.Symbol("u")
    to_second = [BUMP, sympy.Rational(9, 10) - sympy.exp(-(x**2) / 2) / 2]
    moves = [x + sympy.Rational(9, 5) * sympy.sin(x) + v / 2, sympy.Rational(3, 5) * x + v / 2]
    branches = [
        [
            rule.weighted(StochasticMap((x,), [move], Noise((v,)), weight=weight))
            for weight in (1 - second, second)
        ]
        for move, second in zip(moves, to_second, strict=True)
    ]
    sensors = [
        rule.moments(StochasticMap((x,), [shift + x + 2 * u], Noise((u,)))) for shift in (0, 2)
    ]
    count = record.shape[1]
    chance = np.full((2, count), 0.5)
    laws = [(np.zeros((1, count)), np.ones((1, 1)))] * 2
    modes, means = [], []
    for k, seen in enumerate(record):
        after = [
            correct(*law, seen[None], sensor(k, *law))
            for law, sensor in zip(laws, sensors, strict=True)
        ]
        score = np.log(chance) + np.array([loglik for _, _, loglik in after])
        chance = np.exp(score - score.max(axis=0))
        chance /= chance.sum(axis=0)
        modes.append(chance.argmax(axis=0))
        means.append((chance * [mean[0] for mean, _, _ in after]).sum(axis=0))
        parts = [
            [f(k, mean, cov) for f in row]
            for row, (mean, cov, _) in zip(branches, after, strict=True)
        ]
        share = np.array([[c * p.mass for p in row] for c, row in zip(chance, parts, strict=True)])
        chance, laws = share.sum(axis=0), []
        for target in (0, 1):
            weights = share[:, target] / chance[target]
            values = [row[target].value for row in parts]
            mean = sum(q * m.mean for q, m in zip(weights, values, strict=True))
            cov = sum(
                q * (m.cov + (m.mean - mean) ** 2) for q, m in zip(weights, values, strict=True)
            )
            laws.append((mean, cov))
    return np.array(modes), np.array(means)


@pytest.mark.parametrize(
    ("rule", "error_rate", "rmse", "spread"),
    [(ExactGaussian(), 0.2988, 1.1753, 0.0053), (Taylor(), 0.3110, 1.5608, 0.0176)],
)
def test_interacting_modes_from_weighted_moments(rule, error_rate, rmse, spread):
    """Benchmark A1H: averages over k = 10..30 on 4000 paths; the reference has as many."""
    modes, states, record = switching_record(4000, 31, seed=1)
    got_modes, got = interacting_modes(rule, record)
    wrong = (got_modes != modes)[10:].mean(axis=0)
    squares = ((got - states)[10:] ** 2).mean(axis=0)
    tolerance = 4 * np.sqrt(2)
    assert abs(wrong.mean() - error_rate) < tolerance * 0.0020
    assert abs(np.sqrt(squares.mean()) - rmse) < tolerance * spread
