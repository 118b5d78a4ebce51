"""The same numbers on other processors: NumPy and OpenBLAS made to use other kernels than here.

Both choose their code by the processor. Variables of the environment make them choose as on
another one, as long as this one has the instructions.
"""

from __future__ import annotations

import numpy as np

NEEDED = {"Prescott": "", "Nehalem": "", "Haswell": "X86_V3", "SkylakeX": "X86_V4"}
"""Kernels of OpenBLAS, and the group of instructions that each wants beyond the common ones."""


def settings() -> dict[str, dict[str, str]]:
    """What this processor can pretend to be: variables of the environment by a name.

    The first is the farthest from any recent processor: the oldest kernels and plain loops.
    """
    groups = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    plain = {"NPY_DISABLE_CPU_FEATURES": " ".join(groups)} if groups else {}
    result = {}
    for name, group in NEEDED.items():
        if not group or group in groups:
            kernels = {"OPENBLAS_CORETYPE": name}
            result |= {f"{name}, plain loops": kernels | plain, name: kernels}
    return result


def environment(name: str) -> dict[str, str]:
    """Variables of a setting by its name; none for "own", and "farthest" is the first one.

    Raises
    ------
    ValueError
        Another name.
    """
    known = settings()
    known = {"own": {}, "farthest": next(iter(known.values()))} | known
    if name not in known:
        raise ValueError(f"processor: wanted one of {', '.join(known)}; got {name!r}")
    return known[name]
