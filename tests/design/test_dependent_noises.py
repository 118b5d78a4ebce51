"""Remark 1 of the switching paper: noises of sensor and dynamics that depend on each other."""

import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import dependent_steps, optimal_risk
from seedslib.designed import finite_memory, large_order

DECAY, PUSH, LOUD, TIED = 0.9, 0.5, 1.0, 0.7


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


def linear(tied):
    x, y = np.linspace(-5, 5, 61), np.linspace(-8, 8, 49)
    made = kernel(
        x, y, [lambda x: DECAY * x], [lambda x: x], PUSH, LOUD, tied, [[lambda x: 1 + 0 * x]]
    )
    start = normal(x, 0, 1)
    return start / start.sum(), made, x


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


@pytest.mark.parametrize("tied", [TIED, -TIED, 0.0])
@pytest.mark.parametrize("measurements", [False, True])
def test_linear_system(measurements, tied):
    """With the measurement remembered it is the Kalman filter; without it a worse normal filter."""
    start, made, x = linear(tied)
    wanted = (kalman if measurements else one_estimate)(tied, 5)
    errors = [
        np.array([
            s.mse for s in
            dependent_steps(start, [made] * 5, x, 1, z=(-4, 4, n), measurements=measurements)
        ])
        for n in (21, 41)
    ]  # fmt: skip
    assert (errors[1] > wanted - 2e-4).all()
    limit = errors[1] + (errors[1] - errors[0]) / 3
    np.testing.assert_allclose(limit, wanted, rtol=1e-2)
    if tied and measurements:
        assert (one_estimate(tied, 5)[2:] > (1.05 if tied > 0 else 1.005) * limit[2:]).all()
    if not tied:
        np.testing.assert_allclose(kalman(0.0, 5), one_estimate(0.0, 5), rtol=1e-12)


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


def test_independent_noises_are_theorem_2():
    start, made, x = scalar(0.0)
    steps = list(dependent_steps(start, [made] * 5, x, 2, z=(-6, 6, 41)))
    axes = {"x": (-8, 8, 41), "y": (-16, 18, 69)}
    risk = optimal_risk(zoo.scalar_switching(), large_order(1), range(5), z=(-6, 6, 41), **axes)
    np.testing.assert_allclose([s.mse for s in steps], risk.mse, rtol=1e-6)
    np.testing.assert_allclose([s.mode_error for s in steps], risk.mode_error, rtol=1e-6)
    more = list(dependent_steps(start, [made] * 5, x, 2, z=(-6, 6, 41), measurements=True))
    seen = optimal_risk(zoo.scalar_switching(), finite_memory(1), range(5), **axes)
    for other in (risk, seen):
        assert all(s.mse < m + 1e-9 for s, m in zip(more[:3], other.mse, strict=False))


def test_predicted_errors_are_those_on_paths():
    """The functions, looked up by hand, on paths whose noises are tied."""
    tied, count, rng = 0.8, 20_000, np.random.default_rng(1)
    start, made, nodes = scalar(tied)
    z = np.linspace(-6, 6, 41)
    x, mode = rng.standard_normal(count), rng.integers(0, 2, count)
    cell = np.zeros(count, dtype=int)
    for k, step in enumerate(dependent_steps(start, [made] * 2, nodes, 2, z=(-6, 6, 41))):
        noise = rng.standard_normal(count)
        y = x + 2 * mode + 2 * noise
        at = np.clip((y + 16) / 0.5, 0, 67.999)
        j, share = at.astype(int), at % 1
        mean = (1 - share) * step.mean[j, cell] + share * step.mean[j + 1, cell]
        decided = step.mode[np.rint(at).astype(int), cell]
        square = (mean - x) ** 2
        assert abs(square.mean() - step.mse) < 4 * square.std() / np.sqrt(count) + 0.004 * step.mse
        wrong = (decided != mode).mean()
        assert abs(wrong - step.mode_error) < 4 * np.sqrt(wrong * (1 - wrong) / count) + 0.002
        drive = tied * noise + np.sqrt(1 - tied**2) * rng.standard_normal(count)
        leave = np.where(
            mode == 0, 0.35 - 0.3 * np.exp(-(x**2) / 8), 0.1 + 0.5 * np.exp(-(x**2) / 2)
        )
        x = np.where(mode == 0, x + 1.8 * np.sin(x), 0.6 * x) + 0.5 * drive
        mode = np.where(rng.random(count) < leave, 1 - mode, mode)
        if k == 0:  # cells without probability are left out of later steps
            at = np.clip((mean + 6) / 0.3, 0, 39.999)
            low = at.astype(int) + (rng.random(count) < at % 1)
            used = _used(step, len(z))
            cell = np.clip(np.searchsorted(used, low + decided * len(z)), 0, len(used) - 1)


def _used(step, count):
    """Numbers of the cells that the first step fills."""
    at = np.clip((step.mean + 6) / 0.3, 0, count - 1 - 1e-9).astype(int) + step.mode * count
    filled = np.zeros(2 * count + 1, dtype=bool)
    heavy = step.mass > 1e-12
    filled[at[heavy]] = filled[at[heavy] + 1] = True
    return np.flatnonzero(filled[:-1])
