"""Forecasts of measurements against regression on the data before, of one and of many modes."""

from itertools import product

import numpy as np
import pytest
import sympy
from scipy.special import ndtri

from oracles.linear import Regression, along, mixed
from seedslib.designed import SwitchingFilter
from seedslib.export import compiled
from seedslib.filters import (
    KalmanFilter,
    KnownModeFilter,
    ParticleFilter,
    forecast_measurements,
    unscented_kalman,
)
from seedslib.linearization import Taylor
from seedslib.models import LinearSystem, Noise, SwitchingSystem
from systems import (
    INDICATORS,
    INPUTS,
    TIMES,
    discrete_system,
    linear_numbers,
    linear_system,
    record,
    switching_numbers,
    switching_system,
)


def assert_forecasts(found, wanted):
    for k, (mean, cov) in enumerate(wanted):
        np.testing.assert_allclose(found.mean[k], mean, atol=1e-12)
        np.testing.assert_allclose(found.cov[k], cov, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "means"),
    [
        (lambda: KalmanFilter(linear_system()), False),
        (lambda: compiled(KalmanFilter(linear_system())), False),
        (lambda: unscented_kalman(discrete_system()), True),
    ],
)
def test_forecasts_of_one_step_and_of_several(make, means):
    """The last four measurements are not known: forecasts of one to four steps."""
    model = linear_numbers(means=means)
    exact, y = Regression(model), record(model)[1]
    y[3:] = np.nan
    wanted = [exact.measurement(y, k, k - 1) for k in range(7)]
    found = forecast_measurements(make(), TIMES, y, inputs=INPUTS)
    assert_forecasts(found, wanted)
    low, high = found.interval(0.8)
    deviations = np.sqrt([np.diagonal(cov) for _, cov in wanted])
    np.testing.assert_allclose(high - low, 2 * ndtri(0.9) * deviations, rtol=1e-10)
    assert list(found.to_dataframe(TIMES, ["a", "b"])) == ["a", "b", "a_sd", "b_sd"]
    many = np.stack([y, np.full_like(y, np.nan)], axis=-1)[..., None]
    several = forecast_measurements(make(), TIMES, many, inputs=INPUTS)
    nothing = [exact.measurement(y, k, -1) for k in range(7)]
    for i, part in enumerate((wanted, nothing)):
        assert_forecasts(type(found)(several.mean[:, :, i, 0], several.cov[..., i, 0]), part)


def test_what_nothing_has_determined_has_no_forecast():
    """A level and its slope: two measurements determine both, least squares says the rest."""
    system = LinearSystem(
        [[1, 1], [0, 1]], np.zeros((2, 2)), [[1, 0]], 0.5, [0, 0], np.zeros((2, 2)), diffuse=(0, 1)
    )
    y = np.array([[1.0], [np.nan], [4.0], [5.0], [np.nan]])
    found = forecast_measurements(KalmanFilter(system), np.arange(5.0), y)
    assert np.isinf(found.cov[:3]).all()
    for k, rows in ((3, [0, 2]), (4, [0, 2, 3])):
        design = np.stack([np.ones(len(rows)), rows], axis=1)
        inverse, now = np.linalg.inv(design.T @ design), np.array([1.0, k])
        assert found.mean[k, 0] == pytest.approx(now @ inverse @ design.T @ y[rows, 0], abs=1e-10)
        assert found.cov[k, 0, 0] == pytest.approx(0.5 * (1 + now @ inverse @ now), rel=1e-10)


def test_modes_that_are_known():
    model, modes = switching_numbers(), np.array([0, 2, 2, 1, 0, 1, 1])
    exact, y = Regression(along(model, modes)), record(model.modes[0])[1]
    filter = KnownModeFilter(switching_system(indicator=False))
    wanted = [exact.measurement(y, k, k - 1) for k in range(7)]
    assert_forecasts(forecast_measurements(filter, TIMES, y, modes=modes, inputs=INPUTS), wanted)


@pytest.mark.parametrize("indicator", [True, False])
def test_modes_that_are_not_known(indicator):
    """The mixture over all histories of the modes, up to the first step that the filter merges."""
    model, (times, inputs) = switching_numbers(), (TIMES[:2], {u: v[:2] for u, v in INPUTS.items()})
    y = record(model.modes[0])[1][:2]
    filter = SwitchingFilter(switching_system(indicator=indicator), Taylor())
    told = {"indicators": INDICATORS[:2]} if indicator else {}
    found = forecast_measurements(filter, times, y, inputs=inputs, **told)
    wanted = []
    for k in range(2):
        weights, parts = [], []
        for modes in product(range(3), repeat=k + 1):
            chain = Regression(along(model, [*modes, 0])) if k == 0 else None
            chain = chain or Regression(along(model, modes))
            weight = model.initial[modes[0]]
            if k:
                weight *= model.switching[0][modes] * np.exp(chain.loglik(y, 0))
                if indicator:
                    weight *= model.indicator[0][modes[0], INDICATORS[0]]
            weights.append(weight)
            parts.append(chain.measurement(y, k, k - 1))
        wanted.append(mixed(np.array(weights), *map(np.array, zip(*parts, strict=True))))
    assert_forecasts(found, wanted)


def test_angles_of_modes_on_both_sides_of_the_cut():
    """Two modes at 3 and -3 of a circle of length 2 pi: their mean is at pi, not at zero."""
    x, w = sympy.symbols("x w", real=True)
    parts = [(0.6, [3.0], [[0.01]]), (0.4, [-3.0], [[0.01]])]
    system = SwitchingSystem(
        [x],
        [[x], [x]],
        Noise(),
        [[1, 0], [0, 1]],
        [[x + w]] * 2,
        Noise([w], cov=[[0.02]]),
        parts,
        period={0: 2 * np.pi},
    )
    found = forecast_measurements(SwitchingFilter(system, Taylor()), [0.0], [[np.nan]])
    gap = 2 * np.pi - 6.0
    assert found.mean[0, 0] == pytest.approx(3.0 + 0.4 * gap)
    assert found.cov[0, 0, 0] == pytest.approx(0.03 + 0.24 * gap**2)


def test_filters_without_means_and_covariances_are_refused():
    filter = ParticleFilter(linear_system(inputs=False), 10)
    for wrong in (filter, 3):
        with pytest.raises(TypeError, match=r"^filter"):
            forecast_measurements(wrong, TIMES, np.zeros((7, 2)))
