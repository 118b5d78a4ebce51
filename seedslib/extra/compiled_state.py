"""What a compiled filter remembers: the bytes of its C state, and what they say."""

from __future__ import annotations

from typing import Any

import numpy as np


class CompiledState:
    """What a compiled filter remembers, as bytes.

    Attributes
    ----------
    raw : bytes
        The states of C, one for each record.
    batch : tuple of int
    """

    __slots__ = ("_form", "batch", "raw")

    def __init__(self, raw: bytes, batch: tuple[int, ...], form: np.dtype) -> None:
        self.raw, self.batch, self._form = raw, batch, form

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledState, (self.raw, self.batch, self._form)

    def part(self, name: str) -> Any:
        """A part of the state, components first; None where there is no such part."""
        if name not in self._form.names:
            return None
        found = np.frombuffer(self.raw, self._form)[name]
        return np.moveaxis(found, 0, -1).reshape((*found.shape[1:], *self.batch))

    @property
    def time(self) -> float | None:
        """Time of the state, of a filter that carries its law; None before the first."""
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
