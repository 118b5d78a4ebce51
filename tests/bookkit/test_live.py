"""Figures that can be moved: their scripts say what the library says, and load nothing."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bookkit.live import filters, tables
from bookkit.live.fragment import SCRIPTS, STATIC, data_of, unpooled
from seedslib import zoo
from seedslib.export import to_js

ROOT = Path(__file__).resolve().parents[2]
NODE = shutil.which("node")
NUMBER = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+e[-+]?\d+|(?<=[\[,])-?0(?=[\],])")
"""Numbers with a fraction or an exponent, and zeros in lists: rounding may have left something."""
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
needs_node = pytest.mark.skipif(NODE is None, reason="no node")


def text_of(name):
    return (ROOT / "book" / "live" / f"{name}.html").read_text(encoding="utf-8")


def node(script, given):
    """What a script prints, which knows the page's scripts and `given`."""
    script = f"""
const {{ paths }} = require({json.dumps(str(STATIC / SCRIPTS[0]))});
const {{ live }} = require({json.dumps(str(STATIC / SCRIPTS[1]))});
const given = JSON.parse(require('fs').readFileSync(0, 'utf8'));
console.log(JSON.stringify({script}));"""
    done = subprocess.run(
        [NODE, "-e", script], input=json.dumps(given), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def assert_same(found, wanted):
    """Equal words, and equal numbers to the rounding of another processor."""
    assert NUMBER.sub("#", found) == NUMBER.sub("#", wanted)
    pairs = [[float(x) for x in NUMBER.findall(text)] for text in (found, wanted)]
    np.testing.assert_allclose(*pairs, rtol=1e-6, atol=1e-9)


@pytest.fixture(scope="module")
def made():
    """Filters of two figures, made today."""
    return {"dropouts": filters.linear_filters(), "van_der_pol": filters.van_der_pol_filters(2)}


def test_filters_and_tables_of_the_figures_are_those_of_the_library(made):
    for name, found in made.items():
        kept = unpooled(data_of(text_of(name)))
        for key, filter in found.items():
            assert_same(kept[key], to_js(filter))
    for figure in tables.figures():
        data = data_of(text_of(figure.name))
        for key, value in figure.data.items():
            assert_same(json.dumps(data[key]), json.dumps(value))


ESTIMATES = """Object.fromEntries(Object.entries(given).map(([name, { data, keys, options }]) => {
  const drawn = paths.simulate(data, { ...data.options, ...options }, 3, paths.source(7));
  const mean = Object.fromEntries(keys.map((key) => [key, drawn.y.map((y) => {
    const made = paths.module(data, key), state = made.init();
    const all = data.timed.includes(key) ? made.run(state, data.times, y) : made.run(state, y);
    return Array.from(all.mean);
  })]));
  const plain = (x) => Number.isNaN(x) ? null : x;
  return [name, { y: drawn.y.map((y) => Array.from(y, plain)), mean }];
}))"""


@needs_node
def test_estimates_of_a_page_are_those_of_python(made):
    """From the page's own measurements, gaps among them."""
    given = {
        name: {"data": data_of(text_of(name)), "keys": list(made[name]), "options": options}
        for name, options in (("dropouts", {"missing": 0.4}), ("van_der_pol", {"noise": 1.0}))
    }
    found = node(ESTIMATES, given)
    for name, by_key in made.items():
        times = np.array(given[name]["data"]["times"])
        y = np.array(found[name]["y"], dtype=float).reshape(3, len(times), -1)
        assert np.isnan(y).any() == (name == "dropouts")
        for key, filter in by_key.items():
            own = np.arange(len(times)) if key == "kf" else times
            for track, mean in zip(y, found[name]["mean"][key], strict=True):
                wanted = filter.run(own, track).mean.ravel()
                np.testing.assert_allclose(mean, wanted, rtol=1e-7, atol=1e-8)


SIMULATED = """paths.simulate({ plant: given.plant, times: given.times }, given.options, 1500,
  paths.source(3)).y.map((y) => Array.from(y))"""


@needs_node
@pytest.mark.parametrize(
    ("name", "options", "right"),
    [
        ("flip", {}, True),
        ("van_der_pol", {"noise": 1.0}, True),
        ("van_der_pol", {"noise": 1.5}, False),
        ("switching", {"rate": 1.6}, True),
        ("switching", {"rate": 0.4}, False),
    ],
)
def test_measurements_of_a_page_have_the_moments_of_the_zoo(name, options, right):
    """Means and variances, within 4.5 standard errors everywhere."""
    systems = {"flip": zoo.flip_process(), "van_der_pol": zoo.van_der_pol()}
    system = systems.get(name, zoo.scalar_switching(rate=1.6))
    times = np.arange(6.0) if name == "switching" else 0.25 * np.arange(4)
    page = node(SIMULATED, {"plant": name, "times": times.tolist(), "options": options})
    page = np.array(page).reshape(1500, len(times), -1)[..., 0].T
    own = system.simulate(times, 1500, 5).measurements[:, 0]
    centre, worst = own.mean(axis=1, keepdims=True), 0.0
    for one, two in ((page, own), ((page - centre) ** 2, (own - centre) ** 2)):
        error = np.sqrt((one.var(axis=1) + two.var(axis=1)) / 1500)
        worst = max(worst, np.max(np.abs(one.mean(axis=1) - two.mean(axis=1)) / error))
    assert (worst < 4.5) == right
