"""Pictures that can be dragged: they say what the library says, at once, and load nothing."""

import base64
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import sympy

from bookkit import live
from seedslib import zoo
from seedslib.filters import extended_kalman
from seedslib.models import grid_chain
from seedslib.piecewise import PiecewiseLinearFilter
from seedslib.two_step import LinearDiffusion, TwoStepEstimator

NODE, CHROMIUM = shutil.which("node"), shutil.which("chromium")
NUMBER = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+e[-+]?\d+|(?<=[\[,])-?0(?=[\],])")
"""Numbers with a fraction or an exponent, and zeros in lists: rounding may have left something."""
pytestmark = [
    pytest.mark.filterwarnings("ignore::UserWarning"),
    pytest.mark.skipif(NODE is None, reason="no node"),
]
PATHS = {name: live.BOOK / "live" / f"{name}.html" for name in live.PICTURES}


def data_of(name):
    """The data of a committed picture."""
    found = re.search(r'<script type="application/json">(.*?)</script>', PATHS[name].read_text())
    return json.loads(found[1]) if found else {}


def node(name, given, script):
    """What `script` gives, which knows a committed picture as `picture` and `given`."""
    program = f"""
const live = require({json.dumps(str(live.BOOK / "_static" / "live.js"))});
const {{ source, data, given }} = JSON.parse(require('fs').readFileSync(0, 'utf8'));
new Function('live', 'document', source)({{ ...live, attach() {{}} }}, {{ currentScript: {{ closest() {{}} }} }});
const picture = live.pictures.{name}(data), plain = (x) => Array.from(x);
console.log(JSON.stringify({script}));"""
    told = {"source": live.script_of(PATHS[name].read_text()), "data": data_of(name)}
    done = subprocess.run(
        [NODE, "-e", program],
        input=json.dumps(told | {"given": given}),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def texts(data):
    """The data as text, its packed numbers written out."""

    def plain(value):
        if isinstance(value, str) and len(value) > 200 and " " not in value:
            return np.frombuffer(base64.b64decode(value), "<f4").astype(float).tolist()
        return value

    return json.dumps({key: plain(value) for key, value in data.items()})


@pytest.mark.parametrize("name", live.PICTURES)
def test_committed_data_are_those_of_the_library(name):
    found, wanted = texts(data_of(name)), texts(live.PICTURES[name]())
    assert NUMBER.sub("#", found) == NUMBER.sub("#", wanted)
    pairs = [[float(x) for x in NUMBER.findall(text)] for text in (found, wanted)]
    np.testing.assert_allclose(*pairs, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", live.PICTURES)
def test_committed_pages_are_made_of_their_sources(name):
    text = PATHS[name].read_text()
    assert live.fragment(name, data_of(name)) == text
    ids = re.findall(r'\bid="(.*?)"', text)
    assert len(set(ids)) == len(ids) and all(each.startswith(f"live-{name}") for each in ids)
    assert text.count('role="img"') == 2  # the still pictures, wide and narrow
    assert "<!--" not in text


def test_filters_of_the_flip_process_say_what_python_says():
    times, y = live.TIMES, np.random.default_rng(5).uniform(-2.9, 2.9, 25)
    script = """({ exact: plain(picture.bayes(given)), ...Object.fromEntries(["table", "line", "ekf"].map((name) =>
      [name, plain(picture.run(name, given).mean)])), belief: plain(picture.beliefs.slice(-picture.nodes.length)) })"""
    found = node("flip", y.tolist(), script)
    for name, made in live.flip_filters().items():
        wanted = made.run(times, y[:, None]).mean[:, 0]
        np.testing.assert_allclose(found[name], wanted, rtol=1e-6, atol=1e-8)
    chain, means = grid_chain(zoo.flip_process(), live.NODES), []
    belief = chain.initial
    for k, t in enumerate(times):
        belief = chain.transition(0.0, 0.25) @ belief if k else belief
        belief = belief * np.exp(chain.log_likelihood(t, y[k : k + 1, None]))[0]
        belief /= belief.sum()
        means.append(chain.nodes[0] @ belief)
    np.testing.assert_allclose(found["exact"], means, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found["belief"], belief, rtol=0, atol=1e-6)


def test_nodes_of_the_flip_process_are_enough():
    """The belief on the page against one on 4.6 times as many nodes, over the first run."""
    data, means = data_of("flip"), []
    y = np.array(data["runs"][0]["y"])
    for nodes in (live.NODES, (-3.5, 3.5, 561)):
        chain = grid_chain(zoo.flip_process(), nodes)
        belief, found = chain.initial, []
        for k, t in enumerate(live.TIMES):
            belief = chain.transition(0.0, 0.25) @ belief if k else belief
            belief = belief * np.exp(chain.log_likelihood(t, y[k : k + 1, None]))[0]
            belief /= belief.sum()
            found.append(chain.nodes[0] @ belief)
        means.append(found)
    assert np.abs(np.subtract(*means)).max() < 2e-3


def test_answer_of_the_flip_process_is_that_of_the_table():
    """Where the estimate changes sides, by the library's filter on both sides of it."""
    y = np.array(data_of("flip")["runs"][0]["y"])
    at = node("flip", y.tolist(), 'picture.crossing(given, 5, "table")')
    assert f"At −{-at:.2f}." in PATHS["flip"].read_text()
    table = live.flip_filters()["table"]
    for reading, side in ((at - 1e-4, -1), (at + 1e-4, 1)):
        y[5] = reading
        assert np.sign(table.run(live.TIMES, y[:, None]).mean[5, 0]) == side


@pytest.mark.parametrize("curve", ["square", "abs", "sin", "exp"])
def test_means_and_losses_of_the_square_are_those_of_the_two_step_estimator(curve):
    x, ratios = sympy.Symbol("x", real=True), [0.05, 1.0, 5.0, 300.0]
    function = {"square": x**2, "abs": sympy.Abs(x), "sin": sympy.sin(x), "exp": sympy.exp(x)}
    script = f"""given.map((s) => {{ const c = picture.curves.{curve}, v = picture.varianceOf(s);
      return [v, c.mean(0.7, v), picture.mean(c.f, 0.7, v, 20000), picture.loss(c, v, 20000)]; }})"""
    found = node("square", ratios, script)
    for ratio, (variance, exact, summed, loss) in zip(ratios, found, strict=True):
        signal = LinearDiffusion(
            drift=-1.0,
            noise_intensity=2.0,
            sensor=1,
            sensor_intensity=2.0 / ratio,
            mean0=0,
            cov0=1,
        )
        made = TwoStepEstimator(signal, function[curve], variables=[x])
        best, plug = made.steady_errors()
        steady = float(signal.steady_moments().error_cov[0, 0, 0])
        wanted = float(np.squeeze(made.estimate([0.7], [[steady]])))
        assert variance == pytest.approx(steady, rel=1e-9)
        assert exact == pytest.approx(wanted, rel=1e-9)
        assert summed == pytest.approx(wanted, rel=1e-6)
        assert loss == pytest.approx(float(plug / best - 1), rel=1e-6)


@pytest.mark.parametrize("range_", [4.0, 12.0, 50.0])
def test_filters_of_the_falling_body_say_what_python_says(range_):
    data, times = data_of("body"), np.arange(11.0)
    angles = 0.1 - 0.005 * times**2 / range_ + 1e-3 * np.append(0.0, data["noise"][2])
    angles[0] = np.nan
    script = """(() => { const y = picture.measured(given, DATA.noise[2]), seen = (all) => all.map((one) => [one.mean, one.cov]);
      const each = (n) => picture.windows(y, n);
      return { y, ekf: seen(picture.extended(y)), counts: [2, 12, 100].map((n) => [n, seen(each(n)), each(n)[10].pieces.map((p) => p.prob)]) }; })()"""
    found = node("body", range_, script.replace("DATA", "data"))
    np.testing.assert_allclose(found["y"][1:], angles[1:], rtol=1e-12)
    ekf = extended_kalman(zoo.falling_body().discrete()).run(times, angles[:, None])
    for row, mean, cov in zip(found["ekf"], ekf.mean[:, 0], ekf.cov[:, 0, 0], strict=True):
        assert row == pytest.approx([mean, cov], rel=1e-6)
    for count, rows, probs in found["counts"]:
        filter = PiecewiseLinearFilter(zoo.falling_body(count))
        states = list(filter.states(10, angles[:, None]))
        wanted = [[state.mean[0], state.cov[0, 0]] for state in states]
        np.testing.assert_allclose(rows, wanted, rtol=1e-6)
        np.testing.assert_allclose(probs, states[-1].mode_prob, rtol=1e-6, atol=1e-9)


WATCH = """(() => { const figure = document.querySelector("#live-NAME"); figure.tooks = [];
  new MutationObserver(() => figure.tooks.push(+figure.dataset.took)).observe(figure, { attributes: true, attributeFilter: ["data-took"] });
  const box = figure.querySelectorAll(".handle .hit")[HANDLE].getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2]; })()"""
READ = """(() => { const figure = document.querySelector("#live-NAME"), g = figure.querySelectorAll(".handle")[HANDLE];
  const before = +g.getAttribute("aria-valuenow");
  g.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowUp", bubbles: true, cancelable: true }));
  return { tooks: figure.tooks, before, after: +g.getAttribute("aria-valuenow"), words: g.getAttribute("aria-valuetext"),
    wide: document.documentElement.scrollWidth, ids: document.querySelectorAll("[id]").length,
    different: new Set([...document.querySelectorAll("[id]")].map((e) => e.id)).size,
    least: Math.min(...[...figure.querySelectorAll("svg text")].map((e) => parseFloat(getComputedStyle(e).fontSize))) }; })()"""
HANDLES = {"flip": 5, "square": 0, "body": 0}


def chromium(page, steps):
    """What headless Chromium says to each step, on a page as narrow as a telephone."""
    given = json.dumps({"url": page.as_uri(), "width": 390, "height": 3000, "steps": steps})
    command = [NODE, str(Path(__file__).with_name("chromium.js")), CHROMIUM]
    done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
@pytest.mark.parametrize("name", live.PICTURES)
def test_a_drag_is_answered_at_once(name, tmp_path):
    """All pictures on one page from a folder: the drag, a key, the width, the size of the text."""
    (tmp_path / "_static").mkdir()
    (tmp_path / "book").mkdir()
    for file in ("claims.css", "live.css", "live.js"):
        shutil.copy(live.BOOK / "_static" / file, tmp_path / "_static" / file)
    page = tmp_path / "book" / "page.html"
    pictures = "".join(path.read_text() for path in PATHS.values())
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    page.write_text(f"<!doctype html><html><head>{head}</head><body>{pictures}</body></html>")
    own = [
        text.replace("NAME", name).replace("HANDLE", str(HANDLES[name])) for text in (WATCH, READ)
    ]
    ((x, y),) = chromium(page, own[:1])
    drag = [[x + 2 * k, y - 4 * k] for k in range(20)]
    _, found = chromium(page, [own[0], {"drag": drag}, own[1]])
    assert len(found["tooks"]) >= 10
    assert np.median(found["tooks"]) < 50
    assert found["after"] > found["before"]
    assert found["words"]
    assert found["wide"] <= 390
    assert found["ids"] == found["different"]
    assert found["least"] >= 12  # pixels: nine points
