"""Programs on pages: they run, a type checker reads them, and faults are named by their line."""

import shutil
from pathlib import Path

import jupytext
import numpy as np
import pytest

from bookkit import programs

ROOT = Path(__file__).resolve().parents[2]


def test_the_program_of_the_readme_runs():
    known = {}
    exec(compile(programs.program((ROOT / "README.md").read_text()), "README.md", "exec"), known)
    optimal, plugin = known["optimal"], known["plugin"]
    assert (optimal > 0).all()
    assert (optimal < plugin).all()
    (steady,), (plugin,) = known["power"].errors([30.0])
    loss = 0.5 / np.sqrt(1 + known["signal"].noise_intensity[0, 0] / 0.1)
    np.testing.assert_allclose(plugin / steady - 1, loss, rtol=1e-6)


def test_faults_are_named_by_page_and_line(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "Text.\n\n```python\nfrom seedslib.models import Nose\n```\n\n- item\n\n"
        "  ```python\n  wrong: int = 'text'\n  ```\n"
    )
    readme = shutil.copy(ROOT / "README.md", tmp_path)
    for name in ("seedslib", "book"):  # where the type checker looks for packages
        (tmp_path / name).symlink_to(ROOT / name)
    found = programs.faults(tmp_path, [page, Path(readme)])
    assert [fault.split(" ")[0] for fault in found] == ["page.md:4:", "page.md:10:"]


def test_cells_of_a_notebook_are_a_program_without_their_options():
    text = "\n".join(
        (
            *("---", "jupytext: 1", "---", "", "```{code-cell} ipython3", ":tags: [parameters]"),
            *("", "seed = 1", "```", "", "```{code-cell} ipython3", "---", "mystnb:"),
            *("  figure:", "    name: fig-a", "---", "x = {", "  1: 2", "}", "```", ""),
            *("```{math}", ":label: a", "x", "```", "", "```{code-cell} ipython3"),
            *(":tags: [a]", ":other: b", "y = x[:1]", "```"),
        )
    )
    lines = {k: line for k, line in enumerate(programs.program(text).splitlines(), 1) if line}
    assert lines == {8: "seed = 1", 17: "x = {", 18: "  1: 2", 19: "}", 30: "y = x[:1]"}


def test_every_line_of_a_notebook_that_is_code_is_looked_at():
    """And nothing else is, but the programs of solutions, which stand in the text."""
    for page in sorted((ROOT / "notebooks").glob("*.md")):
        text = page.read_text()
        found = programs.program(text).splitlines()
        cells = jupytext.reads(text, fmt="md:myst").cells
        parts = [c.source if c.cell_type == "code" else programs.program(c.source) for c in cells]
        code = [line for part in parts for line in part.splitlines()]
        assert [line for line in found if line] == [line for line in code if line], page.name


def test_a_page_without_a_program_is_refused(tmp_path):
    (tmp_path / "page.md").write_text("nothing here\n")
    with pytest.raises(ValueError, match=r"page\.md: wanted a program, found none"):
        programs.faults(tmp_path, [tmp_path / "page.md"])
