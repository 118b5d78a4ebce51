"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest

from seedslib.delay import (
    DelayKalmanFilter,
    DelaySystem,
    PrintedDelayFilter,
    apply_gains,
    error_covariance,
    examples,
    greedy_gains,
    separate_gains,
    stationary_gains,
)

GIVEN = {
    "dynamics": {0: [[0.5, 0.1], [0.0, 0.4]], 2: [[0.1, 0.0], [0.2, 0.1]]},
    "sensor": [[1.0, 0.0]],
    "noise_cov": [[1.0]],
    "sensor_cov": [[0.5]],
    "cov0": np.eye(2),
    "history_cov": 0.3 * np.eye(2),
    "noise_input": [[0.0], [1.0]],
}
NAN = np.nan
PLANT = examples.rotation(0.7, 3)
KALMAN, PRINTED = DelayKalmanFilter(PLANT), PrintedDelayFilter(PLANT)
GAINS = greedy_gains(PLANT, 5).gains
LINKED = DelaySystem({1: 0.5}, 1.0, 1.0, 1.0, np.eye(2) + 0.5)
VARYING = DelaySystem({1: 0.5 * np.ones((4, 1, 1))}, 1.0, 1.0, 1.0, 1.0)
THREE = DelaySystem({0: 0.5, 1: 0.1, 2: 0.1}, 1.0, 1.0, 1.0, 1.0)
PAIR = DelaySystem({0: 0.5 * np.eye(2)}, np.eye(2), np.eye(2), np.eye(2), np.eye(2))
PAST = DelaySystem({1: 0.5}, 1.0, 1.0, 1.0, 1.0, mean0=[0.0, 1.0])


def system(**changes):
    return lambda: DelaySystem(**(GIVEN | changes))


def varying(**changes):
    return lambda: DelaySystem(**(GIVEN | changes)).step(3)


def wild(method):
    return lambda: DelayKalmanFilter(DelaySystem({0: 1e160}, 1.0, 1.0, 1.0, 1.0), method).gains(5)


def twice():
    state = KALMAN.step(KALMAN.initial(), 1, [0.0])
    return KALMAN.correct(state, [0.0])


REFUSALS = [
    (system(dynamics={}), ValueError, "dynamics"),
    (system(dynamics=[np.eye(2)]), TypeError, "dynamics"),
    (system(dynamics={-1: np.eye(2)}), ValueError, "dynamics"),
    (system(dynamics={1.5: np.eye(2)}), TypeError, "dynamics"),
    (system(dynamics={10**30: np.eye(2)}), ValueError, "dynamics"),
    (system(dynamics={0: np.ones((2, 3))}), ValueError, "dynamics"),
    (system(dynamics={0: np.zeros((0, 2, 2)), 2: np.eye(2)}), ValueError, "dynamics"),
    (system(dynamics={0: np.zeros((0, 0))}), ValueError, "dynamics"),
    (system(dynamics={0: [[1.0, 2.0], [3.0]]}), TypeError, "dynamics"),
    (system(sensor=[[1.0, 0.0, 0.0]]), ValueError, "sensor"),
    (system(sensor=np.ones((0, 2))), ValueError, "sensor"),
    (system(sensor=np.ones((1, 1, 2))), ValueError, "sensor"),
    (varying(sensor=lambda k: np.ones((1 + (k == 3), 2))), ValueError, "sensor at k = 3"),
    (varying(sensor_cov=lambda k: [[3.0 - k]]), ValueError, "sensor_cov at k = 3"),
    (varying(noise_cov=lambda k: np.eye(1 + (k == 2))), ValueError, "noise_cov at k = 2"),
    (varying(sensor=np.ones((3, 1, 2))), ValueError, "k"),
    (system(sensor_cov=[[0.0]]), ValueError, "sensor_cov"),
    (system(sensor=np.ones((2, 2)), sensor_cov=np.ones((2, 2))), ValueError, "sensor_cov"),
    (system(noise_cov=[[-1.0]]), ValueError, "noise_cov"),
    (system(noise_input=np.eye(2)), ValueError, "noise_input"),
    (system(noise_input=[[0.0], [1e200]]), ValueError, "system"),
    (system(cov0=np.eye(3)), ValueError, "cov0"),
    (system(cov0=np.eye(6)), ValueError, "history_cov"),
    (system(history_cov=-np.eye(2)), ValueError, "history_cov"),
    (system(history_cov=np.ones((3, 2, 2))), ValueError, "history_cov"),
    (system(mean0=[1.0, 2.0, 3.0]), ValueError, "mean0"),
    (lambda: PLANT.simulate(0, 1, 1), ValueError, "times"),
    (lambda: PLANT.simulate([0, 2], 1, 1), ValueError, "times"),
    (lambda: PLANT.simulate(2, 0, 1), ValueError, "paths"),
    (lambda: DelaySystem({0: 3.0}, 1.0, 1.0, 1.0, 1.0).simulate(999, 2, 1), ValueError, "system"),
    (lambda: DelayKalmanFilter("plant"), TypeError, "system"),
    (lambda: DelayKalmanFilter(PLANT, "fast"), ValueError, "method"),
    (lambda: DelayKalmanFilter(LINKED, "chandrasekhar"), ValueError, "method"),
    (lambda: DelayKalmanFilter(VARYING, "chandrasekhar"), ValueError, "method"),
    (lambda: KALMAN.gains(0), ValueError, "steps"),
    (lambda: KALMAN.gains(3, np.zeros((4, 1))), ValueError, "missing"),
    (lambda: KALMAN.gains(3, [[True], [True, False]]), TypeError, "missing"),
    (lambda: KALMAN.initial(3), TypeError, "batch"),
    (lambda: KALMAN.initial((0,)), ValueError, "batch"),
    (lambda: KALMAN.run(1, [[NAN]]), ValueError, "measurements"),
    (lambda: KALMAN.run(1, [NAN, 1.0]), ValueError, "measurements"),
    (lambda: KALMAN.innovations([[NAN, NAN], [0.0, 0.0]]), ValueError, "measurements"),
    (lambda: KALMAN.run(3, np.zeros((4, 1))), ValueError, "measurements"),
    (lambda: KALMAN.run(3, np.zeros((4, 1, 0))), ValueError, "measurements"),
    (lambda: KALMAN.run(1, [[NAN], [1.0]], lag=4), ValueError, "lag"),
    (lambda: KALMAN.predict(KALMAN.initial(), 1.5), ValueError, "t"),
    (lambda: KALMAN.predict(KALMAN.predict(KALMAN.initial(), 2), 1), ValueError, "t"),
    (lambda: KALMAN.step(KALMAN.initial(), 1, np.zeros(2)), ValueError, "y"),
    (lambda: KALMAN.step(KALMAN.initial((2,)), 1, [[NAN, 1.0]]), ValueError, "y"),
    (lambda: KALMAN.correct(KALMAN.initial(), [1.0]), ValueError, "state"),
    (twice, ValueError, "state"),
    *((wild(method), ValueError, "system") for method in ("structured", "array", "augmented")),
    (lambda: PrintedDelayFilter("plant"), TypeError, "system"),
    *((lambda s=s: PrintedDelayFilter(s), ValueError, "system") for s in (THREE, LINKED, PAST)),
    (lambda: PRINTED.run(2, [[NAN], [1.0], [NAN]]), ValueError, "measurements"),
    (lambda: PRINTED.predict(PRINTED.initial(), 2), ValueError, "t"),
    (lambda: PRINTED.correct(PRINTED.initial(), [1.0]), ValueError, "state"),
    (lambda: greedy_gains("plant", 5), TypeError, "system"),
    (lambda: separate_gains("plant", 5), TypeError, "system"),
    (lambda: greedy_gains(PLANT, 0), ValueError, "steps"),
    (lambda: greedy_gains(PLANT, 5, past=4), ValueError, "past"),
    (lambda: greedy_gains(PLANT, 5, keep="some"), ValueError, "keep"),
    (lambda: greedy_gains(PLANT, 5, criterion="max"), ValueError, "criterion"),
    (lambda: greedy_gains(PLANT, 5, criterion="sum", corrected=True), ValueError, "criterion"),
    (lambda: error_covariance(PLANT, None), TypeError, "gains"),
    (lambda: error_covariance(PLANT, GAINS._replace(gain=GAINS.gain[:, :1])), ValueError, "gains"),
    (lambda: error_covariance(PLANT, GAINS._replace(past=GAINS.past[:, :1])), ValueError, "gains"),
    (lambda: apply_gains(PLANT, GAINS, np.full((6, 1), NAN)), ValueError, "measurements"),
    (lambda: apply_gains(PLANT, GAINS, np.zeros((4, 1))), ValueError, "measurements"),
    (lambda: stationary_gains("plant"), TypeError, "system"),
    (lambda: stationary_gains(examples.rotation(0.8, 3)), ValueError, "system"),
    (lambda: stationary_gains(examples.scalar(1.0, 0.0, 1.0, 2)), ValueError, "system"),
    (lambda: stationary_gains(examples.scalar(0.9999, 0.0), 512), ValueError, "system"),
    *((lambda s=s: stationary_gains(s), ValueError, "system") for s in (VARYING, PAIR)),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()
