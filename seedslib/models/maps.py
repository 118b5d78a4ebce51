"""Random vectors, and maps with noise, y = g(t, x, v): sensors, discrete dynamics and jumps.

A map offers what the approximations need: its value, its conditional mean and covariance given
the state, for switching systems the probability weight of the branch it belongs to, samples, and
its log-density where that has a closed form.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from seedslib.base.arrays import Array, align
from seedslib.base.blocks import Source, drawn, normal
from seedslib.base.checks import as_covariance, as_real, outside
from seedslib.base.circle import Periods, as_periods, wrapped
from seedslib.base.conditioning import gaussian_logpdf
from seedslib.base.linalg import cholesky
from seedslib.base.objects import Pickled
from seedslib.base.values import Values, in_order
from seedslib.gaussian.quadrature import rule_of_rank

if TYPE_CHECKING:
    import sympy

    from seedslib.base.symbols import Parameter

HERMITE_ORDER = 9


@dataclass(frozen=True, eq=False)
class Noise:
    """A random vector that enters a map.

    Parameters
    ----------
    symbols : sequence of SymPy symbols, or int
        Names of the components; their number where the maps are array functions.
    mean : float or array_like, shape (size,)
        Mean (default 0).
    cov : array_like, shape (size, size), optional
        Covariance (default the identity).
    sample : callable, optional
        ``sample(rng, count) -> (size, count)`` draws the vector where it is not Gaussian; `mean`
        and `cov` must be its moments. Gaussian by default.
    log_density : callable, optional
        ``log_density(v) -> (*batch)``, logarithm of the density of `sample` at v of shape
        (size, *batch). Maps that are affine in the noise and can be solved for it have one then.

    Raises
    ------
    TypeError, ValueError
        A density without `sample`, repeated symbols, shapes that do not fit or a covariance that
        is not positive semidefinite.
    """

    symbols: Sequence[Any] | Any = ()
    mean: Array = 0.0
    cov: Array = None
    sample: Callable[[np.random.Generator, int], np.ndarray] | None = None
    log_density: Callable[..., np.ndarray] | None = None
    size: int = field(init=False)
    root: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if isinstance(self.symbols, int):
            symbols, size = None, self.symbols
        else:
            symbols = _named(self.symbols)
            size = len(symbols)
        if size < 0:
            raise ValueError(f"symbols: wanted a nonnegative number of components, got {size}")
        mean = as_real("mean", self.mean)
        if mean.ndim > 1 or mean.size not in (1, size):
            raise ValueError(f"mean: wanted a number or shape ({size},), got {mean.shape}")
        mean = np.broadcast_to(mean, (size,)).copy()
        cov = np.eye(size) if self.cov is None else as_covariance("cov", self.cov, size)
        if self.sample is not None and not callable(self.sample):
            raise TypeError(f"sample: wanted a function (rng, count), got {self.sample!r}")
        if self.log_density is not None and not (callable(self.log_density) and self.sample):
            raise TypeError("log_density: wanted a function (v) beside sample, got another")
        vars(self).update(symbols=symbols, size=size, mean=mean, cov=cov, root=cholesky(cov))

    def __eq__(self, other: object) -> bool:
        """Whether names, moments and sampler are the same."""
        if not isinstance(other, Noise):
            return NotImplemented
        return self.symbols == other.symbols and self.alike(other)

    def alike(self, other: Noise) -> bool:
        """Whether the distribution is the same, whatever the components are called."""
        return (
            (self.size, self.sample, self.log_density)
            == (other.size, other.sample, other.log_density)
            and np.array_equal(self.mean, other.mean)
            and np.array_equal(self.cov, other.cov)
        )

    def __hash__(self) -> int:
        return hash((self.symbols, self.size, *self.mean.tolist(), *self.cov.ravel().tolist()))

    @property
    def gaussian(self) -> bool:
        """Whether the distribution is the Gaussian one."""
        return self.sample is None

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Independent draws, shape (size, count); the first of many are the draws of a few."""
        if self.sample is None:
            v = normal(rng, self.size, count)
            return v if self._standard else self.mean[:, None] + lower_times(self.root, v)
        return drawn(rng, count, self._sampled)

    @cached_property
    def _standard(self) -> bool:
        """Whether draws are those of standard normal numbers."""
        return not self.mean.any() and np.array_equal(self.root, np.eye(self.size))

    def _sampled(self, rng: np.random.Generator, count: int) -> np.ndarray:
        return as_real("noise.sample", self.sample(rng, count), (self.size, count))

    def rule(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Hermite product rule of the Gaussian noise: points (size, S), weights (S,)."""
        nodes, weights = rule_of_rank(self.size, order)
        return self.mean[:, None] + self.root @ nodes, weights

    def nodes(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States beside the nodes of Gaussian noise, nine Gauss-Hermite nodes per component.

        Parameters
        ----------
        x : ndarray, shape (n, *batch)

        Returns
        -------
        x, v, weights : ndarray, shapes (n, S, *batch), (size, S, *batch) and (S,)
        """
        v, weights = self.rule(HERMITE_ORDER)
        batch = (len(weights), *x.shape[1:])
        v = np.broadcast_to(align(v, v.ndim, x.ndim - 1), (self.size, *batch))
        return np.broadcast_to(x[:, None], (len(x), *batch)), v, weights

    def expectation(self, expression: sympy.Expr) -> sympy.Expr:
        """Mean of a SymPy expression over the noise.

        Raises
        ------
        NoClosedForm
            Neither of degree two in the noise nor (for Gaussian noise) of the class of
            `seedslib.gaussian.expectation`.
        """
        from seedslib.base.symbols import as_expression

        expression = as_expression("expression", expression)
        if not expression.free_symbols & set(self.symbols):
            return expression
        polynomial = expression.as_poly(*self.symbols)
        if polynomial is not None and polynomial.total_degree() <= 2:
            return self._quadratic_mean(polynomial)
        from seedslib.base.symbols import real_part
        from seedslib.gaussian.algebra import NoClosedForm
        from seedslib.gaussian.formulas import mean_expression

        if not self.gaussian:
            raise NoClosedForm(
                f"noise: only its mean and covariance are known, so {expression} has no mean in "
                "closed form; use GaussHermite or another rule with points"
            )
        from sympy import Matrix

        others = tuple(expression.free_symbols - set(self.symbols))
        moments = self.mean.tolist(), Matrix(self.cov.tolist())
        return real_part(mean_expression(expression, self.symbols, *moments, parameters=others))

    def _quadratic_mean(self, polynomial):
        moments = np.ones(()), self.mean, self.cov + np.outer(self.mean, self.mean)
        total = 0
        for powers, coefficient in polynomial.terms():
            used = tuple(k for k, power in enumerate(powers) for _ in range(power))
            total += coefficient * tidy(moments[len(used)][used])
        return total


def named_noise(name: str, noise: Noise | None) -> Noise:
    """The noise of a symbolic map, without components where there is None.

    Raises
    ------
    TypeError, ValueError
        No noise, or one whose components have no names.
    """
    noise = Noise() if noise is None else noise
    if not isinstance(noise, Noise):
        raise TypeError(f"{name}: wanted a Noise, got {noise!r}")
    if noise.symbols is None:
        raise ValueError(f"{name}: wanted named components for a symbolic map, got a number")
    return noise


def _named(symbols: Sequence) -> tuple:
    """Distinct symbols; a noise without components needs no SymPy."""
    if not isinstance(symbols, tuple | list) or symbols:
        from seedslib.base.symbols import as_symbols, require_distinct

        symbols = as_symbols("symbols", symbols)
        require_distinct(symbols=symbols)
    return tuple(symbols)


def tidy(number: float) -> float:
    """The exact integer where a float is one: keeps formulas such as 1*x free of 1.0*x."""
    return int(number) if float(number).is_integer() else float(number)


def lower_times(root: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Product of a lower triangular matrix with draws, component by component."""
    if np.array_equal(root, np.eye(len(root))):
        return normal
    result = np.zeros(normal.shape)
    for k, row in enumerate(root):
        for q in range(k + 1):
            if row[q] != 0.0:
                result[k] += row[q] * normal[q]
    return result


def warn_of_angles(sensor: StochasticMap) -> None:
    """Warn of components of a sensor that are angles in the plane, without a period."""
    if not sensor.symbolic:
        return
    import sympy

    for k, expression in enumerate(sensor.expressions):
        terms = sympy.Add.make_args(expression)
        factors = (factor for term in terms for factor in sympy.Mul.make_args(term))
        if k not in dict(sensor.period) and any(isinstance(f, sympy.atan2) for f in factors):
            warnings.warn(
                f"sensor: wanted the period of component {k}, an angle (atan2), got none, so it "
                f"jumps where it comes round; period={{{k}: 2*pi}} says that it does",
                stacklevel=outside(),
            )


class Conditional(NamedTuple):
    """What a map does on average at a fixed state; SymPy expressions or array functions."""

    mean: Any
    cov: Any
    weight: Any


class StochasticMap(Pickled):
    """y = value(t, x, v, p), in a branch of probability weight(t, x, v, p).

    Parameters
    ----------
    state : sequence of SymPy symbols
    value : sequence of SymPy expressions
        Components of y.
    noise : Noise, optional
        The vector v.
    weight : SymPy expression
        Probability of the branch given x and v (default 1: the map always applies).
    time : SymPy symbol, optional
        Name of the time, ``t`` by default.
    period : mapping of int to float, optional
        Components of y that lie on a circle, as the angles of a bearing, and their periods.

    Attributes
    ----------
    parameters : tuple of Parameter
        Parameters, inputs and elapsed time in the order in which all functions take their numbers
        as p, a tuple; those that it mentions, and in a system all of the system's.

    Raises
    ------
    TypeError, ValueError
        Entries that are not SymPy expressions, or have no finite value; symbols other than the
        state, the noise and the time, or one symbol as two of them.
    """

    state: Any
    time: Any
    state_size: int
    size: int
    parameters: tuple[Parameter, ...]

    def __init__(
        self,
        state: Sequence[Any],
        value: Any,
        noise: Noise | None = None,
        weight: sympy.Expr | float = 1,
        *,
        time: sympy.Symbol | None = None,
        period: Mapping[int, float] | None = None,
    ) -> None:
        from seedslib.base.symbols import as_expression, named_model, require_number
        from seedslib.models.codegen import as_expressions

        self.noise: Noise = named_noise("noise", noise)
        self.state, self.time, _ = named_model(state, time, None, noise=self.noise.symbols)
        self.expressions: Any = as_expressions("value", value)
        if self.expressions.ndim != 1:
            raise ValueError(f"value: wanted a vector, got shape {self.expressions.shape}")
        self.weight_expression: Any = as_expression("weight", weight)
        for name, parts in (("value", self.expressions), ("weight", (self.weight_expression,))):
            for part in parts:
                require_number(name, part)
        self.state_size, self.size = len(self.state), len(self.expressions)
        self.period: Periods = as_periods("period", period, self.size)
        self.parameters = self.mentions
        self._functions: Functions | None = None
        _ = self._value, self._weight  # what has no code is refused now

    @classmethod
    def from_functions(
        cls,
        state_size: int,
        size: int,
        value: Callable[..., np.ndarray],
        noise: Noise | None = None,
        *,
        weight: Callable[..., np.ndarray] | None = None,
        mean: Callable[..., np.ndarray] | None = None,
        cov: Callable[..., np.ndarray] | None = None,
        log_density: Callable[..., np.ndarray] | None = None,
        period: Mapping[int, float] | None = None,
        parameters: Sequence[Parameter] = (),
    ) -> StochasticMap:
        """Make a map of array functions; it takes the sigma-point and quadrature approximations.

        It is pickled where its functions can be: those of a module by their names, lambdas not.

        Parameters
        ----------
        state_size, size : int
            Numbers of components of x and y.
        value : callable
            ``value(t, x, v) -> (size, *batch)`` for x of shape (state_size, *batch) and v of
            shape (noise size, *batch).
        noise : Noise, optional
        weight : callable, optional
            ``weight(t, x, v) -> (*batch)``.
        mean, cov : callable, optional
            Conditional moments ``mean(t, x) -> (size, *batch)``, ``cov(t, x) -> (size, size,
            *batch)``; where absent, points are laid in the joint space of x and v.
        log_density : callable, optional
            ``log_density(t, y, x) -> (*batch)``; it is asked about measurements with a missing
            (NaN) component, never believed about those that are missing altogether.
        parameters : sequence of Parameter, optional
            With inputs and `ELAPSED`: all functions are given their numbers, or arrays (*batch),
            after their other arguments, ``value(t, x, v, *parameters)``.
        """
        if (mean is None) != (cov is None):
            raise ValueError("mean, cov: wanted both or neither, got one")
        self = object.__new__(cls)
        self.state, self.time, self.expressions, self.weight_expression = None, None, None, None
        self.noise = Noise() if noise is None else noise
        self.state_size, self.size = int(state_size), int(size)
        self.period = as_periods("period", period, self.size)
        self.parameters = in_order(parameters)
        self._functions = Functions(value, weight, mean, cov, log_density, tuple(parameters))
        return self

    def __repr__(self) -> str:
        return f"{type(self).__name__}(state_size={self.state_size}, size={self.size})"

    def __eq__(self, other: object) -> bool:
        """Whether the formulas are the same, or it is the same map of array functions."""
        if not (isinstance(other, StochasticMap) and self.symbolic and other.symbolic):
            return self is other
        return self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content) if self.symbolic else id(self)

    @cached_property
    def _content(self) -> tuple[Any, ...]:
        formulas = (*self.expressions, self.weight_expression)
        return self.state, self.time, self.parameters, self.period, formulas, self.noise

    @property
    def symbolic(self) -> bool:
        """Whether the map was given as SymPy expressions."""
        return self.expressions is not None

    @property
    def weighted(self) -> bool:
        """Whether the branch has a probability other than one."""
        if self.symbolic:
            return self.weight_expression != 1
        return self._functions.weight is not None

    @property
    def mentions(self) -> tuple[Parameter, ...]:
        """Parameters, inputs and elapsed time that the map itself depends on."""
        if not self.symbolic:
            return in_order(self._functions.parameters)
        from seedslib.base.symbols import parameters_of

        return parameters_of([self.weight_expression, *self.expressions])

    def taking(self, parameters: tuple[Parameter, ...]) -> StochasticMap:
        """The same map in a system with these parameters, all of which its functions take."""
        return self if parameters == self.parameters else self.remade(parameters=parameters)

    def with_weight(self, weight: sympy.Expr | float) -> StochasticMap:
        """The same map of formulas as a branch of another probability; 1 for always.

        Parameters
        ----------
        weight : SymPy expression or number
        """
        options = {"time": self.time, "period": dict(self.period)}
        made = StochasticMap(self.state, self.expressions, self.noise, weight, **options)
        return made.taking(self.parameters) if weight == 1 else made

    def _compiled(self, arguments: Sequence[Any], expressions: object) -> Callable[..., np.ndarray]:
        """Code of expressions in the time, the arguments and the parameters."""
        from seedslib.models.codegen import compile_array

        return compile_array((self.time, *arguments, self.parameters), expressions)

    def _given(
        self, function: Callable[..., np.ndarray] | None
    ) -> Callable[..., np.ndarray] | None:
        """A given function as one of p, that takes its own of them."""
        if function is None:
            return None
        places = tuple(map(self.parameters.index, self._functions.parameters))
        return partial(picked, function, places)

    @cached_property
    def _value(self) -> Callable[..., np.ndarray]:
        if not self.symbolic:
            return self._given(self._functions.value)
        return self._compiled((self.state, self.noise.symbols), self.expressions)

    @cached_property
    def _weight(self) -> Callable[..., np.ndarray] | None:
        if not self.symbolic:
            return self._given(self._functions.weight)
        return self._compiled((self.state, self.noise.symbols), self.weight_expression)

    def value(self, t: float, x: np.ndarray, v: np.ndarray, p: Values = ()) -> np.ndarray:
        """Value y of shape (size, *batch) at states x and noises v (components first)."""
        result = np.asarray(self._value(t, x, v, p), dtype=float)
        if result.shape[:1] != (self.size,):
            raise ValueError(
                f"value: wanted shape ({self.size}, *batch) from the function, got {result.shape}"
            )
        return result

    def weight(self, t: float, x: np.ndarray, v: np.ndarray, p: Values = ()) -> np.ndarray:
        """Probability of the branch, shape (*batch)."""
        return np.ones(np.shape(x)[1:]) if self._weight is None else self._weight(t, x, v, p)

    @cached_property
    def conditional_expressions(self) -> Conditional:
        """SymPy mean (size,), covariance (size, size) and weight of the map given the state.

        With a weight w(x, v) these are the moments in the branch, E[w y | x] / E[w | x].

        Raises
        ------
        NoClosedForm
            The means over the noise have no closed form, or the map is not symbolic.
        """
        if not self.symbolic:
            from seedslib.gaussian.algebra import NoClosedForm

            raise NoClosedForm("map: array functions have no closed form; use a rule with points")
        import sympy

        average, y, w = self.noise.expectation, self.expressions, self.weight_expression
        joint = bool(w.free_symbols & set(self.noise.symbols))
        weight = average(w) if joint else w
        w, mass = (w, weight) if joint else (1, 1)
        mean = [average(sympy.expand(w * part)) / mass for part in y]
        # in a branch the means are quotients, which only their names keep from being multiplied out
        named = sympy.symbols(f"mean:{self.size}", cls=sympy.Dummy, real=True) if joint else mean
        means = dict(zip(named, mean, strict=True)) if joint else {}
        cov = np.empty((self.size, self.size), dtype=object)
        for i in range(self.size):
            for j in range(i + 1):
                entry = average(sympy.expand(w * (y[i] - named[i]) * (y[j] - named[j])))
                entry = entry.xreplace(means) / mass if joint else sympy.expand(entry)
                cov[i, j] = cov[j, i] = entry
        return Conditional(np.array(mean, dtype=object), cov, weight)

    @cached_property
    def conditional(self) -> Conditional:
        """Array functions of (t, x, p): mean (size, *batch), cov (size, size, *batch), weight.

        Raises
        ------
        NoClosedForm
            As `conditional_expressions`.
        """
        if not self.symbolic and self._functions.mean is not None:
            mean, cov = map(self._given, (self._functions.mean, self._functions.cov))
            return Conditional(mean, cov, None)
        parts = self.conditional_expressions
        return Conditional(*(self._compiled((self.state,), part) for part in parts))

    def conditional_moments(
        self, t: float, x: np.ndarray, p: Values = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean (size, *batch) and covariance (size, size, *batch) of y given x, in numbers.

        The closed forms where there are any; otherwise nine Gauss-Hermite nodes per component
        of Gaussian noise.

        Raises
        ------
        ValueError
            No closed form, and noise that is not Gaussian.
        """
        try:
            mean, cov, _ = self.conditional
        except ValueError:
            if not self.noise.gaussian:
                raise
        else:
            return mean(t, x, p), cov(t, x, p)
        states, v, weights = self.noise.nodes(np.asarray(x, dtype=float))
        y = self.value(t, states, v, p)
        mean = np.einsum("is...,s->i...", y, weights)
        centred = y - mean[:, None]
        return mean, np.einsum("is...,js...,s->ij...", centred, centred, weights)

    def sample(self, t: float, x: np.ndarray, rng: Source, p: Values = ()) -> np.ndarray:
        """One draw of y, shape (size, *batch), for each state, (n, *batch)."""
        batch = np.shape(x)[1:]
        v = self.noise.draw(rng, math.prod(batch)).reshape(self.noise.size, *batch)
        return wrapped(self.value(t, x, v, p), self.period)

    @cached_property
    def has_log_density(self) -> bool:
        """Whether `log_density` exists: the given one, or y affine in noise that has one."""
        if not self.symbolic:
            return self._functions.log_density is not None
        import sympy

        v = self.noise.symbols
        if any(sympy.diff(y, a, b) != 0 for y in self.expressions for a in v for b in v):
            return False
        if self.noise.gaussian or self.noise.log_density is None:
            return self.noise.gaussian
        return not self.period and self.solved_noise is not None

    @property
    def timeless(self) -> bool:
        """Whether it is known to be the same at all times: it has formulas, without the time."""
        return self.symbolic and all(self.time not in y.free_symbols for y in self.expressions)

    @property
    def gaussian_density(self) -> bool:
        """Whether that density is the Gaussian one of the conditional moments."""
        return self.symbolic and self.has_log_density and self.noise.gaussian

    @cached_property
    def solved_noise(self) -> Callable[..., np.ndarray] | None:
        """The noise that makes y of x, and the determinant of dy/dv, of a map affine in the noise.

        A function of (t, x, y, p), shape (size + 1, *batch); None where y does not determine the
        noise.
        """
        if not self.symbolic or self.size != self.noise.size:
            return None
        import sympy

        y = sympy.symbols(f"y:{self.size}", cls=sympy.Dummy, real=True)
        value = sympy.Matrix(self.expressions)
        slope = value.jacobian(self.noise.symbols)
        if (volume := slope.det()) == 0:
            return None
        rest = value.subs(dict.fromkeys(self.noise.symbols, 0))
        noise = slope.LUsolve(sympy.Matrix(y) - rest)
        return self._compiled((self.state, y), [*noise, sympy.Abs(volume)])

    def log_density(self, t: float, y: np.ndarray, x: np.ndarray, p: Values = ()) -> np.ndarray:
        """Logarithm of the density of y given x, shape (*batch); NaN components are left out.

        Raises
        ------
        ValueError
            There is no closed form: the noise enters nonlinearly or has no density. A part of a
            measurement is missing and the given log-density cannot do without it.
        """
        if not self.has_log_density:
            raise ValueError(
                "log_density: wanted y affine in Gaussian noise or a given log_density, "
                "got a map without a closed form"
            )
        if self.gaussian_density:
            mean, cov, _ = self.conditional
            return gaussian_logpdf(y, mean(t, x, p), cov(t, x, p), self.period)
        given = self._by_noise if self.symbolic else self._given(self._functions.log_density)
        return with_missing(given, t, y, x, p)

    def _by_noise(self, t: float, y: np.ndarray, x: np.ndarray, p: Values) -> np.ndarray:
        """Log-density of y from that of the noise, by the change of variables."""
        *noise, volume = self.solved_noise(t, x, y, p)
        with np.errstate(divide="ignore"):
            return self.noise.log_density(np.stack(noise)) - np.log(volume)


class Functions(NamedTuple):
    """The array functions that a map was given, and the parameters that each of them takes last."""

    value: Callable[..., np.ndarray]
    weight: Callable[..., np.ndarray] | None
    mean: Callable[..., np.ndarray] | None
    cov: Callable[..., np.ndarray] | None
    log_density: Callable[..., np.ndarray] | None
    parameters: tuple[Parameter, ...]


def picked(function: Callable[..., Any], places: tuple[int, ...], *given: Any) -> Any:
    """Value of a function that takes some of the numbers p, its last argument, one by one."""
    *others, p = given
    return function(*others, *(p[k] for k in places))


def with_missing(
    log_density: Callable[..., Any], t: float, y: np.ndarray, x: np.ndarray, p: Values
) -> np.ndarray:
    """The given log-density; zero where the whole measurement is missing (NaN), log 1.

    Parameters
    ----------
    log_density : callable
        ``log_density(t, y, x, p) -> (*batch)``.
    t : float
    y, x : ndarray, shapes (m, *batch) and (n, *batch)

    Raises
    ------
    ValueError
        A part of a measurement is missing, and the function gives no number at any state.
    """
    y, gaps = np.asarray(y, dtype=float), np.isnan(y)
    if not gaps.any():
        return log_density(t, y, x, p)
    with np.errstate(invalid="ignore"):
        density = np.where(gaps.all(axis=0), 0.0, log_density(t, y, x, p))
    partly = np.broadcast_to(gaps.any(axis=0) & ~gaps.all(axis=0), density.shape)
    if partly.any() and np.isnan(density[partly]).all():
        raise ValueError(
            "log_density: wanted numbers where a part of the measurement is missing (NaN), got "
            "NaN; it must integrate over that part, or the measurement be missing as a whole"
        )
    return density
