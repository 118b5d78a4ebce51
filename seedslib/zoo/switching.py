"""Three switching systems to compare filters on; see `seedslib.zoo`."""

from __future__ import annotations

from typing import Any

import sympy

from seedslib.base.checks import as_positive
from seedslib.models.maps import Noise
from seedslib.models.switching import SwitchingSystem

SCALAR_SENSORS = {"A1H": 2.0, "A1L": 0.5, "A2": 1.0}


def scalar_switching(
    sensor: str = "A1H", *, deviation: float | None = None, rate: float = 1.0
) -> SwitchingSystem:
    """Scalar system of two modes whose switching depends on the state.

    Mode 0: x + 1.8 sin x + v/2; mode 1: 0.6 x + v/2. From mode 0 it switches with probability
    0.35 - 0.3 exp(-x²/8), in mode 1 it stays with probability 0.9 - 0.5 exp(-x²/2). Default
    times 0, 1, ..., 30.

    Parameters
    ----------
    sensor : {"A1H", "A1L", "A2"}
        "A1H" and "A1L" show x in mode 0 and 2 + x in mode 1, with noise of deviation 2 or 0.5;
        "A2" shows x/2 + x²/5 in both, with unit noise, which leaves the sign of x open.
    deviation : float, optional
        Another deviation of the sensor noise.
    rate : float
        Factor of both probabilities to change the mode; at most 5/3, where mode 1 is left for
        certain at x = 0.

    Raises
    ------
    TypeError, ValueError
        An unknown sensor, a deviation that is not positive, probabilities beyond one.
    """
    if sensor not in SCALAR_SENSORS:
        raise ValueError(f"sensor: wanted one of {', '.join(SCALAR_SENSORS)}, got {sensor!r}")
    deviation = as_positive("deviation", SCALAR_SENSORS[sensor] if deviation is None else deviation)
    x, v, w = sympy.symbols("x v w", real=True)
    leave = rate * (0.35 - 0.3 * sympy.exp(-(x**2) / 8))
    back = rate * (0.1 + 0.5 * sympy.exp(-(x**2) / 2))
    deviation = sympy.nsimplify(deviation, rational=True)
    measured = [[x + deviation * w], [2 + x + deviation * w]]
    if sensor == "A2":
        measured = [[x / 2 + x**2 / 5 + deviation * w]] * 2
    return SwitchingSystem(
        state=(x,),
        dynamics=[
            [x + sympy.Rational(9, 5) * sympy.sin(x) + v / 2],
            [sympy.Rational(3, 5) * x + v / 2],
        ],
        noise=Noise((v,)),
        switching=[[1 - leave, leave], [back, 1 - back]],
        sensor=measured,
        sensor_noise=Noise((w,)),
        initial=[(0.5, [0], [[1]])] * 2,
    )


INDICATORS = {"noisy": [[0.9, 0.1], [0.2, 0.8]], "exact": [[1, 0], [0, 1]], "none": None}


def manoeuvring_target(indicator: str = "noisy") -> SwitchingSystem:
    """Target that flies evenly or manoeuvres; its position is measured, its mode is hinted at.

    State (position, velocity); in mode 1 the velocity decays faster, is driven, and both noises
    are larger. Default times 0, 1, ..., 40.

    Parameters
    ----------
    indicator : {"noisy", "exact", "none"}
        An indicator that is right with probability 0.9 and 0.8, one that shows the mode, or no
        indicator.
    """
    if indicator not in INDICATORS:
        raise ValueError(f"indicator: wanted one of {', '.join(INDICATORS)}, got {indicator!r}")
    x1, x2, v, w = sympy.symbols("x1 x2 v w", real=True)

    def moved(decay: float, drive: float, noise: float) -> list[sympy.Expr]:
        push = drive + noise * v
        return [x1 + x2 + push / 2, decay * x2 + push]

    return SwitchingSystem(
        state=(x1, x2),
        dynamics=[moved(0.98, 0, 0.1), moved(0.9, 1, 0.5)],
        noise=Noise((v,)),
        switching=[[0.95, 0.05], [0.15, 0.85]],
        sensor=[[x1 + w], [x1 + 3 * w]],
        sensor_noise=Noise((w,)),
        initial=[(0.8, [0, 0], [[4, 0], [0, 1]]), (0.2, [0, 0], [[4, 0], [0, 1]])],
        indicator=INDICATORS[indicator],
    )


def steady_target(modes: int = 1) -> SwitchingSystem:
    """Target whose filter is known: a linear system of one mode, or of two that are observed.

    State (position, velocity), its position measured with unit noise; the velocity decays by 0.98
    in a step. With two modes the indicator shows which, and they differ only in what drives the
    velocity, 0 or 1: covariances do not depend on the modes, and a filter of order one can be the
    Kalman filter with known modes. Default times 0, 1, ..., 15.

    Parameters
    ----------
    modes : {1, 2}
    """
    if modes not in (1, 2):
        raise ValueError(f"modes: wanted 1 or 2, got {modes!r}")
    x1, x2, v, w = sympy.symbols("x1 x2 v w", real=True)
    pushes = [drive + 0.1 * v for drive in range(modes)]
    return SwitchingSystem(
        state=(x1, x2),
        dynamics=[[x1 + x2 + push / 2, 0.98 * x2 + push] for push in pushes],
        noise=Noise((v,)),
        switching=[[1]] if modes == 1 else [[0.95, 0.05], [0.15, 0.85]],
        sensor=[[x1 + w]] * modes,
        sensor_noise=Noise((w,)),
        initial=[(1 / modes, [0, 0], [[4, 0], [0, 1]])] * modes,
        indicator=None if modes == 1 else INDICATORS["exact"],
    )


def dependent_switching(offset: Any = 0.0) -> SwitchingSystem:
    """Scalar system with a state-dependent indicator and dependent noises in both equations.

    The next mode is 1 where V' > alpha_i + beta_i x, the indicator where W' > tau_i + delta_i x;
    V' is correlated with the noise of the state, W' with that of the sensor. Default times
    0, 1, ..., 20.

    Parameters
    ----------
    offset : float
        Added to what the sensor shows: no good filter is moved by it.
    """
    x, v, w = sympy.symbols("x v w", real=True)
    q = sympy.nsimplify

    def beyond(threshold, slope, correlation, noise) -> sympy.Expr:
        """Probability that a normal number, given its correlate `noise`, exceeds a threshold."""
        threshold, slope, correlation = map(q, (threshold, slope, correlation))
        distance = (threshold + slope * x - correlation * noise) / sympy.sqrt(1 - correlation**2)
        return (1 - sympy.erf(distance / sympy.sqrt(2))) / 2

    switch = [beyond(1.2, -0.8, 0.6, v), beyond(-0.3, 0.5, -0.4, v)]
    show = [beyond(1, -0.7, 0.5, w), beyond(-0.2, 0.4, -0.3, w)]
    return SwitchingSystem(
        state=(x,),
        dynamics=[[q(0.2) + q(0.9) * x + q(0.6) * v], [q(-0.5) + q(0.5) * x + q(0.8) * v]],
        noise=Noise((v,)),
        switching=[[1 - p, p] for p in switch],
        sensor=[
            [offset + x + q(0.1) * x**2 + q(0.7) * w],
            [offset + 1 + q(0.7) * x - q(0.05) * x**2 + q(0.5) * w],
        ],
        sensor_noise=Noise((w,)),
        initial=[(0.6, [0], [[1]]), (0.4, [0.5], [[0.5]])],
        indicator=[[1 - p, p] for p in show],
    )
