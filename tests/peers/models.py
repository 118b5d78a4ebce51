"""Random models that the library and other programs are given, as arrays and plain functions.

NumPy only, but for the functions that make our systems, so that a program that runs where the
library is not installed can read them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Linear(NamedTuple):
    """X' = F X + W, Y = H X + V; ``y`` has shape (K, m), the distribution is that of the first
    state."""

    F: np.ndarray
    Q: np.ndarray
    H: np.ndarray
    R: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    y: np.ndarray


class Bent(NamedTuple):
    """X' = A X + B sin(C X) + W, Y = D X + E sin(G X) + V."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    E: np.ndarray
    G: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    y: np.ndarray

    def move(self, x: Any, sin: Any = np.sin) -> Any:
        return self.A @ x + self.B @ sin(self.C @ x)

    def see(self, x: Any, sin: Any = np.sin) -> Any:
        return self.D @ x + self.E @ sin(self.G @ x)

    def move_slope(self, x: np.ndarray) -> np.ndarray:
        return self.A + self.B @ np.diag(np.cos(self.C @ x)) @ self.C

    def see_slope(self, x: np.ndarray) -> np.ndarray:
        return self.D + self.E @ np.diag(np.cos(self.G @ x)) @ self.G


def roots(rng, n, more=0.0, rank=None):
    """Parts of a random covariance, each a matrix times its transpose; of a lower rank if wanted.

    Noise is drawn along them: a factor that linear algebra is free to choose would make other
    records on other processors.
    """
    parts = [rng.normal(size=(n, n if rank is None else rank)) / n**0.5]
    return [*parts, more**0.5 * np.eye(n)] if more else parts


def square(parts):
    """The covariance of the parts."""
    return sum(part @ part.T for part in parts)


def drawn(rng, parts):
    """A vector with that covariance."""
    return sum(part @ rng.normal(size=part.shape[1]) for part in parts)


def matrix(rng, n, radius):
    """A random matrix whose largest eigenvalue has this modulus."""
    raw = rng.normal(size=(n, n))
    return raw * (radius / np.abs(np.linalg.eigvals(raw)).max())


def path(rng, model, dists, move, see, steps):
    """The model with a record; distributions are the parts of its three covariances."""
    first, noise, sensor = dists
    x, y = model.mean + drawn(rng, first), []
    for k in range(steps):
        if k:
            x = move(x) + drawn(rng, noise)
        y.append(see(x) + drawn(rng, sensor))
    return model._replace(y=np.array(y))


def linear(seed, n, m, radius=0.9, rank=None, known=0, steps=25):
    """A random linear model; above a radius of one it is unstable.

    `rank` is that of Q; the last `known` components have no noise and a known first value, so
    that every covariance of the state is singular.
    """
    rng = np.random.default_rng(seed)
    F, noise, first = matrix(rng, n, radius), roots(rng, n, rank=rank), roots(rng, n, 0.2)
    last = slice(n - known, n)
    F[last, : n - known] = 0.0
    for part in (*noise, *first):
        part[last] = 0.0
    H, sensor, mean = rng.normal(size=(m, n)), roots(rng, m, 0.1), rng.normal(size=n)
    model = Linear(F, square(noise), H, square(sensor), mean, square(first), np.empty(0))
    dists = first, noise, sensor
    return path(rng, model, dists, lambda x: F @ x, lambda x: H @ x, steps)


def bent(seed, n, m, radius=0.9, steps=20):
    """A random model with sines in its dynamics and its sensor.

    They are flat enough for filters to hold the state: a filter that has lost it makes anything
    of the last digit.
    """
    rng = np.random.default_rng(seed)
    A, (B, C) = matrix(rng, n, radius), rng.normal(size=(2, n, n)) * [[[0.5]], [[n**-0.5]]]
    D, E, G = rng.normal(size=(m, n)), 0.5 * rng.normal(size=(m, n)), rng.normal(size=(n, n)) / n
    noise, sensor, first = (
        [scale**0.5 * part for part in roots(rng, size, 0.1)]
        for size, scale in ((n, 0.1), (m, 0.3), (n, 0.3))
    )
    dists = square(noise), square(sensor), rng.normal(size=n), square(first)
    model = Bent(A, B, C, D, E, G, *dists, np.empty(0))
    return path(rng, model, (first, noise, sensor), model.move, model.see, steps)


def system(model):
    """The library's system of a model."""
    import sympy

    from seedslib.models import DiscreteSystem, LinearSystem, Noise, StochasticMap

    if isinstance(model, Linear):
        return LinearSystem(*model[:6])
    x, w, v = (
        np.array(sympy.symbols(f"{name}1:{len(part) + 1}", real=True))
        for name, part in (("x", model.mean), ("w", model.Q), ("v", model.R))
    )
    sin = np.vectorize(sympy.sin, otypes=[object])
    return DiscreteSystem(
        StochasticMap(x, model.move(x, sin) + w, Noise(w, cov=model.Q)),
        StochasticMap(x, model.see(x, sin) + v, Noise(v, cov=model.R)),
        model.mean,
        model.cov,
    )


def late(y):
    """A record before which nothing was measured: filterpy moves the first distribution once."""
    return np.concatenate([np.full((1, *y.shape[1:]), np.nan), y])


DYNAMAX = {
    "two states": linear(71, 2, 1, steps=8),
    "three unstable states": linear(72, 3, 2, 1.05, steps=8),
    "noise of rank one": linear(73, 3, 2, 0.9, 1, steps=8),
    "two bent states": bent(74, 2, 1, steps=8),
    "three bent states": bent(75, 3, 2, steps=8),
}
"""What ``benchmarks/peers_dynamax.py`` gives to dynamax."""
