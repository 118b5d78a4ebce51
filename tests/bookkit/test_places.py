import pytest

from bookkit import places


def test_a_sound_list_has_no_faults(project):
    assert places.faults(project) == []


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("#A small notebook", "#Another", "two-step (1): no notebooks/tiny.md#Another"),
        ("tiny.md#A small", "none.md#A small", "two-step (1): no notebooks/none.md"),
        ("[TS-X1]", "[TS-X2]", "two-step (1): no claim TS-X2"),
        ("[TS-X1]", "[]", "two-step: no item has the claim TS-X1"),
    ],
)
def test_every_planted_fault_is_named(project, old, new, fault, spoil):
    spoil(project / "book" / "places.yml", old, new)
    assert fault in " ".join(places.faults(project))


def test_an_item_is_somewhere(project):
    (project / "book" / "places.yml").write_text('two-step:\n- {item: "(1)", says: a sum}\n')
    assert "book/places.yml: two-step (1): nowhere in the book" in places.faults(project)


@pytest.mark.parametrize("text", ["[]\n- 3", "3", "none: []", "two-step: [3]", "two-step: [{}]"])
def test_another_shape_is_refused(project, text):
    (project / "book" / "places.yml").write_text(text)
    with pytest.raises(ValueError, match=r"places\.yml"):
        places.faults(project)


def test_the_page_links_headings_and_claims(project):
    page = places.page(project)
    assert '<a href="../notebooks/tiny.html#a-small-notebook">A small notebook</a>' in page
    assert '<a href="../notebooks/tiny.html#TS-X1">TS-X1</a> reproduced' in page
