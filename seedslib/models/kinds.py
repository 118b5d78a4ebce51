"""What kind a system is: the sentence for a wrong one, and the times that its steps allow."""

from __future__ import annotations

import numpy as np

from seedslib.base.checks import as_times

KINDS = ("JumpDiffusion", "DiscreteSystem", "SwitchingSystem")

UNEVEN = 1e-6
"""Steps of a system in discrete time may differ by this part of them."""

_WAYS_OUT = {
    "JumpDiffusion": "see extended_kalman, ParticleFilter or synthesize",
    "DiscreteSystem": "see extended_kalman, ParticleFilter or synthesize",
    "SwitchingSystem": "see SwitchingFilter, RaoBlackwellFilter, ParticleFilter or synthesize",
    "LinearDiffusion": "see two_step.KalmanBucyFilter, or write it as a JumpDiffusion",
    "AugmentedDiffusion": "see the filters of two_step, or write it as a JumpDiffusion",
    "DelaySystem": "see delay.DelayKalmanFilter, or write the stacked state as a DiscreteSystem",
    "PiecewiseLinearSystem": (
        "see piecewise.PiecewiseLinearFilter, or write it as a DiscreteSystem of array functions"
    ),
    "Memory": "the system comes before the memory",
}


def kind_of(system: object) -> str:
    """One of `KINDS`, told by what the object has, or the name of its type."""
    sensor = getattr(system, "sensor", None)
    if hasattr(system, "branches") and hasattr(system, "readings"):
        return "SwitchingSystem"
    if hasattr(sensor, "value") and hasattr(system, "drift_map"):
        return "JumpDiffusion"
    if hasattr(sensor, "value") and hasattr(getattr(system, "dynamics", None), "value"):
        return "DiscreteSystem"
    return type(system).__name__


def require_kind(system: object, *kinds: str) -> None:
    """Refuse a system that a filter or a design cannot take, and say which can.

    Raises
    ------
    TypeError
        None of the wanted kinds.
    """
    found = kind_of(system)
    if found in kinds:
        return
    wanted, way = " or ".join(kinds), _WAYS_OUT.get(found)
    got = f"a {found}"
    if isinstance(system, type):
        got, way = f"the class {system.__name__}", "make one"
    raise TypeError(f"system: wanted a {wanted}, got {got}" + (f"; {way}" if way else ""))


def require_sampled(system: object) -> None:
    """Refuse what cannot be simulated path by path with a sensor.

    Raises
    ------
    TypeError
        None of `KINDS`, and nothing with `initial_sample`, `advance` and a `sensor` map.
    """
    if not (
        all(hasattr(system, name) for name in ("initial_sample", "advance"))
        and hasattr(getattr(system, "sensor", None), "sample")
    ):
        require_kind(system, *KINDS)


def in_steps(system: object) -> bool:
    """Whether the system moves by one application of a map per step of the time grid."""
    # a switching system that is seen as one with a mixed state knows the system that it is
    return hasattr(getattr(system, "system", system), "dynamics")


def as_grid(name: str, value: object, system: object) -> np.ndarray:
    """Times, see `as_times`; equally spaced ones for a system in discrete time.

    Raises
    ------
    TypeError, ValueError
        As `as_times`; `ValueError` also for unequal steps of a system in discrete time, whose
        map moves it by one step however long the gap is.
    """
    times = as_times(name, value)
    if len(times) > 2 and in_steps(system):
        steps = np.diff(times)
        slack = UNEVEN * steps.min() + 4.0 * np.spacing(times[-1])
        apart = np.abs(steps - steps[0]) > slack
        if apart.any():
            k = int(np.argmax(apart))
            raise ValueError(
                f"{name}: wanted equal steps, for a system in discrete time makes one step from "
                f"each time to the next, got steps of {steps[0]:g} and, from {times[k]:g} on, "
                f"{steps[k]:g}; write the missing times with measurements of NaN"
            )
    return times
