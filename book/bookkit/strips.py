"""What pages show of the ledger and of the project: strips of verdicts, version, date, citation."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import yaml

from bookkit.claims import LEDGER, PAPERS, VERDICTS, read_ledger

FRAGMENTS = ("compromise", "riemann")


def strips(root: Path) -> dict[str, str]:
    """HTML of the verdicts on what each paper says, and on what we found, by paper.

    Parameters
    ----------
    root : Path
        The project's folder.

    Returns
    -------
    dict of str to str
        ``verdicts__two_step`` and so on for the papers' claims, ``findings__two_step`` for ours,
        ``verdicts__fragments`` for both fragments, and ``project__version``, ``project__date``,
        ``project__licence`` and ``project__bibtex``.
    """
    found = project(root)
    claims = read_ledger(root / LEDGER)
    groups = {paper: (paper,) for paper in PAPERS} | {"fragments": FRAGMENTS}
    for group, papers in groups.items():
        for kind, ours in (("verdicts", False), ("findings", True)):
            counts = Counter(
                claim.verdict
                for claim in claims
                if claim.paper in papers and (claim.origin == "ours") == ours
            )
            found[f"{kind}__{group.replace('-', '_')}"] = strip(counts)
    return found


def strip(counts: Counter[str]) -> str:
    """One strip: a bar with a piece a verdict, as wide as it is frequent, and the words below."""
    words = [word for word in VERDICTS if counts[word]]
    bar = "".join(f'<span class="{w}" style="flex-grow:{counts[w]}"></span>' for w in words)
    told = " ".join(f'<span class="{w}">{counts[w]} {w}</span>' for w in words)
    return f'<span class="strip"><span class="bar">{bar}</span>{told}</span>'


def project(root: Path) -> dict[str, str]:
    """Version, date, licence and citation of the project, as `CITATION.cff` has them.

    The date is the version's and not that of the build, so that a book built again is the same.
    """
    cited = yaml.safe_load((root / "CITATION.cff").read_text())
    authors = " and ".join(f"{{{author['name']}}}" for author in cited["authors"])
    date = str(cited["date-released"])
    fields = {
        "author": authors,
        "title": f"{{{cited['title']}}}",
        "year": date[:4],
        "version": cited["version"],
        "note": f"{cited['license']} licence",
    }
    lines = [f"  {key:<7} = {{{value}}}," for key, value in fields.items()]
    return {
        "project__version": cited["version"],
        "project__date": date,
        "project__licence": cited["license"],
        "project__bibtex": "\n".join(["```bibtex", "@software{seedslib,", *lines, "}", "```"]),
    }
