"""A design in progress in a file, so that a run that was stopped goes on where it was.

After each step between measurements the file is replaced as a whole: it holds what was found so
far and, for each bundle of paths, the states and what the filter remembers. Random streams follow
from the seed and are not stored. Nothing in a file is executed.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import warnings
import zipfile
import zlib
from pathlib import Path

import numpy as np

import seedslib
from seedslib.base.atomic import replacing
from seedslib.base.blocks import seed_record
from seedslib.design.paths.forward_pass import Found
from seedslib.designed.finite_order_rules import FiniteOrderState, Start
from seedslib.designed.memory import Past
from seedslib.designed.predictors import PolynomialFit
from seedslib.designed.regression import AffineFit
from seedslib.linearization.moments import Moments
from seedslib.models.simulation import simulate
from seedslib.models.words import model_text

FORMAT = "seedslib design in progress, version 2"
TRIAL = 256
"""Paths of the small run by which a system is recognised."""


class Checkpoint:
    """The file of a design in progress.

    Parameters
    ----------
    path : path-like
        In a folder that exists. The file is made when there is none.
    arguments : dict
        What the design depends on, by name; see `arguments`.

    Raises
    ------
    ValueError
        A folder that does not exist.
    """

    def __init__(self, path, arguments):
        self.path = Path(path)
        # as they come back from a file: lists for tuples
        self.arguments = json.loads(json.dumps(arguments))
        if self.path.is_dir() or not self.path.parent.is_dir():
            raise ValueError(f"checkpoint: wanted a file in a folder that exists, got {path}")

    def write(self, forward, last):
        """Replace the file by what a forward pass has now; after the last step without states."""
        walk, found = forward.walk, forward.found
        arrays = {f"alive/{b}": alive for b, alive in enumerate(walk.alive)}
        if not last:
            for b, (x, state) in enumerate(zip(walk.states, forward.states, strict=True)):
                arrays |= {f"states/{b}": x, f"estimate/{b}": state.mean}
                arrays[f"measurement/{b}"] = state.measurement
                for name in ("estimates", "measurements"):
                    for i, part in enumerate(getattr(state.past, name)):
                        arrays[f"past/{b}/{name}/{i}"] = part
        header = {"format": FORMAT, "arguments": self.arguments, "stop": walk.stop}
        arrays |= _packed(found)
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
        with replacing(self.path) as file:
            np.savez(file, **arrays)

    def restore(self, forward):
        """Put a forward pass where the file is; nothing happens where there is no file.

        Raises
        ------
        ValueError
            A file that is damaged or something else, or that belongs to another design; the
            message says what differs.
        """
        if not self.path.exists():
            return
        arrays, header = self._read()
        there, here = header["arguments"], self.arguments
        names = [n for n in {**there, **here} if there.get(n) != here.get(n)]
        if "times" in names:  # the system was looked at there
            names = [name for name in names if name not in ("system", "linearization")]
        if names:
            raise ValueError(
                f"checkpoint: {self.path.name} belongs to another design, which differs in "
                + ", ".join(_apart(n, there.get(n), here.get(n)) for n in names)
                + "; remove it or give another file"
            )
        walk, bundles = forward.walk, range(len(forward.walk.counts))
        try:
            found = _unpacked(arrays)
            alive = [arrays[f"alive/{b}"] for b in bundles]
            states, filters = [], []
            if "states/0" in arrays:
                states = [arrays[f"states/{b}"] for b in bundles]
                filters = [_filter_state(arrays, b, len(found.fits)) for b in bundles]
        except KeyError as error:
            raise self._damaged(error) from None
        walk.resume(header["stop"], states, alive)
        forward.resume(found, filters)

    def _read(self):
        try:
            with np.load(self.path, allow_pickle=False) as file:
                arrays = dict(file)
            header = json.loads(arrays.pop("header").tobytes().decode())
            if header["format"] != FORMAT:
                raise ValueError(f"it says {header['format']!r}")
        except (
            zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError, KeyError,
            TypeError, AttributeError, NotImplementedError, MemoryError,
        ) as error:  # fmt: skip
            raise self._damaged(error) from None
        return arrays, header

    def _damaged(self, error):
        return ValueError(
            f"checkpoint: {self.path.name} is damaged or something else ({error}); remove it to "
            "begin again"
        )


def arguments(system, rules, linearization, predictor, times, grid, paths, root, options, bound):
    """What a design depends on, by name and in a form that JSON takes.

    The system is recognised by its formulas and by a small run, bit by bit, and so are the
    moments of the sensor.
    """
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # the design itself will warn
        trial = simulate(system, times[:3], TRIAL, 0)
        moments = rules.sensor(times[0], trial.states[0], system.cov0)
        rates = [
            system.intensity(times[0], x) for x in trial.states if hasattr(system, "intensity")
        ]
    text = np.frombuffer(json.dumps(model_text(system)).encode(), dtype=np.uint8)
    law = system.mean0, system.cov0
    entropy, spawn_key = seed_record(root)
    return {
        "system": _digest(text, trial.states, trial.measurements, *rates, *law),
        "linearization": [type(linearization).__name__, _digest(*moments)],
        "memory": dataclasses.asdict(rules.memory),
        "predictor": [type(predictor).__name__, dataclasses.asdict(predictor)],
        "times": times.tolist(),
        "nodes": [nodes.tolist() for nodes in grid],
        "components": rules.components,
        "measured_nodes": rules.measured_nodes,
        "paths": paths,
        "seed": entropy,
        "spawn_key": list(spawn_key),
        "options": options,
        "bound": bound,
        "version of seedslib": seedslib.__version__,
        "version of NumPy": np.__version__,
    }


def _digest(*arrays) -> str:
    whole = hashlib.sha256()
    for array in arrays:
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()


def _apart(name, there, here):
    """A name, with the values where they are short."""
    if max(len(str(there)), len(str(here))) > 30:
        return name
    return f"{name} ({there} there, {here} here)"


def _packed(found) -> dict:
    """Arrays of what was found, by name."""
    start = found.start
    parts = dict(zip(_START, (start.mean, start.cov, *start.moments), strict=True))
    times, rms, error = (np.array(part) for part in zip(*found.scores, strict=True))
    parts |= {"size": found.size, "times": times, "rms": rms, "error": error}
    parts["nodes"] = np.array([len(fits) for fits in found.node_fits])
    rows = {f"fits/{k}": fit for k, fit in enumerate(found.fits)}
    for k, fits in enumerate(found.node_fits):
        rows |= {f"nodes/{k}/{i}": fit for i, fit in enumerate(fits)}
    for place, fit in rows.items():
        parts |= {f"{place}/{name}": np.asarray(part) for name, part in fit._asdict().items()}
    return parts


_START = tuple(f"start/{name}" for name in ("mean", "cov", "sensor_mean", "cross", "sensor_cov"))


def _unpacked(arrays) -> Found:
    mean, cov, *moments = (arrays[name] for name in _START)
    scores = zip(arrays["times"].tolist(), arrays["rms"], arrays["error"], strict=True)
    counts = arrays["nodes"].tolist()
    fits = sum(name.startswith("fits/") and name.endswith("/gain") for name in arrays)
    return Found(
        Start(mean, cov, Moments(*moments)),
        tuple(_fit(arrays, f"fits/{k}") for k in range(fits)),
        tuple(
            tuple(_fit(arrays, f"nodes/{k}/{i}") for i in range(count))
            for k, count in enumerate(counts)
        ),
        tuple(scores),
        arrays["size"],
    )


def _fit(arrays, place):
    kind = PolynomialFit if f"{place}/centre" in arrays else AffineFit
    parts = (arrays[f"{place}/{name}"] for name in kind._fields)
    return kind(*(part if part.ndim else int(part) for part in parts))


def _filter_state(arrays, b, index):
    """What the next step takes of the filter's state on a bundle."""
    past = []
    for name in ("estimates", "measurements"):
        place = f"past/{b}/{name}/"
        count = sum(key.startswith(place) for key in arrays)
        past.append(tuple(arrays[f"{place}{i}"] for i in range(count)))
    return FiniteOrderState(
        index, arrays[f"estimate/{b}"], None, Past(*past), arrays[f"measurement/{b}"], 0.0, None,
        True,
    )  # fmt: skip
