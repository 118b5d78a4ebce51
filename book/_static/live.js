// What can be moved in the book: sliders, charts, and the sentence below them. Nothing is loaded.
"use strict";
const live = ((paths) => {
  const KINDS = {
    filters(data, given) {
      const o = { ...data.options }, key = [];
      data.sliders.forEach((s, i) => {
        o[s.name] = s.values[given[i]];
        if (s.modules) key.push(given[i]);
      });
      const drawn = paths.simulate(data, o, data.paths, paths.source(given.seed ?? 1)), t = data.times;
      const found = data.filters.map((f) => paths.score(data, [f.key, ...key].join("@"), drawn));
      const n = data.size, i = data.parts[0], one = found[0].first, told = drawn.y[0].length / t.length;
      const mean = t.map((_, k) => one.mean[k * n + i]);
      const two = t.map((_, k) => 2 * Math.sqrt(one.cov[(k * n + i) * n + i]));
      const sure = two.every(Number.isFinite); // a gap that the design knows nothing of: no errors
      const charts = [
        chart({ x: t, ylabel: "root-mean-square error", xlabel: data.xlabel, zero: true,
          curves: found.map((f, j) => ({ label: data.filters[j].label, y: f.at })) }),
        chart({ x: t, ylabel: data.state, xlabel: `${data.xlabel}, the first path`,
          band: sure && { low: mean.map((m, k) => m - two[k]), high: mean.map((m, k) => m + two[k]) },
          curves: [{ label: data.filters[0].label + (sure ? ", ±2 deviations" : ""), y: mean },
            { label: "the truth", y: drawn.x[0].map((x) => x[i]) }],
          dots: data.shown === undefined ? [] : t.map((s, k) => [s, drawn.y[0][k * told + data.shown]]) }),
      ];
      const said = found.map((f, j) => `${data.filters[j].label} ${f.rms.toFixed(3)} ± ${f.error.toFixed(3)}`);
      return { charts, said: `Error over ${data.paths} new paths: ${said.join("; ")}.`, found, drawn };
    },
  };

  const show = (x) => Math.abs(x) >= 1000 ? x.toFixed(0) : String(Number(x.toPrecision(3)));

  // Curves as SVG text, so that it can be drawn without a page as well.
  function chart({ x, curves, band, dots = [], xlabel, ylabel, zero }) {
    const W = 520, H = 270, L = 60, R = 18, B = 46;
    let row = 0, place = L;
    const keys = curves.map(({ label }) => { // names above the curves, in as many rows as needed
      const wide = 46 + 7.8 * label.length;
      if (place > L && place + wide > W) { row += 1; place = L; }
      place += wide;
      return [place - wide, 14 + 18 * row];
    });
    const T = 34 + 18 * row, seen = dots.filter((d) => Number.isFinite(d[1]));
    const all = [...curves.flatMap((c) => c.y), ...seen.map((d) => d[1]), ...(band ? [...band.low, ...band.high] : []), ...(zero ? [0] : [])];
    const ok = all.filter(Number.isFinite), [x0, x1] = [Math.min(...x), Math.max(...x)], [y0, y1] = [Math.min(...ok), Math.max(...ok)];
    const px = (v) => (L + (v - x0) / (x1 - x0 || 1) * (W - L - R)).toFixed(1);
    const py = (v) => (H - B - (v - y0) / (y1 - y0 || 1) * (H - T - B)).toFixed(1);
    const line = (y) => y.map((v, i) => `${i ? "L" : "M"}${px(x[i])} ${py(v)}`).join("");
    const out = [`<svg viewBox="0 0 ${W} ${H}" aria-hidden="true">`];
    for (const v of ticks(y0, y1)) out.push(`<path class="rule" d="M${L} ${py(v)}H${W - R}"/>`,
      `<text x="${L - 7}" y="${py(v)}" dy="4" text-anchor="end">${show(v)}</text>`);
    for (const v of ticks(x0, x1)) out.push(
      `<text x="${px(v)}" y="${H - B + 18}" text-anchor="middle">${show(v)}</text>`);
    if (band) out.push(`<path class="band" d="${line(band.high)}${x.map((v, i) => `L${px(v)} ${py(band.low[i])}`).reverse().join("")}Z"/>`);
    for (const d of seen) out.push(`<circle class="dot" cx="${px(d[0])}" cy="${py(d[1])}" r="3"/>`);
    curves.forEach((c, j) => {
      out.push(`<path class="curve c${j}" d="${line(c.y)}"/>`);
      const [at, high] = keys[j];
      out.push(`<path class="curve c${j}" d="M${at} ${high}h26"/>`, `<text x="${at + 32}" y="${high + 4}">${c.label}</text>`);
    });
    out.push(`<text x="${(L + W - R) / 2}" y="${H - 8}" text-anchor="middle">${xlabel}</text>`,
      `<text transform="translate(14 ${(T + H - B) / 2}) rotate(-90)" text-anchor="middle">${ylabel}</text></svg>`);
    return out.join("");
  }
  function ticks(low, high) {
    const rough = (high - low) / 5 || 1, ten = 10 ** Math.floor(Math.log10(rough));
    const step = ten * [1, 2, 5, 10].find((m) => m * ten >= rough), found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
    return found;
  }

  // Bind a figure: its sliders, its button for new paths, its charts and the sentence below.
  function attach(figure) {
    const data = JSON.parse(figure.querySelector("script").textContent);
    const inputs = [...figure.querySelectorAll("input")];
    let seed = 1;
    const update = () => {
      const begin = performance.now(), given = inputs.map((input) => Number(input.value));
      inputs.forEach((input, i) => {
        const word = show(data.sliders[i].values[given[i]]);
        input.setAttribute("aria-valuetext", word);
        input.parentNode.querySelector("output").textContent = word;
      });
      const found = KINDS[data.kind](data, Object.assign(given, { seed }));
      figure.querySelector(".live-charts").innerHTML = found.charts.join("");
      figure.querySelector(".live-said").textContent = found.said;
      figure.dataset.took = (performance.now() - begin).toFixed(1);
    };
    inputs.forEach((input) => { input.disabled = false; input.addEventListener("input", update); });
    figure.querySelector("button")?.addEventListener("click", () => { seed += 1; update(); });
    // The first picture is there already: all filters are tried in idle moments, to answer at once.
    const idle = window.requestIdleCallback ?? setTimeout;
    const tries = (data.sliders.find((s) => s.modules) ?? { values: [0] }).values.length;
    const warm = (k) => {
      if (k < 2 * tries) idle(() => {
        KINDS[data.kind](data, inputs.map((input, i) =>
          data.sliders[i].modules ? k % tries : Number(input.value)));
        warm(k + 1);
      });
    };
    warm(0);
  }
  if (typeof document !== "undefined") document.addEventListener("DOMContentLoaded", () =>
    document.querySelectorAll("figure.live").forEach(attach));
  return { KINDS };
})(typeof require === "function" ? require("./live_filters.js").paths : paths);
if (typeof exports === "object") exports.live = live;
