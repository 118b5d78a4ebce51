"""Look over the built book: what a strict build does not see.

Every figure has alt text, every link inside the book has a target, every page names its
language, equations are rendered by a script that lies in the book, and nothing is loaded from
the network.
"""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

from bs4 import BeautifulSoup, Tag

_LOADING = (
    *((kind, "src") for kind in ("script", "img", "iframe", "source", "video", "audio", "embed")),
    ("video", "poster"),
    ("object", "data"),
    ("image", "href"),
)
_OWN_FILES = (("script", "src"), ("link", "href"))
_STYLE_LOADS = re.compile(
    r"""(?:url\(\s*|@import\s+)['"]?((?:https?:)?//[^'")\s;]+)""", re.IGNORECASE
)
_NO_LINKS = ("mailto", "javascript", "tel", "data")
_PICTURES = (".png", ".svg", ".jpg", ".jpeg", ".gif", ".webp")
_LOADING_LINKS = {"stylesheet", "preload", "icon", "shortcut", "modulepreload", "preconnect"}
_UNCHECKED = {"genindex.html", "search.html", "prf-prf.html", "py-modindex.html"}


def faults(html_root: Path) -> list[str]:
    """Everything wrong in a built book, each with its page; empty when all is well.

    Parameters
    ----------
    html_root : Path
        Folder of the built HTML.

    Raises
    ------
    ValueError
        The folder holds no page.
    """
    html_root = html_root.resolve()
    pages = {
        path: BeautifulSoup(path.read_bytes(), "html.parser").find_all(True)
        for path in sorted(html_root.rglob("*.html"))
        if "_static" not in path.relative_to(html_root).parts
    }
    if not pages:
        raise ValueError(f"{html_root}: no built page here")
    anchors = {path: _anchors(tags) for path, tags in pages.items()}
    found = []
    for path, tags in pages.items():
        if _redirects(tags):
            continue
        name = path.relative_to(html_root).as_posix()
        problems = [
            *_page(tags),
            *_external(tags),
            *_files(tags, path, html_root),
            *_images(tags, path, html_root),
            *_links(tags, path, html_root, anchors),
        ]
        found += [f"{name}: {problem}" for problem in dict.fromkeys(problems)]
    for path in sorted(html_root.rglob("*.css")):
        name = path.relative_to(html_root).as_posix()
        found += [f"{name}: {load}" for load in _style(path.read_text(errors="replace"))]
    return found


def _with(tags: list[Tag], attribute: str, *kinds: str) -> list[Tag]:
    """Those of a page's tags that have an attribute; of some kinds, or of any."""
    return [tag for tag in tags if attribute in tag.attrs and (not kinds or tag.name in kinds)]


def _redirects(tags: list[Tag]) -> bool:
    """Whether this is no page but the door to one, made by the builder."""
    return any(tag["http-equiv"].lower() == "refresh" for tag in _with(tags, "http-equiv", "meta"))


def _anchors(tags: list[Tag]) -> set[str]:
    return {tag["id"] for tag in _with(tags, "id")} | {
        tag["name"] for tag in _with(tags, "name", "a")
    }


def _page(tags: list[Tag]) -> list[str]:
    found = []
    if not any(tag["lang"] for tag in _with(tags, "lang", "html")):
        return ["no language on the html element"]
    classed = _with(tags, "class")
    if any("math" in tag["class"] for tag in classed) and not any(
        "mathjax" in tag["src"].lower() for tag in _with(tags, "src", "script")
    ):
        found.append("equations, but no MathJax script in the book")
    for tag in classed:
        if "problematic" in tag["class"]:
            found.append(f"a reference was not resolved: {tag.get_text()[:60]!r}")
    return found


def _external(tags: list[Tag]) -> list[str]:
    found = [
        f"loads {tag[attribute]} from the network"
        for kind, attribute in _LOADING
        for tag in _with(tags, attribute, kind)
        if _is_external(tag[attribute])
    ]
    for tag in _with(tags, "href", "link"):
        if _LOADING_LINKS & set(tag.get("rel", [])) and _is_external(tag["href"]):
            found.append(f"loads {tag['href']} from the network")
    for tag in _with(tags, "srcset"):
        for candidate in tag["srcset"].split(","):
            if candidate.strip() and _is_external(candidate.split()[0]):
                found.append(f"loads {candidate.split()[0]} from the network")
    for tag in _with(tags, "style"):
        found += _style(tag["style"])
    for tag in tags:
        if tag.name in ("script", "style") and "src" not in tag.attrs:
            text = tag.string or ""
            found += [f"{tag.name} with {m} in it" for m in ("@import", "import(") if m in text]
            found += _style(text) if tag.name == "style" else []
    return found


def _style(text: str) -> list[str]:
    return [f"loads {address} from the network" for address in _STYLE_LOADS.findall(text)]


def _files(tags: list[Tag], page: Path, root: Path) -> list[str]:
    """Scripts and styles of the book's own that are not there."""
    return [
        f"file is missing: {tag[attribute]}"
        for kind, attribute in _OWN_FILES
        for tag in _with(tags, attribute, kind)
        if (kind == "script" or _LOADING_LINKS & set(tag.get("rel", [])))
        and not _is_external(tag[attribute])
        and _scheme(tag[attribute]) != "data"
        and not _is_file(_target(tag[attribute], page, root))
    ]


def _images(tags: list[Tag], page: Path, root: Path) -> list[str]:
    found = []
    for image in (tag for tag in tags if tag.name == "img"):
        source, alt = image.get("src", ""), (image.get("alt") or "").strip()
        if not alt or alt.lower().endswith(_PICTURES):
            found.append(f"image without alt text: {source[-60:]}")
        elsewhere = _is_external(source) or _scheme(source) == "data"
        if not elsewhere and not (source and _is_file(_target(source, page, root))):
            found.append(f"image file is missing: {source}")
    return found


def _links(tags: list[Tag], page: Path, root: Path, anchors: dict[Path, set[str]]) -> list[str]:
    if page.name in _UNCHECKED:
        return []
    found = []
    for link in _with(tags, "href", "a", "area"):
        href = link["href"]
        if _is_external(href) or href in ("#", "") or _scheme(href) in _NO_LINKS:
            continue
        target = _target(href, page, root)
        if target is not None and target.is_dir():
            target = target / "index.html"
        fragment = unquote(href.partition("#")[2])
        if not _is_file(target):
            found.append(f"dead link: {href}{_label(link)}")
        elif fragment and target in anchors and fragment not in anchors[target]:
            found.append(f"dead anchor: {href}{_label(link)}")
    return found


def _target(href: str, page: Path, root: Path) -> Path | None:
    """The file in the book that a relative address means; None when it can mean none."""
    try:
        parts = urlsplit(href)
        path = (page.parent / unquote(parts.path)).resolve() if parts.path else page
        path.exists()  # a name that no file can have raises here
    except (ValueError, OSError):
        return None
    return path if not parts.scheme and path.is_relative_to(root) else None


def _is_file(path: Path | None) -> bool:
    return path is not None and path.is_file()


def _label(link: Tag) -> str:
    text = link.get_text().strip()
    return f" ({text[:40]!r})" if text else ""


def _scheme(address: str) -> str:
    return address.partition(":")[0].lower() if ":" in address else ""


def _is_external(address: str) -> bool:
    return address.startswith("//") or _scheme(address) in ("http", "https", "ftp")
