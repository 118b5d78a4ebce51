"""What the landing page shows of the ledger: the verdicts on each paper as a strip."""

from __future__ import annotations

import tomllib
from collections import Counter
from pathlib import Path

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
        ``verdicts__fragments`` for both fragments, and ``project__version``.
    """
    found = {"project__version": _version(root)}
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


def _version(root: Path) -> str:
    return tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
