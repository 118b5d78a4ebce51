"""Every public name has its place in the reference, and names in the text lead to it."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

import seedslib
from bookkit import reference

ROOT = Path(__file__).parents[2]


def test_every_room_has_a_page_in_the_book():
    rooms = set(seedslib.__all__) - {"commands"}  # which `python -m seedslib --help` describes
    assert set(reference.ROOMS) == rooms
    parts = yaml.safe_load((ROOT / "_toc.yml").read_text())["parts"]
    files = [chapter["file"] for part in parts for chapter in part["chapters"]]
    assert {f"book/api/{room}" for room in rooms} <= set(files)


@pytest.mark.parametrize("room", reference.ROOMS)
def test_every_public_name_has_a_reference(room):
    text = reference.page(room)
    described = set(re.findall(r"^\.\. (?:auto\w+|py:module):: (\S+)$", text, re.MULTILINE))
    assert described == {name for name, _ in reference.public(room)}
    assert "*batch" not in text.replace(r"\*batch", "")


def test_methods_of_parents_elsewhere_are_left_to_them():
    from seedslib.base import Parameter
    from seedslib.filters import KalmanFilter

    assert reference._members(Parameter) == ["default"]
    assert {"run", "predict", "correct", "forecast"} <= set(reference._members(KalmanFilter))


def test_a_name_that_two_objects_have_leads_nowhere():
    entries = {
        "seedslib.filters.smooth": SimpleNamespace(objtype="function"),
        "seedslib.one.diff": SimpleNamespace(objtype="function"),
        "seedslib.two.diff": SimpleNamespace(objtype="function"),
        "seedslib.filters.KalmanFilter.run": SimpleNamespace(objtype="method"),
    }
    known = reference._by_name(entries)
    assert known["smooth"] is entries["seedslib.filters.smooth"]
    assert known["diff"] is None
    assert "run" not in known


def test_no_value_that_is_shown_names_a_place_on_this_machine():
    values = {name: thing for room in reference.ROOMS for name, thing in reference.public(room)}
    places = {
        name
        for name, thing in values.items()
        if isinstance(thing, dict) and "<module" in repr(thing)
    }
    assert "seedslib.delay.RECURSIONS" in places
    for name in places:
        shown = reference.page(name.split(".")[1])
        assert f".. autodata:: {name}\n   :no-value:\n" in shown
