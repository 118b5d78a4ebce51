"""Design of finite-order filters: exact for linear systems, on simulated paths for others."""

from itertools import pairwise

import numpy as np
import pytest
import sympy
from scipy.linalg import expm

from seedslib import zoo
from seedslib.base import correct
from seedslib.design import Affine, Continuous, Polynomial, synthesize
from seedslib.designed import Memory, finite_memory, large_order, load, save, small_order
from seedslib.evaluation import compare
from seedslib.filters import assumed_density, extended_kalman
from seedslib.linearization import Cubature, ExactGaussian, GaussHermite, Taylor, Unscented
from seedslib.models import DiscreteSystem, JumpDiffusion, Noise, StochasticMap

TACTS = np.arange(7) * 0.5
STEPS = np.arange(21) * 0.5


@pytest.fixture(scope="module")
def linear():
    return zoo.linear_gaussian()


@pytest.fixture(scope="module")
def oscillator():
    return zoo.van_der_pol()


# Linear systems: exact moments


def kalman(steps):
    """Forecast and corrected covariances of the linear example, by a plain Kalman filter."""
    drift = np.array([[0.0, 1.0], [-1.0, -0.4]])
    move = expm(0.5 * drift)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    columns = [expm(0.25 * (s + 1) * drift) @ [[0.0], [1.0]] for s in nodes]
    noise = sum(0.25 * w * c @ c.T for w, c in zip(weights, columns, strict=True))
    before, after, p = [], [], np.eye(2)
    for k in range(steps):
        if k:
            p = move @ p @ move.T + noise
        before.append(p)
        gain = p[:, :1] / (p[0, 0] + 0.25)
        p = p - gain @ p[:1]
        after.append(p)
    return np.array(before), np.array(after)


@pytest.mark.parametrize("l", [1, 2, 4])
def test_large_order_of_the_whole_state_is_the_kalman_filter(linear, l):
    filter = synthesize(linear, Memory(l), Taylor(), STEPS, nodes=0, exact_moments=True)
    before, after = kalman(21)
    forecast = np.array([filter.start.cov, *(fit.cov for fit in filter.fits)])
    np.testing.assert_allclose(forecast, before, rtol=0, atol=1e-12)
    corrected = np.array([after[k].diagonal() for k in range(21)])
    np.testing.assert_allclose(filter.predicted.rms**2, corrected, rtol=0, atol=1e-12)
    printed = [0.2, 0.1507645623, 0.1530811068, 0.1400092003, 0.1398418705, 0.1398407929]
    np.testing.assert_allclose(
        filter.predicted.rms[[0, 1, 2, 5, 10, 20], 0] ** 2, printed, rtol=0, atol=1e-10
    )


@pytest.mark.parametrize(
    ("memory", "components", "printed"),
    [
        (large_order(1), 1, 0.1684343396),
        (large_order(2), 1, 0.1439983892),
        (large_order(3), 1, 0.1404112880),
        (large_order(4), 1, 0.1399235284),
        (large_order(6), 1, 0.1398425903),
        (finite_memory(1), 2, 0.158402511),
        (finite_memory(2), 2, 0.1573850072),
        (finite_memory(4), 2, 0.1415818281),
        (finite_memory(8), 2, 0.1398818821),
    ],
)
def test_order_study_of_the_linear_example(linear, memory, components, printed):
    filter = synthesize(
        linear, memory, Taylor(), STEPS, components=components, nodes=1, exact_moments=True
    )
    assert filter.predicted.times[-1] == 10.0
    assert filter.predicted.rms[-1, 0] ** 2 == pytest.approx(printed, abs=1e-8)
    assert not filter.predicted.in_sample


def test_finite_memory_is_the_regression_on_all_that_it_holds(linear):
    """E[X_k | Y_k, Y_{k-1}, Y_{k-2}] from the joint covariance, without any recursion."""
    filter = synthesize(linear, finite_memory(2), Taylor(), STEPS, exact_moments=True)
    drift = np.array([[0.0, 1.0], [-1.0, -0.4]])
    move = expm(0.5 * drift)
    before, _ = kalman(2)
    noise = before[1] - move @ kalman(1)[1][0] @ move.T
    k, cov = 7, [np.eye(2)]
    for _ in range(k):
        cov.append(move @ cov[-1] @ move.T + noise)
    power = np.linalg.matrix_power
    cross = np.array([(power(move, j) @ cov[k - j])[:, 0] for j in range(3)]).T
    square = np.array(
        [[(power(move, abs(i - j)) @ cov[k - max(i, j)])[0, 0] for j in range(3)] for i in range(3)]
    ) + 0.25 * np.eye(3)
    expected = cov[k] - cross @ np.linalg.solve(square, cross.T)
    place = np.searchsorted(filter.predicted.times, STEPS[k] - 1e-9)
    np.testing.assert_allclose(
        filter.predicted.rms[place] ** 2, expected.diagonal(), rtol=0, atol=1e-12
    )


def test_exact_moments_with_time_dependent_coefficients_and_offsets():
    """Against a very fine recursion of the Kalman filter."""
    x, v, t = sympy.symbols("x v t")
    system = JumpDiffusion(
        state=(x,), drift=[1 - (1 + t) * x], diffusion=[[sympy.sqrt(1 + t)]],
        sensor=[(2 + t) * x + 1 + v], noise=Noise((v,), mean=0.5, cov=[[0.3]]), mean0=[2],
        cov0=[[0.7]],
    )  # fmt: skip
    filter = synthesize(system, Memory(2), Taylor(), [0, 0.5, 1], nodes=2, exact_moments=True)
    mean, p, found = 2.0, 0.7, []
    for start, stop in ((0, 0), (0, 0.5), (0.5, 1.0)):
        if stop > start:
            count = 20_000
            for s in start + (stop - start) * (np.arange(count) + 0.5) / count:
                h = (stop - start) / count
                mean = mean * np.exp(-(1 + s) * h) + h
                p = p * np.exp(-2 * (1 + s) * h) + (1 + s) * h
        found.append((mean, p))
        p = p - p**2 * (2 + stop) ** 2 / (p * (2 + stop) ** 2 + 0.3)
    for fit, (_, spread) in zip(filter.fits, found[1:], strict=True):
        assert fit.cov[0, 0] == pytest.approx(spread, rel=2e-4)
    # the mean of the forecast is the mean of the state
    means = [fit.gain[0].sum() * m + fit.offset[0] for fit, (m, _) in zip(
        filter.fits[:1], found[:1], strict=True)]  # fmt: skip
    assert means[0] == pytest.approx(found[1][0], rel=2e-4)


def test_exact_moments_count_jumps_that_do_not_depend_on_the_state():
    """Compound Poisson noise of the same second moment as a Wiener noise gives the same filter."""
    x, v, z = sympy.symbols("x v z")
    common = {"sensor": [x + v], "noise": Noise((v,)), "mean0": [0], "cov0": [[1]]}
    smooth = JumpDiffusion((x,), [-x], [[sympy.sqrt(2)]], **common)
    jumping = JumpDiffusion(
        (x,), [-x], [[1]], intensity=4, jump=[z / 2], marks=Noise((z,)), **common
    )
    one, two = (
        synthesize(s, Memory(1), Taylor(), STEPS[:5], exact_moments=True) for s in (smooth, jumping)
    )
    np.testing.assert_allclose(two.predicted.rms, one.predicted.rms, rtol=1e-12)


def test_simulated_moments_approach_the_exact_ones(linear):
    """Excess mean-square error of a simulated design, about (4.4 absolute for l = 4) / paths."""
    exact = synthesize(linear, Memory(2), Taylor(), STEPS[:6], nodes=1, exact_moments=True)
    made = synthesize(
        linear, Memory(2), Taylor(), STEPS[:6], nodes=1, paths=20_000, seed=1, step=0.005
    )
    fresh = linear.simulate(STEPS[:6], 4000, 2, step=0.05)
    a, b = (f.run(STEPS[:6], fresh.measurements).mean for f in (exact, made))
    assert np.sqrt(((a - b) ** 2).mean()) < 0.02
    # predicted errors agree within their standard errors and the bias of the Euler scheme
    np.testing.assert_array_less(
        np.abs(made.predicted.rms - exact.predicted.rms), 4 * made.predicted.error + 2e-3
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"drift": ["-x**3"]}, "wanted a linear drift"),
        ({"sensor": ["x**2 + v"]}, "wanted a linear sensor"),
        ({"diffusion": [["x"]]}, "a diffusion that is free of the state"),
        ({"sensor": ["x + x*v"]}, "a sensor noise that is free of the state"),
    ],
)
def test_exact_moments_want_a_linear_system(changes, message):
    x, v = sympy.symbols("x v")
    parts = {"drift": ["-x"], "diffusion": [["1"]], "sensor": ["x + v"]} | changes
    parts = {
        name: [
            [sympy.sympify(e) for e in r] if isinstance(r, list) else sympy.sympify(r) for r in p
        ]
        for name, p in parts.items()
    }
    system = JumpDiffusion((x,), noise=Noise((v,)), mean0=[0], cov0=[[1]], **parts)
    with pytest.raises(ValueError, match=message):
        synthesize(system, Memory(1), Taylor(), [0, 1], exact_moments=True)


# Simulated paths


def arrays(filter):
    """All numbers of a designed filter."""
    found = [filter.start.mean, filter.start.cov, *filter.start.moments, *filter.predicted[:3]]
    for fit in [*filter.fits, *(f for row in filter.node_fits for f in row)]:
        found += [np.asarray(part) for part in fit]
    return found


@pytest.mark.parametrize(
    ("memory", "predictor"),
    [(Memory(2), Affine()), (Memory(1), Polynomial(2, 2)), (Memory(1), Continuous())],
)
def test_filter_does_not_depend_on_threads(oscillator, memory, predictor):
    one, two = (
        synthesize(
            oscillator, memory, ExactGaussian(), TACTS[:4], predictor=predictor, paths=17_000,
            seed=5, workers=workers, step=0.02,
        )
        for workers in (1, 2)
    )  # fmt: skip
    assert all(np.array_equal(a, b) for a, b in zip(arrays(one), arrays(two), strict=True))


def test_design_is_a_run_on_its_own_paths(oscillator):
    """The paths are those of `simulate`, and predicted errors are those of a run on them."""
    filter = synthesize(oscillator, Memory(2), Taylor(), TACTS[:4], nodes=2, paths=9000, seed=8)
    stops = filter.predicted.times
    tacts = np.searchsorted(stops, TACTS[:4] - 1e-9)
    data = oscillator.simulate(stops, 9000, 8, measured=tacts)
    found = filter.run(stops, data.measurements)
    squares = (found.mean - data.states) ** 2
    np.testing.assert_allclose(np.sqrt(squares.mean(axis=2)), filter.predicted.rms, rtol=1e-10)
    error = squares.std(axis=2) / np.sqrt(9000) / (2 * filter.predicted.rms)
    np.testing.assert_allclose(error, filter.predicted.error, rtol=1e-9)
    assert filter.predicted.in_sample


def test_fit_is_the_regression_on_the_run(oscillator):
    """Forecast parameters are the least-squares ones of the run's own memory, (6.3)."""
    filter = synthesize(oscillator, Memory(2), Taylor(), TACTS[:4], nodes=0, paths=9000, seed=8)
    data = oscillator.simulate(TACTS[:4], 9000, 8)
    z = filter.run(TACTS[:4], data.measurements).mean
    u = np.concatenate([z[2], z[1], np.ones((1, 9000))])
    expected, _, _, _ = np.linalg.lstsq(u.T, data.states[3].T, rcond=None)
    fit = filter.fits[2]
    np.testing.assert_allclose(fit.gain, expected[:4].T, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(fit.offset, expected[4], rtol=1e-7, atol=1e-9)
    residual = data.states[3] - expected.T @ u
    np.testing.assert_allclose(fit.cov, residual @ residual.T / 9000, rtol=1e-9)
    # unbiased by construction: the forecasts' mean errors vanish on these paths
    assert np.abs(residual.mean(axis=1)).max() < 1e-12


# The Van der Pol table, within four combined standard errors

TABLE = {  # memory, components, predictor, linearization, RMS at .5, ..., 3
    "L-FBP1": (Memory(1), 2, Affine(), "L", [0.198, 0.245, 0.343, 0.365, 0.398, 0.437]),
    "L-FBP2": (Memory(2), 2, Affine(), "L", [0.198, 0.245, 0.337, 0.355, 0.385, 0.417]),
    "L-FBP4": (Memory(4), 2, Affine(), "L", [0.198, 0.245, 0.337, 0.355, 0.384, 0.416]),
    "G-FBP1": (Memory(1), 2, Affine(), "G", [0.197, 0.244, 0.343, 0.368, 0.392, 0.419]),
    "G-FBP2": (Memory(2), 2, Affine(), "G", [0.197, 0.244, 0.338, 0.360, 0.383, 0.408]),
    "G-FBP4": (Memory(4), 2, Affine(), "G", [0.197, 0.244, 0.338, 0.360, 0.383, 0.407]),
    "L-FKP1": (finite_memory(1), 2, Affine(), "L", [0.198, 0.253, 0.415, 0.677, 1.141, 1.566]),
    "L-FKP2": (finite_memory(2), 2, Affine(), "L", [0.198, 0.247, 0.377, 0.463, 0.701, 1.162]),
    "L-FKP4": (finite_memory(4), 2, Affine(), "L", [0.198, 0.247, 0.374, 0.421, 0.482, 0.598]),
    "G-FKP4": (finite_memory(4), 2, Affine(), "G", [0.197, 0.246, 0.371, 0.430, 0.486, 0.578]),
    "L-FBP1'": (Memory(1), 1, Affine(), "L", [0.198, 0.250, 0.397, 0.461, 0.558, 0.714]),
    "L-FBP4'": (Memory(4), 1, Affine(), "L", [0.198, 0.249, 0.387, 0.447, 0.544, 0.703]),
    "G-FBP1'": (Memory(1), 1, Affine(), "G", [0.198, 0.249, 0.393, 0.456, 0.521, 0.617]),
    "G-FBP4'": (Memory(4), 1, Affine(), "G", [0.198, 0.248, 0.383, 0.442, 0.509, 0.603]),
    "poly 3,2": (Memory(1), 2, Polynomial(3, 2), "G", [0.198, 0.224, 0.278, 0.313, 0.340, 0.354]),
    "poly 3,4": (Memory(1), 2, Polynomial(3, 4), "G", [0.198, 0.224, 0.269, 0.304, 0.331, 0.343]),
    "L-FMP": (Memory(1), 2, Continuous(), "L", [0.197, 0.237, 0.311, 0.366, 0.409, 0.445]),
    "G-FMP": (Memory(1), 2, Continuous(), "G", [0.197, 0.236, 0.309, 0.363, 0.403, 0.437]),
    "L-mixed": (Memory(2, 2), 2, Affine(), "L", [0.198, None, 0.313, None, None, 0.409]),
}  # fmt: skip


@pytest.fixture(scope="module")
def van_der_pol_table(oscillator):
    designed = {}
    for name, (memory, components, predictor, kind, _) in TABLE.items():
        linearization = {"L": Taylor(), "G": ExactGaussian()}[kind]
        designed[name] = synthesize(
            oscillator, memory, linearization, TACTS, predictor=predictor, nodes=0,
            components=components, paths=16_384, seed=11,
        )  # fmt: skip
    others = {"EKF": extended_kalman(oscillator, integrator="euler")}  # as the continuous forecast
    return designed, compare(designed | others, oscillator, TACTS, 40_960, 12, components=1)


@pytest.mark.parametrize("name", TABLE)
def test_van_der_pol_table(van_der_pol_table, name):
    found = van_der_pol_table[1][name]
    for k, printed in enumerate(TABLE[name][4], start=1):
        if printed is None:
            continue
        # the table stands on 1e5 test paths, the polynomial rows on 3e4 training and test paths
        paths = 3e4 if name.startswith("poly") else 1e5
        combined = found.rms_error[k, 0] * np.sqrt(1 + 40_960 / paths + 40_960 / 16_384)
        assert abs(found.rms[k, 0] - printed) < 4 * combined + 5e-4, (k, found.rms[k, 0])
    assert found.diverged == 0


def test_order_pays_and_structure_pays_more(van_der_pol_table):
    """Paired differences at the last measurement, in standard errors."""
    table = van_der_pol_table[1]

    def score(first, second):
        found = table.difference(first, second)
        return found.rms[-1, 0] / found.error[-1, 0]

    assert score("L-FBP4", "L-FBP1") < -4
    assert score("G-FBP2", "G-FBP1") < -4
    assert score("L-FKP4", "L-FBP4") > 4
    assert score("poly 3,2", "G-FBP1") < -4
    assert score("poly 3,4", "poly 3,2") < -2
    assert score("L-FBP4", "L-FBP4'") < -4


def significance(table, first, second, k):
    """Paired difference of errors after measurement k, in standard errors."""
    found = table.difference(first, second)
    return found.rms[k, 0] / found.error[k, 0]


def test_figure_2_extended_filter_loses_to_small_order_more_and_more(van_der_pol_table):
    """Equal until 1; .484 against .445 at 3; one integrator for both."""
    table = van_der_pol_table[1]
    assert table["EKF"].rms[6, 0] == pytest.approx(0.484, abs=4 * table["EKF"].rms_error[6, 0])

    def more_and_more(name):
        lead = table.difference("EKF", name).rms[:, 0]
        late = [significance(table, "EKF", name, k) for k in (4, 5, 6)]
        rising = lead[3] > 0 and (np.diff(lead[3:]) > 0).all()
        return bool(abs(lead[1]) < 0.01 and rising and min(late) > 2)

    assert more_and_more("L-FMP")
    assert significance(table, "EKF", "L-FMP", 6) > 4
    assert not more_and_more("L-FKP4")
    assert not more_and_more("L-FBP1")


def test_figure_2_extended_filter_loses_to_large_order_late_only(van_der_pol_table):
    """.484 against .437 at 3, but .319 against .343 at 1.5; from 2 on the lead grows."""
    table = van_der_pol_table[1]
    lead = table.difference("EKF", "L-FBP1").rms[:, 0]
    scores = [significance(table, "EKF", "L-FBP1", k) for k in range(7)]
    assert max(scores[2:4]) < -4
    assert min(scores[4:]) > 2
    assert scores[6] > 4
    assert lead[6] > lead[4]
    crossing = 1.5 + 0.5 * lead[3] / (lead[3] - lead[4])
    assert crossing == pytest.approx(1.75, abs=0.1)


def test_figure_2_finite_memory_is_the_worst_and_large_order_the_best(van_der_pol_table):
    table = van_der_pol_table[1]
    for other in ("EKF", "L-FMP", "L-FBP1"):
        assert significance(table, "L-FKP4", other, 6) > 4
        assert significance(table, "L-FBP4", other, 6) < -3


def test_mixed_memory_is_better_early_and_not_worse_late(van_der_pol_table):
    """Two estimates with two measurements against four estimates, on the same paths."""
    table = van_der_pol_table[1]
    assert significance(table, "L-mixed", "L-FBP4", 3) < -4
    assert significance(table, "L-mixed", "L-FBP4", 6) < 2


def test_polynomial_forecast_beats_the_assumed_density_filter(van_der_pol_table, oscillator):
    """.354 and .343 against .388 at 3, on enough paths to tell."""
    degrees = ("poly 3,2", "poly 3,4")
    filters = {name: van_der_pol_table[0][name] for name in degrees}
    filters["FNA"] = assumed_density(oscillator, step=0.02)
    found = compare(filters, oscillator, TACTS, 57_344, 13, components=1)
    for name in degrees:
        assert all(significance(found, name, "FNA", k) < -4 for k in (5, 6))


def test_forecasts_are_unbiased_and_corrected_estimates_are_not(oscillator):
    """Bias of x1 at 3: linearised +.032, Gaussian -.017; none at the nodes."""
    stops = np.linspace(0, 3, 13)
    designed = {
        name: synthesize(oscillator, Memory(1), rule, TACTS, nodes=1, paths=16_384, seed=31)
        for name, rule in (("L", Taylor()), ("G", ExactGaussian()))
    }
    found = compare(designed, oscillator, stops, 40_960, 32, components=1)
    for name, printed in (("L", 0.032), ("G", -0.017)):
        row = found[name]
        spread = row.rms[:, 0] * np.sqrt(1 / 40_960 + 1 / 16_384)
        assert np.all(np.abs(row.bias[1::2, 0]) < 4 * spread[1::2])
        assert abs(row.bias[-1, 0]) > 4 * spread[-1]
        assert abs(row.bias[-1, 0] - printed) < 4 * spread[-1]


DUFFING = {  # RMS of the position over the measurements from the fifth on
    "G-FBP1": (Memory(1), 2, Affine(), ExactGaussian(), 0.726),
    "G-FBP4": (Memory(4), 2, Affine(), ExactGaussian(), 0.726),
    "G-FKP4": (finite_memory(4), 2, Affine(), ExactGaussian(), 0.726),
    "G-FBP1'": (Memory(1), 1, Affine(), ExactGaussian(), 0.741),
    "G-FBP2'": (Memory(2), 1, Affine(), ExactGaussian(), 0.726),
    "L-FMP": (Memory(1), 2, Continuous(), Taylor(), 0.709),
    "poly 3,2": (Memory(1), 2, Polynomial(3, 2), ExactGaussian(), 0.699),
}


def test_kicked_duffing_table():
    """Within two per cent; the bound 20 on both components counts as divergence."""
    duffing, times = zoo.kicked_duffing(), np.arange(13) * 0.5
    filters = {
        name: synthesize(
            duffing, memory, rule, times, predictor=predictor, components=components, nodes=0,
            paths=8192, seed=41,
        )
        for name, (memory, components, predictor, rule, _) in DUFFING.items()
    }  # fmt: skip
    filters["FNA"] = assumed_density(duffing)
    found = compare(filters, duffing, times, 12_288, 42, components=1, bound=20)
    printed = {name: row[4] for name, row in DUFFING.items()} | {"FNA": 0.726}
    for name, value in printed.items():
        assert np.sqrt((found[name].rms[4:, 0] ** 2).mean()) == pytest.approx(value, rel=0.02)
        assert found[name].diverged < 10
    apart = found.difference("poly 3,2", "FNA")
    assert apart.rms[8, 0] < -4 * apart.error[8, 0]


def test_start_is_the_best_affine_estimate(van_der_pol_table):
    found = van_der_pol_table[1]["L-FBP1"]
    assert found.rms[0, 0] == pytest.approx(0.2133, abs=4 * found.rms_error[0, 0])


def test_sigma_points_lie_between(oscillator):
    """Remark 3: linearised .4317, Gaussian .4143, cubature .4182, unscented .4143 and .4116."""
    kinds = {
        "taylor": (Taylor(), 0.4317), "exact": (ExactGaussian(), 0.4143),
        "cubature": (Cubature(), 0.4182), "unscented 0": (Unscented(1, 0, 1), 0.4143),
        "unscented 2": (Unscented(1, 2, 0), 0.4116), "hermite": (GaussHermite(5), 0.4143),
    }  # fmt: skip
    designed = {
        name: synthesize(oscillator, Memory(1), rule, TACTS, nodes=0, paths=8192, seed=3)
        for name, (rule, _) in kinds.items()
    }
    found = compare(designed, oscillator, TACTS, 8192, 4, components=1)
    for name, (_, printed) in kinds.items():
        combined = found[name].rms_error[-1, 0] * np.sqrt(2 + 8192 / 20_000)
        assert abs(found[name].rms[-1, 0] - printed) < 4 * combined
    assert found["taylor"].rms[-1, 0] > found["cubature"].rms[-1, 0] > found["exact"].rms[-1, 0]
    # a quadratic sensor: these rules are exact for it
    for other in ("unscented 0", "hermite"):
        np.testing.assert_allclose(found[other].rms, found["exact"].rms, rtol=1e-9)


def test_linear_sensor_makes_gaussian_and_linearised_filters_one():
    """Corollary 1 with C x + v: both take the same moments."""
    system = zoo.van_der_pol("K")
    one, two = (
        synthesize(system, Memory(2), rule, TACTS[:4], nodes=0, paths=4000, seed=3)
        for rule in (Taylor(), ExactGaussian())
    )
    np.testing.assert_allclose(one.predicted.rms, two.predicted.rms, rtol=1e-12)


def test_polynomial_of_degrees_one_and_zero_is_affine_where_nothing_is_clipped():
    """A bounded state: the standardised memory stays within the clipping range."""
    x, v = sympy.symbols("x v")
    system = JumpDiffusion(
        (x,), [-sympy.sin(x)], [[0.3 * sympy.cos(x)]], [sympy.sin(x) + v / 5], Noise((v,)), [0],
        [[1]], initial=lambda rng, count: rng.uniform(-1, 1, (1, count)),
    )  # fmt: skip
    one, two = (
        synthesize(system, Memory(1), ExactGaussian(), [0, 0.5, 1], predictor=p, paths=5000, seed=1)
        for p in (Affine(), Polynomial(1, 0))
    )
    np.testing.assert_allclose(one.predicted.rms, two.predicted.rms, rtol=1e-12)
    for a, b in zip(one.fits, two.fits, strict=True):
        np.testing.assert_allclose(a.cov, b.residual, rtol=1e-12)


def test_remark_one_node_forecasts_that_look_at_the_measurement(oscillator):
    """Never worse on the design paths; .414 to .395 at t_2 + .4 and .479 to .453 at t_3 + .4."""
    one, two = (
        synthesize(
            oscillator, Memory(1), Taylor(), TACTS, paths=20_000, seed=2, measured_nodes=flag
        )
        for flag in (False, True)
    )
    assert np.all(two.predicted.rms <= one.predicted.rms * (1 + 1e-12))
    nodes = np.searchsorted(one.predicted.times, np.array([1.4, 1.9]) - 1e-9)
    for filter, printed in ((one, [0.414, 0.479]), (two, [0.395, 0.453])):
        found, error = filter.predicted.rms[nodes, 0], filter.predicted.error[nodes, 0]
        np.testing.assert_array_less(np.abs(found - printed), 4 * np.sqrt(2) * error + 5e-4)
    data = oscillator.simulate(TACTS, 3, 5)
    shared = [f.run(TACTS, data.measurements).mean for f in (one, two)]
    np.testing.assert_array_equal(*shared)


def test_horizon_after_the_last_measurement(linear):
    made = synthesize(
        linear, Memory(1), Taylor(), [0, 0.5], nodes=1, horizon=2.5, exact_moments=True
    )
    np.testing.assert_allclose(made.predicted.times, [0, 0.25, 0.5, 1.5, 2.5])
    p = kalman(2)[1][1]
    move = expm(2.0 * np.array([[0.0, 1.0], [-1.0, -0.4]]))
    # the stationary law has covariance diag(1.25, 1.25) = A P + P Aᵀ + diag(0, 1) solved by hand
    noise = 1.25 * (np.eye(2) - move @ move.T)
    expected = move @ p @ move.T + noise
    np.testing.assert_allclose(made.predicted.rms[-1] ** 2, expected.diagonal(), atol=1e-10)


def test_nodes_given_one_by_one(oscillator):
    nodes = [[0.1, 0.45], [], [1.2]]
    made = synthesize(oscillator, Memory(1), Taylor(), TACTS[:4], nodes=nodes, paths=500, seed=1)
    np.testing.assert_allclose(made.predicted.times, [0, 0.1, 0.45, 0.5, 1, 1.2, 1.5])


def test_known_start_is_no_regressor():
    """The first estimate is the same on all paths; a relative cut-off alone would keep it."""
    x, v = sympy.symbols("x v")
    system = JumpDiffusion((x,), [-x], [[1]], [x + v], Noise((v,)), [0.3], [[0]])
    made = synthesize(system, Memory(2), Taylor(), [0, 0.5, 1.0], paths=2000, seed=1)
    assert made.fits[0].gain[0, 0] == 0.0
    assert made.fits[1].gain[0, 1] == 0.0
    exact = synthesize(system, Memory(2), Taylor(), [0, 0.5, 1.0], exact_moments=True)
    assert exact.fits[0].gain[0, 0] == 0.0
    assert made.predicted.rms[0, 0] < 1e-12


def exploding():
    """Paths that start beyond 1 leave every bound in finite time."""
    x, v = sympy.symbols("x v")
    return JumpDiffusion((x,), [x**3 - x], [[0.1]], [x + v], Noise((v,)), [0], [[0.09]], step=0.01)


def test_diverging_design_paths_are_left_out_and_reported():
    with pytest.warns(UserWarning, match="of 5000 design paths diverged"):
        made = synthesize(
            exploding(), Memory(1), ExactGaussian(), np.arange(9) * 0.5, paths=5000, seed=1, bound=5
        )
    assert 0 < made.design.diverged < 100
    assert all(np.isfinite(part).all() for part in arrays(made))
    assert made.predicted.rms.max() < 0.3
    assert "diverged paths left out" in str(made)


@pytest.mark.filterwarnings("ignore:paths:UserWarning")
def test_a_path_on_its_way_to_infinity_is_noticed():
    with pytest.warns(UserWarning, match="rest on very few paths"):
        made = synthesize(
            exploding(), Memory(1), ExactGaussian(), np.arange(9) * 0.5, paths=5000, seed=1
        )
    assert all(np.isfinite(part).all() for part in arrays(made))


def test_bound_on_design_paths():
    with pytest.warns(UserWarning, match="design paths diverged"):
        made = synthesize(exploding(), Memory(1), Taylor(), [0, 0.1], paths=5000, seed=1, bound=0.9)
    # the initial law is N(0, .09): 0.27 % beyond three deviations
    assert made.design.diverged == pytest.approx(13.5, abs=4 * np.sqrt(13.5))


def test_a_system_in_discrete_time(tmp_path):
    """An autoregression: forecast variances of the scalar Kalman filter, and a file of it."""
    x, w, v = sympy.symbols("x w v")
    system = DiscreteSystem(
        StochasticMap((x,), [0.9 * x + w], Noise((w,), cov=[[0.5]])),
        StochasticMap((x,), [x + v], Noise((v,), cov=[[0.3]])),
        mean0=[1], cov0=[[2]],
    )  # fmt: skip
    made = synthesize(system, Memory(2), Taylor(), np.arange(8), paths=40_000, seed=1)
    p = 2.0
    for fit in made.fits:
        p = 0.81 * p * 0.3 / (p + 0.3) + 0.5
        assert fit.cov[0, 0] == pytest.approx(p, abs=4 * p * np.sqrt(2 / 40_000))
    assert all(len(nodes) == 0 for nodes in made.node_times)
    save(made, tmp_path / "discrete.npz")
    data = system.simulate(np.arange(8), 5, 2)
    found = load(tmp_path / "discrete.npz", system).run(np.arange(8), data.measurements)
    np.testing.assert_array_equal(found.mean, made.run(np.arange(8), data.measurements).mean)
    with pytest.raises(ValueError, match="want a system in continuous time"):
        synthesize(system, Memory(1), Taylor(), [0, 1], paths=500, seed=1, horizon=2)


# Bad input


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"memory": 2}, TypeError, "memory: wanted a Memory"),
        ({"memory": Memory(1, indicators=1)}, ValueError, "memory: wanted estimates"),
        ({"linearization": "taylor"}, TypeError, "linearization: wanted a Linearization"),
        ({"predictor": "affine"}, TypeError, "predictor: wanted"),
        ({"predictor": Continuous(), "memory": Memory(2)}, ValueError, "Continuous wants"),
        ({"predictor": Continuous(), "measured_nodes": True}, ValueError, "Continuous wants"),
        ({"predictor": Polynomial(), "exact_moments": True}, ValueError, "exact_moments: wanted"),
        ({"components": 3}, ValueError, "components: wanted 1 to 2, got 3"),
        ({"components": 0}, ValueError, "components: wanted 1 to 2, got 0"),
        ({"times": [0, 1, 1]}, ValueError, "times: wanted strictly increasing"),
        ({"nodes": -1}, ValueError, "nodes: wanted at least 0"),
        ({"nodes": [[0.7], []]}, ValueError, "nodes: wanted times between 0 and 0.5"),
        ({"nodes": [[0.2]]}, ValueError, "nodes: wanted 2 lists"),
        ({"horizon": 0.9}, ValueError, "horizon: wanted a time after"),
        ({"paths": 5, "memory": Memory(2)}, ValueError, "paths: wanted more than 5 for 4"),
        ({"paths": None}, TypeError, "paths: wanted a whole number"),
        ({"seed": None}, TypeError, "seed: wanted"),
        ({"workers": 0}, ValueError, "workers: wanted at least 1"),
        ({"step": 0.0}, ValueError, "step: wanted a positive number"),
        ({"scheme": "milstein"}, ValueError, "scheme: wanted one of"),
    ],
)
def test_bad_input_is_named(oscillator, changes, error, message):
    options = {
        "memory": Memory(1), "linearization": Taylor(), "times": [0, 0.5, 1], "paths": 200,
        "seed": 1,
    } | changes  # fmt: skip
    first = [options.pop(name) for name in ("memory", "linearization", "times")]
    with pytest.raises(error, match=message):
        synthesize(oscillator, *first, **options)


def test_few_paths_are_worth_a_warning(oscillator):
    with pytest.warns(UserWarning, match="paths: 60 are few for 2 coefficients"):
        synthesize(oscillator, Memory(1), Taylor(), [0, 0.5], paths=60, seed=1)


def test_missing_formulas_offer_points():
    drift = lambda t, x: -x  # noqa: E731
    sensor = StochasticMap.from_functions(1, 1, lambda t, x, v: x + v, Noise(1))
    system = JumpDiffusion.from_functions(
        drift, lambda t, x: np.ones((1, *x.shape)), sensor, [0.0], [[1.0]]
    )
    for rule in (Taylor(), ExactGaussian()):
        with pytest.raises(ValueError, match="Unscented, Cubature or GaussHermite"):
            synthesize(system, Memory(1), rule, [0, 1], paths=200, seed=1)
    made = synthesize(system, Memory(1), Cubature(), [0, 1], paths=4000, seed=1)
    assert made.predicted.rms[0, 0] == pytest.approx(np.sqrt(0.5), abs=0.05)


def test_polynomial_degrees():
    with pytest.raises(ValueError, match="mean_degree: wanted at least 1"):
        Polynomial(0, 0)
    with pytest.raises(TypeError, match="cov_degree: wanted a whole number"):
        Polynomial(2, 1.5)


def test_design_uses_the_shared_correction(oscillator):
    """One measurement corrected by hand, from the stored parameters alone: equations (6.2)."""
    made = synthesize(oscillator, small_order(), ExactGaussian(), TACTS[:2], paths=3000, seed=1)
    y0, y1 = np.array([3.0, 0.5]), np.array([2.0, -1.0])
    gain = np.linalg.solve(made.start.moments.cov, made.start.moments.cross.T).T
    z0 = made.start.mean + gain @ (y0 - made.start.moments.mean)
    fit = made.fits[0]
    m, d = fit.gain @ z0 + fit.offset, fit.cov
    h = np.array([m[0] ** 2 + d[0, 0], m[1]])
    slope = np.array([[2 * m[0], 0.0], [0.0, 1.0]])
    spread = np.array(
        [
            [4 * m[0] ** 2 * d[0, 0] + 2 * d[0, 0] ** 2 + 1, 2 * m[0] * d[0, 1]],
            [2 * m[0] * d[0, 1], d[1, 1] + 1],
        ]
    )
    z1 = m + d @ slope.T @ np.linalg.solve(spread, y1 - h)
    found = made.run(TACTS[:2], np.array([y0, y1])).mean
    np.testing.assert_allclose(found, [z0, z1], rtol=1e-12)
    assert correct(m, d, y1, (h, d @ slope.T, spread))[0] == pytest.approx(z1)


def test_times_between_tacts_are_even(oscillator):
    made = synthesize(oscillator, Memory(1), Taylor(), TACTS[:3], nodes=4, paths=300, seed=1)
    steps = [b - a for a, b in pairwise(made.predicted.times)]
    np.testing.assert_allclose(steps, 0.1)
