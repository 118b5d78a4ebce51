"""What the pages of the book take from the notebooks and the ledger; an extension of Sphinx.

Recorded numbers are substitutions in the text of any page, ``{{ '%.3f' % notebook__name }}``, the
entries of a list ``notebook__name_0`` and so on. So are the counts of verdicts on a paper. The
claims page is written when the build begins.
"""

from __future__ import annotations

import base64
import html
import json
import re
import struct
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml
from bs4 import BeautifulSoup
from docutils import nodes

from bookkit.claims import LEDGER, ORIGINS, PAPERS, PROOFS, VERDICTS, Claim, read_ledger
from bookkit.recording import MIME, claim_html, columns, read_notebooks, read_verdicts

CONCORDANCE = "book/concordance.yml"


def substitutions(root: Path) -> dict[str, Any]:
    """Every recorded value, the verdicts by paper, and version and date of the project."""
    cited = yaml.safe_load((root / "CITATION.cff").read_text())
    result = {"project__version": cited["version"], "project__date": str(cited["date-released"])}
    for stem, records in read_notebooks(root).items():
        result |= {f"{stem}__{name}": value for name, value in columns(records.values).items()}
    claims = read_ledger(root / LEDGER)
    for group in [*PAPERS, "fragments"]:
        papers = ("compromise", "riemann") if group == "fragments" else (group,)
        own = [claim for claim in claims if claim.paper in papers]
        name = group.replace("-", "_")
        result[f"verdicts__{name}"] = paper_counts(own)
        result[f"findings__{name}"] = counts(c for c in own if c.origin == "ours")
        result[f"errata__{name}"] = errata(own)
    return result


def counts(claims: Iterable[Claim]) -> str:
    """How many claims have each verdict, such as "1 refuted, 12 reproduced"."""
    number = Counter(claim.verdict for claim in claims)
    return ", ".join(f"{number[verdict]} {verdict}" for verdict in VERDICTS if number[verdict])


def paper_counts(claims: Iterable[Claim]) -> str:
    """The verdicts on what a paper says, and apart from them on what it only implies."""
    claims = list(claims)
    said = counts(c for c in claims if c.origin in ("stated", "restored"))
    implied = counts(c for c in claims if c.origin == "implied")
    return f"{said}; of what it only implies {implied}" if implied else said


def errata(claims: Iterable[Claim]) -> str:
    """What a paper says that is not reproduced, as a table in MyST text."""
    lines = ["| place | the paper says | verdict |", "|---|---|---|"]
    for claim in claims:
        if claim.origin != "ours" and claim.verdict != "reproduced":
            said = " ".join(claim.statement.split()).replace("|", r"\|")
            if claim.corrected_formula:
                said += f" Right: {claim.corrected_formula}.".replace("|", r"\|")
            link = (
                f'<a href="../{claim.notebook.removesuffix(".md")}.html#{claim.id}">{claim.id}</a>'
            )
            lines.append(f"| {claim.place} | {said} | {claim.verdict}, {link} |")
    return "\n".join(lines)


def claims_page(root: Path) -> str:
    """The claims page, as MyST text: the papers' claims first and ours apart."""
    claims, recorded = read_ledger(root / LEDGER), read_verdicts(root)
    theirs = [claim for claim in claims if claim.origin != "ours"]
    ours = [claim for claim in claims if claim.origin == "ours"]
    said = [claim for claim in theirs if claim.origin != "implied"]
    implied = [claim for claim in theirs if claim.origin == "implied"]
    origins = Counter(claim.origin for claim in theirs)
    lines = [
        "# Claims",
        "",
        f"The papers make {len(said)} claims: {counts(said)}. {len(implied)} more follow from them",
        f"without standing there: {counts(implied) or 'none'}. {len(ours)} findings of our own",
        f"are listed apart: {counts(ours)}. Each verdict is computed by the notebook it links to,",
        "which also says which planted faults would change it. The verdicts are explained in",
        r"[](#verdicts), the symbols ($\hat x$, $P$) in [](notation.md).",
        "",
        "Of the papers' claims "
        + "; ".join(f"{n} are *{word}* ({ORIGINS[word]})" for word, n in origins.items())
        + ".",
        "",
        "The tables say what carries each verdict.",
        "",
        "| proved by | what it means | of the papers | ours |",
        "|---|---|---|---|",
    ]
    for word, meaning in PROOFS.items():
        numbers = [sum(c.proved == word for c in group) for group in (theirs, ours)]
        if any(numbers):
            lines.append(f"| {word} | {meaning} | {numbers[0]} | {numbers[1]} |")
    for title, chosen in (("What the papers claim", theirs), ("What we found ourselves", ours)):
        lines += ["", f"## {title}"]
        for key, name in PAPERS.items():
            own = sorted(
                (claim for claim in chosen if claim.paper == key),
                key=lambda claim: VERDICTS.index(claim.verdict),
            )
            if own:
                lines += ["", f"### {name}{': ours' if chosen is ours else ''}", ""]
                lines += ["| place | claim | verdict | proved by |", "|---|---|---|---|"]
                lines += [_row(claim) for claim in own]
                lines += ["", "```{raw} html", *(_box(claim, recorded) for claim in own), "```"]
            if chosen is theirs:
                lines += concordance(root, key)
    return "\n".join(lines) + "\n"


def concordance(root: Path, paper: str) -> list[str]:
    """Lines of a paper's surviving text beside our reading of them, folded, as MyST text."""
    rows = [r for r in yaml.safe_load((root / CONCORDANCE).read_text()) if r["paper"] == paper]
    if not rows:
        return []
    lines = ["", ":::{dropdown} What the scan has, and how we read it"]
    for row in rows:
        named = f" ({', '.join(row['claims'])})" if "claims" in row else ""
        lines += [f"- {row['place']}{named}: ``{row['line']}``", "", f"  ${row['reading']}$", ""]
    return [*lines, ":::"]


def _row(claim: Claim) -> str:
    """Where a claim stands in its paper, its verdict, and what carries it; for the search too."""
    caveat = " under one reading" if claim.readings == "one" and claim.verdict != "open" else ""
    index = f"{{index}}`{claim.id}`"
    return f"| {claim.place} | {index} | {claim.verdict}{caveat} | {claim.proved} |"


def _box(claim: Claim, recorded: dict[str, dict[str, dict]]) -> str:
    """The box of a claim as its notebook shows it, with a link to it there."""
    page = claim.notebook.removesuffix(".md")
    link = f'<a href="../{page}.html#{claim.id}">{page.partition("/")[2]}</a>'
    box = claim_html(claim.id, recorded[claim.id][claim.notebook])
    return box.removesuffix("</p></details>") + f" ({link})</p></details>"


def as_shown(notebook: dict) -> dict:
    """A notebook as its page shows it: without the printed records, figures at their own size."""
    for cell in notebook["cells"]:
        outputs = []
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:  # two dots of a picture are one of the page
                width = struct.unpack(">I", base64.b64decode(data["image/png"][:32])[16:20])[0]
                options = cell["metadata"].setdefault("mystnb", {})
                options.setdefault("image", {}).setdefault("width", f"{width // 2}px")
            if MIME not in data or "text/html" in data:  # the badge of a claim stays
                outputs.append(output)
        if "outputs" in cell:
            cell["outputs"] = outputs
    return notebook


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    root = Path(app.srcdir)
    (root / "book" / "claims.md").write_text(claims_page(root))
    app.config.myst_substitutions = substitutions(root)
    app.connect("source-read", _read_source)
    app.connect("doctree-resolved", _mark_sentences)
    app.connect("html-page-context", _page, priority=900)  # after the theme has made the sidebar
    app.connect("build-finished", _write_texts)
    app.connect("autodoc-process-docstring", _literal_stars, priority=100)
    app.connect("autodoc-skip-member", _skip_foreign)
    return {"parallel_read_safe": True}


def _read_source(app: Any, docname: str, source: list[str]) -> None:
    if str(app.env.doc2path(docname)).endswith(".ipynb"):
        source[0] = json.dumps(as_shown(json.loads(source[0])))


def _mark_sentences(app: Any, doctree: nodes.document, docname: str) -> None:
    """Printed sentences are broken as text is; printed tables keep their lines."""
    for block in doctree.findall(nodes.literal_block):
        rows = [line.strip() for line in block.astext().splitlines()]
        long = any(len(row) > 60 and "  " not in row for row in rows)
        if block.get("language") == "myst-ansi" and long and sum("  " in row for row in rows) < 2:
            block["classes"].append("sentences")


def _page(app: Any, pagename: str, template: str, context: dict, doctree: Any) -> None:
    """The sidebar of the part that a page is in, and what says of it what it is."""
    sidebar = context.get("generate_toctree_html")
    if sidebar is not None:
        context["generate_toctree_html"] = lambda *a, **k: _of_this_part(sidebar(*a, **k))
    if pagename == "search":
        for name in ("texts.js", "search.js"):
            app.add_js_file(name, priority=100)
    if doctree is None:
        return
    first = next((p.astext() for p in doctree.findall(nodes.paragraph) if len(p.astext()) > 60), "")
    said = html.escape(" ".join(first.split())[:200], quote=True)
    title = html.escape(re.sub("<[^>]+>", "", context["title"]), quote=True)
    context["metatags"] = context.get("metatags", "") + "".join(
        f'<meta {kind}="{name}" content="{value}">'
        for kind, name, value in (
            ("name", "description", said),
            ("property", "og:title", title),
            ("property", "og:description", said),
            ("property", "og:image", context["pathto"]("_static/flip_run.png", resource=True)),
        )
    )


def _of_this_part(sidebar: str) -> Any:
    """A sidebar with the pages of one part; of the others it has a link to the first page.

    The parts of the contents but the last two are the book; those are the record and the library.
    """
    soup = BeautifulSoup(str(sidebar), "html.parser")
    captions = soup.find_all("p", class_="caption")
    lists = [caption.find_next_sibling("ul") for caption in captions]
    where = next((i for i, ul in enumerate(lists) if ul.find(class_="current")), 0)
    book = range(len(captions) - 2)
    for i, (caption, pages) in enumerate(zip(captions, lists, strict=True)):
        if i == where or (i in book and where in book):
            continue
        link = pages.find("a")
        if i in book and i > 0:
            caption.decompose()
        else:
            link.string = "A Few Numbers" if i == 0 else caption.get_text()
            caption.clear()
            caption.append(link.extract())
        pages.decompose()
    return soup


WEIGHTS = {"book/api": 0.6, "book/claims": 0.2, "book/errata": 0.3, "notebooks": 0.4}
"""How much a page counts in the search by the beginning of its name; a chapter counts one."""


def texts(folder: Path, pages: Iterable[str], contents: Any) -> dict[str, dict[str, Any]]:
    """Text and weight of built pages for the search, by their names."""
    chapters = {c["file"] for part in contents["parts"][:-2] for c in part["chapters"]}
    result = {}
    for name in pages:
        built = (folder / f"{name}.html").read_text()
        body = re.search(r'(?s)<article class="bd-article">(.*?)</article>', built)[1]
        bare = re.sub(r"(?s)<(script|style|svg|pre).*?</\1>|<[^>]+>", " ", body)
        text = re.sub(r"\\[()]|¶|#(?=\s)", "", html.unescape(bare))
        known = (weight for part, weight in WEIGHTS.items() if name.startswith(part))
        weight = 1.0 if name in chapters else next(known, 0.7)
        result[name] = {"text": " ".join(text.split()), "weight": weight}
    return result


def _write_texts(app: Any, exception: Exception | None) -> None:
    """All pages that there are, not those alone that were written again."""
    if exception is None and app.builder.format == "html":
        contents = yaml.safe_load((Path(app.srcdir) / "_toc.yml").read_text())
        found = texts(Path(app.outdir), sorted(app.env.found_docs), contents)
        text = "const TEXTS = " + json.dumps(found, ensure_ascii=False) + ";\n"
        (Path(app.outdir) / "_static" / "texts.js").write_text(text)


def _literal_stars(app, what, name, thing, options, lines: list[str]) -> None:
    """A star before a word, as in ``*batch``, is no emphasis."""
    lines[:] = [re.sub(r"(?<![*\\])\*(?=\w)(?!\w+\*)", r"\\*", line) for line in lines]


def _skip_foreign(app, what, name, thing, skip, options) -> bool | None:
    """Leave out what a class has from Python, such as the methods of an exception or a tuple."""
    parts = (getattr(thing, part, None) for part in ("fget", "func", "__func__"))
    module = getattr(next(filter(None, parts), thing), "__module__", None) or ""
    return True if what in ("class", "exception") and not module.startswith("seedslib") else None
