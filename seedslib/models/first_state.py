"""The distribution of a first state, whose moments may be formulas of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from seedslib.base.blocks import Source
from seedslib.base.checks import NEGATIVE_EIGENVALUE, as_covariance, as_real
from seedslib.base.objects import Pickled
from seedslib.base.values import Parametrized
from seedslib.models.maps import Noise

if TYPE_CHECKING:
    from typing import Self


class FormulasOfMoments(Pickled):
    """Mean and covariance of a first state as expressions in parameters.

    Parameters
    ----------
    mean0, cov0 : array_like of SymPy expressions, shapes (n,) and (n, n)
    n : int

    Raises
    ------
    TypeError, ValueError
        No expressions, another shape, symbols that are no parameters.
    """

    def __init__(self, mean0: Any, cov0: Any, n: int) -> None:
        from seedslib.base.symbols import parameters_of
        from seedslib.models.codegen import known_expressions

        self.mean0: np.ndarray = known_expressions("mean0", mean0, (n,), {}, set())
        self.cov0: np.ndarray = known_expressions("cov0", cov0, (n, n), {}, set())
        self.mentions: tuple[Any, ...] = parameters_of([*self.mean0, *self.cov0.flat])
        for p in self.mentions:
            if p.role != "parameter":
                raise ValueError(f"mean0, cov0: wanted parameters, got the {p.role} {p}")

    @cached_property
    def _functions(self) -> Any:
        from seedslib.models.codegen import compile_array

        return [compile_array([self.mentions], part) for part in (self.mean0, self.cov0)]

    def moments(self, numbers: Mapping[Any, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Mean (n, *batch) and covariance (n, n, *batch) with these numbers of the parameters.

        Records whose matrix is no covariance get NaN, so that their likelihood is no number.

        Raises
        ------
        ValueError
            The one matrix of all records is no covariance.
        """
        p = [numbers.get(q, q.value) for q in self.mentions]
        with np.errstate(all="ignore"):
            mean, cov = (function(p) for function in self._functions)
        if cov.ndim == 2:
            return as_real("mean0", mean), as_covariance("cov0", cov)
        variances = np.einsum("ii...->i...", cov)
        unit = np.sqrt(np.where(variances > 0, variances, 1.0))
        scaled = np.nan_to_num(np.moveaxis(cov / unit / unit[:, None], (0, 1), (-2, -1)))
        values = np.linalg.eigvalsh(scaled)
        wrong = (variances < 0).any(axis=0) | (values[..., 0] < -NEGATIVE_EIGENVALUE)
        return mean, np.where(wrong, np.nan, cov)


class Started(Parametrized):
    """A model whose first state has the moments `mean0` and `cov0`.

    Attributes
    ----------
    mean0, cov0 : ndarray, shapes (n,) and (n, n)
        Where they have parameters, those of the present numbers; with axes (*batch) where a
        number of each record was bound.
    prior : Noise, or None
        The distribution; None where each record has its own.
    """

    mean0: np.ndarray
    cov0: np.ndarray
    prior: Noise | None
    first: FormulasOfMoments | None = None

    def _start(self, mean0: Any, cov0: Any, initial: Any, n: int) -> tuple[Any, ...]:
        """Set the first state; the parameters that its moments mention."""
        mean, cov = np.array(mean0, dtype=object, ndmin=1), np.array(cov0, dtype=object, ndmin=2)
        if not any(hasattr(entry, "free_symbols") for entry in (*mean.flat, *cov.flat)):
            mean = as_real("mean0", np.atleast_1d(as_real("mean0", mean0)), (n,))
            cov = as_covariance("cov0", np.atleast_2d(as_real("cov0", cov0)), n)
            vars(self).update(mean0=mean, cov0=cov, prior=Noise(n, mean, cov, initial))
            return ()
        if initial is not None:
            raise ValueError("initial: wanted none beside moments with parameters, got one")
        vars(self)["first"] = FormulasOfMoments(mean, cov, n)
        self._set_moments()
        return self.first.mentions

    def _set_moments(self) -> None:
        mean, cov = self.first.moments(self.numbers)
        alike = mean.ndim == 1 and cov.ndim == 2
        prior = Noise(len(mean), mean, cov) if alike else None
        vars(self).update(mean0=mean, cov0=cov, prior=prior)

    def bind(self, values: Mapping[Any, ArrayLike] | None = None, /, **named: Any) -> Self:
        """See `seedslib.base.values.Parametrized.bind`."""
        other = super().bind(values, **named)
        if self.first is not None:
            other._set_moments()
        return other

    def initial_sample(self, rng: Source, count: int) -> np.ndarray:
        """Draws of the first state, shape (n, count).

        Raises
        ------
        ValueError
            A first state of each record.
        """
        if self.prior is None:
            raise ValueError("mean0, cov0: wanted one first state to draw, got one for each record")
        return self.prior.draw(rng, count)
