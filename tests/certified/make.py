"""Write the enclosures: ``python tests/certified/make.py`` gives the same bytes each time.

``enclosures.csv`` has the arguments, and for each quantity decimal numbers and one radius within
which all exact values lie. ``functions.csv`` has the largest proved error of the library for each
function. It takes half a minute.
"""

import csv
import json
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
RUNS, STEPS = 10, 16


def dyadic(rng: np.random.Generator, low: float, high: float, *shape: int) -> Any:
    """Multiples of 1/64."""
    return (rng.integers(round(64 * low), round(64 * high) + 1, shape) / 64).tolist()


def spread(rng: np.random.Generator, scale: float = 1.0) -> list:
    """A covariance (2, 2) in multiples of 1/4096, never singular."""
    root = np.array(dyadic(rng, -scale, scale, 2, 2))
    return (root @ root.T + np.eye(2) * scale / 16).tolist()


def dist(rng: np.random.Generator) -> tuple[list, list, list]:
    """A mean, a covariance, and the covariance of an error, which is smaller."""
    error, rest = spread(rng), np.array(spread(rng))
    return dyadic(rng, -2, 2, 2), (np.array(error) + rest).tolist(), error


def cases() -> dict[str, list[dict[str, Any]]]:
    """The arguments of each function."""
    rng = np.random.default_rng(1)
    chevron = [[0.0, 0.0], [2.0, -1.0], [1.0, 1.0], [2.0, 3.0], [-1.0, 1.0]]
    regions = [{"mean": [0.25, 0.5], "cov": [[1.0, 0.5], [0.5, 2.0]], "vertices": chevron}]
    far = [[4.0, 3.0], [6.0, 3.0], [5.0, 7.0]]
    thin = [[-3.0, -3.0], [3.0, 3.0], [3.0, 3.0 + 2.0**-10]]
    for vertices in (far, thin):
        regions.append({"mean": [0.0, 0.0], "cov": [[1.0, 0.0], [0.0, 1.0]], "vertices": vertices})
    for count in [3] * 15 + [4, 5, 6] * 3:  # star-shaped about the middle
        turn = np.sort(rng.random(count)) * 2 * np.pi
        ends = (np.array([np.cos(turn), np.sin(turn)]) * (0.5 + 2 * rng.random(count))).T
        vertices = (np.round(ends * 64) / 64 + dyadic(rng, -1, 1, 2)).tolist()
        regions.append({"mean": dyadic(rng, -1, 1, 2), "cov": spread(rng), "vertices": vertices})
    pairs = {"h": dyadic(rng, -4, 4, 40), "k": dyadic(rng, -4, 4, 40)}
    pairs["rho"] = dyadic(rng, -0.98, 0.98, 40)
    means, error_vars = dyadic(rng, -3, 3, 24), dyadic(rng, 0.03, 1, 24)
    rest = dyadic(rng, 0.03, 2, 24)
    lines = {"mean": means, "error_var": error_vars}
    lines["var"] = [p + q for p, q in zip(error_vars, rest, strict=True)]
    dists = [dist(rng) for _ in range(16)]
    planes = {
        name: [part[k] for part in dists] for k, name in enumerate(("mean", "cov", "error_cov"))
    }
    power = {"drift": "-1", "noise": "1/2", "sensor_noise": "1/10"}
    energies = []
    for sign in ("", "-"):
        f = Fraction(sign + "1245/10000")
        row = [f, Fraction("701/10000")]
        form = [[Fraction("136/2000") * a * b for b in row] for a in row]
        form[1][1] += Fraction("739/200")
        drift = [[str(part) for part in row], ["-25247/10000", "-5488/10000"]]
        weights = [[str(part) for part in line] for line in form]
        energies.append(
            {"drift": drift, "noise": "1/100", "sensor_noise": "1/20", "weights": weights}
        )
    first, second = [[0.5, 0.75], [1.0, 0.75]], [[-0.75, -1.0], [0.5, 0.5]]
    delays = [
        {"dynamics": {"0": first, "1": second}, "sensor_var": 1.0, "steps": 12},
        {
            "dynamics": {"0": [[0.0, -0.75], [-0.5, 1.0]], "2": [[0.0, -0.5], [0.0, -1.0]]},
            "sensor_var": 0.125,
            "steps": 10,
        },
    ]
    shown = {"H": [[1.0, 0.0]], "R": [[0.25]]}
    move, push = [[1.0, 0.5], [-0.5, 0.75]], [[0.25, 0.0], [0.0, 0.0625]]
    kalman, designed, imm = [], [], []
    for _ in range(RUNS):
        y = dyadic(rng, -3, 3, STEPS, 1)
        plant = {"F": move, "Q": push, "mean0": [1.0, -0.5], "cov0": spread(rng)}
        kalman.append(plant | shown | {"y": y})
        fits = [
            [dyadic(rng, -0.75, 0.75, 2, 2), dyadic(rng, -1, 1, 2), spread(rng)]
            for _ in range(STEPS - 1)
        ]
        start = [dyadic(rng, -1, 1, 2), spread(rng)]
        designed.append({"fits": fits, "start": start} | shown | {"y": y})
        modes = {"chain": [[0.9375, 0.0625], [0.25, 0.75]], "F": [move, [[1.0, 1.0], [0.0, 1.0]]]}
        modes["Q"] = [push, [[0.25, 0.0], [0.0, 4.0]]]
        modes["starts"] = [[0.75, *start], [0.25, *start]]
        imm.append(modes | shown | {"y": y})
    return {
        "polygon": regions,
        "bivariate_normal_cdf": [pairs],
        "sine": [lines],
        "modulus": [lines],
        "maximum": [planes],
        "steady_power": [power],
        "steady_energy": energies,
        "delay_gains": delays,
        "kalman": kalman,
        "designed": designed,
        "imm": imm,
    }


def decimals(values: list) -> tuple[str, str]:
    """Decimal numbers, and a radius within which all exact values lie."""
    texts, radius = [], Fraction(0)
    for value in values:
        middle, width, power = (int(part) for part in value.mid_rad_10exp(24))
        texts.append(f"{middle}e{power}")
        radius = max(radius, Fraction(width) * Fraction(10) ** power)
    return " ".join(texts), f"{float(radius) * (1 + 1e-9) + 1e-60:.3e}"


def write(name: str, rows: list[list[Any]]) -> None:
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def main() -> None:
    from certified import comparison, enclosures

    rows = [["function", "case", "quantity", "radius", "values", "units", "arguments"]]
    for function, several in cases().items():
        for case, arguments in enumerate(several):
            told = json.dumps(arguments)
            for quantity, (values, units) in getattr(enclosures, function)(**arguments).items():
                texts, radius = decimals(values)
                scale = "" if units is values else " ".join(f"{float(u):.6e}" for u in units)
                rows.append([function, case, quantity, radius, texts, scale, told])
                told = ""
    write("enclosures.csv", rows)
    write("functions.csv", comparison.summary())


if __name__ == "__main__":
    main()
