import numpy as np
import pytest

from seedslib.design.law.recursion import conditional, posterior_means, push_forward, seen


def forward_slowly(joint, likelihood, lower, share, letters, dropped):
    """(4.10) by loops: one event at a time."""
    cells, size = joint.shape
    new = np.zeros((letters, cells // dropped, size))
    for y in range(len(likelihood)):
        for cell in range(cells):
            for s in range(size):
                mass = joint[cell, s] * likelihood[y, s]
                first = lower[y, cell]
                new[first, cell // dropped, s] += mass * (1 - share[y, cell])
                new[first + 1, cell // dropped, s] += mass * share[y, cell]
    return new.reshape(-1, size)


@pytest.mark.parametrize(("cells", "dropped"), [(1, 1), (5, 5), (5, 1), (25, 5)])
def test_push_forward_against_loops(cells, dropped):
    rng, letters = np.random.default_rng(cells), 5
    joint = rng.random((cells, 7)) / (7 * cells)
    joint[cells // 2, :3] = 0.0
    likelihood = rng.random((9, 7))
    likelihood /= likelihood.sum(axis=0)
    lower = rng.integers(0, letters - 1, (9, cells))
    share = rng.random((9, cells))
    found = push_forward(joint, likelihood, lower, share, letters, dropped)
    assert found.shape == (letters * cells // dropped, 7)
    wanted = forward_slowly(joint, likelihood, lower, share, letters, dropped)
    assert np.allclose(found, wanted, rtol=1e-13, atol=1e-16)
    assert found.sum() == pytest.approx(joint.sum(), rel=1e-14)
    assert np.allclose(found.sum(axis=0), joint.sum(axis=0), rtol=1e-13)


def test_push_forward_in_pieces_is_the_same(monkeypatch):
    rng = np.random.default_rng(3)
    joint, likelihood = rng.random((16, 6)), rng.random((30, 6))
    lower, share = rng.integers(0, 3, (30, 16)), rng.random((30, 16))
    whole = push_forward(joint, likelihood, lower, share, 4, 4)
    monkeypatch.setattr("seedslib.design.law.recursion.CHUNK", 50)
    assert np.allclose(push_forward(joint, likelihood, lower, share, 4, 4), whole, rtol=1e-13)


def test_posterior_means_against_loops():
    rng = np.random.default_rng(4)
    values, joint, likelihood = rng.random((2, 5)), rng.random((3, 5)), rng.random((4, 5))
    found = posterior_means(values, conditional(joint), likelihood)
    for y in range(4):
        for cell in range(3):
            weight = joint[cell] * likelihood[y]
            assert found[:, y, cell] == pytest.approx(values @ weight / weight.sum(), rel=1e-13)


def test_cells_without_probability_use_the_measurement_alone():
    rng = np.random.default_rng(5)
    joint, likelihood = rng.random((3, 5)), rng.random((4, 5))
    joint[1] = 0.0
    values = rng.random((1, 5))
    law = conditional(joint)
    assert np.allclose(law.sum(axis=1), 1.0)
    found = posterior_means(values, law, likelihood)
    assert np.isfinite(found).all()
    weight = joint.sum(axis=0) * likelihood
    assert found[0, :, 1] == pytest.approx((weight @ values[0]) / weight.sum(axis=1))


def test_measurements_that_no_state_explains_leave_the_forecast():
    """The law is at one node, the measurement near another, and the likelihood is tiny there."""
    law = np.array([[1.0, 0.0]])
    relative = np.array([[0.0, 1.0]])
    assert posterior_means(np.array([[3.0, 5.0]]), law, relative)[0, 0, 0] == 3.0


def test_quadrature_weights_are_normalised_and_the_defect_told():
    y = np.linspace(-6, 6, 49)
    states = np.array([0.0, 5.5])
    loglik = -0.5 * (y[:, None] - states) ** 2 - 0.5 * np.log(2 * np.pi)
    weights = np.full(49, 0.25)
    found = seen(loglik, weights)
    assert np.allclose(found.mass.sum(axis=0), 1.0, atol=1e-15)
    assert found.defect[0] < 1e-8
    assert found.defect[1] == pytest.approx(0.3085, abs=0.05)
    ratio = found.mass / found.relative
    assert np.allclose(ratio, ratio[:, :1], rtol=1e-12)
    with pytest.raises(ValueError, match="y: wanted axes that hold"):
        seen(-0.5 * (y[:, None] - np.array([0.0, 900.0])) ** 2, weights)
