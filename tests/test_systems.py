"""The page of all systems: every plant of the library is there, as the code has it, and linked."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
import sympy
from sympy import Matrix, sin

from seedslib import zoo
from seedslib.delay import DelaySystem
from seedslib.delay import examples as delays
from seedslib.piecewise import examples as pieces

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "book/systems.md").read_text()
NOTEBOOKS = {path.stem: path.read_text() for path in (ROOT / "notebooks").glob("*.md")}
SHOWN = {
    "delay_printed": {
        "system-delay-scalar", "system-delay-rotation", "system-delay-precise-sensor",
        "system-delay-two-noises",
    },
    "jump_diffusion_flip": {"system-flip-process"},
    "jump_diffusion_van_der_pol": {"system-van-der-pol"},
    "piecewise_filter": {"system-falling-body"},
    "switching_scalar": {"system-scalar-switching"},
}  # fmt: skip
"""Pages with the equations and all numbers of a plant: these need no link to its section."""


def public(module):
    """The plants of a module: functions of its own that make systems."""
    names = getattr(module, "__all__", dir(module))
    made = {name: getattr(module, name) for name in names if not name.startswith("_")}
    return {
        name for name, make in made.items()
        if inspect.isfunction(make) and make.__module__.startswith(module.__name__)
        and make.__annotations__["return"] != "float"
    }  # fmt: skip


ANCHORS = (
    {("zoo", name): f"system-{name.replace('_', '-')}" for name in public(zoo)}
    | {("delay", name): f"system-delay-{name.replace('_', '-')}" for name in public(delays)}
    | {("piecewise", name): f"system-{name.replace('_', '-')}" for name in public(pieces)}
)
SECTIONS = {
    part.partition(")=")[0]: part.partition(")=")[2]
    for part in re.split(r"^\((?=system-)", PAGE, flags=re.M)[1:]
}


def used(text):
    """Anchors of the plants that a notebook's code builds."""
    code = "\n".join(re.findall(r"^```\{code-cell\}.*?^```", text, re.M | re.S))
    kit = "delay" if "from seedslib.delay import" in code else "piecewise"
    calls = re.findall(r"\b(zoo|examples)\.(\w+)\(", code)
    found = {("zoo" if room == "zoo" else kit, name) for room, name in calls}
    return {ANCHORS[each] for each in found if each in ANCHORS}


def missing(text, shown=frozenset()):
    """Anchors of plants that a page uses and neither shows nor links to."""
    return sorted(used(text) - set(re.findall(r"\b(system-[\w-]+)[)`>]", text)) - set(shown))


def test_every_plant_of_the_library_has_its_section():
    assert len(ANCHORS) == 15
    for (room, name), anchor in ANCHORS.items():
        call = f"{'zoo' if room == 'zoo' else 'examples'}.{name}("
        assert call in SECTIONS[anchor], f"{anchor}: say how {call}) builds it"


@pytest.mark.parametrize("page", sorted(NOTEBOOKS))
def test_a_page_shows_its_plants_or_links_to_them(page):
    assert missing(NOTEBOOKS[page], SHOWN.get(page, ())) == []


def test_a_page_without_a_link_is_found():
    page = '```{code-cell}\nsystem = zoo.scalar_switching("A2")\n```\n'
    assert missing(page) == ["system-scalar-switching"]
    assert missing(page + "[the system](system-scalar-switching)") == []


def test_pages_are_named_where_their_plants_are_described():
    for page, text in NOTEBOOKS.items():
        for anchor in used(text):
            assert f"(../notebooks/{page}.md)" in SECTIONS[anchor], f"{anchor}: name {page}"
    for page, anchors in SHOWN.items():
        assert anchors <= used(NOTEBOOKS[page])


def test_every_section_is_linked_and_every_link_of_the_page_leads_somewhere():
    links = re.findall(r"\]\(([^)#]+\.md)\)", PAGE)
    assert [link for link in links if not (ROOT / "book" / link).exists()] == []
    for anchor, section in SECTIONS.items():
        assert re.search(r"notebooks/\w+\.md", section), f"{anchor}: where is it used?"
    assert len(set(re.findall(r"^\((system-[\w-]+)\)=\n### ", PAGE, re.M))) == len(SECTIONS)


# numbers and formulas of the page against the code


def rows(anchor):
    """Cells of the tables of a section by the first one."""
    lines = re.findall(r"^\| (.*) \|$", SECTIONS[anchor], re.M)
    cells = [[cell.strip() for cell in line.split(" | ")] for line in lines]
    return {cell[0]: cell[1:] for cell in cells}


def number(text):
    """A number of the page, without rounding."""
    text = text.replace("\\", "").replace("{", "(").replace("}", ")")
    return sympy.sympify(text.replace("^", "**"), rational=True)


def parameters(anchor):
    """Numbers that the row of parameters gives to symbols."""
    given = re.findall(r"\$\\?(\w+) = ([^$]+?)\$", rows(anchor)["parameters"][0])
    return {name: number(value) for name, value in given}


def law(anchor):
    """Mean and covariance of the first normal law in the row of the start."""
    start = rows(anchor)["start"][0]
    mean, cov = re.search(r"\\mathcal N(?:\\big)?\((.*?),\\; (.*?)(?:\\big)?\)\$", start).groups()
    mean = [float(part) for part in mean.strip("()").split(",")]
    if "diag" in cov:
        parts = cov.partition("(")[2].strip(")").split(",")
        return mean, np.diag([float(number(part)) for part in parts])
    return mean, float(cov.replace("\\,", "").replace("I", "") or 1) * np.eye(len(mean))


def columns(anchor, *names):
    """Numbers of two modes in the rows of these names, each as a list of pairs."""
    table = rows(anchor)
    parts = [[list(map(sympy.Rational, cell.split(", "))) for cell in table[n]] for n in names]
    return [pair for row in parts for pair in zip(*row, strict=True)]


def equal(one, other):
    """Whether two expressions, or tables of them, agree in a few points."""
    gap = sympy.Matrix(one) - sympy.Matrix(other)
    symbols = sorted(gap.free_symbols, key=str)
    points = np.random.default_rng(1).normal(size=(3, len(symbols)))
    values = [gap.subs(dict(zip(symbols, p, strict=True))).evalf() for p in points.tolist()]
    return all(abs(entry) < 1e-12 for value in values for entry in value)


x1, x2, x, v, w, v1, v2, z = sympy.symbols("x1 x2 x v w v1 v2 z")


def real(expressions):
    """Expressions in plain symbols, whatever was assumed of theirs."""
    plain = {s: sympy.Symbol(s.name) for e in expressions for s in sympy.sympify(e).free_symbols}
    return [sympy.sympify(e).subs(plain) for e in expressions]


def continuous(name):
    """Drift, diffusion, sensor, intensity and jump of the page, with its numbers."""
    p = parameters(f"system-{name}")
    if name == "van-der-pol":
        pull = -(p["omega"] ** 2) * x1 + p["alpha"] * x2 * (1 - p["beta"] * x1**2)
        return [x2, pull], [0, x1], [x1**2 + v1, x2 + v2], 0, None
    if name == "linear-gaussian":
        r = p["r"]
        return [x2, -x1 - p["delta"] * x2], [0, 1], [x1 + v], (r,), None
    rate = p["mu_0"] + p["mu_1"] * (x if name == "flip-process" else x1) ** 2
    if name == "flip-process":
        seen = x * (1 + p["b"] * v1) + p["r"] * v2
        return [x - x**3], [p["sigma"]], [seen], rate, [-p["c"] * x + p["s"] * z]
    seen = x1 * (1 + p["b"] * v1) + p["r"] * v2
    drift = [x2, x1 - x1**3 - p["delta"] * x2]
    return drift, [0, p["sigma"]], [seen], rate, [0, p["rho"] + p["sigma_s"] * z]


@pytest.mark.parametrize(
    "name", ["van-der-pol", "kicked-duffing", "flip-process", "linear-gaussian"]
)
def test_systems_in_continuous_time(name):
    system = getattr(zoo, name.replace("-", "_"))()
    drift, diffusion, sensor, intensity, jump = continuous(name)
    assert equal(real(system.drift_expressions), drift)
    assert equal(real(Matrix(system.diffusion_expressions)), diffusion)
    assert equal(real(system.sensor.expressions), sensor)
    if name == "linear-gaussian":  # the deviation stands in the noise
        assert float(system.sensor.noise.cov[0, 0]) == pytest.approx(float(intensity[0]) ** 2)
        assert system.jump is None
    else:
        assert equal([system.intensity_expression or 0], [intensity])
    if jump is not None:
        assert equal(real(system.jump.expressions), jump)
    mean, cov = law(f"system-{name}")
    np.testing.assert_array_equal(mean, system.mean0)
    np.testing.assert_allclose(cov, system.cov0, rtol=1e-14)
    assert f"step $h = {system.step:g}$" in rows(f"system-{name}")["times"][0]


def test_scalar_switching_system():
    for sensor, deviation in (("A1H", 2), ("A1L", 0.5), ("A2", 1)):
        system = zoo.scalar_switching(sensor)
        row = next(line for line in PAGE.splitlines() if f'`"{sensor}"`' in line)
        assert float(row.rstrip("| ").rpartition("|")[2]) == deviation
        seen = [x / 2 + x**2 / 5] * 2 if sensor == "A2" else [x, x + 2]
        shown = [s + sympy.Rational(str(deviation)) * w for s in seen]
        assert equal([real(s.expressions)[0] for s in system.sensors], shown)
    section = SECTIONS["system-scalar-switching"]
    found = [float(n) for n in re.findall(r"(?<![/\d])\d\.\d+", section.partition("| sensor")[0])]
    assert found == [1.8, 0.5, 0.6, 0.5, 0.35, 0.3, 0.1, 0.5]
    a, s, b, t, c0, c1, d0, d1 = (sympy.Rational(str(n)) for n in found)
    moved = [x + a * sin(x) + s * v, b * x + t * v]
    assert equal([real(m.expressions)[0] for m in system.dynamics], moved)
    chances = [c0 - c1 * sympy.exp(-(x**2) / 8), d0 + d1 * sympy.exp(-(x**2) / 2)]
    weights = [system.branches[0][1].map, system.branches[1][0].map]
    assert equal(real([m.weight_expression for m in weights]), chances)


def test_manoeuvring_target():
    anchor, system = "system-manoeuvring-target", zoo.manoeuvring_target()
    names = (
        "decay $d_i$ of the velocity", "drive $c_i$", "noise $s_i$", "sensor $r_i$",
        "probability to stay in the mode", "noisy indicator: right with probability",
        "start: probability of the mode",
    )  # fmt: skip
    for i, numbers in enumerate(zip(*columns(anchor, *names), strict=True)):
        d, c, s, r, stay, right, chance = numbers
        push = c + s * v
        assert equal(real(system.dynamics[i].expressions), [x1 + x2 + push / 2, d * x2 + push])
        assert equal(real(system.sensors[i].expressions), [x1 + r * w])
        assert equal([system.branches[i][i].map.weight_expression], [stay])
        assert equal([system.readings[i][i].map.weight_expression], [right])
        mean, cov = law(anchor)
        assert system.initial[i].probability == pytest.approx(float(chance))
        np.testing.assert_array_equal(system.initial[i].mean, mean)
        np.testing.assert_array_equal(system.initial[i].cov, cov)


def test_steady_target():
    anchor, p = "system-steady-target", parameters("system-steady-target")
    for modes in (1, 2):
        system = zoo.steady_target(modes)
        for i in range(modes):
            push = i + p["s"] * v
            moved = [x1 + x2 + push / 2, p["d"] * x2 + push]
            assert equal(real(system.dynamics[i].expressions), moved)
            assert equal(real(system.sensors[i].expressions), [x1 + p["r"] * w])
            np.testing.assert_array_equal(system.initial[i].cov, law(anchor)[1])


def test_dependent_switching():
    anchor, system = "system-dependent-switching", zoo.dependent_switching()
    names = (
        "dynamics $a_{0i}$, $a_{1i}$, $s_i$", r"switch $\alpha_i$, $\beta_i$, $\rho_i$",
        "sensor $b_{0i}$, $b_{1i}$, $b_{2i}$, $r_i$", r"indicator $\tau_i$, $\delta_i$, $\rho'_i$",
        "start: probability, mean, variance",
    )  # fmt: skip

    def beyond(threshold, slope, correlation, noise):
        apart = (threshold + slope * x - correlation * noise) / sympy.sqrt(1 - correlation**2)
        return sympy.erfc(apart / sympy.sqrt(2)) / 2

    for i, n in enumerate(zip(*columns(anchor, *names), strict=True)):
        assert equal(real(system.dynamics[i].expressions), [n[0] + n[1] * x + n[2] * v])
        assert equal(real([system.branches[i][1].map.weight_expression]), [beyond(*n[3:6], v)])
        seen = n[6] + n[7] * x + n[8] * x**2 + n[9] * w
        assert equal(real(system.sensors[i].expressions), [seen])
        assert equal(real([system.readings[i][1].map.weight_expression]), [beyond(*n[10:13], w)])
        start = system.initial[i]
        found = [start.probability, float(start.mean[0]), float(start.cov[0, 0])]
        assert found == pytest.approx([float(part) for part in n[13:16]])


def matrix(anchor, name):
    """A matrix of numbers that a section shows."""
    start = re.escape(f"{name} =") + r"(?: \\varrho)?" + r" \\begin{pmatrix}(.*?)\\end{pmatrix}"
    text = re.search(r"(?<!bar )" + start, SECTIONS[anchor]).group(1)
    for word, value in ((r"\cos 0.5", np.cos(0.5)), (r"\sin 0.5", np.sin(0.5)), ("10^{-7}", 1e-7)):
        text = text.replace(word, repr(float(value)))
    return np.array([[float(n) for n in row.split("&")] for row in text.split(r"\\")])


def described(anchor, count, near=None, *, c=((1, 0),), g=((0,), (1,)), q=1, r=1, p0=1, x=1):
    """The plant of the page, by the usual values of its chapter and those that it names."""
    assert f"N = {count}" in SECTIONS[anchor]
    home = anchor if near is None else "system-delay-rotation"
    near = (1 if near is None else near) * matrix(home, "A")
    return DelaySystem(
        {0: near, count: matrix(home, r"\bar A")}, np.array(c), q * np.eye(np.shape(g)[1]),
        r * np.eye(len(c)), p0 * np.eye(2), x * np.eye(2), noise_input=np.array(g),
    )  # fmt: skip


def test_plants_with_delay():
    turn, noisy, exact, alike = (
        f"system-delay-{name}"
        for name in ("rotation", "two-noises", "precise-sensor", "nearly-parallel-sensors")
    )
    options = {"c": matrix(alike, "C"), "q": 1e-4, "r": 1e-12, "p0": 1e6, "x": 1e6}
    pairs = [
        (delays.rotation(), described(turn, 3, 0.7, x=0.5)),
        (delays.two_noises(), described(noisy, 1, g=np.eye(2))),
        (delays.precise_sensor(), described(exact, 2, r=0.1)),
        (delays.nearly_parallel_sensors(), described(alike, 4, 0.7, **options)),
        (delays.scalar(0.6, 0.3), DelaySystem({0: 0.6, 1: 0.3}, 1.0, 1.0, 1.0, 1.0, 1.0)),
    ]
    for plant, told in pairs:
        for key in ("sensor", "noise_cov", "sensor_cov", "cov0", "history_cov", "noise_input"):
            np.testing.assert_allclose(getattr(plant, key), getattr(told, key), rtol=1e-14)
        assert plant.delays == told.delays
        for d in plant.dynamics:
            np.testing.assert_allclose(plant.dynamics[d], told.dynamics[d], rtol=1e-14)
    for anchor, (plant, _) in zip((turn, noisy, exact), pairs, strict=False):
        assert f"spectral radius {delays.spectral_radius(plant):.3f}" in SECTIONS[anchor]


def test_falling_body():
    body, p = pieces.falling_body(), parameters("system-falling-body")
    mean, cov = law("system-falling-body")
    np.testing.assert_array_equal(body.mean0, mean)
    np.testing.assert_allclose(body.cov0, cov, rtol=1e-14)
    step = body.dynamics_at(6.0)  # the second that ends at t = 7
    middle = 0.5 * (body.regions.edges[3] + body.regions.edges[4])
    slope = float(p["g"]) * (7 - 0.5) / middle**2
    assert np.broadcast_to(step.matrix[1, 0], (100, 1))[3, 0] == pytest.approx(slope, rel=1e-12)
    assert np.ravel(body.sensor_at(1.0).noise)[0] == pytest.approx(float(p["H"]))
