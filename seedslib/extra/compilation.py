"""A filter whose steps are compiled C, behind the verbs of the filter."""

from __future__ import annotations

import ctypes
import math
import struct
import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.checks import as_real, outside
from seedslib.base.clock import ROUNDING, SAME, when
from seedslib.base.values import current
from seedslib.designed.base import DesignedFilter
from seedslib.extra.c.build import library
from seedslib.extra.c.driver import FIELDS, REFUSED, driver
from seedslib.extra.c.header import to_c
from seedslib.extra.c.traced import told_of
from seedslib.extra.compiled_records import CompiledRecords
from seedslib.extra.compiled_state import CompiledState
from seedslib.filters.base import Estimates, as_indicators
from seedslib.filters.covariance import CovarianceFilter

_DOUBLE = np.dtype(np.float64)


def compiled(filter: Any) -> Any:
    """The same filter, its steps compiled: a single one takes a microsecond or two from Python.

    The C that `to_c` writes is built once with the C compiler of the machine (``CC``, cc, gcc or
    clang, or the one in the package ziglang) and kept by content in the user's cache. The numbers
    are those of the filter but for rounding.

    Parameters
    ----------
    filter : FiniteOrderFilter, TableFilter, SwitchingFilter or CovarianceFilter
        One that `to_c` can write.

    Returns
    -------
    CompiledFilter
        Or, without a compiler, the filter itself.

    Raises
    ------
    TypeError, ValueError
        As `to_c`.
    RuntimeError
        The compiler refuses what was written.

    Warns
    -----
    UserWarning
        There is no C compiler.

    Examples
    --------
    >>> from seedslib.extra import compiled
    >>> from seedslib.filters import unscented_kalman
    >>> from seedslib import zoo
    >>> quick = compiled(unscented_kalman(zoo.van_der_pol()))
    >>> state = quick.step(quick.initial(), 0.0, [1.0, 0.5])
    >>> state.mean.shape
    (2,)
    """
    later = slack = ""
    if getattr(filter, "memory", None) is not None and isinstance(filter, DesignedFilter):
        last, cycle, steps = filter.times[-1], filter.cycle, np.diff(filter.times)
        if cycle:
            later = f" + s[i].laps * {float(last - filter.times[-1 - cycle])!r}"
        gap = float(steps.min()) if len(steps) else 1.0
        near = f"fmax({SAME * gap!r}, {ROUNDING!r} * fabs(t))"
        slack = f"fmin(fmax({filter.clock.tolerance!r}, {near}), {0.25 * gap!r})"
    path = library(driver(to_c(filter, name="f"), later, slack))
    if path is None:
        warnings.warn(
            "compiled: wanted a C compiler (cc, or pip install ziglang), found none; the filter "
            "runs in Python",
            stacklevel=outside(),
        )
        return filter
    return CompiledFilter(filter, path)


class CompiledFilter(CompiledRecords):
    """A filter whose steps are C; `compiled` makes it. It has the verbs of the filter.

    Those of one measurement are `initial` and `step`, `forecast` where the filter forecasts
    between measurements, `predict` and `correct` where it carries mean and covariance.

    Attributes
    ----------
    filter : Filter
        The one that was compiled.
    """

    _shown = ("filter",)

    def __init__(self, filter: Any, path: Any) -> None:
        self.filter, self.system = filter, filter.system
        self.takes = filter.takes
        if getattr(filter, "times", None) is not None:
            self.times = filter.times
        # a step holds the interpreter, which is quicker; whole records let others run
        self._c, self._whole = ctypes.PyDLL(str(path)), ctypes.CDLL(str(path)).api_fill
        self._whole.argtypes = [
            ctypes.c_int,
            ctypes.c_longlong,
            ctypes.c_int,
            *[ctypes.c_void_p] * 10,
        ]
        # without declared arguments, which would cost more than C
        self._one, self._alone = self._c.api_step, getattr(self._c, "api_alone", None)
        self._form = self._layout()
        self._size = self._form.itemsize
        self._first = bytes(self._size)  # as in `step`
        self._c.api_init(1, self._first)
        self._shape = (self.system.measurement_size,)
        self._time, self._pack = (struct.Struct(f"{k}d").pack for k in (1, 1 + self._shape[0]))
        carries = isinstance(filter, CovarianceFilter)
        self._inputs = [p for p in told_of(self.system) if p.role == "input" and carries]
        # runs as the filter does, but for its loop
        self._twin = object.__new__(type(filter))
        vars(self._twin).update(vars(filter), fill=self._fill)
        self._told = bool(getattr(self.system, "indicators", 0))

    def __reduce__(self) -> tuple[Any, ...]:
        return compiled, (self.filter,)

    def _layout(self) -> np.dtype:
        size, *places = [self._c.api_layout(i) for i in range(len(FIELDS) + 1)]
        n = getattr(self.filter, "components", None) or self.system.state_size
        modes = getattr(self.system, "modes", 0)
        kinds = [("f8", n), ("f8", (n, n)), "f8", ("f8", modes), "i4", "f8", "i4", "i4"]
        known = [(f, k, p) for f, k, p in zip(FIELDS, kinds, places, strict=True) if p >= 0]
        names, formats, offsets = map(list, zip(*known, strict=True))
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> CompiledState:
        """State before any measurement; nothing is drawn from `seed`."""
        many = self._first * math.prod(batch) if batch else self._first
        return CompiledState(many, tuple(batch), self._form)

    def step(
        self, state: CompiledState, t: float, y: ArrayLike, indicator: ArrayLike | None = None
    ) -> CompiledState:
        """Forecast to time t and correct there; see `Filter.step`.

        Raises
        ------
        ValueError
            What the filter refuses.
        """
        if state.batch or indicator is not None or self._alone is None:
            return self._many(state, t, y, indicator)
        try:
            if type(y) is np.ndarray and y.dtype is _DOUBLE and y.shape == self._shape:
                given = self._time(t) + y.tobytes()
            else:
                given = self._pack(t, *y)  # type: ignore[misc]
        except (struct.error, TypeError):
            given = self._time(as_real("t", t, ndim=0)) + self._measured(y, ()).tobytes()
        out = bytes(self._size)  # nobody has seen it, so that C may write it
        if code := self._alone(state.raw, out, given):
            raise ValueError(REFUSED[code])
        return CompiledState(out, (), self._form)

    def _many(self, state, t, y, indicator):
        """A step of several records, or with what is told: an indicator, inputs."""
        shown, told = self._measured(y, state.batch), None
        if indicator is not None or self._told:
            told = ctypes.c_void_p(self._seen(indicator, state.batch).ctypes.data)
        place, given = ctypes.c_void_p(shown.ctypes.data), self._given(state.batch)
        return self._made(state, self._one, ctypes.c_double(t), place, told, *given)

    def _given(self, batch):
        """Present values of the inputs, one after the other, of a filter that C tells them."""
        if not self._inputs:
            return ()
        values = [np.broadcast_to(value, batch) for value in current(self._inputs)]
        return (np.array(values, dtype=float).tobytes(),)

    def _seen(self, indicator, batch):
        if type(indicator) is int and not batch and -1 <= indicator < self.system.indicators:
            return np.array(indicator)
        seen = as_indicators(indicator, self.system, batch, "indicator")
        return np.ascontiguousarray(seen, dtype=np.int64)

    def _measured(self, y, batch):
        shown = np.ascontiguousarray(as_real("y", y, nan=True))
        wanted = (self.system.measurement_size, *batch)
        if shown.shape != wanted:
            raise ValueError(f"y: wanted shape {wanted}, got {shown.shape}")
        return shown

    def _made(self, state, work, *given):
        """The states that a function of C makes of some."""
        out = bytes(len(state.raw))  # nobody has seen it, so that C may write it
        code = work(len(out) // self._size, state.raw, out, *given)
        if code:
            raise ValueError(REFUSED[code])
        return CompiledState(out, state.batch, self._form)

    def predict(self, state: CompiledState, t: float, *told: ArrayLike) -> CompiledState:
        """Forecast to time t, of a filter that carries mean and covariance.

        Raises
        ------
        ValueError
            A time before that of the state, another kind of filter.
        """
        given = self._given(state.batch)
        return self._made(state, self._half("predict"), ctypes.c_double(t), *given)

    def correct(self, state: CompiledState, y: ArrayLike) -> CompiledState:
        """Correct by a measurement, of a filter that carries mean and covariance.

        Raises
        ------
        ValueError
            A state without a time, a wrong shape, another kind of filter.
        """
        shown = self._measured(y, state.batch)
        place, given = ctypes.c_void_p(shown.ctypes.data), self._given(state.batch)
        return self._made(state, self._half("correct"), place, *given)

    def _half(self, name):
        if not isinstance(self.filter, CovarianceFilter):
            raise ValueError(f"{name}: wanted a filter that carries mean and covariance; call step")
        return getattr(self._c, f"api_{name}")

    def forecast(self, state: CompiledState, t: float, **told: Any) -> Estimates:
        """What the filter expects at a later time, without a measurement.

        Raises
        ------
        ValueError
            A time out of reach, a filter of modes.
        """
        if isinstance(self.filter, CovarianceFilter):
            return self.report(self.predict(state, t))._replace(loglik=None)
        if not hasattr(self.filter, "between") or hasattr(self.system, "modes"):
            raise ValueError("forecast: wanted a filter without modes")
        out = np.empty((len(state.mean), len(state.raw) // self._size))
        code = self._c.api_forecast(
            out.shape[1], state.raw, ctypes.c_double(t), ctypes.c_void_p(out.ctypes.data)
        )
        if code:
            raise ValueError(f"t: wanted a time up to the next measurement, got {when(t)}")
        return Estimates(out.reshape(-1, *state.batch))
