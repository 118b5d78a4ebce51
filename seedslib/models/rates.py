"""Mean velocity and rate of covariance of a jump-diffusion, its jumps included.

With intensity mu, mean jump s̄ and second moment S₂ of the jump these are b = a + mu s̄ and
Sigma = B Bᵀ + mu S₂: all that a filter which carries two moments has to know of the motion.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from seedslib.models.maps import StochasticMap

if TYPE_CHECKING:
    from seedslib.models.jump_diffusion import JumpDiffusion


def closed_rates(system: JumpDiffusion) -> tuple[np.ndarray, np.ndarray]:
    """SymPy b of shape (n,) and Sigma of shape (n, n) of a symbolic `JumpDiffusion`.

    Raises
    ------
    NoClosedForm
        The mean of the jump over its marks has no closed form.
    """
    import sympy

    velocity = system.drift_expressions
    spread = system.diffusion_expressions @ system.diffusion_expressions.T
    if system.jump is not None:
        mean, cov, _ = system.jump.conditional_expressions
        velocity = velocity + system.intensity_expression * mean
        spread = spread + system.intensity_expression * (cov + np.outer(mean, mean))
    expand = np.vectorize(sympy.expand, otypes=[object])
    return expand(velocity), expand(spread)


def numeric_rates(system: JumpDiffusion, t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same as arrays (n, *batch) and (n, n, *batch), the jump averaged over its marks."""
    x = np.asarray(x)
    velocity, diffusion = system.drift(t, x), system.diffusion(t, x)
    spread = np.einsum("ik...,jk...->ij...", diffusion, diffusion)
    if system.jump is not None:
        rate = system.intensity(t, x)
        mean, cov = system.jump.conditional_moments(t, x)
        velocity = velocity + rate * mean
        spread = spread + rate * (cov + mean[:, None] * mean[None, :])
    return velocity, spread


def rate_map(system: JumpDiffusion, part: int, chosen: object, size: int) -> StochasticMap:
    """Map without noise of b (`part` 0) or Sigma (1): its `chosen` entries, `size` in number.

    The closed form where there is one, array functions otherwise.
    """
    if system.symbolic:
        from seedslib.gaussian.means.classes import NoClosedForm

        try:
            value = system.moment_expressions[part][chosen]
            return StochasticMap(system.state, value, time=system.time)
        except NoClosedForm:
            pass
    return StochasticMap.from_functions(
        system.state_size, size, lambda t, x, v: numeric_rates(system, t, x)[part][chosen]
    )
