"""The same numbers on other processors: NumPy and OpenBLAS made to use other kernels than here.

Both choose their code by the processor. Variables of the environment make them choose as on the
processor that is farthest from any recent one: the oldest kernels, and plain loops.
"""

from __future__ import annotations

import numpy as np


def environment(name: str) -> dict[str, str]:
    """Variables of the environment that make this processor "own" or "farthest".

    Raises
    ------
    ValueError
        Another name.
    """
    if name not in ("own", "farthest"):
        raise ValueError(f"processor: wanted own or farthest, got {name!r}")
    if name == "own":
        return {}
    groups = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    plain = {"NPY_DISABLE_CPU_FEATURES": " ".join(groups)} if groups else {}
    return {"OPENBLAS_CORETYPE": "Prescott", **plain}
