"""Linearizations that are formulas: Taylor expansion and exact Gaussian means."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from seedslib.gaussian.algebra import NoClosedForm
from seedslib.linearization import means
from seedslib.linearization.formulas import BranchFormulas, Formulas, Parts
from seedslib.models.codegen import fold
from seedslib.models.maps import StochasticMap


def _expanded(map: StochasticMap, mean: Sequence) -> tuple[dict, sympy.Matrix, sympy.Matrix]:
    """Where a map is expanded, as substitutions; its value; its slope there."""
    here = dict(zip(map.state, mean, strict=True))
    here.update(zip(map.noise.symbols, map.noise.mean.tolist(), strict=True))
    value = sympy.Matrix(map.expressions)
    return here, value, value.jacobian(map.state).subs(here)


@dataclass(frozen=True)
class Taylor(Formulas):
    """First-order expansion about the mean, the linearization of the extended Kalman filter.

    (7.1) and (8.4) of the jump-diffusion paper; noise may enter nonlinearly.
    """

    def formulas(
        self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix, spread: bool = True
    ) -> Parts:
        """See `Formulas.formulas`."""
        here, value, slope = _expanded(map, mean)
        cross = cov * slope.T
        if not spread:
            return value.subs(here), cross, None
        return value.subs(here), cross, slope * cross + means.noise_spread(map, value, here)

    def branch(
        self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix, name: Callable[..., Any]
    ) -> BranchFormulas:
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
            raise NoClosedForm("Taylor: wanted a weight without noise; use GaussHermite")
        here, value, slope = _expanded(map, mean)
        weight = sympy.Matrix([map.weight_expression])
        tilt = name(weight.jacobian(map.state).subs(here))
        lean = name(cov * tilt.T)
        mass = name(weight.subs(here)[0])
        usable = sympy.Heaviside(mass**2 - (tilt * lean)[0], 0)
        # 1 / mass, or 0 where the slope is dropped
        inverse = name(usable / (mass + 1 - usable))
        state_cov = cov - inverse**2 * lean * lean.T
        cross = state_cov * slope.T
        return BranchFormulas(
            mass,
            sympy.Matrix(mean) + inverse * lean,
            state_cov,
            value.subs(here) + inverse * slope * lean,
            cross,
            slope * cross + means.noise_spread(map, value, here),
        )


@dataclass(frozen=True)
class ExactGaussian(Formulas):
    """Exact means of the map over N(m, D): statistical linearization (Kazakov).

    (6.1) and (8.3) of the jump-diffusion paper, (6.22) and (6.36) of the switching paper. It
    gives the normal-approximation (assumed-density) filters. The cross-covariance follows from
    Stein's identity, cov(x, y) = D (dE y / dm)ᵀ. A state that is known to be where the map jumps
    is on either side with probability one half: the limit of a variance that vanishes.
    """

    def formulas(
        self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix, spread: bool = True
    ) -> Parts:
        """See `Formulas.formulas`."""
        conditional, noise_cov, _ = map.conditional_expressions
        average = means.averager(map.state, mean, cov)
        y = sympy.Matrix([average(part) for part in conditional])
        cross = cov * y.jacobian(mean).T
        if not spread:
            return y, cross, None
        covariance = means.covariances(map.state, mean, cov, average)
        return y, cross, means.centred_square(average, conditional, noise_cov, y, covariance)

    def branch(
        self, map: StochasticMap, mean: Sequence[Any], cov: sympy.Matrix, name: Callable[..., Any]
    ) -> BranchFormulas:
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
            covariance = means.covariances(state, mean, cov, average)
            square = means.centred_square(average, expressions, spread, y, covariance)
            return BranchFormulas(
                weight, sympy.Matrix(mean), cov, y, cov * y.jacobian(mean).T, square
            )

        def settled(part: sympy.Matrix) -> sympy.Matrix:
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
        return BranchFormulas(
            mass,
            centre[:n, :],
            within[:n, :n],
            slope * centre + constant + bent,
            cross[:n, :],
            slope * cross + joint.T * slope.T + inverse * squares - bent * bent.T,
        )
