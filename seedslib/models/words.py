"""A model in words: a label for people, nothing of it is ever read back."""

from __future__ import annotations

from seedslib.base.objects import Shown
from seedslib.models.kinds import in_steps, switches


class ShownModel(Shown):
    """A model that shows its sizes, and in a notebook its formulas too."""

    _shown = "state_size", "measurement_size"

    def _rows(self) -> dict[str, object]:
        return super()._rows() | model_text(self)


def model_text(system: object) -> dict[str, str]:
    """The model in words, a label for people: nothing of it is ever read back."""
    modes = switches(system)
    if in_steps(system) and not modes:
        maps = {"dynamics": system.dynamics, "sensor": system.sensor}
        return {
            name: _lines(map.expressions) if map.symbolic else "array functions"
            for name, map in maps.items()
        }
    if not system.symbolic:
        return {"model": "array functions"}
    if modes:
        tables = {"switching": system.branches, "readings": system.readings}
        return {name: str([list(map(_branch, row)) for row in t]) for name, t in tables.items()}
    text = {
        "state": ", ".join(map(str, system.state)),
        "drift": _lines(system.drift_expressions),
        "diffusion": _lines(system.diffusion_expressions),
        "sensor": _lines(system.sensor.expressions),
    }
    if system.jump is not None:
        text["intensity"] = str(system.intensity_expression)
        text["jump"] = _lines(system.jump.expressions)
    return text


def _lines(expressions: object) -> str:
    return str(expressions.tolist())


def _branch(branch):
    """Weight and value of a branch, None where there is none."""
    return branch and [str(branch.map.weight_expression), *map(str, branch.map.expressions)]
