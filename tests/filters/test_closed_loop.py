"""Closed loops: the numbers of `simulate`, and the exact expected cost of linear control."""

import numpy as np
import pytest
import sympy

from seedslib import zoo
from seedslib.base import Input
from seedslib.filters import (
    KalmanFilter,
    KnownModeFilter,
    ParticleFilter,
    extended_kalman,
    simulate_closed_loop,
    unscented_kalman,
)
from seedslib.models import DiscreteSystem, JumpDiffusion, LinearSystem, Noise, StochasticMap
from systems import S, U

x, v, w = sympy.symbols("x v w", real=True)
TIMES = np.arange(5.0)
equal = np.testing.assert_array_equal
close = np.testing.assert_allclose


def pendulum(control=U):
    """A nonlinear system in discrete time with two states and an input."""
    a, b = sympy.symbols("a b", real=True)
    moves = StochasticMap([a, b], [a + b / 5, b - sympy.sin(a) / 5 + control + v / 9], Noise([v]))
    return DiscreteSystem(moves, StochasticMap([a, b], [a + w / 3], Noise([w])), [1, 0], np.eye(2))


def relaxation():
    """A jump-diffusion with an input."""
    noise = Noise((w,))
    return JumpDiffusion((x,), [-x + U], [[1]], [x**3 / 3 + w], noise, [0], [[1]], step=0.1)


LINE = LinearSystem(0.9, 1, 1, 1, 0, 2, b=U)
SYSTEMS = [
    (LINE, KalmanFilter),
    (LINE, lambda s: ParticleFilter(s, 30)),
    (pendulum(), unscented_kalman),
    (relaxation(), extended_kalman),
]


@pytest.mark.parametrize(("system", "make"), SYSTEMS)
@pytest.mark.parametrize("of_paths", [False, True])
def test_a_constant_policy_gives_the_numbers_of_a_simulation(system, make, of_paths):
    value = np.linspace(-1, 1, 7) if of_paths else 0.4
    loop = simulate_closed_loop(system, make(system), lambda t, estimate: {U: value}, TIMES, 7, 3)
    rows = np.repeat(np.broadcast_to(value, 7)[None], 5, axis=0)
    wanted = system.simulate(TIMES, 7, 3, inputs={U: rows if of_paths else np.full(5, 0.4)})
    equal(loop.times, TIMES)
    equal(loop.inputs[U], rows)
    equal(loop.states, wanted.states)
    equal(loop.measurements, wanted.measurements)


@pytest.mark.parametrize(("system", "make"), [SYSTEMS[0], *SYSTEMS[2:]])
def test_what_is_estimated_is_what_a_run_on_its_inputs_estimates(system, make):
    """And its states are those of a simulation with these inputs, in blocks of paths as well."""
    paths, filter, asked = 8200, make(system), []

    def policy(t, estimate):
        asked.append((t, estimate.mean.shape[1]))
        return {U: 0.1 * t - 0.5 * estimate.mean[0]}

    loop = simulate_closed_loop(system, filter, policy, TIMES, paths, 3)
    assert asked == [(t, size) for size in (8192, 8) for t in TIMES[:4]]
    equal(loop.states, system.simulate(TIMES, paths, 3, inputs=loop.inputs).states)
    run = filter.run(TIMES, loop.measurements, inputs=loop.inputs)
    for name in ("mean", "cov", "loglik", "diverged"):
        close(getattr(loop.estimates, name), getattr(run, name), rtol=1e-9, atol=1e-11)
    equal(loop.inputs[U][:4], (0.1 * TIMES[:, None] - 0.5 * loop.estimates.mean[:, 0])[:4])
    equal(loop.inputs[U][4], loop.inputs[U][3])


def test_options_and_several_inputs_reach_the_system():
    a, b = Input("a"), Input("b")
    system, given = relaxation(), {"scheme": "euler", "step": 0.5}
    nothing = {U: 0.0}
    loop = simulate_closed_loop(
        system, extended_kalman(system), lambda t, e: nothing, TIMES, 5, 2, **given
    )
    wanted = system.simulate(TIMES, 5, 2, inputs={U: np.zeros(5)}, **given)
    equal(loop.states, wanted.states)
    assert (wanted.states != system.simulate(TIMES, 5, 2, inputs={U: np.zeros(5)}).states).any()
    system = LinearSystem(0.9, 1, 1, 1, 0, 2, b=a - 2 * b)
    loop = simulate_closed_loop(
        system, KalmanFilter(system), lambda t, e: {b: t, a: e.mean[0]}, TIMES, 5, 2
    )
    equal(loop.states, system.simulate(TIMES, 5, 2, inputs=loop.inputs).states)
    equal(loop.inputs[b][:, 0], [0, 1, 2, 3, 3])
    equal(loop.inputs[a][:4], loop.estimates.mean[:4, 0])


def test_a_filter_that_draws_has_a_stream_of_its_own_in_each_block():
    """Not that of a time, from which the system draws."""
    noted = []

    class Noting(KalmanFilter):
        def initial(self, batch=(), seed=None):
            noted.append((*batch, *seed.spawn_key))
            return super().initial(batch)

    simulate_closed_loop(LINE, Noting(LINE), lambda t, e: {U: 0.0}, TIMES, 8200, 2)
    (*first, one), (*second, other) = noted
    assert (first, second) == ([8192, 0], [8, 1])
    assert one == other >= 10**6


def test_a_bound_input_is_not_chosen_and_may_be_that_of_a_path():
    system = LinearSystem(0.9, 1, 1, 1, 0, 2, b=U + S, d=S)
    given = np.linspace(-1, 1, 8200)
    bound = system.bind({S: given})
    loop = simulate_closed_loop(
        bound, KalmanFilter(bound), lambda t, e: {U: -e.mean[0]}, TIMES, 8200, 2
    )
    inputs = {**loop.inputs, S: np.tile(given, (5, 1))}
    equal(loop.states, system.simulate(TIMES, 8200, 2, inputs=inputs).states)
    run = KalmanFilter(system).run(TIMES, loop.measurements, inputs=inputs)
    close(loop.estimates.mean, run.mean, atol=1e-12)


def test_a_filter_may_have_another_model_than_the_truth():
    """Also one that knows nothing of the first state."""
    for start in ({"mean0": 1, "cov0": 2}, {"mean0": 0, "cov0": 0, "diffuse": (0,)}):
        other = LinearSystem(0.5, 3, 1, 2, **start, b=2 * U)
        assert_follows(other)


def assert_follows(other):
    loop = simulate_closed_loop(LINE, KalmanFilter(other), lambda t, e: {U: e.mean[0]}, TIMES, 5, 1)
    equal(loop.states, LINE.simulate(TIMES, 5, 1, inputs=loop.inputs).states)
    run = KalmanFilter(other).run(TIMES, loop.measurements, inputs=loop.inputs)
    close(loop.estimates.mean, run.mean, atol=1e-12)


F, B = np.array([[1.0, 0.3], [0.0, 1.1]]), np.array([[0.1], [0.3]])
Q, R = np.array([[0.02, 0.01], [0.01, 0.05]]), np.array([[0.4]])
H, MEAN0, COV0 = np.array([[1.0, 0.0]]), np.array([2.0, -1.0]), np.diag([0.5, 0.3])
STATE_COST, INPUT_COST, LAST = np.diag([1.0, 0.2]), np.array([[0.3]]), 15


def gains_and_costs():
    """Gains L_k, costs to go S_k and weights of the error, by the Riccati recursion of control."""
    S, gains, costs, weights = STATE_COST, [], [STATE_COST], []
    for _ in range(LAST):
        W = INPUT_COST + B.T @ S @ B
        L = np.linalg.solve(W, B.T @ S @ F)
        S = STATE_COST + F.T @ S @ (F - B @ L)
        gains, costs, weights = [L, *gains], [S, *costs], [L.T @ W @ L, *weights]
    return gains, costs, weights


def error_covariances():
    """Covariances of the error after each measurement, by the Riccati recursion of filtering."""
    P, after = COV0, []
    for _ in range(LAST + 1):
        after.append(np.linalg.inv(np.linalg.inv(P) + H.T @ np.linalg.solve(R, H)))
        P = F @ after[-1] @ F.T + Q
    return after


def cost_of_moments(gains):
    """Expected cost of u = -L m by the second moments of state and estimate, step by step."""
    after, cost = error_covariances(), 0.0
    # (x, m before the measurement): m is the known mean, x is drawn about it
    joint = np.outer(np.tile(MEAN0, 2), np.tile(MEAN0, 2))
    joint[:2, :2] += COV0
    for k in range(LAST + 1):
        K = after[k] @ H.T @ np.linalg.inv(R)
        correct = np.block([[np.eye(2), np.zeros((2, 2))], [K @ H, np.eye(2) - K @ H]])
        joint = correct @ joint @ correct.T
        joint[2:, 2:] += K @ R @ K.T
        cost += np.trace(STATE_COST @ joint[:2, :2])
        if k == LAST:
            return cost
        L = gains[k]
        cost += np.trace(L.T @ INPUT_COST @ L @ joint[2:, 2:])
        step = np.block([[F, -B @ L], [np.zeros((2, 2)), F - B @ L]])
        joint = step @ joint @ step.T
        joint[:2, :2] += Q
    return cost


def simulated_costs(sensor, noise, gains, paths, seed):
    system = LinearSystem(F, Q, sensor, noise, MEAN0, COV0, b=B[:, 0] * U)

    def policy(t, estimate):
        return {U: -(gains[int(t)] @ estimate.mean)[0]}

    loop = simulate_closed_loop(
        system, KalmanFilter(system), policy, np.arange(LAST + 1.0), paths, seed
    )
    u = loop.inputs[U][:LAST, None]
    return np.einsum("kiN,ij,kjN->N", loop.states, STATE_COST, loop.states) + np.einsum(
        "kiN,ij,kjN->N", u, INPUT_COST, u
    )


def test_the_cost_of_linear_quadratic_gaussian_control_is_the_expected_one():
    """Separation: the cost with the true state, and what the errors of the estimates add."""
    gains, costs, weights = gains_and_costs()
    known = MEAN0 @ costs[0] @ MEAN0 + np.trace(costs[0] @ COV0)
    known += sum(np.trace(S @ Q) for S in costs[1:])
    after = error_covariances()
    added = sum(np.trace(W @ P) for W, P in zip(weights, after[:LAST], strict=True))
    assert added > 0.1 * known
    close(cost_of_moments(gains), known + added, rtol=1e-12)

    estimated = simulated_costs(H, R, gains, 20000, 5)
    exact = simulated_costs(np.eye(2), np.zeros((2, 2)), gains, 20000, 5)
    other = simulated_costs(H, R, [0.6 * L for L in gains], 20000, 5)
    worse = cost_of_moments([0.6 * L for L in gains])
    assert worse > 1.05 * (known + added)
    pairs = [(estimated, known + added), (exact, known), (estimated - exact, added), (other, worse)]
    for found, wanted in pairs:
        error = found.std() / np.sqrt(len(found))
        assert error < 0.02 * wanted
        assert abs(found.mean() - wanted) < 3 * error


def policy_of(value):
    return lambda t, estimate: value


IDLE, KALMAN = policy_of({U: 0.0}), KalmanFilter(LINE)


def loop(policy=IDLE, system=LINE, filter=KALMAN, **options):
    return simulate_closed_loop(
        system, filter, policy, **{"times": TIMES, "paths": 4, "seed": 1} | options
    )


QUIET, SEEN = LinearSystem(0.9, 1, 1, 1, 0, 2), LinearSystem(0.9, 1, 1, 1, 0, 2, b=U, d=U)
TWO = LinearSystem(0.9, 1, [[1], [1]], np.eye(2), 0, 2, b=U)
OTHER = LinearSystem(0.9, 1, 1, 1, 0, 2, b=S)
BANK = zoo.manoeuvring_target("noisy")
ROWS = [
    (lambda: loop(system=QUIET, filter=KalmanFilter(QUIET)), ValueError, "system"),
    (lambda: loop(system=LINE.bind({U: 1.0})), ValueError, "system"),
    (lambda: loop(system=SEEN), ValueError, "system"),
    (lambda: loop(system=BANK, filter=KnownModeFilter(BANK)), TypeError, "system"),
    (lambda: loop(system=KalmanFilter(LINE)), TypeError, "system"),
    (lambda: loop(filter=LINE), TypeError, "filter"),
    (lambda: loop(filter=KnownModeFilter(BANK)), TypeError, "filter"),
    (lambda: loop(filter=KalmanFilter(QUIET)), ValueError, "filter"),
    (lambda: loop(filter=KalmanFilter(SEEN)), ValueError, "filter"),
    (lambda: loop(filter=KalmanFilter(TWO)), ValueError, "filter"),
    (lambda: loop(filter=KalmanFilter(OTHER)), ValueError, "filter"),
    (lambda: loop({U: 0.0}), TypeError, "policy"),
    (lambda: loop(policy_of(None)), ValueError, "policy"),
    (lambda: loop(policy_of(0.0)), ValueError, "policy"),
    (lambda: loop(policy_of({})), ValueError, "policy"),
    (lambda: loop(policy_of({S: 0.0})), ValueError, "policy"),
    (lambda: loop(policy_of({U: 0.0, S: 0.0})), ValueError, "policy"),
    (lambda: loop(policy_of({U: "a"})), TypeError, "policy"),
    (lambda: loop(policy_of({U: np.nan})), ValueError, "policy"),
    (lambda: loop(policy_of({U: [0, 0, np.inf, 0]})), ValueError, "policy"),
    (lambda: loop(policy_of({U: [0.0, 0.0]})), ValueError, "policy"),
    (lambda: loop(policy_of({U: np.zeros((1, 4))})), ValueError, "policy"),
    (lambda: loop(times=[0.0]), ValueError, "times"),
    (lambda: loop(times=[0.0, 1.0, 3.0]), ValueError, "times"),
    (lambda: loop(paths=0), ValueError, "paths"),
    (lambda: loop(seed=None), TypeError, "seed"),
]


@pytest.mark.parametrize(("call", "error", "name"), ROWS)
def test_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=rf"^{name}\b"):
        call()
