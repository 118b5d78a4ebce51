"""The built book loads nothing from the network."""

from __future__ import annotations

import re
from pathlib import Path

from bs4 import BeautifulSoup

_OUTSIDE = re.compile(r"(https?:)?//", re.IGNORECASE)
_IN_STYLE = re.compile(r"""(?:url\(|@import)\s*['"]?((?:https?:)?//[^'")\s;]+)""", re.IGNORECASE)
_LOADED = {"stylesheet", "preload", "icon", "modulepreload", "preconnect"}


def network_loads(folder: Path) -> list[str]:
    """What pages and styles of the built book load from the network, a line each.

    Raises
    ------
    ValueError
        The folder holds no page.
    """
    pages = sorted(folder.rglob("*.html"))
    if not pages:
        raise ValueError(f"{folder}: no built page here")
    found = [(page, load) for page in pages for load in dict.fromkeys(_page_loads(page))]
    for style in sorted(folder.rglob("*.css")):
        found += [(style, load) for load in _IN_STYLE.findall(style.read_text())]
    return [f"{path.relative_to(folder)}: loads {load} from the network" for path, load in found]


def _page_loads(page: Path) -> list[str]:
    loads = []
    for tag in BeautifulSoup(page.read_bytes(), "html.parser").find_all(True):
        linked = tag.name == "image" or (tag.name == "link" and _LOADED & set(tag.get("rel", [])))
        names = ("src", "poster", "data", *(["href"] if linked else []))
        given = [tag.get(name, "") for name in names]
        given += [part.strip() for part in tag.get("srcset", "").split(",")]
        loads += [part for part in given if _OUTSIDE.match(part)]
        styled = tag.get("style", "") + (tag.string or "" if tag.name == "style" else "")
        loads += _IN_STYLE.findall(styled)
    return loads
