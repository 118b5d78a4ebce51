"""Models in continuous time; each call builds a new system."""

from __future__ import annotations

import sympy

from seedslib.models.jump_diffusion import JumpDiffusion
from seedslib.models.maps import Noise

Pair = tuple[float, float]


def van_der_pol(reading: str = "A") -> JumpDiffusion:
    """Van der Pol oscillator with multiplicative noise, section 9 of the jump-diffusion paper.

    dX1 = X2 dt, dX2 = [-w² X1 + alpha X2 (1 - beta X1²)] dt + X1 dW, measured Y1 = X1² + V1 and
    Y2 = X2 + V2 at the times 0, 0.5, ..., 3.

    Parameters
    ----------
    reading : str
        The paper's scan leaves some entries open. "A" is the default reading; the others change
        it: "B" noise X2 dW; "C" additive dW; "D" Y1 = X1³ + V1; "E" Y1 = X1 + V1 and
        Y2 = X1² + X2 + V2; "F" restoring force -w X1; "G" 0.15 is a standard deviation; "H"
        variance 0.1 of the sensor noise; "I" w = pi; "J" w = 1.1 pi; "K" linear sensor; "L"
        w = 1; "M" noise X2 dW with w = 1 and alpha = 0.2; "N" one measurement,
        Y = 0.9 X1² + 0.7071 X2 + V1, as in a program of the author's group.

    Raises
    ------
    ValueError
        An unknown reading.
    """
    if reading not in tuple("ABCDEFGHIJKLMN"):
        raise ValueError(f"reading: wanted a letter from A to N, got {reading!r}")
    x1, x2, v1, v2, w, alpha, beta = sympy.symbols("x1 x2 v1 v2 w alpha beta")
    frequency = {"I": sympy.pi, "J": 1.1 * sympy.pi, "L": 1, "M": 1}.get(reading, sympy.pi / 10)
    diffusion = {"B": x2, "M": x2, "C": 1}.get(reading, x1)
    first = {"D": x1**3, "E": x1, "K": x1}.get(reading, x1**2)
    second = x1**2 + x2 if reading == "E" else x2
    variance = 0.15**2 if reading == "G" else 0.15
    sensor, noise = [first + v1, second + v2], Noise((v1, v2))
    if reading == "H":
        noise = Noise((v1, v2), cov=[[0.1, 0], [0, 0.1]])
    if reading == "N":
        sensor, noise = [0.9 * x1**2 + 0.7071 * x2 + v1], Noise((v1,))
    return JumpDiffusion(
        state=(x1, x2),
        drift=[x2, -(w if reading == "F" else w**2) * x1 + alpha * x2 * (1 - beta * x1**2)],
        diffusion=[[0], [diffusion]],
        sensor=sensor,
        noise=noise,
        mean0=[2, 0],
        cov0=[[variance, 0], [0, variance]],
        parameters={w: frequency, alpha: sympy.Rational(1, 5) if reading == "M" else 2, beta: 1},
        step=0.01,
    )


def kicked_duffing(sensor_noise: Pair = (0.2, 1.0)) -> JumpDiffusion:
    """Duffing oscillator kicked at random times, more often where it is far out.

    dX1 = X2 dt, dX2 = (X1 - X1³ - 0.5 X2) dt + 0.2 dW + kicks; kicks come with
    intensity 0.2 + 0.2 X1² and are N(0.5, 3²) in velocity;
    Y = X1 (1 + sensor_noise[0] V1) + sensor_noise[1] V2. Default times 0, 0.5, ..., 6.
    """
    x1, x2, v1, v2, z = sympy.symbols("x1 x2 v1 v2 z")
    return JumpDiffusion(
        state=(x1, x2),
        drift=[x2, x1 - x1**3 - 0.5 * x2],
        diffusion=[[0], [0.2]],
        intensity=0.2 + 0.2 * x1**2,
        jump=[0, 0.5 + 3.0 * z],
        marks=Noise((z,)),
        sensor=[x1 * (1 + sensor_noise[0] * v1) + sensor_noise[1] * v2],
        noise=Noise((v1, v2)),
        mean0=[1, 0],
        cov0=[[0.1, 0], [0, 0.1]],
        step=0.01,
    )


def flip_process(rate: Pair = (0.3, 0.2), flip: float = 2.0) -> JumpDiffusion:
    """Bistable scalar process whose jumps throw it to the other side.

    dX = (X - X³) dt + 0.5 dW + jumps with intensity rate[0] + rate[1] X² and size
    N(-flip X, 0.3²); Y = X (1 + 0.3 V1) + 0.5 V2. Default times 0, 0.25, ..., 3.
    """
    x, v1, v2, z = sympy.symbols("x v1 v2 z")
    return JumpDiffusion(
        state=(x,),
        drift=[x - x**3],
        diffusion=[[0.5]],
        intensity=rate[0] + rate[1] * x**2,
        jump=[-flip * x + 0.3 * z],
        marks=Noise((z,)),
        sensor=[x * (1 + 0.3 * v1) + 0.5 * v2],
        noise=Noise((v1, v2)),
        mean0=[1],
        cov0=[[0.25]],
        step=0.0025,
    )


def linear_gaussian() -> JumpDiffusion:
    """Damped linear oscillator driven by noise, its position measured every half unit of time.

    dX = [[0, 1], [-1, -0.4]] X dt + (0, 1) dW, Y = X1 + V with variance 0.25, X0 of mean
    (1, -0.5) and unit covariance. Every approximation is exact here.
    """
    x1, x2, v = sympy.symbols("x1 x2 v")
    return JumpDiffusion(
        state=(x1, x2),
        drift=[x2, -x1 - 0.4 * x2],
        diffusion=[[0], [1]],
        sensor=[x1 + v],
        noise=Noise((v,), cov=[[0.25]]),
        mean0=[1, -0.5],
        cov0=[[1, 0], [0, 1]],
        step=0.01,
    )
