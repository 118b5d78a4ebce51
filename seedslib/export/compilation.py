"""A filter whose steps are compiled C, behind the verbs of the filter."""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import math
import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike

from seedslib.base.blocks import in_blocks
from seedslib.base.checks import as_real, outside
from seedslib.base.objects import changed
from seedslib.base.values import Inputs, InputTrajectory, Values, as_trajectory
from seedslib.designed.base import with_gaps
from seedslib.designed.tables import OutputFilter
from seedslib.export.c import arguments, header
from seedslib.export.lanes import to_lanes
from seedslib.export.programs import recorded
from seedslib.filters.base import Estimates, Filter, as_indicators
from seedslib.filters.covariance import CovarianceFilter, FilterState
from seedslib.filters.program import CODES, Program

if TYPE_CHECKING:
    from typing import Self

FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-shared", "-fPIC")
NATIVE = ("-march=native", "-DLIBMVEC", "-lmvec")
"""What not every machine has: its own instructions by that name, a library of vector functions."""

REFUSALS = {
    "END": "t: wanted at most the last measurement time",
    "INFINITE": "y: wanted finite numbers or NaN, got an infinite one",
    "PARTLY": "y: wanted all components of a measurement and what the memory keeps, got some "
    "missing",
    "TIME": "t: wanted the next measurement time, or one after that of the state within 1e7 steps",
    "RANGE": "indicator: wanted one of the system, or -1 for a missing one",
    "STRAY": "y: wanted what the schedule of the design has, got a component of a measurement "
    "without it",
    "UNTOLD": "inputs: wanted values of the inputs of the model, got none",
}
"""What the codes of a step say, in words."""

DOUBLE = np.dtype(np.float64)


# A library of the machine


def compiler() -> list[str] | None:
    """Command of a C compiler: ``CC``, cc, gcc, clang, or the one of the package ziglang."""
    named = os.environ.get("CC", "").split()
    for command in (named, ["cc"], ["gcc"], ["clang"]):
        if command and (path := shutil.which(command[0])):
            return [path, *command[1:]]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    return None


@cache
def processor() -> str:
    """What tells processors apart that may share a folder of libraries."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    known = {line for line in lines if line.startswith(("model name", "flags", "Features"))}
    return "\n".join([sys.platform, platform.machine(), platform.processor(), *sorted(known)])


def library(text: str) -> Path | None:
    """Path of the library made of a C text, made at most once; None without a compiler.

    It is kept by content in ``XDG_CACHE_HOME`` or the user's own cache. It appears under its name
    when it is whole, so that several processes may want it at the same time.

    Raises
    ------
    RuntimeError
        The compiler refuses the text.
    """
    command = compiler()
    if command is None:
        return None
    described = "\n".join([*command, *FLAGS, *NATIVE, processor(), text])
    name = hashlib.sha256(described.encode()).hexdigest()[:32]
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    folder = (Path(base) if base else Path.home() / ".cache") / "seedslib"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        path = folder / f"{name}{'.dll' if os.name == 'nt' else '.so'}"
        if not (path.exists() and _loads(path)):
            _make(command, text, path)
    except OSError:  # a home that cannot be written to
        path = Path(tempfile.mkdtemp(prefix="seedslib")) / f"{name}.so"
        _make(command, text, path)
    return path


def _loads(path: Path) -> bool:
    try:
        ctypes.CDLL(str(path))
    except OSError:
        return False
    return True


def _make(command: list[str], text: str, path: Path) -> None:
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        source, made = Path(folder) / "filter.c", Path(folder) / path.name
        source.write_text(text)
        last = [] if os.name == "nt" else ["-lm"]
        for own in (NATIVE, ()):
            line = [*command, *FLAGS, str(source), "-o", str(made), *own, *last]
            done = subprocess.run(line, capture_output=True, text=True)
            if done.returncode == 0 and _loads(made):
                os.replace(made, path)
                return
        raise RuntimeError(f"compiler: {' '.join(line)} failed: {done.stderr.strip()[:2000]}")


def source(step: Program) -> str:
    """C of a filter with what Python calls."""
    state = [a for a in step.arrays.values() if a.owner == "state"]
    places = ", ".join(f"(int)offsetof(f_state, {a.name})" for a in state)
    given = ", ".join(["s", *arguments(step)])
    driver = (files("seedslib.export").joinpath("api.c")).read_text()
    return "\n".join(
        [
            header(step, "f"),
            "#include <stddef.h>",
            "#define F_OUT F_ESTIMATE",
            f"#define F_PARAMETERS {len(step.parameters)}",
            *(["#define F_INPUTS 0"] if not step.inputs else []),
            f"#define CALL(s, time, y, indicator, held, u, p) f_step({given})",
            f"const int api_layout[] = {{ (int)sizeof(f_state), {places} }};",
            driver,
            to_lanes(step, "f"),
        ]
    )


def _layout(step: Program, library: Any) -> np.dtype:
    """How the bytes of a state are to be read."""
    state = [a for a in step.arrays.values() if a.owner == "state"]
    size, *places = (ctypes.c_int * (1 + len(state))).in_dll(library, "api_layout")
    return np.dtype(
        {
            "names": [a.name for a in state],
            "formats": [("i4" if a.kind == "int" else "f8", a.shape) for a in state],
            "offsets": places,
            "itemsize": size,
        }
    )


# What a compiled filter remembers


class CompiledState(NamedTuple):
    """What a compiled filter remembers, as bytes.

    Attributes
    ----------
    raw : bytes
        The states of C, one for each record.
    batch : tuple of int
    form : dtype
        How the bytes are to be read.
    """

    raw: bytes
    batch: tuple[int, ...]
    form: np.dtype

    def part(self, name: str) -> Any:
        """A part of the state, components first; None where there is no such part."""
        if name not in (self.form.names or ()):
            return None
        part = np.frombuffer(self.raw, self.form)[name]
        return np.moveaxis(part, 0, -1).reshape((*part.shape[1:], *self.batch))

    @property
    def time(self) -> float | None:
        """Time of the state, of a filter that carries its distribution; None before the first."""
        if self.part("started") is None or not self.part("started").all():
            return None
        return float(np.ravel(self.part("t"))[0])

    @property
    def mean(self) -> np.ndarray:
        """Estimate, (n', *batch)."""
        return self.part("mean")

    @property
    def cov(self) -> np.ndarray:
        """Its covariance, (n', n', *batch)."""
        return self.part("cov")

    @property
    def loglik(self) -> np.ndarray:
        """Log-density of the last measurement, (*batch)."""
        return self.part("loglik")

    @property
    def mode(self) -> Any:
        """Decided mode, (*batch)."""
        return self.part("mode")

    @property
    def mode_prob(self) -> Any:
        """Probabilities of the modes, (L, *batch)."""
        return self.part("prob")


_new = tuple.__new__  # a third of the time of `CompiledState(...)`


# The filter


def compiled(filter: Any) -> Any:
    """The same filter, its steps compiled: one takes a microsecond or so from Python.

    The C that `to_c` writes is built once with the C compiler of the machine (``CC``, cc, gcc or
    clang, or the one in the package ziglang) and kept by content in the user's cache. The numbers
    are those of the filter but for rounding. Parameters of the model are arguments of the C:
    nothing is compiled again by `bind`.

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
    >>> from seedslib.export import compiled
    >>> from seedslib.filters import unscented_kalman
    >>> from seedslib import zoo
    >>> quick = compiled(unscented_kalman(zoo.van_der_pol()))
    >>> state = quick.step(quick.initial(), 0.0, [1.0, 0.5])
    >>> state.mean.shape
    (2,)
    """
    if getattr(getattr(filter, "system", None), "first", None) is not None:
        raise ValueError("filter: wanted numbers in mean0 and cov0, got formulas of parameters")
    step = recorded(filter, parameters=True)
    path = library(source(step))
    if path is None:
        warnings.warn(
            "compiled: wanted a C compiler (cc, or pip install ziglang), found none; the filter "
            "runs in Python",
            stacklevel=outside(),
        )
        return filter
    return CompiledFilter(filter, step, path)


class CompiledFilter(Filter):
    """A filter whose steps are C; `compiled` makes it. It has the verbs of the filter.

    Those of one measurement are `initial` and `step`, and `predict`, `correct` and `forecast`
    where the filter carries mean and covariance.

    Attributes
    ----------
    filter : Filter
        The one that was compiled.
    """

    def __init__(self, filter: Any, step: Program, path: Path) -> None:
        self.filter, self.system, self.takes = filter, filter.system, filter.takes
        if getattr(filter, "times", None) is not None:
            self.times = filter.times
        self._designed = step.designed
        self._inputs, self._parameters = step.inputs, step.parameters
        self._indicators = step.indicators
        # a step holds the interpreter, which is quicker; whole records let others run
        locked, free = ctypes.PyDLL(str(path)), ctypes.CDLL(str(path))
        # without declared arguments, which would cost more than C
        self._many, self._run = locked.api_steps, free.api_run
        whole, pointer = ctypes.c_int64, ctypes.c_void_p
        self._run.argtypes = [*[whole] * 5, *[pointer] * 5, ctypes.c_double, *[pointer] * 6]
        self._form = _layout(step, locked)
        self._size = self._form.itemsize
        self._first = bytes(self._size)  # nobody has seen it, so that C may write it
        locked.api_init(self._first)
        self._shape = (self.system.measurement_size,)
        packs = [struct.Struct(f"{size}d").pack for size in (1, 1 + self._shape[0])]
        alone = not (self._inputs or self._parameters or step.indicators)
        # what a step of one record that is given no more than a time and a measurement needs
        quick = (locked.api_step, self._size, self._form, self._shape, *packs)
        self._quick = quick if alone else None

    def __reduce__(self) -> tuple[Any, ...]:
        return compiled, (self.filter,)

    def bind(self, values: Mapping[Any, ArrayLike] | None = None, /, **named: Any) -> Self:
        """See `Filter.bind`."""
        filter = self.filter.bind(values, **named)
        return changed(self, filter=filter, system=filter.system)

    def _numbers(self, inputs: Mapping[Any, Any] | None = None) -> tuple[Values, Values]:
        """Numbers of the inputs, and of the parameters, that C takes."""
        if not (self._inputs or self._parameters):
            return (), ()
        p = self.filter.values(inputs)
        table = dict(zip(self.system.parameters, p, strict=True))
        return tuple(table[u] for u in self._inputs), tuple(table[q] for q in self._parameters)

    def initial(self, batch: tuple[int, ...] = (), seed: object = None) -> CompiledState:
        """State before any measurement; nothing is drawn from `seed`."""
        return CompiledState(self._first * math.prod(batch), tuple(batch), self._form)

    def step(
        self,
        state: CompiledState,
        t: float,
        y: ArrayLike,
        indicator: ArrayLike | None = None,
        *,
        inputs: Mapping[Any, Any] | None = None,
    ) -> CompiledState:
        """Forecast to time t and correct there; see `Filter.step`.

        Raises
        ------
        ValueError
            What the filter refuses.
        """
        quick = self._quick
        if quick is None or state.batch or indicator is not None:
            return self._stepped(state, t, self._measured(y, state.batch), indicator, inputs)
        work, size, form, shape, time, pack = quick
        try:
            if type(y) is ndarray and y.dtype is DOUBLE and y.shape == shape:
                given = time(t) + y.tobytes()
            else:
                given = pack(t, *y)  # type: ignore[misc]
        except (struct.error, TypeError):
            given = time(as_real("t", t, ())) + self._measured(y, ()).tobytes()
        out = bytes(size)  # nobody has seen it, so that C may write it
        if code := work(state.raw, out, given):
            raise ValueError(REFUSALS[CODES[code]])
        return _new(CompiledState, (out, (), form))

    def _measured(self, y: ArrayLike, batch: tuple[int, ...]) -> np.ndarray:
        shape = (*self._shape, *batch)
        if type(y) is ndarray and y.dtype is DOUBLE and y.shape == shape:
            return y  # C sees whether it is finite
        return as_real("y", y, shape, nan=True)

    def _stepped(
        self,
        state: CompiledState,
        t: ArrayLike,
        y: np.ndarray,
        indicator: Any = None,
        inputs: Mapping[Any, Any] | None = None,
    ) -> CompiledState:
        """A step of several records, or with more than a time and a measurement."""
        batch = state.batch
        u, p = self._numbers(inputs)
        known = type(indicator) is int and not batch and self._indicators > 0  # C sees its range
        if not known:
            indicator = as_indicators(indicator, self.system, batch, "indicator")
        rows = [t, *y, -1 if indicator is None else indicator, *u, *u, *p]
        if batch:
            given = np.array([np.broadcast_to(row, batch) for row in rows], dtype=float).tobytes()
        else:
            given = struct.pack(f"{len(rows)}d", *rows)
        out = bytes(len(state.raw))  # nobody has seen it, so that C may write it
        if code := self._many(state.raw, out, given, len(out) // self._size):
            raise ValueError(REFUSALS[CODES[code]])
        return CompiledState(out, batch, self._form)

    def predict(
        self,
        state: CompiledState,
        t: float,
        *modes: ArrayLike,
        inputs: Mapping[Any, Any] | None = None,
    ) -> CompiledState:
        """Forecast to time t, of a filter that carries mean and covariance.

        Raises
        ------
        ValueError
            A time before that of the state, another kind of filter.
        """
        self._require_carried("predict")
        return self._stepped(state, t, np.full((*self._shape, *state.batch), np.nan), None, inputs)

    def correct(
        self, state: CompiledState, y: ArrayLike, *, inputs: Mapping[Any, Any] | None = None
    ) -> CompiledState:
        """Correct by a measurement, of a filter that carries mean and covariance.

        Raises
        ------
        ValueError
            A state without a time, a wrong shape, another kind of filter.
        """
        self._require_carried("correct")
        if state.time is None:
            raise ValueError("state: wanted a state with a time, got None; predict to it first")
        y = self._measured(y, state.batch)
        return self._stepped(state, state.part("t"), y, None, inputs)

    def predictive(self, state: CompiledState, p: Values) -> tuple[ndarray, ndarray]:
        """See `Filter.predictive`."""
        self._require_carried("forecast_measurements")
        return self.filter.predictive(FilterState(state.time, state.mean, state.cov), p)

    def _require_carried(self, name: str) -> None:
        if not isinstance(self.filter, CovarianceFilter):
            raise ValueError(f"{name}: wanted a filter that carries mean and covariance; call step")

    def run(
        self,
        times: ArrayLike,
        measurements: ArrayLike,
        *,
        indicators: ArrayLike | None = None,
        inputs: Inputs | None = None,
        covariances: bool = False,
        workers: int = 1,
    ) -> Estimates:
        """Filter a record, or many at once; arguments, results and errors as of the filter."""
        filter, designed = self.filter, self._designed
        y = measurements
        if type(y) is np.ndarray and y.dtype is DOUBLE and y.ndim > 2 and y.flags.c_contiguous:
            few = y.reshape(*y.shape[:2], -1)[..., :0]  # C sees whether they are finite
            times, _ = filter.record(times, few)
        else:
            times, y = filter.record(times, y)
        count, batch = len(times), y.shape[2:]
        indicators = as_indicators(indicators, self.system, (count, *batch))
        trajectory = as_trajectory(self.system, inputs, count, batch)
        if designed:
            numbers = filter.numbered(times, y)
            if (numbers < 0).any():  # forecasts between measurements
                return filter.run(
                    times,
                    y,
                    indicators=indicators,
                    inputs=inputs,
                    covariances=covariances,
                    workers=workers,
                )
            gaps = filter.record_gaps(y, indicators, numbers)
        carried = isinstance(filter, CovarianceFilter)
        n = self._form["mean"].shape[0]
        sizes = self._sizes(n, carried or covariances)
        result = Estimates(
            *(s if s is None else room((count, *s), math.prod(batch)) for s in sizes)
        )
        result = result._replace(diverged=np.empty(math.prod(batch), dtype=bool))
        self._fill(result, times, y, indicators, trajectory, workers)
        result = Estimates(
            *(p if p is None else p.reshape((*p.shape[:-1], *batch)) for p in result)
        )
        if result.modes is not None:
            result = result._replace(modes=result.modes.astype(int))
        if carried:
            known = np.isfinite(result.cov[-1]).all(axis=(0, 1))
            return result._replace(diverged=result.diverged | ~known)
        if isinstance(filter, OutputFilter) and covariances:
            result = result._replace(cov=filter.covariances[[filter.served(k) for k in numbers]])
        if result.loglik is not None:
            impossible = (result.loglik == -np.inf).any(axis=0)
            result = result._replace(diverged=result.diverged | impossible)
        return with_gaps(result, gaps, times) if designed else result

    def _sizes(self, n: int, covariances: bool) -> Estimates:
        """Shapes of what C writes at each time, without batch axes; None for no such thing."""
        filter, modes = self.filter, getattr(self.system, "modes", 0)
        if isinstance(filter, OutputFilter):
            return Estimates((n,), modes=() if modes else None)
        cov = (n, n) if covariances else None
        return Estimates((n,), cov, (modes,) if modes else None, (), None, () if modes else None)

    def _fill(
        self,
        result: Estimates,
        times: np.ndarray,
        y: np.ndarray,
        indicators: np.ndarray | None,
        trajectory: InputTrajectory,
        workers: int,
    ) -> None:
        """Run all records and write their estimates."""
        count, batch, total = len(times), y.shape[2:], math.prod(y.shape[2:])
        inputs, parameters = self._numbers(trajectory.at(0))
        given = [trajectory.values.get(u) for u in self._inputs]
        inputs = [  # one that is bound is the same at all times
            number if row is None else row.reshape(len(row), *(row.shape[1:] or (1,) * len(batch)))
            for number, row in zip(inputs, given, strict=True)
        ]
        rows = [
            y,
            indicators,
            side_by_side(inputs, (count,), batch),
            side_by_side(parameters, (), batch),
        ]
        given = [p if p is None else np.ascontiguousarray(p, dtype=float) for p in (times, *rows)]
        given_at, result_at = ([_place(p) for p in parts] for parts in (given, result))
        wide = result.mean.strides[1] // result.mean.itemsize
        bound = min(getattr(self.filter, "bound", np.inf), sys.float_info.max)

        def work(start, stop, _):
            code = self._run(start, stop, total, wide, count, *given_at, bound, *result_at)
            if code:
                raise ValueError(REFUSALS[CODES[code]])

        in_blocks(work, total, 0, workers=workers, block=-(-total // (64 * workers)) * 64)


def room(lead: tuple[int, ...], total: int) -> np.ndarray:
    """Array (*lead, total) whose rows, if long, begin at 64 bytes: C may write past the caches."""
    wide = total if total < 64 else -(-total // 8) * 8
    flat = np.empty(math.prod(lead) * wide + 8)
    first = -flat.ctypes.data // flat.itemsize % 8
    return flat[first : first + len(flat) - 8].reshape(*lead, wide)[..., :total]


def side_by_side(values: list[Any], lead: tuple[int, ...], batch: tuple[int, ...]) -> Any:
    """Numbers (*lead, values, *batch) of all records; None where there are no values."""
    wide = [np.broadcast_to(value, (*lead, *batch)) for value in values]
    return np.stack(wide, axis=len(lead)) if wide else None


def _place(array: np.ndarray | None) -> int | None:
    return None if array is None else array.ctypes.data
