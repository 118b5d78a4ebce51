"""The words of verdicts can be read in both themes, on their panels and on the landing page."""

import re
from pathlib import Path

import pytest

CSS = (Path(__file__).resolve().parents[2] / "book" / "_static" / "claims.css").read_text()
WORDS = ("reproduced", "checked", "corrected", "refuted", "open", "book-ink", "book-quiet")


def colours(selector):
    block = CSS.split(selector + " {", 1)[1].split("}")[0]
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block))


def luminance(colour):
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


def test_contrast_is_that_of_known_pairs():
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize(
    ("selector", "grounds"),
    [
        (":root", ["#ffffff"]),
        # the theme's page and its cards
        ('html[data-theme="dark"]', ["#121212", "#222832"]),
    ],
)
def test_verdicts_can_be_read_in_both_themes(selector, grounds):
    found = colours(selector)
    for ground in (found["book-panel"], *grounds):
        assert {
            w: contrast(found[w], ground) for w in WORDS if contrast(found[w], ground) < 4.5
        } == {}
