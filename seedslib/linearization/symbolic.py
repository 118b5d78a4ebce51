"""Linearizations that are formulas: Taylor expansion and exact Gaussian means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import sympy

from seedslib.linearization import means
from seedslib.linearization.moments import (
    TINY,
    Gaussian,
    Linearization,
    Moments,
    Weighted,
    refuse_weight,
)
from seedslib.models.codegen import batch_shape, compile_components, fold, stack


class _Branch(NamedTuple):
    """SymPy mass of a branch, moments of the state in it, and moments of y with it."""

    mass: object
    mean: object
    cov: object
    value: object
    cross: object
    spread: object


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

    def branch(self, map, mean, cov, name):
        """SymPy moments of a branch (`_Branch`) at given mean and covariance of the state.

        `name` gives large expressions a symbol, see `Names`.
        """
        raise NotImplementedError

    def weighted(self, map):
        """See `Linearization.weighted`.

        Raises
        ------
        NoClosedForm
            As `moments`.
        """
        row = self.row([map])
        return lambda t, mean, cov: row(t, mean, cov)[0]

    def row(self, maps):
        """See `Linearization.row`; one compiled function, in which branches share what they can.

        Raises
        ------
        NoClosedForm
            As `moments`.
        ValueError
            Maps of different states.
        """
        maps = list(maps)
        arguments, mean, cov = _arguments(maps[0], type(self).__name__)
        if any((m.state, m.time) != (maps[0].state, maps[0].time) for m in maps):
            raise ValueError("maps: wanted maps of the same state and time")
        names = means.Names()
        branches = [self.branch(map, mean, cov, names) for map in maps]
        # equal moments of several branches are evaluated and stored once
        wanted = [
            [(slot in (0, 2), sympy.ImmutableMatrix(part)) for slot, part in enumerate(branch[1:])]
            for branch in branches
        ]
        parts = list(dict.fromkeys(part for row in wanted for part in row))
        places = [[parts.index(part) for part in row] for row in wanted]
        evaluate = _compiled(
            arguments, [[b.mass for b in branches], *(part for _, part in parts)], names.table
        )
        varied = [means.mentions(names.meaning(b.mass), {*mean, *cov}) for b in branches]

        def f(t, mean, cov):
            lower = _lower(cov)
            batch = batch_shape(mean, lower)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                masses, *found = evaluate(t, mean, lower)
            found = [
                stack(values, part.shape[:1], batch) if vector else stack(values, part.shape)
                for values, (vector, part) in zip(found, parts, strict=True)
            ]
            result = []
            for mass, row, varies in zip(masses, places, varied, strict=True):
                branch = [stack([mass], (), batch), *(found[k] for k in row)]
                result.append(_weighted(*(_emptied(*branch) if varies else branch)))
            return result

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
        from seedslib.gaussian.means.classes import NoClosedForm

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


def _compiled(arguments, parts, named=()):
    """Function that returns the component lists of several matrices, evaluated together."""
    sizes = np.cumsum([len(part) for part in parts])[:-1]
    function = compile_components(arguments, [e for part in parts for e in part], named)

    def evaluate(*values):
        flat = function(*values)
        return [flat[a:b] for a, b in zip([0, *sizes], [*sizes, None], strict=True)]

    return evaluate


def _weighted(mass, mean, cov, y, cross, spread):
    return Weighted(mass, Gaussian(mean, cov), Moments(y, cross, spread))


def _emptied(mass, *moments):
    """Zero for the mass of an empty branch (rounding may be negative), NaN for its moments."""
    empty = mass < TINY
    if empty.any():
        moments = [np.where(empty, np.nan, part) for part in moments]
        mass = np.where(empty, 0.0, mass)
    return mass, *moments


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
        return value.subs(here), cross, slope * cross + means.noise_spread(map, value, here)

    def branch(self, map, mean, cov, name):
        """Moments of a branch, (7.3) of the switching paper.

        It is the exact Gaussian mean of the product of the expansions of weight and value.
        Where the expanded weight would make a variance negative, A' D A'ᵀ >= A², its slope is
        dropped (guard).

        Raises
        ------
        NoClosedForm
            The weight depends on the noise, which the paper's linearization excludes.
        """
        if means.mentions(map.weight_expression, map.noise.symbols):
            from seedslib.gaussian.means.classes import NoClosedForm

            raise NoClosedForm("Taylor: wanted a weight without noise; use GaussHermite")
        here = dict(zip(map.state, mean, strict=True))
        here.update(zip(map.noise.symbols, map.noise.mean.tolist(), strict=True))
        weight = sympy.Matrix([map.weight_expression])
        tilt = name(weight.jacobian(map.state).subs(here))
        lean = name(cov * tilt.T)
        mass = name(weight.subs(here)[0])
        usable = sympy.Heaviside(mass**2 - (tilt * lean)[0], 0)
        # 1 / mass, or 0 where the slope is dropped
        inverse = name(usable / (mass + 1 - usable))
        value = sympy.Matrix(map.expressions)
        slope = value.jacobian(map.state).subs(here)
        state_cov = cov - inverse**2 * lean * lean.T
        cross = state_cov * slope.T
        return _Branch(
            mass,
            sympy.Matrix(mean) + inverse * lean,
            state_cov,
            value.subs(here) + inverse * slope * lean,
            cross,
            slope * cross + means.noise_spread(map, value, here),
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
        average = means.averager(map.state, mean, cov)
        y = sympy.Matrix([average(part) for part in conditional])
        cross = cov * y.jacobian(mean).T
        if not spread:
            return y, cross, None
        return y, cross, means.centred_square(average, conditional, noise_cov, y)

    def branch(self, map, mean, cov, name):
        """Moments of a branch, the centred form of (6.22) and (6.36) of the switching paper.

        With the mass q(m, D) = E w the state in the branch has the mean m + D grad log q and the
        covariance D + D (Hessian of log q) D, by Stein's identity applied twice. What of y is
        affine in the state follows from these two; only the rest takes raw means, so that no
        digits are lost far from the origin. A weight that mentions the noise, (6.23) and (6.27),
        makes the noise part of the state.
        """
        state, expressions, spread, mean, cov, still = means.joined(map, mean, cov)
        weight, n = fold(map.weight_expression), map.state_size
        average = means.averager(state, mean, cov)
        if not means.mentions(weight, state):
            y = sympy.Matrix([average(part) for part in expressions])
            square = means.centred_square(average, expressions, spread, y)
            return _Branch(weight, sympy.Matrix(mean), cov, y, cov * y.jacobian(mean).T, square)

        def settled(part):
            return name(part.xreplace(still))

        mass = average(weight)
        grade = sympy.Matrix([mass]).jacobian(mean)
        slope, constant, rest = means.affine_part(expressions, state)
        raw = sympy.Matrix([average(means.expand(weight * part)) for part in rest])
        squares = settled(means.raw_square(average, weight, rest, spread))
        bend, tilt = settled(grade.jacobian(mean)), settled(raw.jacobian(mean))
        mass, grade, raw = settled(mass), settled(grade), settled(raw)
        inverse = name(1 / mass)
        lean, bent = name(inverse * cov * grade.T), name(inverse * raw)
        within = name(cov + inverse * cov * bend * cov - lean * lean.T)
        joint = name(inverse * cov * tilt.T - lean * bent.T)  # cov(state, rest)
        centre = sympy.Matrix(mean).xreplace(still) + lean
        cross = name(within * slope.T + joint)
        return _Branch(
            mass,
            centre[:n, :],
            within[:n, :n],
            slope * centre + constant + bent,
            cross[:n, :],
            slope * cross + joint.T * slope.T + inverse * squares - bent * bent.T,
        )
