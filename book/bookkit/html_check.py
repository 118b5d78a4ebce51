"""The built book loads nothing from the network."""

from __future__ import annotations

import re
from pathlib import Path

from bs4 import BeautifulSoup

_OUTSIDE = re.compile(r"(https?:)?//", re.IGNORECASE)
_STYLE_LOADS = re.compile(r"""(?:url\(|@import)\s*['"]?((?:https?:)?//[^'")\s;]+)""", re.IGNORECASE)
_LOADED_LINKS = {"stylesheet", "preload", "icon", "modulepreload", "preconnect"}


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
    result = [(page, load) for page in pages for load in _page_loads(page)]
    for style in sorted(folder.rglob("*.css")):
        result += [(style, load) for load in _STYLE_LOADS.findall(style.read_text())]
    return [f"{path.relative_to(folder)}: loads {load} from the network" for path, load in result]


def _page_loads(page: Path) -> list[str]:
    loads = []
    for tag in BeautifulSoup(page.read_bytes(), "html.parser").find_all(True):
        for attribute in ("src", "poster", "data"):
            loads.append(tag.get(attribute, ""))
        loads += [part.strip() for part in tag.get("srcset", "").split(",")]
        if tag.name == "image" or (tag.name == "link" and _LOADED_LINKS & set(tag.get("rel", []))):
            loads.append(tag.get("href", ""))
        if tag.name == "style":
            loads += _STYLE_LOADS.findall(tag.string or "")
        loads += _STYLE_LOADS.findall(tag.get("style", ""))
    return [load for load in dict.fromkeys(loads) if _OUTSIDE.match(load)]
