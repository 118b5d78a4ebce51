"""A model in words: a label for people, nothing of it is ever read back."""

from __future__ import annotations


def model_text(system) -> dict[str, str]:
    """The model in words, a label for people: nothing of it is ever read back."""
    if hasattr(system, "dynamics"):
        maps = {"dynamics": system.dynamics, "sensor": system.sensor}
        return {
            name: _lines(map.expressions) if map.symbolic else "array functions"
            for name, map in maps.items()
        }
    if not system.symbolic:
        return {"model": "array functions"}
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


def _lines(expressions):
    return str(expressions.tolist())
