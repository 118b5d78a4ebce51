"""How wide a displayed equation will be, without a browser: an estimate from its TeX.

Each sign has the width that MathJax gives it, in ems. Against Chromium the estimate is within a
tenth for the equations of the book; what is missing is named in `COMMANDS`, and an unknown command
counts as one letter.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

COLUMN, NUMBERED = 36.5, 33.3
"""Ems that a display has on a page, and one with a number: 757 and 691 pixels at 20.4 an em, less a
fiftieth, by which the estimate is too small on average."""

SCRIPT = 0.707


def _signs(table: str) -> dict[str, float]:
    """Widths by sign, from lines of a width and the signs that have it."""
    lines = (line.split() for line in table.strip().splitlines())
    return {sign: float(width) for width, *signs in lines for sign in signs}


LETTERS = _signs("""
0.28 [ ] | ! . '
0.37 i j l f t
0.39 ( )
0.45 r s , ;
0.5 a b c d e g h k n o p q u v x y z 0 1 2 3 4 5 6 7 8 9 /
0.57 I J S T V Y
0.74 A B C D E F G H K L N O P Q R U X Z w
0.83 :
0.9 m
0.95 M W
1.22 + - * −
1.33 = < >
0.25 ~
""")
COMMANDS = _signs("""
-0.17 !
0.17 ,
0.22 :
0.28 ; | vert lvert rvert vdots prime
0.36 varsigma
0.4 langle rangle ell lfloor rfloor dagger colon
0.5 { } Vert lVert rVert | lambda beta gamma delta epsilon varepsilon zeta eta theta kappa nu xi
0.5 rho tau iota psi varrho partial
0.6 mu pi sigma alpha phi varphi chi upsilon omega forall
0.74 Phi Psi Sigma Gamma Delta Lambda Omega Theta Pi Xi Upsilon cdot top int
0.83 mid nabla %
1.0 quad infty circ setminus ln
1.17 dots ldots cap cup
1.28 le ge ne leq geq neq approx sim propto in equiv subset
1.3 times pm mp oplus otimes cdots iint
1.42 Pr inf sin det log prod
1.56 to mapsto Rightarrow rightarrow cos tan sup arg dim lim gg ll exp sum
1.9 min sinh
2.05 max cosh tanh qquad
2.9 arctan pmod
""")
COMMANDS[" "] = 0.25
"""Widths of commands in ems, with the space that stands around them."""

_SPACES = _signs("""
0 displaystyle textstyle big Big biggl biggr middle limits nolimits mathstrut notag nonumber strut
0.07 bigl bigr
0.1 left right
0.2 Bigl Bigr
""")
_OVER = _signs("0 hat bar tilde dot ddot vec widehat widetilde overline underline check")
_STACKED = _signs("0 sum prod min max lim sup inf bigcup bigcap")
_FONTS = _signs("""
0.48 text textrm textit operatorname
0.5 mathrm mathsf mathit
0.6 mathbf boldsymbol
0.75 mathcal mathbb
""")
_TOKENS = re.compile(r"\\([A-Za-z]+\*?|.)|([{}^_&])|(\s+)|(.)", re.DOTALL)
_GRIDS = ("aligned", "align", "split", "cases", "matrix", "array", "gather", "gathered")


def width(tex: str) -> float:
    """Estimated width of a displayed equation in ems; of one in several lines, of the widest."""
    tex = re.sub(
        r"\\(label|tag)\{[^}]*\}|(?<!\\)%.*|\\\\\[[^\]]*\]",
        lambda m: "\\\\" * ("\\\\" in m[0]),
        tex,
    )
    return _width(list(_tokens(tex)))


def displays(text: str) -> Iterator[tuple[str, float]]:
    """Displayed equations of a page in MyST, each with the ems that it has.

    They stand between double dollar signs or in a directive; one with a label is numbered.
    """
    pattern = r"\$\$(?!\$)(.*?)\$\$( *\([\w-]+\))?|^[`:]{3,}\{math\}\n(.*?)\n[`:]{3,}"
    for match in re.finditer(pattern, text, re.M | re.S):
        lines = (match[1] or match[3] or "").splitlines()
        labelled = bool(match[2]) or any(line.startswith(":label:") for line in lines)
        tex = "\n".join(line for line in lines if not re.match(r":\w+:", line)).strip()
        yield tex, NUMBERED if labelled or r"\label" in tex else COLUMN


def _tokens(tex: str) -> Iterator[str]:
    for match in _TOKENS.finditer(tex):
        if match[1]:
            yield "\\" + match[1]
        elif not match[3]:
            yield match[2] or match[4]


def _group(tokens: list[str], at: int) -> tuple[list[str], int]:
    """The argument that begins at a place, and the place behind it."""
    if at >= len(tokens) or tokens[at] != "{":
        return tokens[at : at + 1], at + 1
    depth = 0
    for end in range(at, len(tokens)):
        depth += (tokens[end] == "{") - (tokens[end] == "}")
        if depth == 0:
            return tokens[at + 1 : end], end + 1
    return tokens[at + 1 :], len(tokens)


def _environment(tokens: list[str], at: int) -> tuple[str, list[str], int]:
    """Name and inside of an environment that begins at a place, and the place behind it."""
    name, start = _group(tokens, at + 1)
    depth = 0
    for end in range(at, len(tokens)):
        depth += (tokens[end] == r"\begin") - (tokens[end] == r"\end")
        if depth == 0:
            return "".join(name), tokens[start:end], _group(tokens, end + 1)[1]
    return "".join(name), tokens[start:], len(tokens)


def _grid(name: str, tokens: list[str]) -> float:
    """Width of rows and columns."""
    if name == "array" and tokens[:1] == ["{"]:
        tokens = tokens[_group(tokens, 0)[1] :]
    rows: list[list[list[str]]] = [[[]]]
    depth = 0
    for token in tokens:
        depth += (token in ("{", r"\begin")) - (token in ("}", r"\end"))
        if depth == 0 and token == r"\\":
            rows.append([[]])
        elif depth == 0 and token == "&":
            rows[-1].append([])
        else:
            rows[-1][-1].append(token)
    columns = max(map(len, rows))
    widths = [
        max(
            (_width(row[k]) for row in rows if (k < len(row) and len(row) > 1) or columns == 1),
            default=0,
        )
        for k in range(columns)
    ]
    alone = max((_width(row[0]) for row in rows if len(row) == 1), default=0) if columns > 1 else 0
    gap = 1.0 if "matrix" in name or name in ("cases", "array") else 0.0
    pairs = 0.0 if gap else 2.0 * max(0, (columns - 1) // 2)
    fence = {"pmatrix": 1.5, "bmatrix": 1.1, "vmatrix": 0.7, "cases": 0.9}.get(name, 0.0)
    return max(sum(widths) + gap * (columns - 1) + pairs, alone) + fence


def _width(tokens: list[str], *, script: bool = False) -> float:
    """Width of one line of tokens; in a script no space stands around operators."""
    at, total, base = 0, 0.0, ""
    while at < len(tokens):
        token = tokens[at]
        at += 1
        if token in "^_":
            scripts = 0.0
            at -= 1
            while at < len(tokens) and tokens[at] in "^_":
                inside, at = _group(tokens, at + 1)
                scripts = max(scripts, SCRIPT * _width(inside, script=True))
            total += max(0.0, scripts - COMMANDS[base]) if base in _STACKED else scripts + 0.05
            continue
        name = token[1:] if token.startswith("\\") else ""
        base = name
        if token == "{":
            inside, at = _group(tokens, at - 1)
            total += _width(inside)
        elif name == "begin":
            kind, inside, at = _environment(tokens, at - 1)
            grid = kind.rstrip("*").endswith(_GRIDS)
            total += _grid(kind.rstrip("*"), inside) if grid else _width(inside)
        elif name in ("frac", "dfrac", "tfrac", "binom"):
            above, at = _group(tokens, at)
            below, at = _group(tokens, at)
            scale = SCRIPT if name == "tfrac" else 1.0
            total += scale * max(_width(above), _width(below)) + 0.24
        elif name == "sqrt":
            inside, at = _group(tokens, at)
            total += _width(inside) + 0.9
        elif name in ("underbrace", "overbrace", "phantom", "boxed", *_OVER):
            inside, at = _group(tokens, at)
            total += _width(inside)
        elif name.rstrip("*") in _FONTS:
            inside, at = _group(tokens, at)
            letters = sum(1 for sign in inside if len(sign) == 1)
            total += _FONTS[name.rstrip("*")] * letters + 0.17 * name.startswith("operatorname")
        elif name in _SPACES:
            total += _SPACES[name]
        elif name:
            total += COMMANDS.get(name, 0.6)
        elif token not in "{}&":
            wide = LETTERS.get(token, 0.5)
            total += min(wide, 0.78) if script else wide
    return total
