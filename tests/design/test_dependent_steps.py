"""Noises of sensor and dynamics that depend on each other: the exact recursion of remark 1."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import DependentStep, dependent_steps, optimal_risk
from seedslib.designed import finite_memory, large_order

DECAY, PUSH, LOUD = 0.9, 0.5, 1.0


def normal(x, mean, deviation):
    return np.exp(-0.5 * ((x - mean) / deviation) ** 2) / deviation


def kernel(x, y, moves, sensors, push, loud, tied, leave):
    """gamma(x', y | x) on nodes: the next state is normal given the noise of the sensor."""
    modes, count = len(moves), len(x)
    found = np.zeros((len(y), modes, count, modes, count))
    for i in range(modes):
        seen = normal(y[:, None], sensors[i](x), loud)
        seen /= seen.sum(axis=0)
        mean = moves[i](x) + push * tied * (y[:, None] - sensors[i](x)) / loud
        there = normal(x[:, None], mean[:, None, :], push * np.sqrt(1 - tied**2))
        there /= there.sum(axis=1, keepdims=True)
        for l in range(modes):
            found[:, l, :, i] = seen[:, None] * there * leave[i][l](x)
    return found.reshape(len(y), modes * count, modes * count)


def kalman(tied, steps):
    """Error variances of the Kalman filter whose forecast uses the correlation."""
    forecast, found, both = 1.0, [], PUSH * LOUD * tied
    for _ in range(steps):
        total = forecast + LOUD**2
        found.append(forecast - forecast**2 / total)
        forecast = DECAY**2 * forecast + PUSH**2 - (DECAY * forecast + both) ** 2 / total
    return np.array(found)


def one_estimate(tied, steps):
    """Error variances where only the last estimate is remembered: all laws are normal."""
    xx, xu, uu, found = 1.0, 0.0, 0.0, []
    for _ in range(steps):
        spread = np.array([[xx + LOUD**2, xu], [xu, uu]])
        gain = np.linalg.pinv(spread) @ [xx, xu]
        found.append(xx - gain @ [xx, xu])
        both = DECAY * gain @ [xx, xu] + gain[0] * PUSH * LOUD * tied
        xx, xu, uu = DECAY**2 * xx + PUSH**2, both, gain @ spread @ gain
    return np.array(found)


@pytest.mark.parametrize(("measurements", "tied"), [(False, 0.7), (True, 0.7), (True, -0.7)])
def test_linear_system_with_tied_noises_is_the_kalman_filter_where_it_remembers_enough(
    measurements, tied
):
    x, y = np.linspace(-5, 5, 61), np.linspace(-8, 8, 49)
    made = kernel(
        x, y, [lambda x: DECAY * x], [lambda x: x], PUSH, LOUD, tied, [[lambda x: 1 + 0 * x]]
    )
    start = normal(x, 0, 1)
    wanted = (kalman if measurements else one_estimate)(tied, 4)
    errors = [
        np.array([
            s.mse
            for s in dependent_steps(
                start / start.sum(), [made] * 4, x, 1, z=(-4, 4, n), measurements=measurements
            )
        ])
        for n in (21, 41)
    ]  # fmt: skip
    assert (errors[1] > wanted - 2e-4).all()
    limit = errors[1] + (errors[1] - errors[0]) / 3
    np.testing.assert_allclose(limit, wanted, rtol=1e-2)
    if measurements:
        assert (one_estimate(tied, 4)[2:] > 1.003 * limit[2:]).all()


def scalar(tied):
    """The scalar benchmark with its noises tied, on nodes."""
    x, y = np.linspace(-8, 8, 41), np.linspace(-16, 18, 69)

    def leave(x):
        return 0.35 - 0.3 * np.exp(-(x**2) / 8)

    def back(x):
        return 0.1 + 0.5 * np.exp(-(x**2) / 2)

    made = kernel(
        x, y, [lambda x: x + 1.8 * np.sin(x), lambda x: 0.6 * x], [lambda x: x, lambda x: 2 + x],
        0.5, 2.0, tied, [[lambda x: 1 - leave(x), leave], [back, lambda x: 1 - back(x)]],
    )  # fmt: skip
    start = np.tile(normal(x, 0, 1), 2)
    return start / start.sum(), made, np.tile(x, 2)


def test_independent_noises_are_the_recursion_of_theorem_2():
    start, made, x = scalar(0.0)
    steps = list(dependent_steps(start, [made] * 4, x, 2, z=(-6, 6, 41)))
    axes = {"x": (-8, 8, 41), "y": (-16, 18, 69)}
    system = zoo.scalar_switching()
    risk = optimal_risk(system, large_order(1), range(4), z=(-6, 6, 41), **axes)
    np.testing.assert_allclose([s.mse for s in steps], risk.mse, rtol=1e-6)
    np.testing.assert_allclose([s.mode_error for s in steps], risk.mode_error, rtol=1e-6)
    more = list(dependent_steps(start, [made] * 3, x, 2, z=(-6, 6, 41), measurements=True))
    past = optimal_risk(system, finite_memory(1), range(3), **axes)
    for other in (risk.mse, past.mse):
        assert all(s.mse < m + 1e-9 for s, m in zip(more, other, strict=False))


def test_errors_of_the_first_two_steps_are_those_on_paths():
    """The second function is looked up where the first estimate and mode were remembered."""
    tied, count, rng = 0.8, 20_000, np.random.default_rng(1)
    start, made, nodes = scalar(tied)
    first, second = dependent_steps(start, [made] * 2, nodes, 2, z=(-6, 6, 41))
    assert isinstance(first, DependentStep)
    # numbers of the cells that have probability
    place = np.clip((first.mean[:, 0] + 6) / 0.3, 0, 40 - 1e-9)
    used = np.zeros(82, dtype=bool)
    for up in (0, 1):
        used[(place.astype(int) + up + 41 * first.mode[:, 0])[first.mass[:, 0] > 1e-12]] = True
    used = np.flatnonzero(used)
    assert abs(second.mass.shape[1] - len(used)) <= 2
    x, mode, cell = rng.standard_normal(count), rng.integers(0, 2, count), np.zeros(count, int)
    for step in (first, second):
        noise = rng.standard_normal(count)
        y = x + 2 * mode + 2 * noise
        at = np.clip((y + 16) / 0.5, 0, 67.999)
        j, share = at.astype(int), at % 1
        mean = (1 - share) * step.mean[j, cell] + share * step.mean[j + 1, cell]
        decided = step.mode[np.rint(at).astype(int), cell]
        square = (mean - x) ** 2
        assert abs(square.mean() - step.mse) < 4 * square.std() / np.sqrt(count) + 0.004 * step.mse
        wrong = (decided != mode).mean()
        doubt = np.sqrt(wrong * (1 - wrong) / count)
        assert abs(wrong - step.mode_error) < 4 * doubt + 0.002
        drive = tied * noise + np.sqrt(1 - tied**2) * rng.standard_normal(count)
        leave = np.where(
            mode == 0, 0.35 - 0.3 * np.exp(-(x**2) / 8), 0.1 + 0.5 * np.exp(-(x**2) / 2)
        )
        x = np.where(mode == 0, x + 1.8 * np.sin(x), 0.6 * x) + 0.5 * drive
        mode = np.where(rng.random(count) < leave, 1 - mode, mode)
        at = np.clip((mean + 6) / 0.3, 0, 39.999)
        low = at.astype(int) + (rng.random(count) < at % 1) + 41 * decided
        cell = np.clip(np.searchsorted(used, low), 0, second.mass.shape[1] - 1)
