"""Figures that can be moved: their scripts say what the library says, and load nothing."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bookkit import live
from seedslib import zoo
from seedslib.export import to_js

ROOT = Path(__file__).resolve().parents[2]
NODE = shutil.which("node")
NUMBER = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+e[-+]?\d+|(?<=[\[,])-?0(?=[\],])")
"""Numbers with a fraction or an exponent, and zeros in lists: rounding may have left something."""
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
needs_node = pytest.mark.skipif(NODE is None, reason="no node")


def data_of(name):
    """The data of a committed figure."""
    text = (ROOT / "book" / "live" / f"{name}.html").read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json">(.*?)</script>', text)[1])


def module(data, name):
    """The text of a filter in a figure's data: runs of lines, each a first line and a number."""
    lines, runs = data["lines"], data["modules"][name]
    pairs = zip(runs[::2], runs[1::2], strict=True)
    return "\n".join(line for at, count in pairs for line in lines[at : at + count])


def node(script, given):
    """What a script prints, which knows the page's scripts and `given`."""
    script = f"""
const {{ paths }} = require({json.dumps(str(live.STATIC / "live_filters.js"))});
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
    return {"dropouts": live.linear_filters(), "van_der_pol": live.van_der_pol_filters(2)}


def test_filters_of_the_figures_are_those_of_the_library(made):
    for name, filters in made.items():
        for key, filter in filters.items():
            assert_same(module(data_of(name), key), to_js(filter))


@needs_node
def test_a_figure_has_its_data_and_a_first_picture(made):
    slider = live.Slider("missing", "share", live.MISSING, 3)
    data = data_of("dropouts") | live.pooled({"kf": to_js(made["dropouts"]["kf"])})
    data["filters"] = [{"key": "kf", "label": "Kalman < all"}]
    text = live.fragment(live.Figure("x", slider, "a caption", data))
    assert text.count("<svg") == 2
    assert "Kalman &lt; all" in text
    assert 'aria-valuetext="0.3"' in text


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
        name: {"data": data_of(name), "keys": list(made[name]), "options": options}
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
