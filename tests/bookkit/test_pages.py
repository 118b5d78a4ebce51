"""What is made into pages: tables, the reference, programs, colours of words."""

import re
from pathlib import Path

import numpy as np
import pytest
from docutils import nodes
from docutils.utils import new_document

import seedslib
from bookkit import folding, programs, reference

ROOT = Path(__file__).resolve().parents[2]


def test_a_printed_table_becomes_a_table_with_each_number_in_its_column():
    table = "name     a     b\none            2\ntwo    1.5   3\na<b    2.5"
    output = nodes.container(nb_element="cell_code_output")
    output += nodes.literal_block("", f"a line\n\n{table}", classes=["output", "stream"])
    document = new_document("page")
    document += output
    folding.TextTables(document).run()
    text, made = (child.astext() for child in output.children)
    assert text.strip() == "a line"
    assert '<th scope="row" class="text">one</th><td></td><td>2</td>' in made
    assert '<th scope="row" class="text">a&lt;b</th><td>2.5</td><td></td>' in made


def test_every_public_name_of_the_library_is_in_the_reference():
    packages = set(seedslib.__all__) - {"commands"}  # `python -m seedslib --help` describes them
    assert set(reference.ROOMS) == packages
    for package in packages:
        text = reference.page(package)
        described = set(re.findall(r"^\.\. (?:auto\w+|py:module):: (\S+)$", text, re.MULTILINE))
        assert described == {name for name, _ in reference.public(package)}


def test_the_program_of_the_readme_runs_and_its_errors_are_ordered():
    known = {}
    exec(compile(programs.program((ROOT / "README.md").read_text()), "README.md", "exec"), known)
    assert (known["optimal"] < known["plugin"]).all()
    (steady,), (plugin,) = known["power"].errors([30.0])
    loss = 0.5 / np.sqrt(1 + known["signal"].noise_intensity[0, 0] / 0.1)
    np.testing.assert_allclose(plugin / steady - 1, loss, rtol=1e-6)


CSS = (ROOT / "book" / "_static" / "claims.css").read_text()
WORDS = ("reproduced", "checked", "corrected", "refuted", "open", "book-ink", "book-quiet")


def luminance(colour):
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize(
    ("selector", "grounds"),
    [(":root", ["#ffffff"]), ('html[data-theme="dark"]', ["#121212", "#222832"])],
)
def test_words_have_a_contrast_of_four_and_a_half(selector, grounds):
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)
    block = CSS.split(selector + " {", 1)[1].split("}")[0]
    colours = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block))
    pairs = [(word, g) for word in WORDS for g in (colours["book-panel"], *grounds)]
    assert [(word, g) for word, g in pairs if contrast(colours[word], g) < 4.5] == []
