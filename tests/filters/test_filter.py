"""What all exact filters share: run, steps, forecasts, batches and inputs against regression.

The reference systems depend on time, start late, have inputs and noise means, and records with
gaps. Filters of modes are compared with the sum over all histories of the modes.
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

from oracles.linear import Regression, along, histories
from seedslib.base import Parameter
from seedslib.filters import (
    CovarianceFilter,
    KalmanFilter,
    KnownModeFilter,
    RaoBlackwellFilter,
    assumed_density,
    cubature_kalman,
    extended_kalman,
    unscented_kalman,
)
from seedslib.linearization import GaussHermite
from seedslib.models import DiscreteSystem, StochasticMap
from systems import (
    EVEN,
    INDICATORS,
    INPUTS,
    STATE,
    TIMES,
    discrete_system,
    linear_formulas,
    linear_numbers,
    linear_system,
    noises,
    record,
    switching_numbers,
    switching_system,
)

MODES = np.array([0, 2, 1, 1, 0, 2, 1])
SHORT = [0, 4, 2, 5]
"""Rows of a record for the sum over histories: partly, not, wholly and partly missing."""
SHORT_INDICATORS = np.array([0, -1, 1, 0])


class Case(NamedTuple):
    """A filter, its record, and the exact distribution of the state at k given what is known until
    last."""

    filter: Any
    times: np.ndarray
    y: np.ndarray
    dist: Any
    logliks: np.ndarray
    inputs: dict
    options: dict

    def told(self, k):
        """Arguments of a step to time k: the indicator, and the mode."""
        shown = self.options.get("indicators")
        modes = self.options.get("modes")
        return (
            () if shown is None else (shown[k],),
            {} if modes is None else {"mode": modes[k]},
        )

    def inputs_at(self, k):
        return {u: values[k] for u, values in self.inputs.items()}


def linear_case(filter, *, means, times=TIMES):
    return regression_case(filter, linear_numbers(times, means=means), times)


def known_mode_case(drives):
    chain = along(switching_numbers(), MODES, drives)
    options = {"modes": MODES, "indicators": INDICATORS}
    return regression_case(KnownModeFilter(switching_system(drives)), chain, TIMES, **options)


def regression_case(filter, model, times, **options):
    y, exact = record(model)[1], Regression(model)
    dist = partial(exact.estimate, y)
    return Case(filter, times, y, dist, exact.logliks(y), INPUTS, options)


def history_case(drives):
    y, model = record(linear_numbers())[1][SHORT], switching_numbers()

    def dist(k, last):
        return histories(model, y, SHORT_INDICATORS, k, last, drives)[:3]

    total = [histories(model, y, SHORT_INDICATORS, k, k, drives).loglik for k in range(4)]
    filter = RaoBlackwellFilter(switching_system(drives), 81)
    inputs = {u: values[:4] for u, values in INPUTS.items()}
    options = {"indicators": SHORT_INDICATORS}
    return Case(filter, TIMES[:4], y, dist, np.diff(total, prepend=0.0), inputs, options)


CASES = {
    "Kalman": lambda: linear_case(KalmanFilter(linear_system()), means=False),
    "Kalman, functions of time": lambda: linear_case(
        KalmanFilter(linear_system("functions")), means=False, times=EVEN
    ),
    "extended": lambda: linear_case(extended_kalman(discrete_system()), means=True),
    "cubature, LinearSystem": lambda: linear_case(cubature_kalman(linear_system()), means=False),
    "assumed density": lambda: linear_case(assumed_density(discrete_system()), means=True),
    "unscented": lambda: linear_case(unscented_kalman(discrete_system()), means=True),
    "unscented, other points": lambda: linear_case(
        unscented_kalman(discrete_system(), alpha=0.5, beta=2.0, kappa=0.0), means=True
    ),
    "cubature": lambda: linear_case(cubature_kalman(discrete_system()), means=True),
    "Gauss-Hermite": lambda: linear_case(
        CovarianceFilter(discrete_system(), GaussHermite(3)), means=True
    ),
    "known modes, old": lambda: known_mode_case("old"),
    "known modes, new": lambda: known_mode_case("new"),
    "Rao-Blackwell, old": lambda: history_case("old"),
    "Rao-Blackwell, new": lambda: history_case("new"),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    return CASES[request.param]()


def close(estimates, dist, index=...):
    """Mean, covariance and, where there are modes that are guessed, their probabilities."""
    np.testing.assert_allclose(estimates.mean[index], dist[0], rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(estimates.cov[index], dist[1], rtol=1e-10, atol=1e-12)
    if len(dist) == 3:
        np.testing.assert_allclose(estimates.mode_prob[index], dist[2], rtol=1e-11)


def test_run_equals_the_exact_distribution(case):
    estimates = case.filter.run(case.times, case.y, inputs=case.inputs, **case.options)
    for k in range(len(case.times)):
        close(estimates, case.dist(k, k), k)
    np.testing.assert_allclose(estimates.loglik, case.logliks, rtol=1e-10, atol=1e-12)
    assert not estimates.diverged


def test_steps_and_forecasts_equal_the_exact_distribution(case):
    """The inputs that act in a forecast are those of the time it leaves."""
    state = case.filter.initial(**case.told(0)[1])
    for k, t in enumerate(case.times):
        shown, mode = case.told(k)
        ahead = case.filter.forecast(state, t, **mode, inputs=case.inputs_at(max(k - 1, 0)))
        state = case.filter.predict(state, t, *mode.values(), inputs=case.inputs_at(max(k - 1, 0)))
        close(ahead, case.dist(k, k - 1) if k else case.dist(0, -1))
        assert ahead.loglik is None
        assert ahead.diverged is None
        state = case.filter.correct(state, case.y[k], *shown, inputs=case.inputs_at(k))
        estimate = case.filter.report(state)
        close(estimate, case.dist(k, k))
        np.testing.assert_allclose(estimate.loglik, case.logliks[k], rtol=1e-10, atol=1e-12)


def test_two_forecasts_in_a_row_equal_the_exact_distribution(case):
    state = case.filter.initial(**case.told(0)[1])
    for k in range(2):
        shown, mode = case.told(k)
        state = case.filter.predict(state, case.times[k], *mode.values(), inputs=case.inputs_at(0))
        state = case.filter.correct(state, case.y[k], *shown, inputs=case.inputs_at(k))
    state = case.filter.predict(
        state, case.times[2], *case.told(2)[1].values(), inputs=case.inputs_at(1)
    )
    close(
        case.filter.forecast(state, case.times[3], **case.told(3)[1], inputs=case.inputs_at(2)),
        case.dist(3, 1),
    )
    with pytest.raises(ValueError, match=r"^t: "):
        case.filter.predict(state, case.times[1], inputs=case.inputs_at(2))
    assert state.time == case.times[2]


def test_many_records_with_inputs_of_their_own_equal_single_ones(case):
    """In blocks, in threads, and with any batch axes."""
    count, filter = len(case.times), case.filter
    y = np.stack([case.y, case.y + 1.0, np.nan_to_num(case.y), case.y - 0.5], axis=-1)
    inputs = {u: values[:, None] * [1.0, -0.5, 2.0, 0.3] for u, values in case.inputs.items()}
    options = {name: np.repeat(part[:, None], 4, 1) for name, part in case.options.items()}
    if "modes" in options:
        options["modes"][2:, 1] = 0
    if "indicators" in options:
        options["indicators"][1, 2] = 0
    whole = filter.run(case.times, y, inputs=inputs, **options)
    assert whole.cov.shape == (*whole.mean.shape[:2], *whole.mean.shape[1:])
    for i in range(4):
        own = {name: part[:, i] for name, part in options.items()}
        given = {u: values[:, i] for u, values in inputs.items()}
        one = filter.run(case.times, y[..., i], inputs=given, **own)
        for a, b in ((whole.mean, one.mean), (whole.cov, one.cov), (whole.loglik, one.loglik)):
            np.testing.assert_allclose(a[..., i], b, rtol=1e-10, atol=1e-12)
        if one.modes is not None:
            np.testing.assert_array_equal(whole.modes[:, i], one.modes)
    square = {name: part.reshape(count, 2, 2) for name, part in options.items()}
    folded = {u: values.reshape(count, 2, 2) for u, values in inputs.items()}
    filter.block = lambda *_: 3
    try:
        parts = filter.run(
            case.times, y.reshape(count, 2, 2, 2), inputs=folded, workers=2, **square
        )
    finally:
        del filter.block
    for a, b in zip(parts, whole, strict=True):
        if a is not None:
            np.testing.assert_allclose(a, b.reshape(a.shape), rtol=1e-13, atol=1e-14)


def test_inputs_that_do_not_change_may_be_bound():
    y = record(linear_numbers())[1]
    constant = {u: np.full(7, 0.1 + k) for k, u in enumerate(INPUTS)}
    filter = extended_kalman(discrete_system())
    wanted = filter.run(TIMES, y, inputs=constant)
    bound, state = filter.bind({u: values[0] for u, values in constant.items()}), filter.initial()
    np.testing.assert_array_equal(bound.run(TIMES, y).mean, wanted.mean)
    for k, t in enumerate(TIMES):
        state = bound.step(state, t, y[k])
        np.testing.assert_array_equal(state.mean, wanted.mean[k])


def test_a_system_without_inputs_equals_one_with_inputs_of_zero():
    y = record(linear_numbers())[1]
    zero = dict.fromkeys(INPUTS, np.zeros(7))
    for make, filter in ((linear_system, KalmanFilter), (discrete_system, cubature_kalman)):
        one = filter(make(inputs=False)).run(TIMES, y)
        two = filter(make()).run(TIMES, y, inputs=zero)
        np.testing.assert_allclose(one.mean, two.mean, rtol=1e-12)
        np.testing.assert_allclose(one.loglik, two.loglik, rtol=1e-12, atol=1e-14)


def test_parameters_of_records_reach_all_blocks_and_threads():
    shift = Parameter("shift", 0.0)
    move, show = linear_formulas()
    noise, sensor_noise = noises()
    dynamics = StochasticMap(STATE, [move[0] + shift, *move[1:]], noise)
    base = discrete_system()
    system = DiscreteSystem(
        dynamics, StochasticMap(STATE, show, sensor_noise), base.mean0, base.cov0
    )
    filter, y = extended_kalman(system), np.repeat(record(linear_numbers())[1][..., None], 5, -1)
    values = np.arange(5.0)
    filter = filter.bind({shift: values})
    whole = filter.run(TIMES, y, inputs=INPUTS)
    filter.block = lambda *_: 2
    parts = filter.run(TIMES, y, inputs=INPUTS, workers=2)
    np.testing.assert_array_equal(whole.mean, parts.mean)
    model = linear_numbers()
    for i, value in enumerate(values):
        exact = Regression(model._replace(b=model.b + np.array([value, 0, 0])))
        np.testing.assert_allclose(whole.mean[..., i], exact.filtered(y[..., i])[0], rtol=1e-11)


def test_a_covariance_common_to_all_records_is_given_once():
    filter, y = extended_kalman(discrete_system()), record(linear_numbers())[1]
    many = np.stack([y, y + 1.0], axis=-1)
    assert filter.run(TIMES, many, inputs=INPUTS).cov.shape == (7, 3, 3)
    many[4, 1, 1] = np.nan
    cov = filter.run(TIMES, many, inputs=INPUTS).cov
    assert cov.shape == (7, 3, 3, 2)
    np.testing.assert_array_equal(cov[:4, ..., 0], cov[:4, ..., 1])
    assert (cov[4, ..., 0] != cov[4, ..., 1]).any()


def test_steps_of_unequal_length_need_the_elapsed_time():
    """Of the maps; a late first step fixes the length."""
    even = linear_system("functions")
    filter, y = KalmanFilter(even), record(linear_numbers(EVEN, means=False))[1]
    with pytest.raises(ValueError, match=r"^times: "):
        filter.run(TIMES, y, inputs=INPUTS)
    filter = filter.bind(dict.fromkeys(INPUTS, 0.0))
    state = filter.predict(filter.predict(filter.initial(), EVEN[0]), EVEN[1])
    for wrong in (EVEN[2] + 0.1, EVEN[1] - 0.1):
        with pytest.raises(ValueError, match=r"^t: "):
            filter.predict(state, wrong)
    later = filter.predict(state, EVEN[2])
    assert later.time == EVEN[2]
    same = filter.predict(state, EVEN[1])
    np.testing.assert_array_equal(same.mean, state.mean)
