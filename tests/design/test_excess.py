"""What a design on N paths loses: against the exact law of a regression fitted to N samples."""

import numpy as np
import pytest
import sympy

from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.linearization import Taylor
from seedslib.models import DiscreteSystem, Noise, StochasticMap

DESIGNS = 150


def random_walk(paths, steps):
    """Designs of a Gaussian walk X' = X + W, Y = X + V with unit variances."""
    x, w, v = sympy.symbols("x w v")
    system = DiscreteSystem(
        StochasticMap((x,), [x + w], Noise((w,))), StochasticMap((x,), [x + v], Noise((v,))), [1],
        [[1]],
    )  # fmt: skip
    return [
        synthesize(system, Memory(1), Taylor(), np.arange(steps), paths=paths, seed=child)
        for child in np.random.SeedSequence(3).spawn(DESIGNS)
    ]


def law(variance, n):
    """E (fitted - best)² of a line through n normal points: v (1/n + (n + 1) / (n (n - 3)))."""
    return variance * (1 / n + (n + 1) / (n * (n - 3)))


@pytest.mark.filterwarnings("ignore:paths. .* are few")
@pytest.mark.filterwarnings("ignore:held out:UserWarning")
def test_excess_of_the_first_estimate_and_of_the_first_forecast():
    """Both are regressions on (1, Y_0), whatever the gain of the first estimate came out as."""
    start, forecast = [], []
    for filter in random_walk(40, 2):
        first, fit = filter.start, filter.fits[0]
        gain = (first.moments.cross / first.moments.cov)[0, 0]
        # the estimate z = level + gain (y - 1), for Y_0 ~ N(1, 2); the best is 1 + (y - 1) / 2
        level = first.mean[0] + gain * (1 - first.moments.mean[0])
        start.append((level - 1) ** 2 + 2 * (gain - 0.5) ** 2)
        slope = fit.gain[0, 0] * gain
        middle = fit.gain[0, 0] * level + fit.offset[0]
        forecast.append((middle - 1) ** 2 + 2 * (slope - 0.5) ** 2)
    for found, variance in ((start, 0.5), (forecast, 1.5)):
        error = np.std(found, ddof=1) / np.sqrt(DESIGNS)
        assert abs(np.mean(found) - law(variance, 40)) < 4 * error
        assert error < 0.15 * law(variance, 40)


@pytest.mark.filterwarnings("ignore:paths. .* are few")
@pytest.mark.filterwarnings("ignore:held out:UserWarning")
def test_a_promise_is_too_good_by_the_coefficients():
    """In-sample error of the first estimate: (1 - 2/N) of the true residual variance."""
    found = [filter.predicted.rms[0, 0] ** 2 for filter in random_walk(12, 1)]
    error = np.std(found, ddof=1) / np.sqrt(DESIGNS)
    assert abs(np.mean(found) - 0.5 * (1 - 2 / 12)) < 3 * error
    assert np.mean(found) < 0.5 - 3 * error
