"""What both sides of a comparison agree on: a record of measurements, and the infinite."""

STEPS = 50
"""Of the filters in discrete time."""

INF = 1e300
"""Stands for an infinite end."""


def wave(k: int, j: int = 0) -> float:
    """Component j of measurement k, exact in binary."""
    return ((37 * k * k + 11 * k + 23 * j) % 64 - 32) / 16
