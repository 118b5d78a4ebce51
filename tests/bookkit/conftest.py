"""What the tests of the harness share: a small project to plant faults in."""

import shutil

import pytest

from bookkit import execution

TINY = """---
jupytext:
  text_representation:
    extension: .md
    format_name: myst
kernelspec:
  display_name: Python 3
  language: python
  name: python3
---

# A small notebook

```{code-cell} ipython3
:tags: [parameters]

gain: float = 2.0  # what the input is multiplied with
count: int = 3  # how many terms
```

```{code-cell} ipython3
from bookkit import check, integer, real

check(globals(), gain=real(gt=0, le=10), count=integer(ge=1, le=5))
```

```{code-cell} ipython3
from bookkit import claim, record

if gain == 7.0:
    raise ArithmeticError("seven is out of reach")
total = sum(gain**k for k in range(count))
record(total=total, terms=[gain**k for k in range(count)])
claim("TS-X1", computed=total, wrong={"one term less": total - gain ** (count - 1)})
```
"""

LEDGER = """- id: TS-X1
  paper: two-step
  origin: stated
  place: example 0
  statement: The three terms of the sum make 7.
  notebook: notebooks/tiny.md
  printed: 7
  tolerance: 1.0e-9
  proved: numbers
  verdict: reproduced
"""


CONCORDANCE = """\
- paper: two-step
  place: 'example 0'
  line: 'a |> h'
  reading: 'a + b'
  claims: [TS-X1]
"""


@pytest.fixture(scope="session")
def executed_project(tmp_path_factory):
    """The small project with its notebook executed; not to be changed."""
    root = tmp_path_factory.mktemp("project")
    for folder in ("notebooks", "book"):
        (root / folder).mkdir()
    (root / "requirements.lock").write_text("nothing==1.0\n")
    (root / "notebooks" / "tiny.md").write_text(TINY)
    (root / "book" / "claims.yml").write_text(LEDGER)
    (root / "book" / "concordance.yml").write_text(CONCORDANCE)
    assert execution.execute(root) == {"tiny.md": ""}
    return root


@pytest.fixture
def project(executed_project, tmp_path):
    """A copy of the small project that a test may spoil."""
    return shutil.copytree(executed_project, tmp_path / "project")


@pytest.fixture
def spoil():
    """Put another text in place of one that stands in a file."""

    def put(path, old, new):
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return put
