"""Figures that can be moved: the page's filters are those of the library, and need no network."""

import functools
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bookkit import live
from bookkit.live import filters, tables
from bookkit.live.fragment import LARGEST, SCRIPTS, STATIC, data_of, unpooled
from seedslib import zoo
from seedslib.extra import to_js

ROOT = Path(__file__).resolve().parents[2]
NODE = shutil.which("node")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
NAMES = [name for names in live.PAGES.values() for name in names]
NUMBER = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+e[-+]?\d+|(?<=[\[,])-?0(?=[\],])")
"""Numbers with a fraction or an exponent, and zeros in lists: rounding may have left something."""
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
needs_node = pytest.mark.skipif(NODE is None, reason="no node")


def text_of(name):
    return (ROOT / "book" / "live" / f"{name}.html").read_text(encoding="utf-8")


def node(script, given):
    """What a script prints, told of the page's scripts and of `given`."""
    script = f"""
const {{ paths }} = require({json.dumps(str(STATIC / SCRIPTS[0]))});
const {{ live }} = require({json.dumps(str(STATIC / SCRIPTS[1]))});
const given = JSON.parse(require('fs').readFileSync(0, 'utf8'));
const plain = (x) => Number.isNaN(x) ? null : x;
{script}"""
    done = subprocess.run(
        [NODE, "-e", script], input=json.dumps(given), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def same(found, wanted):
    """Equal words, and equal numbers to the rounding of another processor."""
    assert NUMBER.sub("#", found) == NUMBER.sub("#", wanted)
    pairs = [[float(x) for x in NUMBER.findall(text)] for text in (found, wanted)]
    np.testing.assert_allclose(*pairs, rtol=1e-6, atol=1e-9)


def test_fragments_are_small_and_load_nothing():
    scripts = [(STATIC / name).read_text(encoding="utf-8") for name in SCRIPTS]
    assert {path.stem for path in (ROOT / "book" / "live").glob("*.html")} == set(NAMES)
    for page, names in live.PAGES.items():
        said = (ROOT / "book" / f"{page}.md").read_text(encoding="utf-8")
        assert set(re.findall(r":file: live/(\w+)\.html", said)) == set(names)
        texts = [text_of(name) for name in names]
        assert sum(len(text.encode()) for text in [*texts, *scripts]) <= LARGEST
        for text in [*texts, *scripts]:
            assert not re.search(
                r"//\w+\.\w|https?:|\bfetch\(|\bimport\b *[({'\"]|url\(|src=", text
            )


def test_controls_have_labels_and_a_first_picture():
    for name in NAMES:
        text = text_of(name)
        assert re.findall(r'label for="([\w-]+)"', text) == re.findall(
            r'input [^>]*id="([\w-]+)"', text
        )
        assert 'aria-live="polite"' in text
        assert "<noscript>" in text
        assert "<svg" in text.partition("<script")[0]
        assert "NaN" not in text.partition("<script")[0]


MADE = {
    "dropouts": functools.cache(filters.linear_filters),
    "van_der_pol": functools.cache(lambda: filters.van_der_pol_filters(2)),
}


@pytest.mark.parametrize("name", MADE)
def test_modules_are_those_of_today(name):
    kept = unpooled(data_of(text_of(name)))
    for key, filter in MADE[name]().items():
        same(kept[key], to_js(filter))


def test_tables_are_those_of_today():
    for figure in tables.figures():
        data = data_of(text_of(figure.name))
        for key, value in figure.data.items():
            same(json.dumps(data[key]), json.dumps(value))
        assert [s["values"] for s in data["sliders"]] == [list(s.values) for s in figure.sliders]


SCORES = """
const found = {};
for (const [name, { data, keys, options }] of Object.entries(given)) {
  const drawn = paths.simulate(data, { ...data.options, ...options }, 3, paths.source(7));
  found[name] = { x: drawn.x, y: drawn.y.map((y) => y.map(plain)), mean: {} };
  for (const key of keys) found[name].mean[key] = drawn.y.map((y) => {
    const made = paths.module(data, key), state = made.init();
    const all = data.timed.includes(key) ? made.run(state, data.times, y) : made.run(state, y);
    return Array.from(all.mean);
  });
}
console.log(JSON.stringify(found));
"""


@needs_node
def test_page_and_python_agree():
    """The page's measurements, gaps among them, by the library's filters: the page's estimates."""
    made = {
        "dropouts": (MADE["dropouts"](), {"missing": 0.4}),
        "van_der_pol": (MADE["van_der_pol"](), {"noise": 1.0}),
    }
    given = {
        name: {"data": data_of(text_of(name)), "keys": list(found), "options": options}
        for name, (found, options) in made.items()
    }
    said = node(SCORES, given)
    for name, (found, _) in made.items():
        data = given[name]["data"]
        y = np.array(said[name]["y"], dtype=float).reshape(3, len(data["times"]), -1)
        assert np.isnan(y).any() == (name == "dropouts")
        for key, filter in found.items():
            for p in range(3):
                if key == "kf":
                    times = np.arange(len(y[p]))
                else:
                    times = np.array(data["times"])
                wanted = filter.run(times, y[p]).mean.ravel()
                np.testing.assert_allclose(said[name]["mean"][key][p], wanted, rtol=1e-7, atol=1e-8)


MOMENTS = """
const found = {};
for (const [name, { plant, times, options }] of Object.entries(given)) {
  const drawn = paths.simulate({ plant, times }, options, 1500, paths.source(3));
  found[name] = [drawn.x.map((path) => path.map((x) => x[0])), drawn.y];
}
console.log(JSON.stringify(found));
"""


@needs_node
def test_systems_of_the_page_are_those_of_the_zoo():
    """Means and variances of states and measurements, within 4.5 standard errors everywhere."""
    systems = {
        "van_der_pol": (zoo.van_der_pol(), 0.5 * np.arange(4), {"noise": 1.0}),
        "linear": (zoo.linear_gaussian(), 0.5 * np.arange(4), None),
        "flip": (zoo.flip_process(), 0.25 * np.arange(4), {}),
        "switching": (zoo.scalar_switching(rate=1.6), np.arange(6.0), {"rate": 1.6}),
    }
    matrix, root = filters.linear_step()
    steps = {"matrix": matrix.ravel().tolist(), "root": [root[0, 0], root[1, 0], root[1, 1]]}
    given = {
        name: {"plant": name, "times": times.tolist(), "options": steps if o is None else o}
        for name, (_, times, o) in systems.items()
    }
    given["wrong rate"] = given["switching"] | {"options": {"rate": 0.4}}
    given["wrong noise"] = given["van_der_pol"] | {"options": {"noise": 1.5}}
    systems |= {"wrong rate": systems["switching"], "wrong noise": systems["van_der_pol"]}
    worst = {}
    said = node(MOMENTS, given)
    for name, (system, times, _) in systems.items():
        data = system.simulate(times, 1500, 5)
        parts = []
        for page, own in (
            (np.array(said[name][0]).T, data.states[:, 0]),
            (
                np.array(said[name][1]).reshape(1500, len(times), -1)[..., 0].T,
                data.measurements[:, 0],
            ),
        ):
            centre = own.mean(axis=1, keepdims=True)
            for one, other in ((page, own), ((page - centre) ** 2, (own - centre) ** 2)):
                doubt = np.sqrt((one.var(axis=1) + other.var(axis=1)) / 1500)
                parts.append(np.abs(one.mean(axis=1) - other.mean(axis=1)) / doubt)
        worst[name] = np.max(parts)
    wrong = {name for name in worst if worst[name] > 4.5}
    assert wrong == {"wrong rate", "wrong noise"}, worst


@needs_node
def test_the_law_is_that_of_the_table():
    """At the signal-to-noise ratios of the sweep, the losses that its notebooks computed."""
    _, curves = tables.swept("plugin_loss", ["a", "q", "r"], {"loss": ("steady_loss", None)})
    values, _ = tables.swept("plugin_loss", ["a", "q", "r"], {})
    a, q, r = np.meshgrid(*values, indexing="ij")
    ratios = (q / (r * a**2)).ravel().tolist()
    found = node(
        "console.log(JSON.stringify(given.map((s) => live.KINDS.law("
        "{ sliders: [{ values: [s, 2 * s] }] }, [0]).value)));",
        ratios,
    )
    np.testing.assert_allclose(found, np.ravel(curves[0]["values"]), rtol=1e-5)


ANSWER = """
console.log(JSON.stringify(given.map(([data, at]) => live.KINDS[data.kind](data, at).said)));
"""
MOVE = """<script>document.addEventListener("DOMContentLoaded", () => {
for (const input of document.querySelectorAll("figure input")) {
  input.value = input.max;
  input.dispatchEvent(new Event("input"));
}});</script>"""


@needs_node
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium")
def test_a_page_from_a_file_answers(tmp_path):
    """Sliders are moved in a headless browser; what it then says is what node says."""
    names = ("dropouts", "flip_function", "growth")
    scripts = "".join(f'<script src="{(STATIC / name).as_uri()}"></script>' for name in SCRIPTS)
    body = "".join(text_of(name) for name in names)
    page = tmp_path / "page.html"
    page.write_text(
        f'<!doctype html><html lang="en"><meta charset="utf-8">{scripts}{MOVE}{body}</html>',
        encoding="utf-8",
    )
    done = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
         f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    found = re.findall(r'class="live-said"[^>]*>([^<]*)<', done.stdout)
    every = [data_of(text_of(name)) for name in names]
    wanted = node(ANSWER, [[d, [len(s["values"]) - 1 for s in d["sliders"]]] for d in every])
    assert found == wanted
    first = [re.search(r'class="live-said"[^>]*>([^<]*)<', text_of(name))[1] for name in names]
    assert all(a != b for a, b in zip(found, first, strict=True))
