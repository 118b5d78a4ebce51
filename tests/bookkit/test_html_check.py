"""The built book is looked over: each planted fault is named with its page."""

import pytest

from bookkit import html_check

PAGE = """<html lang="en"><head><script src="_static/mathjax/tex.js"></script></head><body>
<h1 id="top">A page</h1><p><a href="other.html#there">link</a> <a href="#top">up</a>
<a href="https://example.org/">outside</a> <span class="math">x</span></p>
<img src="picture.png" alt="A line that rises"></body></html>"""
OTHER = '<html lang="en"><body><h1 id="there">There</h1></body></html>'


@pytest.fixture
def built(tmp_path):
    (tmp_path / "page.html").write_text(PAGE)
    (tmp_path / "other.html").write_text(OTHER)
    (tmp_path / "picture.png").write_bytes(b"")
    (tmp_path / "_static" / "mathjax").mkdir(parents=True)
    (tmp_path / "_static" / "mathjax" / "tex.js").write_text("")
    return tmp_path


ALT, LINK, CDN = 'alt="A line that rises"', "other.html#there", "//cdn.example.org/a"


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (ALT, "", "image without alt text: picture.png"),
        (ALT, 'alt="x/picture.PNG"', "image without alt text: picture.png"),
        ('src="picture.png"', 'src="lost.png"', "image file is missing: lost.png"),
        (LINK, "another.html", "dead link: another.html ('link')"),
        (LINK, "other.html#here", "dead anchor: other.html#here ('link')"),
        (LINK, "/etc/hosts", "dead link: /etc/hosts ('link')"),
        ("#top", "#bottom", "dead anchor: #bottom ('up')"),
        (' lang="en"', "", "no language on the html element"),
        ("_static/mathjax/tex.js", "_static/other.js", "equations, but no MathJax"),
        ("<p>", '<p><script src="lost.js"></script>', "file is missing: lost.js"),
        ("<p>", '<p><span class="problematic">`lost`</span>', "a reference was not resolved"),
        ("_static/mathjax/tex.js", "https://e.org/mathjax.js", "loads https://e.org/mathjax.js"),
        ("<p>", f'<p><img src="picture.png" {ALT} srcset="picture.png, {CDN} 2x">', f"loads {CDN}"),
        ("<p>", f'<p><div style="background: url({CDN})"></div>', f"loads {CDN}"),
        ("<p>", f"<p><style>p {{ background: url('{CDN}') }}</style>", f"loads {CDN}"),
    ],
)
def test_every_planted_fault_is_named_with_its_page(built, old, new, fault):
    assert html_check.faults(built) == []
    assert old in PAGE
    (built / "page.html").write_text(PAGE.replace(old, new))
    found = html_check.faults(built)
    assert any(line.startswith("page.html: ") and fault in line for line in found), found


def test_links_of_every_kind_that_lead_somewhere_are_sound(built):
    (built / "folder").mkdir()
    (built / "folder" / "index.html").write_text('<html lang="en"><p id="in">x</p></html>')
    (built / "a b.html").write_text('<html lang="en"><a name="x y"></a></html>')
    links = ("folder/", "folder/#in", "a%20b.html#x%20y", "page.html?q=1#top", "tel:1", "#")
    text = "".join(f'<a href="{link}">k</a>' for link in links)
    (built / "page.html").write_text(PAGE.replace("<p>", f"<p>{text}"))
    assert html_check.faults(built) == []
