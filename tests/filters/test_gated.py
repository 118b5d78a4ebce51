"""A gate leaves out measurements that are too far from what the filter expects."""

import numpy as np
import sympy as sp
from scipy.stats import chi2

from seedslib.filters import Gated, KalmanFilter, extended_kalman
from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap
from systems import INPUTS, TIMES, linear_numbers, linear_system, record


def test_gate_rejects_by_the_quadratic_form_and_leaves_out_what_it_rejects():
    """Beyond the quantile of as many degrees of freedom as there are components."""
    model, plain = linear_numbers(means=False), KalmanFilter(linear_system())
    y, gated = record(model)[1], Gated(plain, 0.99, patience=2)
    expected = plain.run(TIMES, y, inputs=INPUTS)
    spread = model.H[0] @ model.cov0 @ model.H[0].T + model.R[0]
    expected_y, most = model.H[0] @ model.mean0 + model.d[0], chi2.ppf(0.99, [1, 2])
    for number, direction in ((0, [1.0, np.nan]), (1, [0.7, -0.4])):
        here = np.isfinite(direction)
        step = np.array(direction)[here]
        length = np.sqrt(most[number] / (step @ np.linalg.solve(spread[np.ix_(here, here)], step)))
        many = np.repeat(y[..., None], 2, axis=-1)
        for i, factor in enumerate((0.999, 1.001)):
            many[0, :, i] = expected_y + factor * length * np.array(direction)
        estimates = gated.run(TIMES, many, inputs=INPUTS)
        assert estimates.rejected[0].tolist() == [False, True]
        many = np.where(estimates.rejected[:, None], np.nan, many)
        wanted = plain.run(TIMES, many, inputs=INPUTS)
        np.testing.assert_array_equal(estimates.mean, wanted.mean)
        np.testing.assert_array_equal(estimates.loglik, wanted.loglik)
    assert not gated.run(TIMES, y, inputs=INPUTS).rejected.any()
    np.testing.assert_array_equal(gated.run(TIMES, y, inputs=INPUTS).mean, expected.mean)
    assert gated.run(TIMES, y, inputs=INPUTS).to_dataframe(TIMES)["rejected"].sum() == 0


def test_gate_opens_after_its_patience():
    """A gap is no refusal; on the circle nearness counts; unknown numbers are not gated."""
    sure = LinearSystem(1, 0.01, 1, 1, 50, 1e-4)
    y = np.array([0.0, np.nan, 0.0, 0.0, 0.0])[:, None]
    estimates = Gated(KalmanFilter(sure), patience=3).run(range(5), y)
    assert estimates.rejected.tolist() == [True, False, True, True, False]
    x, w, v = sp.symbols("x w v", real=True)
    move = StochasticMap([x], [x + 0.1 * w], Noise([w]))
    seen = StochasticMap([x], [x + 0.1 * v], Noise([v]), period={0: 2 * np.pi})
    gated = Gated(extended_kalman(DiscreteSystem(move, seen, [3.1], [[0.01]])))
    assert not gated.run([0.0], [[-3.15]]).rejected[0]
    assert gated.run([0.0], [[2.0]]).rejected[0]
    gated = Gated(KalmanFilter(LinearSystem(1, 0.1, 1, 1, 0, 0, diffuse=(0,))))
    assert gated.run(range(3), [[1e6], [1e6], [0.0]]).rejected.tolist() == [False, False, True]
    assert gated.initial().time is None
    assert gated.predict(gated.initial(), 3.5).time == 3.5
