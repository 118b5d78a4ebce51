import json

import pytest

from bookkit import weight


@pytest.fixture
def built(tmp_path):
    files = {
        "page.html": '<script defer src="_static/scripts/fontawesome.js?digest=1">\n</script>'
        '<script src="_static/mathjax/tex-chtml.js"></script><img alt="a" src="a%20b.png">'
        '<link rel="next" href="heavy.html">'
        + 2
        * '<script>const THEBE_JS_URL = "https://a.example/b.js";</script>',
        "search.html": '<script src="searchindex.js"></script>',
        "part/other.html": '<script src="../searchindex.js"></script>',
        "searchindex.js": "x",
        "_static/scripts/fontawesome.js": "x" * 900,
        "_static/scripts/theme.js.map": "x",
        "_static/mathjax/tex-chtml.js": "x" * 500,
        "_static/mathjax/tex-svg.js": "x",
        "_static/mathjax/output/chtml/fonts/a.woff": "x",
        "_static/mathjax/output/svg/fonts/tex.js": "x",
        "a b.png": "x" * 300,
        "_sources/a.ipynb": json.dumps(
            {"cells": [{"cell_type": "code", "source": "1", "outputs": [{"data": {}}]}]}
        ),
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def test_what_no_page_loads_is_removed_and_what_it_loads_stays(built):
    weight.prune(built)
    left = {p.relative_to(built).as_posix() for p in built.rglob("*") if p.is_file()}
    assert left == {
        "page.html", "a b.png", "_static/mathjax/tex-chtml.js", "_sources/a.ipynb",
        "_static/mathjax/output/chtml/fonts/a.woff", "search.html", "part/other.html",
        "searchindex.js",
    }  # fmt: skip
    assert "searchindex" in (built / "search.html").read_text()
    assert (built / "part/other.html").read_text() == ""
    text = (built / "page.html").read_text()
    assert "fontawesome" not in text
    assert "THEBE" not in text
    assert json.loads((built / "_sources/a.ipynb").read_text())["cells"][0]["outputs"] == []


def test_a_page_weighs_what_it_loads(built):
    page = built / "page.html"
    assert weight.page_weight(page) == page.stat().st_size + 900 + 500 + 300
    weight.prune(built)
    assert weight.page_weight(page) == page.stat().st_size + 500 + 300
    assert weight.faults(built, page=1000) == []
    assert len(weight.faults(built, page=800)) == 1
    assert len(weight.faults(built, site=800)) == 1
