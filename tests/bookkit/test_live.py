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
import yaml
from scipy.interpolate import interpn

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
    text = PATHS[name].read_text()
    found = re.search(r'<script type="application/json">(.*?)</script>', text)
    return json.loads(found[1]) if found else {}


def node(name, given, script):
    """What `script` gives, which knows a committed picture as `picture` and `given`."""
    shared = json.dumps(str(live.BOOK / "_static" / "live.js"))
    program = f"""
const live = require({shared});
const {{ source, data, given }} = JSON.parse(require('fs').readFileSync(0, 'utf8'));
const page = {{ currentScript: {{ closest() {{}} }} }};
new Function('live', 'document', source)({{ ...live, attach() {{}} }}, page);
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
    assert len(set(ids)) == len(ids)
    assert all(each.startswith(f"live-{name}") for each in ids)
    assert text.count('role="img"') == 2  # the still pictures, wide and narrow
    assert "<!--" not in text


def test_filters_of_the_flip_process_say_what_python_says():
    times, y = live.TIMES, np.random.default_rng(5).uniform(-2.9, 2.9, 25)
    script = """({ exact: plain(picture.bayes(given)),
      belief: plain(picture.beliefs.slice(-picture.nodes.length)),
      ...Object.fromEntries(["table", "line", "ekf"].map((name) =>
        [name, plain(picture.run(name, given).mean)])) })"""
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
      const summed = picture.mean(c.f, 0.7, v, 20000);
      return [v, c.mean(0.7, v), summed, picture.loss(c, v, 20000)]; }})"""
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
        assert loss == pytest.approx(float(plug / best - 1), abs=1e-6)


@pytest.mark.parametrize("range_", [4.0, 12.0, 50.0])
def test_filters_of_the_falling_body_say_what_python_says(range_):
    data, times = data_of("body"), np.arange(11.0)
    angles = 0.1 - 0.005 * times**2 / range_ + 1e-3 * np.append(0.0, data["noise"][2])
    angles[0] = np.nan
    script = """(() => { const y = picture.measured(given, data.noise[2]);
      const seen = (all) => all.map((one) => [one.mean, one.cov]);
      const probs = (n) => picture.windows(y, n)[10].pieces.map((piece) => piece.prob);
      const count = (n) => [n, seen(picture.windows(y, n)), probs(n)];
      return { y, ekf: seen(picture.extended(y)), counts: [2, 12, 100].map(count) }; })()"""
    found = node("body", range_, script)
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


def test_runs_of_the_design_are_those_of_the_growth_model():
    """The library's best function makes the predicted error on the page's runs at each step."""
    script = """(() => { const runs = picture.simulate(given, 10000);
      return [runs.x.map(plain), runs.y.map(plain)]; })()"""
    x, y = np.array(node("design", 5, script))
    best = live.growth_filter()
    square = (best.run(np.arange(6), y[:, None]).mean[:, 0] - x) ** 2
    error = square.std(axis=1) / 100
    apart = square.mean(axis=1) - best.predicted.rms[:, 0] ** 2
    assert np.abs(apart / error).max() < 4
    assert data_of("design")["best"] == pytest.approx(best.predicted.rms[5, 0])


def test_design_takes_local_means_and_tries_them_on_new_runs():
    """The errors of the page from its tables, interpolated here by another routine."""
    script = """(() => { const runs = picture.simulate(3, 400), made = picture.design(runs, 400);
      return { x: runs.x.map(plain), y: runs.y.map(plain), tables: made.tables.map(plain),
        own: made.error, tried: picture.tried(made.tables, runs),
        few: picture.design(runs, 30).error }; })()"""
    found = node("design", 0, script)
    x, y = np.array(found["x"]), np.array(found["y"])
    centres = (np.arange(20) + 0.5) / 10 - 1
    u = y[0] * 4 / 29
    for k, table in enumerate(found["tables"], 1):
        values = np.reshape(table, (20, 20))
        inside = [np.clip(y[k], *(25 * centres)[[0, -1]]), np.clip(u, *(15 * centres)[[0, -1]])]
        u = interpn((25 * centres, 15 * centres), values, np.transpose(inside))
    assert found["own"] == pytest.approx(np.sqrt(np.mean((u - x[5]) ** 2)), rel=1e-9)
    assert found["tried"] == pytest.approx(found["own"], rel=1e-9)
    assert found["few"] < found["own"]  # few runs are fitted too well


def test_surface_of_the_design_is_the_best_function():
    """Between its 400 points it makes the error of the best function, within one per cent."""
    surface = np.frombuffer(base64.b64decode(data_of("design")["surface"]), "<f4").reshape(20, 20)
    best, times = live.growth_filter(), np.arange(6)
    runs = best.system.simulate(times, 40_000, 7)
    estimates = best.run(times, runs.measurements).mean[:, 0]
    axes = [side * ((np.arange(20) + 0.5) / 10 - 1) for side in (25, 15)]
    given = runs.measurements[5, 0], estimates[4]
    inside = [np.clip(part, *axis[[0, -1]]) for part, axis in zip(given, axes, strict=True)]
    errors = {}
    for name, values in (("right", surface), ("upside down", surface[::-1])):
        found = interpn(axes, values, np.transpose(inside))
        errors[name] = np.mean((found - runs.states[5, 0]) ** 2)
    own = np.mean((estimates[5] - runs.states[5, 0]) ** 2)
    assert errors["right"] == pytest.approx(own, rel=0.01)
    assert errors["upside down"] > 2 * own


def test_errors_of_the_memories_are_those_of_the_tables():
    """As the chapters print them: root-mean-square errors of the switching systems, squared."""
    oscillator, scalar, target = data_of("memory")["systems"]
    claims = yaml.safe_load((live.BOOK / "claims.yml").read_text())
    (mse,) = (claim["reference"] for claim in claims if claim["id"] == "JD-X1")
    # after six of the Kalman filter: 1, 2, 3, 4 and 6 positions, then 1, 2, 4 and 8 measurements
    rows = dict(zip(("e1", "e2", "e3", "e4"), mse[6:10], strict=True))
    rows |= dict(zip(("y1", "y2", "y4"), mse[11:14], strict=True))
    for last, value in rows.items():
        key = " ".join(f"{last[0]}{k + 1}" for k in range(int(last[1])))
        excess = 100 * (value / mse[5] - 1)
        assert oscillator["found"][key][0] == pytest.approx(excess, abs=2e-5)
    assert target["found"]["e1 c"][0] == pytest.approx(100 * ((1.1106 / 0.956302) ** 2 - 1))
    assert target["found"]["e1 j"][0] == pytest.approx(100 * ((1.12534 / 0.956302) ** 2 - 1))
    assert scalar["found"]["y1 y2"][0] == pytest.approx(100 * ((1.63904 / 1.24205) ** 2 - 1))
    assert scalar["best"]["e1"] == pytest.approx(100 * ((1.28347 / 1.24205) ** 2 - 1))
    assert "e1 y1" not in scalar["found"] | target["found"] | oscillator["found"]


WIDE = """<link rel="stylesheet" href="../_static/claims.css">
<style>:root { --pst-color-background: #fff; --pst-color-surface: #eee; }</style>
<mjx-container display="true" style="display: block"><p style="width: 700px">x</p></mjx-container>
<div class="pst-scrollable-table-container"><p style="width: 700px">x</p></div>
<div class="bd-content cell_output"><span class="math" style="display: inline-flex"><mjx-container>
<b style="display: block; width: 700px">x</b></mjx-container></span>
<div class="output stream"><div><pre>NUMBERS</pre></div></div>
<div class="output stream sentences"><div><pre>NUMBERS</pre></div></div></div>""".replace(
    "NUMBERS", 60 * "12 "
)
SHADOWS = """[...document.querySelectorAll("[display], [class^=pst], .math, pre")].map(
  (e) => [e, getComputedStyle(e)]).map(
  ([e, s]) => [e.scrollWidth, e.clientWidth, s.overflowX, s.backgroundAttachment])"""

HANDLES = {"flip": 5, "square": 0, "body": 0, "design": 0, "memory": 8}
"""The handle that is dragged, and then moved by a key."""


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """What headless Chromium says of all pictures on one page from a folder, as on a telephone."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "_static").mkdir()
    (folder / "book").mkdir()
    for file in ("claims.css", "live.css", "live.js"):
        shutil.copy(live.BOOK / "_static" / file, folder / "_static" / file)
    page = folder / "book" / "page.html"
    pictures = "".join(path.read_text() for path in PATHS.values())
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    page.write_text(f"<!doctype html><html><head>{head}</head><body>{pictures}{WIDE}</body></html>")
    here = Path(__file__).parent
    steps = [(here / "drag.js").read_text() + "; 0"]
    for name, handle in HANDLES.items():
        down = 10 if name == "memory" else -4  # into the memory, which lies below
        steps += [{"from": f"watch('live-{name}', {handle})", "by": [2, down]}]
        steps += [f"read('live-{name}', {handle})"]
    steps.append(SHADOWS)
    told = json.dumps({"url": page.as_uri(), "width": 390, "height": 800, "steps": steps})
    command = [NODE, here / "chromium.js", CHROMIUM]
    done = subprocess.run(command, input=told, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return dict(zip([*HANDLES, "wide"], json.loads(done.stdout)[1:], strict=True))


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
@pytest.mark.parametrize("name", live.PICTURES)
def test_a_drag_is_answered_at_once(name, answers):
    found = answers[name]
    assert len(found["tooks"]) >= 10
    assert np.median(found["tooks"]) < 50  # milliseconds
    assert found["before"] != found["start"]
    assert found["after"] != found["before"]
    assert found["words"]
    assert found["wide"] <= 390
    assert found["ids"] == found["different"]
    assert found["least"] >= 12  # pixels: nine points


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_a_wide_equation_or_table_scrolls_and_a_shadow_says_so(answers):
    *wide, sentence = answers["wide"]
    assert len(wide) == 4
    assert sentence[0] == sentence[1]  # it is broken into lines
    for whole, shown, overflow, ground in wide:
        assert whole > shown
        assert overflow == "auto"
        assert "local" in ground
        assert "scroll" in ground
