"""Pages of the reference: every public name of the library, from its docstring.

The pages are written by ``python -m bookkit pages``. As a Sphinx extension it links the names of
the library in a page's text to them.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType

from docutils import nodes
from sphinx.transforms.post_transforms import SphinxPostTransform

ROOMS = {
    "base": "Values, parameters and one correction",
    "models": "Models of systems",
    "linearization": "Ways of taking Gaussian means of maps",
    "filters": "Filters and smoothers",
    "designed": "Designed filters: memory, files, use",
    "design": "Design of filters",
    "gaussian": "Gaussian moments and probabilities",
    "evaluation": "Comparing filters, fitting parameters",
    "two_step": "Two-step estimator",
    "piecewise": "Piecewise-linear filter",
    "delay": "Kalman filter with delay",
    "pareto": "Compromise of two criteria",
    "riemann": "Riemann's problem",
    "zoo": "Systems of the papers, ready made",
    "export": "Filters in C and JavaScript",
    "extra": "Learning, clusters, plots",
}
"""Rooms of the library with public names, and what each is for."""

_STAR = re.compile(r"(?<![*\\])\*(?=\w)(?!\w+\*)")


def public(room: str) -> Iterator[tuple[str, object]]:
    """The public names of a room and what they are; those of its public modules as well."""
    package = f"seedslib.{room}"
    for name in import_module(package).__all__:
        thing = getattr(import_module(package), name)
        yield f"{package}.{name}", thing
        if isinstance(thing, ModuleType):
            for inner in getattr(thing, "__all__", _own(thing)):
                yield f"{package}.{name}.{inner}", getattr(thing, inner)


def page(room: str) -> str:
    """The reference page of a room, as MyST text."""
    lines = [f"# {ROOMS[room]}", "", "```{eval-rst}", f".. module:: seedslib.{room}", ""]
    lines += [f"``seedslib.{room}``", "", *_told(import_module(f"seedslib.{room}"))]
    for name, thing in public(room):
        lines += ["", *_directive(name, thing)]
    return "\n".join([*lines, "```", ""])


def _directive(name: str, thing: object) -> list[str]:
    if isinstance(thing, ModuleType):
        return [f".. py:module:: {name}", "", f"``{name}``", "", *_told(thing)]
    if inspect.isclass(thing):
        members = _members(thing)
        lines = [f".. autoclass:: {name}"]
        lines += [f"   :members: {', '.join(members)}"] if members else []
        return lines + (["   :inherited-members:"] if set(members) - set(vars(thing)) else [])
    if callable(thing):
        return [f".. autofunction:: {name}"]
    # The value of a table of modules would be their places on this machine.
    return [f".. autodata:: {name}", *(["   :no-value:"] if "<module" in repr(thing) else [])]


def _told(thing: object) -> list[str]:
    """The docstring in lines; a star before a word is one, and no emphasis."""
    return [_STAR.sub(r"\\*", line) for line in (inspect.getdoc(thing) or "").splitlines()]


def _members(thing: type) -> list[str]:
    """Methods and properties that the library defines and says something of."""
    found = []
    for name in dir(thing):
        static = inspect.getattr_static(thing, name)
        wrapped = (getattr(static, part, None) for part in ("fget", "func", "__func__"))
        home = next(filter(None, wrapped), static)
        ours = str(getattr(home, "__module__", "")).startswith("seedslib")
        if not name.startswith("_") and ours and inspect.isroutine(home) and inspect.getdoc(home):
            found.append(name)
    return found


def _own(module: ModuleType) -> list[str]:
    return [
        name
        for name, thing in vars(module).items()
        if not name.startswith("_") and getattr(thing, "__module__", "") == module.__name__
    ]


def _literal_stars(app, what, name, thing, options, lines: list[str]) -> None:
    lines[:] = [_STAR.sub(r"\\*", line) for line in lines]


class LinkNames(SphinxPostTransform):
    """Link names of the library in a text to the reference."""

    default_priority = 9  # while references are still looked up

    def run(self, **kwargs: object) -> None:
        """Called by Sphinx for each page."""
        if self.env.docname.startswith("book/api/"):
            return
        known = _by_name(self.env.domaindata["py"]["objects"])
        for literal in list(self.document.findall(nodes.literal)):
            match = re.fullmatch(r"([A-Za-z_][\w.]*)(\(.*\))?", literal.astext())
            entry = known.get(match[1]) if match else None
            if entry is None or isinstance(literal.parent, nodes.reference):
                continue
            uri = self.app.builder.get_relative_uri(self.env.docname, entry.docname)
            link = nodes.reference("", "", internal=True, refuri=f"{uri}#{entry.node_id}")
            literal.replace_self(link)
            link += literal


def _by_name(objects: dict) -> dict:
    """Objects by their full name, and by the last part where only one has it."""
    found: dict = {}
    for full, entry in objects.items():
        found[full] = entry
        if entry.objtype in ("class", "function", "data"):
            short = full.rpartition(".")[2]
            found[short] = None if short in found else entry
    return found


def setup(app) -> dict[str, bool]:
    """Called by Sphinx."""
    app.setup_extension("sphinx.ext.autodoc")
    app.setup_extension("numpydoc")
    app.config.numpydoc_show_class_members = False
    app.config.autodoc_typehints = "none"
    app.connect("autodoc-process-docstring", _literal_stars, priority=100)
    app.add_post_transform(LinkNames)
    return {"parallel_read_safe": True}
