"""The measurements of the filters: numbers that are exact in binary."""


def wave(k: int, j: int = 0) -> float:
    """Component j of measurement k."""
    return ((37 * k * k + 11 * k + 23 * j) % 64 - 32) / 16
