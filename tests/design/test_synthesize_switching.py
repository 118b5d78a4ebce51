"""Designs of switching systems on simulated paths: distributions in cells, thin cells, inputs,
schedules."""

import numpy as np
import pytest
import sympy

from seedslib.base import Input
from seedslib.design import cells_from_moments, synthesize
from seedslib.designed import Memory
from seedslib.linearization import ExactGaussian
from seedslib.models import Noise, SwitchingSystem

x, y, v, w, r, t = sympy.symbols("x y v w r t")
u = Input("u")


@pytest.fixture(scope="module")
def system():
    """Two unlike components, two modes that depend on the state, and an indicator."""
    leave = 0.35 - 0.3 * sympy.exp(-((x - 1) ** 2) / 8)
    return SwitchingSystem(
        (x, y),
        [[0.9 * x + y / 4 + v, 0.7 * y + w / 2], [x / 2 - 1 + 2 * v, y / 3 + 0.6 + w]],
        Noise((v, w)),
        [[1 - leave, leave], [0.3, 0.7]],
        [[x + r], [y - x / 2 + 0.7 * r]],
        Noise((r,)),
        [(0.6, [0.3, -0.2], [[1.2, 0.3], [0.3, 0.8]]), (0.4, [-0.5, 0.4], [[0.7, 0], [0, 1.1]])],
        indicator=[[0.8, 0.2], [0.3, 0.7]],
    )


def dist(rows):
    """Gain, offset and covariance of the state (two rows) given the memory, by least squares."""
    known = np.vstack([rows[2:], np.ones(rows.shape[1])])
    found = np.linalg.lstsq(known.T, rows[:2].T, rcond=None)[0].T
    rest = rows[:2] - found @ known
    return found[:, :-1], found[:, -1], rest @ rest.T / rows.shape[1]


def density(rows, z):
    mean, cov = rows[2:].mean(axis=1), np.atleast_2d(np.cov(rows[2:], bias=True))
    apart = z - mean
    score = -0.5 * apart @ np.linalg.solve(cov, apart)
    return np.exp(score) / np.sqrt(np.linalg.det(cov))


@pytest.mark.parametrize(
    ("memory", "paths"), [(Memory(1), 3000), (Memory(1, 0, 1), 1200), (Memory(0, 1, 1), 1200)]
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_fits_are_the_distributions_of_state_and_memory_in_the_cells_of_the_design_paths(
    system, memory, paths
):
    """Thin cells borrow from the modes of their cell, from their mode, and from everything."""
    made = synthesize(system, memory, ExactGaussian(), range(3), paths=paths, seed=5)
    data = system.simulate(range(3), paths, 5)
    found = made.run(data.times, data.measurements, indicators=data.indicators)
    square = (found.mean - data.states) ** 2
    np.testing.assert_allclose(made.predicted.rms, np.sqrt(square.mean(axis=2)), rtol=1e-9)
    wrong = (found.modes != data.modes).mean(axis=1)
    np.testing.assert_allclose(made.predicted.mode_rate, wrong, rtol=1e-12)
    doubt = np.sqrt(wrong * (1 - wrong) / paths)
    np.testing.assert_allclose(made.predicted.mode_error, doubt, rtol=1e-9)
    thin, pairs = 0, 0
    for k, fit in enumerate(made.fits):
        known = found.mean[k] if memory.estimates else data.measurements[k]
        cell = np.zeros(paths, dtype=int)
        if memory.estimates:
            cell = found.modes[k].astype(int)
        if memory.indicators:
            cell = cell * 2 + data.indicators[k]
        cells = (2 if memory.estimates else 1) * (2 if memory.indicators else 1)
        rows, least = np.concatenate([data.states[k], known]), max(50, 3 * (len(known) + 1))
        for c in range(cells):
            used, weights = [], []
            for i in (0, 1):
                here = (cell == c) & (data.modes[k] == i)
                weights.append(max(here.sum(), 0.5) / paths)
                pairs += 1
                for part in (here, cell == c, data.modes[k] == i, np.ones(paths, dtype=bool)):
                    if part.sum() >= least:
                        break
                thin += part is not here
                gain, offset, cov = dist(rows[:, part])
                used.append(rows[:, part])
                np.testing.assert_allclose(fit.gain[:, :, i, c], gain, rtol=1e-4, atol=1e-5)
                np.testing.assert_allclose(fit.offset[:, i, c], offset, rtol=1e-4, atol=1e-5)
                np.testing.assert_allclose(fit.cov[:, :, i, c], cov, rtol=1e-5, atol=1e-6)
            z = rows[2:].mean(axis=1) + 0.3
            mass = np.array(weights) * [density(part, z) for part in used]
            log_prob = fit.forecast(np.array(c), z).log_prob
            np.testing.assert_allclose(np.exp(log_prob), mass / mass.sum(), rtol=1e-4)
    assert (made.design.pooled, made.design.pairs) == (thin, pairs)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_design_moves_with_the_dynamics_of_the_time_that_a_step_leaves():
    """Its errors on its own paths are those of a run, where the dynamics change with time."""
    push = 3 * sympy.sin(2 * t)
    system = SwitchingSystem(
        (x,),
        [[x / 2 + push + v], [x / 3 - push + v]],
        Noise((v,)),
        [[0.8, 0.2], [0.3, 0.7]],
        [[x + r], [x + 2 * r]],
        Noise((r,)),
        [(0.6, [0.0], [[1.0]]), (0.4, [1.0], [[1.0]])],
    )
    made = synthesize(system, Memory(1), ExactGaussian(), range(4), paths=1200, seed=5)
    data = system.simulate(range(4), 1200, 5)
    found = made.run(data.times, data.measurements)
    square = (found.mean - data.states) ** 2
    np.testing.assert_allclose(made.predicted.rms, np.sqrt(square.mean(axis=2)), rtol=1e-9)


def test_cells_from_moments_are_conditional_normal_distributions():
    """A mode that never comes with a cell has the moments of the others."""
    root = np.array([[1.1, 0.0, 0.0], [0.4, 0.8, 0.0], [-0.5, 0.3, 0.6]])
    mean = np.array([[[0.3], [-0.4]], [[0.1], [0.5]], [[1.2], [0.7]]])
    first, second = root @ root.T, 2.0 * root @ root.T + 0.3 * np.eye(3)
    cov = np.stack([first, second], axis=-1)[..., None]
    fit = cells_from_moments(np.array([[0.7], [0.3]]), mean, cov, 1, jitter=0.0)
    z, mass = np.array([0.4, 0.9]), []
    for i, part in enumerate((first, second)):
        gain = np.linalg.solve(part[1:, 1:], part[1:, 0])
        np.testing.assert_allclose(fit.gain[0, :, i, 0], gain, rtol=1e-10)
        left = part[0, 0] - part[0, 1:] @ gain
        assert fit.cov[0, 0, i, 0] == pytest.approx(left, rel=1e-10)
        offset = mean[0, i, 0] - gain @ mean[1:, i, 0]
        assert fit.offset[0, i, 0] == pytest.approx(offset, rel=1e-10)
        apart = z - mean[1:, i, 0]
        score = -0.5 * apart @ np.linalg.solve(part[1:, 1:], apart)
        mass.append((0.7, 0.3)[i] * np.exp(score) / np.sqrt(np.linalg.det(part[1:, 1:])))
    found = np.exp(fit.forecast(np.array(0), z).log_prob)
    np.testing.assert_allclose(found, np.array(mass) / np.sum(mass), rtol=1e-10)
    alone = cells_from_moments(np.array([[0.7], [0.0]]), mean, cov, 1, jitter=0.0)
    np.testing.assert_allclose(alone.gain[:, :, 1], fit.gain[:, :, 0], rtol=1e-10)
    assert np.exp(alone.forecast(np.array(0), np.zeros(2)).log_prob).tolist() == [1.0, 0.0]
    # a covariance that is none is refused
    bad = np.array([[1.0, 1.5], [1.5, 1.0]])[..., None, None]
    with pytest.raises(
        ValueError, match=r"^moments: wanted a residual covariance that is positive"
    ):
        cells_from_moments(np.ones((1, 1)), np.zeros((2, 1, 1)), bad, 1)
