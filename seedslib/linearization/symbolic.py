"""Linearizations that are formulas: Taylor expansion and exact Gaussian means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy

from seedslib.linearization import Gaussian, Linearization, Moments, Weighted, refuse_weight
from seedslib.systems.codegen import batch_shape, compile_components, real_part, stack


class _Formulas(Linearization):
    """A linearization given by SymPy formulas in the mean and the covariance of the state."""

    def formulas(self, map, mean, cov, spread=True):
        """SymPy E y (m, 1), cov(x, y) (n, m) and cov y (m, m) at given mean and covariance."""
        raise NotImplementedError

    def rate_formulas(self, system, mean, cov):
        """SymPy rates of the mean (n, 1) and the covariance (n, n) of a jump-diffusion."""
        velocity, cross, _ = self.formulas(system.drift_map, mean, cov, spread=False)
        lower, _, _ = self.formulas(system.spread_map, mean, cov, spread=False)
        spread = sympy.zeros(len(mean))
        for k, (i, j) in enumerate(zip(*np.tril_indices(len(mean)), strict=True)):
            spread[i, j] = spread[j, i] = lower[k]
        return velocity, cross + cross.T + spread

    def moments(self, map, spread=True):
        """See `Linearization.moments`.

        Raises
        ------
        NoClosedForm
            The map is given by array functions, or a mean has no closed form.
        """
        refuse_weight(map)
        arguments, mean, cov = _arguments(map, type(self).__name__)
        parts = self.formulas(map, mean, cov, spread)
        evaluate = _compiled(arguments, parts if spread else parts[:2])
        n, m = map.state_size, map.size

        def f(t, mean, cov):
            lower = _lower(cov)
            y, cross, *rest = evaluate(t, mean, lower)
            return Moments(
                stack(y, (m,), batch_shape(mean, lower)),
                stack(cross, (n, m)),
                stack(rest[0], (m, m)) if spread else None,
            )

        return f

    def transition(self, map):
        """See `Linearization.transition`."""
        refuse_weight(map)
        arguments, mean, cov = _arguments(map, type(self).__name__)
        y, _, spread = self.formulas(map, mean, cov)
        evaluate, m = _compiled(arguments, [y, spread]), map.size

        def f(t, mean, cov):
            lower = _lower(cov)
            y, spread = evaluate(t, mean, lower)
            return Gaussian(stack(y, (m,), batch_shape(mean, lower)), stack(spread, (m, m)))

        return f

    def rate(self, system):
        """See `Linearization.rate`."""
        (time, mean, lower), vector, cov = _arguments(system.drift_map, type(self).__name__)
        velocity, change = self.rate_formulas(system, vector, cov)
        rows, columns = np.tril_indices(len(mean))
        rates = [*velocity, *(change[int(i), int(j)] for i, j in zip(rows, columns, strict=True))]
        return compile_components((time, (*mean, *lower)), rates)


def _arguments(map, name):
    """Arguments (t, mean, lower covariance) and the SymPy mean and covariance made of them."""
    if not map.symbolic:
        from seedslib.gaussian.symbolic import NoClosedForm

        raise NoClosedForm(
            f"{name}: wanted a symbolic map, got array functions; use Unscented, Cubature or "
            "GaussHermite"
        )
    n = map.state_size
    mean = sympy.symbols(f"m:{n}", cls=sympy.Dummy, real=True)
    cov = sympy.zeros(n)
    lower = []
    for i, j in zip(*np.tril_indices(n), strict=True):
        entry = sympy.Dummy(f"P{i}{j}", real=True)
        lower.append(entry)
        cov[i, j] = cov[j, i] = entry
    return (map.time, mean, tuple(lower)), list(mean), cov


def _lower(cov):
    return [cov[i, j] for i in range(len(cov)) for j in range(i + 1)]


def _compiled(arguments, parts):
    """Function that returns the component lists of several matrices, evaluated together."""
    sizes = np.cumsum([len(part) for part in parts])[:-1]
    function = compile_components(arguments, [e for part in parts for e in part])

    def evaluate(*values):
        flat = function(*values)
        return [flat[a:b] for a, b in zip([0, *sizes], [*sizes, None], strict=True)]

    return evaluate


@dataclass(frozen=True)
class Taylor(_Formulas):
    """First-order expansion about the mean, the linearization of the extended Kalman filter.

    (7.1) and (8.4) of the jump-diffusion paper; noise may enter nonlinearly.
    """

    def formulas(self, map, mean, cov, spread=True):
        """See `_Formulas.formulas`."""
        here = dict(zip(map.state, mean, strict=True))
        here.update(zip(map.noise.symbols, map.noise.mean.tolist(), strict=True))
        value = sympy.Matrix(map.expressions)
        slope = value.jacobian(map.state).subs(here)
        cross = cov * slope.T
        if not spread:
            return value.subs(here), cross, None
        return value.subs(here), cross, slope * cross + _noise_spread(map, value, here)

    def weighted(self, map):
        """Moments of a branch, (7.3) of the switching paper.

        It is the exact Gaussian mean of the product of the expansions of weight and value.
        Where the expanded weight would make a variance negative, A' D A'ᵀ >= A², its slope is
        dropped (guard).

        Raises
        ------
        NoClosedForm
            The weight depends on the noise, which the paper's linearization excludes.
        """
        arguments, mean, cov = _arguments(map, "Taylor")
        if map.weight_expression.free_symbols & set(map.noise.symbols):
            from seedslib.gaussian.symbolic import NoClosedForm

            raise NoClosedForm("Taylor: wanted a weight without noise; use GaussHermite")
        here = dict(zip(map.state, mean, strict=True))
        here.update(zip(map.noise.symbols, map.noise.mean.tolist(), strict=True))
        weight = sympy.Matrix([map.weight_expression])
        lean = cov * weight.jacobian(map.state).subs(here).T
        strength = weight.jacobian(map.state).subs(here) * lean
        inverse = sympy.Dummy("inverse", real=True)
        value = sympy.Matrix(map.expressions)
        slope = value.jacobian(map.state).subs(here)
        state_cov = cov - inverse**2 * lean * lean.T
        cross = state_cov * slope.T
        first = _compiled(arguments, [weight.subs(here), strength])
        second = _compiled(
            (*arguments, inverse),
            [
                sympy.Matrix(mean) + inverse * lean,
                state_cov,
                value.subs(here) + inverse * slope * lean,
                cross,
                slope * cross + _noise_spread(map, value, here),
            ],
        )

        def branch(t, mean, cov):
            lower = _lower(cov)
            (mass,), (strength,) = first(t, mean, lower)
            usable = np.asarray(strength < mass * mass)
            inverse = np.where(usable, 1.0, 0.0) / np.where(usable, mass, 1.0)
            return _weighted(map, mass, mean, lower, second(t, mean, lower, inverse))

        return branch


def _noise_spread(map, value, here):
    """Covariance of y by the expanded noise."""
    if map.noise.size == 0:
        return sympy.zeros(map.size)
    slope = value.jacobian(map.noise.symbols).subs(here)
    return slope * sympy.Matrix(map.noise.cov.tolist()) * slope.T


def _weighted(map, mass, mean, lower, parts):
    n, m = map.state_size, map.size
    batch = batch_shape(mean, lower)
    return Weighted(
        stack([mass], (), batch),
        Gaussian(stack(parts[0], (n,), batch), stack(parts[1], (n, n))),
        Moments(stack(parts[2], (m,), batch), stack(parts[3], (n, m)), stack(parts[4], (m, m))),
    )


@dataclass(frozen=True)
class ExactGaussian(_Formulas):
    """Exact means of the map over N(m, D): statistical linearization (Kazakov).

    (6.1) and (8.3) of the jump-diffusion paper, (6.22) and (6.36) of the switching paper. It
    gives the normal-approximation (assumed-density) filters. The cross-covariance follows from
    Stein's identity, cov(x, y) = D (dE y / dm)ᵀ.
    """

    def formulas(self, map, mean, cov, spread=True):
        """See `_Formulas.formulas`."""
        conditional, noise_cov, _ = map.conditional_expressions
        average = _averager(map.state, mean, cov)
        y = sympy.Matrix([average(part) for part in conditional])
        cross = cov * y.jacobian(mean).T
        if not spread:
            return y, cross, None
        return y, cross, _centred_square(average, conditional, noise_cov, y)

    def weighted(self, map):
        """Moments of a branch, the centred form of (6.22) and (6.36) of the switching paper.

        With the mass q(m, D) = E w the state in the branch has the mean m + D grad log q and the
        covariance D + D (Hessian of log q) D, by Stein's identity applied twice.
        """
        arguments, mean, cov = _arguments(map, "ExactGaussian")
        conditional, noise_cov, weight = map.conditional_expressions
        average = _averager(map.state, mean, cov)
        inverse = sympy.Dummy("inverse", real=True)
        if weight.free_symbols & set(map.state):
            q = sympy.Matrix([average(weight)])
            y = inverse * sympy.Matrix([average(_expand(weight * part)) for part in conditional])
            second = inverse * _raw_square(average, weight, conditional, noise_cov)
            spread = second - y * y.T
            lean = inverse * cov * q.jacobian(mean).T
            bend = inverse * cov * q.jacobian(mean).jacobian(mean) * cov - lean * lean.T
            raw = sympy.Matrix([average(_expand(weight * part)) for part in conditional])
            cross = inverse * cov * raw.jacobian(mean).T - lean * y.T
        else:
            q = sympy.Matrix([weight])
            y = sympy.Matrix([average(part) for part in conditional])
            spread = _centred_square(average, conditional, noise_cov, y)
            lean, bend = sympy.zeros(len(mean), 1), sympy.zeros(len(mean))
            cross = cov * y.jacobian(mean).T
        first = _compiled(arguments, [q])
        parts = _compiled(
            (*arguments, inverse), [sympy.Matrix(mean) + lean, cov + bend, y, cross, spread]
        )

        def branch(t, mean, cov):
            lower = _lower(cov)
            ((mass,),) = first(t, mean, lower)
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = 1.0 / np.where(mass == 0, np.nan, mass)
                return _weighted(map, mass, mean, lower, parts(t, mean, lower, inverse))

        return branch


def _averager(state, mean, cov):
    """Exact mean of an expression of the state; what does not depend on the state passes."""
    from seedslib.gaussian.symbolic import NoClosedForm, expectation

    known = {}

    def average(expression):
        expression = sympy.sympify(expression)
        if not expression.free_symbols & set(state):
            return expression
        if expression not in known:
            others = tuple(expression.free_symbols - set(state))
            try:
                result = expectation(expression, state, mean, cov, parameters=others)
            except NoClosedForm as error:
                raise NoClosedForm(
                    f"{error}; GaussHermite, Unscented and Cubature take this map"
                ) from error
            known[expression] = real_part(result)
        return known[expression]

    return average


def _expand(expression):
    """Products multiplied out, exponentials left whole (their factors may overflow)."""
    return sympy.expand(expression, power_exp=False, power_base=False, log=False)


def _centred_square(average, conditional, noise_cov, mean):
    """Mean of cov(y | x) plus cov of E(y | x); what cancels does so before numbers are put in."""
    size = len(conditional)
    spread = sympy.zeros(size)
    for i in range(size):
        for j in range(i + 1):
            product = average(_expand(conditional[i] * conditional[j]))
            inner = average(noise_cov[i, j])
            spread[i, j] = spread[j, i] = inner + _expand(product - mean[i] * mean[j])
    return spread


def _raw_square(average, weight, conditional, noise_cov):
    size = len(conditional)
    square = sympy.zeros(size)
    for i in range(size):
        for j in range(i + 1):
            inner = conditional[i] * conditional[j] + noise_cov[i, j]
            square[i, j] = square[j, i] = average(_expand(weight * inner))
    return square
