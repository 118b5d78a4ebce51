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


def test_a_sound_book_has_no_faults(built):
    assert html_check.faults(built) == []


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('alt="A line that rises"', "", "image without alt text: picture.png"),
        ('alt="A line that rises"', 'alt="x/picture.png"', "image without alt text: picture.png"),
        ('src="picture.png"', 'src="lost.png"', "image file is missing: lost.png"),
        ("other.html#there", "another.html", "dead link: another.html ('link')"),
        ("other.html#there", "other.html#here", "dead anchor: other.html#here ('link')"),
        ("#top", "#bottom", "dead anchor: #bottom ('up')"),
        (' lang="en"', "", "no language on the html element"),
        (
            "_static/mathjax/tex.js",
            "https://cdn.example.org/mathjax.js",
            "loads https://cdn.example.org/mathjax.js from the network",
        ),
        ("_static/mathjax/tex.js", "_static/other.js", "equations, but no MathJax"),
        (
            "</head>",
            '<link rel="stylesheet" href="//cdn.example.org/a.css"></head>',
            "loads //cdn.example.org/a.css from the network",
        ),
        ("</head>", "<style>@import url(x)</style></head>", "style with @import in it"),
        ('src="picture.png"', "", "image file is missing: "),
        ('alt="A line that rises"', 'alt="x/picture.PNG"', "image without alt text: picture.png"),
        ("other.html#there", "/etc/hosts", "dead link: /etc/hosts ('link')"),
        ("other.html#there", "file:///etc/hosts", "dead link: file:///etc/hosts ('link')"),
        ("other.html#there", "a%00b.html", "dead link: a%00b.html ('link')"),
        ("<p>", '<p><map><area href="lost.html"></map>', "dead link: lost.html"),
        ("<p>", '<p><script src="lost.js"></script>', "file is missing: lost.js"),
        ("</head>", '<link rel="stylesheet" href="lost.css"></head>', "file is missing: lost.css"),
        *(
            ("<p>", f"<p>{tag}", f"loads {address} from the network")
            for address in ("https://example.org/a.png", "//example.org/a.png")
            for tag in (
                f'<img src="picture.png" alt="A line" srcset="picture.png, {address} 2x">',
                f'<picture><source srcset="{address}"></picture>',
                f'<div style="background: url({address})"></div>',
                f"<style>p {{ background: url('{address}') }}</style>",
                f'<object data="{address}"></object>',
                f'<video poster="{address}"></video>',
            )
        ),
        ("<p>", '<p><span class="problematic">`lost`</span>', "a reference was not resolved"),
    ],
)
def test_every_planted_fault_is_named_with_its_page(built, old, new, fault):
    assert old in PAGE
    (built / "page.html").write_text(PAGE.replace(old, new))
    found = html_check.faults(built)
    assert any(line.startswith("page.html: ") and fault in line for line in found), found


def test_links_of_every_kind_that_lead_somewhere_are_sound(built):
    (built / "folder").mkdir()
    (built / "folder" / "index.html").write_text('<html lang="en"><p id="in">x</p></html>')
    (built / "a b.html").write_text('<html lang="en"><a name="x y"></a></html>')
    links = ("folder/", "folder", "folder/#in", "a%20b.html#x%20y", "?q=1", "page.html?q=1#top")
    links += ("mailto:a@example.org", "tel:1", "#")
    text = "".join(f'<a href="{link}">k</a>' for link in links)
    (built / "page.html").write_text(PAGE.replace("<p>", f"<p>{text}"))
    assert html_check.faults(built) == []


def test_a_style_sheet_that_loads_from_the_network_is_named(built):
    (built / "_static" / "a.css").write_text("p { src: url(data:image/svg+xml;a='http://b') }")
    assert html_check.faults(built) == []
    (built / "_static" / "a.css").write_text('@import "https://example.org/b.css";')
    assert html_check.faults(built) == [
        "_static/a.css: loads https://example.org/b.css from the network"
    ]


def test_an_empty_folder_is_named(tmp_path):
    with pytest.raises(ValueError, match="no built page"):
        html_check.faults(tmp_path)


def test_the_command_fails_with_the_place(built, command):
    assert "sound" in command(built, "-m", "bookkit", "check-html", ".").stdout
    (built / "page.html").write_text(PAGE.replace("other.html", "lost.html"))
    done = command(built, "-m", "bookkit", "check-html", ".")
    assert done.returncode == 1
    assert "page.html: dead link: lost.html#there ('link')" in done.stdout
