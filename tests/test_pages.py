"""What a reader sees of the pages: equations that fit, one notation, names, colours, pictures."""

import importlib
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml

from bookkit import access, claims_page, equations, plots, strips
from bookkit.numbers import recorded
from bookkit.pictures import LETTERS, WIDTH, pictures

ROOT = Path(__file__).resolve().parents[1]
STYLED = sorted(
    page
    for page in [*ROOT.glob("book/*.md"), *ROOT.glob("notebooks/*.md")]
    if page.stem not in ("claims", "where")
)
"""Pages that keep to the notation of `book/notation.md` and to its widths."""

PHONE = 358
"""Pixels that a page has for a picture on a phone of 390."""
SMALLEST = 9
"""Pixels of the smallest letters that are still read there."""

FORBIDDEN = {
    "transpose": r"\^\{?T\}?(?![A-Za-z])",
    "expectation": r"\\mathsf\s*\{?E|(?<![A-Za-z])M\[|(?<!\\mathrm )(?<!\\mathrm\{)\bE\[",
    "a value in an equation": r"\{\{",
}
"""What does not stand in an equation of a page."""
ABBREVIATION = re.compile(r"\b(FBP|FKP|AOF|FNA|FMP|OFK|FKB)\b")


def prose(text):
    """A page's text without its code; of a code cell the caption and the alternative text stay."""
    text = re.sub(r"^```\{code-cell\}.*?^```$", _said, text, flags=re.M | re.S)
    text = re.sub(r"^```(?!\{math\}|\{admonition\}).*?^```$", "", text, flags=re.M | re.S)
    return re.sub(r"(?<!`)`[^`\n]+`(?!`)", "", text)


def _said(cell):
    header = re.match(r"```\{code-cell\}[^\n]*\n---\n(.*?)\n---\n", cell[0], re.S)
    return header[1] if header else ""


def mathematics(text):
    """Equations of a text, in lines and displayed."""
    shown = [tex for tex, _ in equations.displays(text)]
    inline = re.sub(r"\$\$.*?\$\$", "", text, flags=re.S)
    return shown + re.findall(r"(?<![\\$])\$([^$\n]+(?:\n[^$\n]+)?)\$", inline)


def notation_faults(text):
    """Forbidden signs in the equations of a page, and abbreviations of filters in its prose."""
    said = prose(text)
    found = [
        f"{name}: {tex[:60]}"
        for tex in mathematics(said)
        for name, pattern in FORBIDDEN.items()
        if re.search(pattern, tex)
    ]
    return found + ABBREVIATION.findall(said)


def wide_displays(text):
    """Equations of a page that are estimated wider than its column."""
    return [tex for tex, room in equations.displays(text) if equations.width(tex) > room]


@pytest.mark.parametrize("page", STYLED, ids=lambda path: path.stem)
def test_equations_fit_into_the_column(page):
    assert wide_displays(page.read_text()) == []


@pytest.mark.parametrize("page", STYLED, ids=lambda path: path.stem)
def test_pages_keep_to_the_notation(page):
    found = notation_faults(page.read_text())
    if page.stem == "glossary" or page.stem.startswith("errata"):
        found = [entry for entry in found if not ABBREVIATION.fullmatch(entry)]
    assert found == []


# Ems of equations of the book as Chromium showed them with MathJax, 16 pixels to the em.
MEASURED = {
    r"z = \tfrac m2 x_3^2 + \tfrac I2 \dot x_2^2 .": 7.2,
    r"P_k = (I-K_kC_k)(P'_k - T) + \sum_i\sum_{j\ne i}L_{k,i}C_{k-i}P'_{k,i,j}"
    r"C_{k-j}^{\mathsf T}L_{k,j}^{\mathsf T} .": 25.1,
    r"X_{k+1}=F_iX_k+c_i+s_i\,g\,V_k,\qquad Y_k=X_{k,1}+r_iW_k,\qquad i=I_k ,": 26.0,
    r"x_i' = (x_{i+1} - x_{i-2})\,x_{i-1} - x_i + 8, \qquad i = 1, \dots, 10 \pmod{10}.": 26.9,
    r"\Phi^+(t) = G_0\,\Phi^-(t) + G_1\,\Phi^-(\omega t) + G_2\,\Phi^-(\omega^2 t) + g(t)": 22.4,
}
CUT_OFF = (
    r"dp = v\,dt, \qquad dv = \sqrt{.1}\;dW, \qquad Y_{k,i} = \operatorname{atan2}(p_y - b_i,\ "
    r"p_x - a_i) + V_{k,i}, \qquad (p, v) \sim N((0, 0, 1, 0), I),"
)
"""As wide as 47 ems: a page once showed two thirds of it."""


@pytest.mark.parametrize("tex", MEASURED)
def test_the_estimate_of_a_width_is_that_of_the_browser(tex):
    assert equations.width(tex) == pytest.approx(MEASURED[tex], rel=0.09)


def test_an_equation_that_was_cut_off_is_seen():
    wide = CUT_OFF
    page = f"Text.\n\n```{{math}}\n:label: x\n{wide}\n```\n\n$$\nx = y\n$$\n\n$${wide}$$ (name)\n"
    assert wide_displays(page) == [wide, wide]
    halves = wide.replace(r"\qquad Y", r"\\ Y")
    assert wide_displays(f"$$\n\\begin{{gathered}}{halves}\\end{{gathered}}\n$$") == []


@pytest.mark.parametrize(
    "fault",
    [
        "$x^T y$", "$x^{T}y$", r"$\mathsf E x$", r"$\mathsf{E}[x]$", "$M[x]$", "$E[x]$", "the FBP",
        "$$\nE[x]\n$$", "$a = {{ b }}$", "```{math}\nA^T\n```",
        "```{code-cell} ipython3\n---\nmystnb:\n  figure:\n    caption: The FNA.\n---\nx = 1\n```",
    ],
)  # fmt: skip
def test_forbidden_notation_is_seen(fault):
    assert notation_faults(f"Words.\n\n{fault}\n\nWords.") != []


def test_what_only_looks_forbidden_is_not():
    fine = r"$x^{\mathsf T}$, $\mathrm E[x]$, `FBP`, $x_{T}$, $\mathrm{E}[x]$, {{ a }}"
    assert notation_faults(fine + "\n\n```{code-cell} ipython3\nFNA = x**T\n```\n") == []


# Linear red, green, blue as people without red or green cones see them: Machado, Oliveira and
# Fernandes (2009), severity 1.
SEEN = {
    "all cones": "1 0 0  0 1 0  0 0 1",
    "protanopia": """0.152286 1.052583 -0.204868  0.114503 0.786281 0.099216
        -0.003882 -0.048116 1.051998""",
    "deuteranopia": """0.367322 0.860646 -0.227968  0.280085 0.672501 0.047413
        -0.011820 0.042940 0.968881""",
}
SEEN = {eye: np.array(row.split(), float).reshape(3, 3) for eye, row in SEEN.items()}
TO_XYZ = """0.4124564 0.3575761 0.1804375  0.2126729 0.7151522 0.0721750
    0.0193339 0.1191920 0.9503041"""
TO_XYZ = np.array(TO_XYZ.split(), float).reshape(3, 3)


def linear(colours):
    """Linear red, green and blue of colours in hexadecimal, a row each."""
    shown = np.array([[int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)] for c in colours])
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def nearest(colours, seen):
    """Smallest distance of two of the colours in CIE Lab."""
    xyz = np.clip(linear(colours) @ seen.T, 0, 1) @ TO_XYZ.T / TO_XYZ.sum(1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    lab = np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], 1)
    apart = np.linalg.norm(lab[:, None] - lab[None], axis=2)
    return apart[np.triu_indices(len(colours), 1)].min()


def contrast(colours, ground="#ffffff"):
    """Contrast of each of the colours with the ground, as WCAG defines it."""
    light = linear([*colours, ground]) @ TO_XYZ[1]
    high, low = np.maximum(light[:-1], light[-1]), np.minimum(light[:-1], light[-1])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("eye", SEEN)
def test_colours_of_figures_are_told_apart(eye):
    assert nearest(plots.COLOURS, SEEN[eye]) >= 25
    assert contrast(plots.COLOURS).min() >= 3


def test_colours_that_are_too_near_are_seen():
    assert nearest(["#d62728", "#2ca02c"], SEEN["all cones"]) > 100
    assert nearest(["#d62728", "#8c7a00"], SEEN["deuteranopia"]) < 25
    assert contrast(["#f0e442"]) < 3


DRAWN = sorted((ROOT / "book" / "_static").glob("*.svg"))


def smallest_letters(svg):
    """Pixels of a diagram's smallest letters on a phone."""
    width = float(re.search(r'viewBox="\S+ \S+ (\S+) ', svg)[1])
    return min(map(float, re.findall(r'font-size="([\d.]+)"', svg))) * PHONE / width


@pytest.mark.parametrize("path", DRAWN, ids=lambda path: path.stem)
def test_diagrams_are_told_in_words_and_read_on_a_phone(path):
    svg = path.read_text()
    title, told = (
        re.search(r"<title[^>]*>(.*?)</title>", svg)[1],
        re.search(r"<desc.*?>(.*?)<", svg)[1],
    )
    assert len(title) > 10
    assert len(told) > 60
    assert smallest_letters(svg) >= SMALLEST
    assert smallest_letters(svg.replace("0 0 420", "0 0 760")) < SMALLEST


def test_small_pictures_are_told_in_words_and_read_on_a_phone():
    drawn = pictures(ROOT, recorded(ROOT))
    assert LETTERS * (PHONE - 32) / WIDTH >= SMALLEST  # a card has a margin
    for name, svg in drawn.items():
        assert len(re.search(r'aria-label="([^"]*)"', svg)[1]) > 20, name
        for x, anchor, told in re.findall(r'<text x="([-\d.]+)".*?anchor="(\w+)".*?>(.*?)<', svg):
            wide = 0.56 * LETTERS * len(told)
            left = float(x) - {"start": 0, "middle": wide / 2, "end": wide}[anchor]
            assert left > -6, (name, told)
            assert left + wide < float(re.search(r'viewBox="0 0 (\d+)', svg)[1]) + 6, (name, told)


def test_names_in_the_glossary_are_those_of_the_library():
    rooms = ("filters", "designed", "design", "linearization", "two_step", "delay", "zoo", "extra")
    known = {name for room in rooms for name in importlib.import_module(f"seedslib.{room}").__all__}
    text = (ROOT / "book" / "glossary.md").read_text()
    named = set(re.findall(r"(?<!\})`([A-Za-z_]+)(?:\([^`]*\))?`", text))
    assert named - known == {"mse"}


def test_the_citation_has_the_version_of_the_project():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    told = strips.project(ROOT)
    assert told["project__version"] == version
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", told["project__date"])
    assert f"version = {{{version}}}" in told["project__bibtex"]


def test_references_have_what_a_reader_needs():
    text = (ROOT / "book" / "references.bib").read_text()
    entries = re.findall(r"@(\w+)\{(\w+),\n(.*?)\n\}", text, re.S)
    keys = [key for _, key, _ in entries]
    assert len(keys) == len(set(keys)) >= 40
    for kind, key, fields in entries:
        wanted = {"article": ("journal", "year"), "book": ("publisher", "year")}.get(
            kind, ("year",)
        )
        for field in ("author", "title", *wanted):
            assert re.search(rf"^  {field}\s*= ", fields, re.M), (key, field)


def test_what_the_theme_leaves_unsaid_is_said():
    page = (
        '<summary><span class="toctree-toggle"></span></summary>'
        '<button class="btn search-button-field x" title="Search" aria-label="Search">'
        '<button class="btn search-button" aria-label="Search">'
        '<summary aria-label="Toggle hidden content"><p>Show the code</p></summary>'
    )
    mended = access.mend(page)
    assert '<summary aria-label="Pages of this chapter">' in mended
    assert mended.count('aria-label="Search"') == 1
    assert "Toggle hidden content" not in mended


def test_a_box_leads_to_its_row_and_a_row_to_its_box():
    box = '<div class="claim open" id="TS-E7"><b>TS-E7</b> open</div>'
    assert '<b><a href="../book/claims.html#TS-E7">TS-E7</a></b>' in claims_page.linked(box)
    page = claims_page.page(ROOT)
    rows = re.findall(r'<tr id="([\w-]+)" data-verdict="(\w+)"><td><a href="[^"]+#([\w-]+)">', page)
    assert len(rows) == len(set(rows)) == page.count("data-verdict") > 150
    assert [row for row, _, box in rows if row != box] == []
    assert [row for row, *_ in rows if f"{{index}}`{row}`" not in page] == []  # found by a search


def test_the_contents_name_every_page_once():
    toc = (ROOT / "_toc.yml").read_text()
    files = re.findall(r"file: (\S+)", toc)
    assert len(files) == len(set(files))
    pages = {f"book/{path.stem}" for path in (ROOT / "book").glob("*.md")}
    assert pages - set(files) - {yaml.safe_load(toc)["root"]} == set()
