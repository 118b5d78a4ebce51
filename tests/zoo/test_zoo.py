"""The systems of the papers: their formulas, written again, and distributions of their paths."""

import numpy as np
import pytest
import sympy

from seedslib import zoo

X = np.linspace(-4.0, 4.0, 9)[None]


def test_rates_of_the_systems_with_jumps_are_their_closed_forms():
    duffing = zoo.kicked_duffing()
    (x1, x2), rate = duffing.state, (1 + duffing.state[0] ** 2) / 5
    flip = zoo.flip_process()
    (q,), flips = flip.state, 0.3 + 0.2 * flip.state[0] ** 2
    for system, velocity, spread in (
        (duffing, [x2, x1 - x1**3 - 0.5 * x2 + 0.5 * rate], [[0, 0], [0, 0.04 + 9.25 * rate]]),
        (flip, [q - q**3 - 2 * q * flips], [[0.25 + flips * (4 * q**2 + 0.09)]]),
    ):
        found = [sympy.Matrix(part) for part in system.moment_expressions]
        for one, two in zip(found, (velocity, spread), strict=True):
            error = one - sympy.Matrix(two)
            error = error.applyfunc(lambda e: sympy.expand(sympy.nsimplify(e)))
            assert error.is_zero_matrix


def test_readings_of_the_van_der_pol_oscillator():
    at = np.array([[0.7], [-1.2]])
    noise = np.array([[0.3], [-0.1]])
    for letter in "ABCDEFGHIJKLMN":
        system = zoo.van_der_pol(letter)
        w = {"I": np.pi, "J": 1.1 * np.pi, "L": 1, "M": 1}.get(letter, np.pi / 10)
        force = w if letter == "F" else w**2
        damping = 0.2 if letter == "M" else 2.0
        drift = [-1.2, -force * 0.7 + damping * -1.2 * (1 - 0.7**2)]
        np.testing.assert_allclose(system.drift(0.0, at)[:, 0], drift, rtol=1e-13)
        push = {"B": -1.2, "M": -1.2, "C": 1.0}.get(letter, 0.7)
        np.testing.assert_allclose(system.diffusion(0.0, at).ravel(), [0, push])
        first = {"D": 0.7**3, "E": 0.7, "K": 0.7}.get(letter, 0.7**2)
        second = 0.49 - 1.2 if letter == "E" else -1.2
        shown = system.sensor.value(0.0, at, noise[:1] if letter == "N" else noise)
        wanted = [0.9 * 0.49 - 0.7071 * 1.2 + 0.3] if letter == "N" else [first + 0.3, second - 0.1]
        np.testing.assert_allclose(shown[:, 0], wanted, rtol=1e-13)
        assert system.cov0[0, 0] == pytest.approx(0.0225 if letter == "G" else 0.15)
        assert system.sensor.noise.cov[0, 0] == (0.1 if letter == "H" else 1.0)


@pytest.mark.parametrize("rate", [0.25, 1.0, 5 / 3])
def test_rate_scales_both_switches(rate):
    leave = rate * (0.35 - 0.3 * np.exp(-(X[0] ** 2) / 8))
    back = rate * (0.1 + 0.5 * np.exp(-(X[0] ** 2) / 2))
    system = zoo.scalar_switching("A1H", rate=rate)
    found = [[np.broadcast_to(b.probability(0.0, X), 9) for b in row] for row in system.branches]
    np.testing.assert_allclose(found, [[1 - leave, leave], [back, 1 - back]], atol=1e-14)


@pytest.mark.parametrize(("sensor", "default"), [("A1H", 2.0), ("A1L", 0.5), ("A2", 1.0)])
def test_scalar_switching_moves_and_shows_as_it_says(sensor, default):
    for given, wanted in ((None, default), (1 / 3, 1 / 3)):
        data = zoo.scalar_switching(sensor, deviation=given).simulate(range(3), 10_000, 5)
        x, modes = data.states[:, 0], data.modes
        shown = 0.5 * x + 0.2 * x**2 if sensor == "A2" else x + 2.0 * modes
        moved = np.where(modes == 0, x + 1.8 * np.sin(x), 0.6 * x)[:-1]
        for noise, size in ((data.measurements[:, 0] - shown, wanted), (x[1:] - moved, 0.5)):
            assert noise.std() == pytest.approx(size, rel=4 / np.sqrt(2 * noise.size))
            assert abs(noise.mean()) < 4 * size / np.sqrt(noise.size)


@pytest.mark.parametrize("modes", [1, 2])
def test_steady_target_moves_as_it_says(modes):
    system = zoo.steady_target(modes)
    data = system.simulate(np.arange(6.0), 5_000, 3)
    x, drive = data.states, data.modes[:-1]
    push = x[1:, 1] - 0.98 * x[:-1, 1]
    np.testing.assert_allclose(x[1:, 0], x[:-1, 0] + x[:-1, 1] + push / 2, atol=1e-12)
    for noise, wanted in ((push - drive, 0.1), (data.measurements[:, 0] - x[:, 0], 1.0)):
        assert noise.std() == pytest.approx(wanted, rel=4 / np.sqrt(2 * noise.size))
    assert (system.indicators > 0) == (modes == 2)
    if modes == 2:
        np.testing.assert_array_equal(data.indicators, data.modes)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: zoo.scalar_switching(rate=1.7), "switching of mode 1"),
        (lambda: zoo.scalar_switching("A3"), "sensor"),
        (lambda: zoo.scalar_switching(deviation=0.0), "deviation"),
        (lambda: zoo.steady_target(3), "modes"),
        (lambda: zoo.manoeuvring_target("other"), "indicator"),
        (lambda: zoo.van_der_pol("Z"), "reading"),
    ],
)
def test_wrong_arguments_are_refused_by_name(call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call()
