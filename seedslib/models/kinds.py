"""What a system is, and of which kind: the sentence for a wrong one, its sizes, its times."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from seedslib.base.checks import as_count, as_times, is_whole, outside
from seedslib.base.clock import when
from seedslib.base.values import Values


@runtime_checkable
class System(Protocol):
    """What simulation, filters and designs ask of a system that is observed.

    Attributes
    ----------
    state_size, measurement_size : int
        Numbers of components.
    indicators : int
        Values of the indicator that a switching system shows beside its measurements; 0 for none.
    sensor : StochasticMap
        What is measured, with ``sample(t, x, rng, p)``.
    """

    state_size: int
    measurement_size: int
    indicators: int
    sensor: Any

    def initial_sample(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Draws of the initial state, shape (n, count)."""
        ...

    def advance(
        self, x: np.ndarray, start: float, stop: float, rng: np.random.Generator, p: Values
    ) -> np.ndarray:
        """States (n, *batch) at time `stop` from those at time `start`."""
        ...

    def values(self, inputs: Any = None, dt: float = ...) -> Values:
        """Numbers p of parameters and inputs in a step, see `seedslib.base.values`."""
        ...


if TYPE_CHECKING:
    from seedslib.base.symbols import Input
    from seedslib.models.discrete import DiscreteSystem
    from seedslib.models.jump_diffusion import JumpDiffusion
    from seedslib.models.switching import SwitchingSystem
AnySystem: TypeAlias = "JumpDiffusion | DiscreteSystem | SwitchingSystem"

KINDS = ("JumpDiffusion", "DiscreteSystem", "SwitchingSystem")

UNEVEN = 1e-6
"""Steps of a system in discrete time may differ by this part of them."""

FEW = 12
"""Whole units of time in a step of which several steps may be meant."""


def as_system(name: str, value: Any, *wanted: str) -> Any:
    """The system that was passed, or a sentence that says what it is.

    Parameters
    ----------
    name : str
        The caller's name of the argument, for the message.
    value : System
    *wanted : str
        Kinds of systems, by the names of their classes; none for anything that can be sampled,
        see `System`.

    Raises
    ------
    TypeError
        None of the wanted kinds.
    ValueError
        A linear system with diffuse components, for which the Kalman filter is made.
    """
    kinds = {base.__name__ for base in type(value).__mro__}
    if getattr(value, "diffuse", ()) and "LinearSystem" not in wanted:
        raise ValueError(
            f"{name}: wanted a distribution of the first state, got none in "
            f"components {value.diffuse}; see KalmanFilter"
        )
    if kinds & {*wanted} or (not wanted and isinstance(value, System)):
        return value
    got = f"the class {value.__name__}" if isinstance(value, type) else f"a {type(value).__name__}"
    raise TypeError(f"{name}: wanted a {' or '.join(wanted or KINDS)}, got {got}")


def switches(system: object) -> bool:
    """Whether the system has modes, and so jumps from one motion to another."""
    return getattr(system, "modes", 0) > 0


def in_steps(system: object) -> bool:
    """Whether the system moves by one application of a map per step of the time grid."""
    # a switching system in the form of one with a mixed state knows the system that it is
    return hasattr(getattr(system, "system", system), "dynamics")


def in_even_steps(system: object) -> bool:
    """Whether these steps must be of one length, since the map does not see the elapsed time."""
    return in_steps(system) and all(p.role != "elapsed" for p in system.parameters)


def inputs_of(system: object) -> frozenset[Input]:
    """Inputs that the formulas of a system mention: what a record must come with."""
    return frozenset(p for p in getattr(system, "parameters", ()) if p.role == "input")


def as_grid(name: str, value: object, system: object) -> np.ndarray:
    """Times, see `as_times`; equally spaced ones for what moves by steps of one length.

    Raises
    ------
    TypeError, ValueError
        As `as_times`; `ValueError` also for unequal steps of a system in discrete time, whose
        map moves it by one step however long the gap is: it does not mention the elapsed time.

    Warns
    -----
    UserWarning
        Steps of a few whole units, in which it may be meant to move several times.
    """
    times = as_times(name, value)
    if len(times) > 1 and in_even_steps(system):
        steps = np.diff(times)
        require_even(name, steps, times)
        if 2.0 <= steps[0] <= FEW and steps[0].is_integer():
            warnings.warn(
                f"{name}: steps of {steps[0]:g} count as one step each, for the dynamics do not "
                "mention the elapsed time ELAPSED; every time wants to be there, with NaN where "
                "nothing was measured",
                stacklevel=outside(),
            )
    return times


def require_even(name: str, steps: np.ndarray, times: np.ndarray) -> None:
    """Refuse a grid of a system in discrete time whose steps differ.

    Parameters
    ----------
    name : str
    steps : ndarray, shape (K,)
    times : ndarray, shape (K+1,)

    Raises
    ------
    ValueError
        A step of another length than the first.
    """
    other = np.abs(steps - steps[0]) > UNEVEN * steps.min() + 4.0 * np.spacing(times[-1])
    if other.any():
        k = int(np.argmax(other))
        raise ValueError(
            f"{name}: wanted equal steps, for a system in discrete time makes one step from "
            f"each time to the next, got steps of {steps[0]:g} and, from {when(times[k])} on, "
            f"{steps[k]:g}; write the missing times with measurements of NaN, or the dynamics with "
            "the elapsed time ELAPSED"
        )


def as_steps(times: object) -> np.ndarray:
    """Grid of times (K+1,) from a number of steps K or from the grid itself."""
    if is_whole(times):
        return np.arange(as_count("times", times) + 1.0)
    times = as_times("times", times)
    if times.size < 2:
        raise ValueError(f"times: wanted at least two times, got {times.size}")
    return times
