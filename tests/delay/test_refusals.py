"""What is refused: the type of the error, and the argument that its message names."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.delay import (
    DelaySystem,
    apply_gains,
    error_covariance,
    greedy_gains,
    optimal_gains,
    printed_gains,
    separate_gains,
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
PLANT = zoo.delayed_oscillator(0.7, 3)
GAINS = greedy_gains(PLANT, 5).gains
EXPLODING = DelaySystem({0: 1e3}, 0.0, 1.0, 1.0, 1.0)
THREE = DelaySystem({0: 0.5, 1: 0.1, 2: 0.1}, 1.0, 1.0, 1.0, 1.0)


def system(**changes):
    return lambda: DelaySystem(**(GIVEN | changes))


REFUSALS = [
    (system(dynamics={}), ValueError, "dynamics"),
    (system(dynamics=[np.eye(2)]), ValueError, "dynamics"),
    (system(dynamics={-1: np.eye(2)}), ValueError, "dynamics"),
    (system(dynamics={1.5: np.eye(2)}), ValueError, "dynamics"),
    (system(dynamics={0: np.ones((2, 3))}), ValueError, "dynamics"),
    (system(sensor=[[1.0, 0.0, 0.0]]), ValueError, "sensor"),
    (system(sensor_cov=[[0.0]]), ValueError, "sensor_cov"),
    (system(sensor_cov=np.eye(2)), ValueError, "sensor"),
    (system(noise_cov=[[-1.0]]), ValueError, "noise_cov"),
    (system(noise_input=np.eye(2)), ValueError, "noise_input"),
    (system(cov0=np.eye(3)), ValueError, "dynamics"),
    (system(history_cov=-np.eye(2)), ValueError, "history_cov"),
    (system(history_cov=np.ones((3, 2, 2))), ValueError, "history_cov"),
    (system(mean0=[1.0, 2.0, 3.0]), ValueError, "mean0"),
    (lambda: PLANT.simulate(0, 1, 1), ValueError, "steps"),
    (lambda: PLANT.simulate(2, 0, 1), ValueError, "paths"),
    (lambda: optimal_gains(PLANT, 0), ValueError, "steps"),
    (lambda: optimal_gains(EXPLODING, 200), ValueError, "steps"),
    (lambda: printed_gains(PLANT, 0), ValueError, "steps"),
    (lambda: printed_gains(THREE, 5), ValueError, "system"),
    (lambda: greedy_gains(PLANT, 0), ValueError, "steps"),
    (lambda: separate_gains(PLANT, 0), ValueError, "steps"),
    (lambda: greedy_gains(PLANT, 5, past=4), ValueError, "past"),
    (lambda: greedy_gains(PLANT, 5, keep="some"), ValueError, "keep"),
    (lambda: greedy_gains(PLANT, 5, criterion="max"), ValueError, "criterion"),
    (lambda: greedy_gains(PLANT, 5, criterion="sum", corrected=True), ValueError, "criterion"),
    (lambda: error_covariance(PLANT, GAINS._replace(gain=GAINS.gain[:, :1])), ValueError, "gains"),
    (lambda: error_covariance(PLANT, GAINS._replace(past=GAINS.past[:, :1])), ValueError, "gains"),
    (lambda: apply_gains(PLANT, GAINS, np.full((6, 1), NAN)), ValueError, "measurements"),
    (lambda: apply_gains(PLANT, GAINS, np.zeros((4, 1))), ValueError, "measurements"),
]


@pytest.mark.parametrize(("call", "error", "name"), REFUSALS)
def test_a_wrong_argument_is_refused_by_its_name(call, error, name):
    with pytest.raises(error, match=f"^{name}"):
        call()
