// Pictures that can be dragged. A picture is a function of its data that gives `view(W)`: SVG as text,
// handles, and texts; so it can be drawn without a page as well. Nothing is loaded.
"use strict";
globalThis.live ??= (() => {
  const pictures = {}, NS = "http://www.w3.org/2000/svg";

  // --- words and shapes ---------------------------------------------------------------------------
  const num = (v, d = 2) => (v < 0 && Math.abs(v) >= 0.5 * 10 ** -d ? "−" : "") + Math.abs(v).toFixed(d);
  const clamp = (v, a, b) => Math.min(Math.max(v, a), b);
  const path = (points) => "M" + points.map(([a, b]) => `${a.toFixed(1)} ${b.toFixed(1)}`).join("L");
  const line = (kind, d) => `<path class="${kind}" d="${d}"/>`;
  const text = (x, y, words, anchor = "start", kind = "q") =>
    `<text class="${kind}" x="${x.toFixed(1)}" y="${y.toFixed(1)}" text-anchor="${anchor}">${words}</text>`;
  const marks = { // one shape a filter, so that colour is not needed to tell them apart
    disc: (a, b, r) => `M${(a - r).toFixed(1)} ${b.toFixed(1)}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0`,
    square: (a, b, r) => `M${(a - r).toFixed(1)} ${(b - r).toFixed(1)}h${2 * r}v${2 * r}h${-2 * r}z`,
    wedge: (a, b, r) => `M${a.toFixed(1)} ${(b - 1.2 * r).toFixed(1)}l${1.15 * r} ${2 * r}h${-2.3 * r}z`,
  };
  const choose = (kind, options, now) => options.map(([key, words]) =>
    `<button type="button" data-${kind}="${key}" aria-pressed="${key === now}">${words}</button>`).join("");

  // --- numbers ------------------------------------------------------------------------------------
  function floats(code) { // numbers of four bytes, as text of base 64
    const bytes = Uint8Array.from(atob(code), (c) => c.charCodeAt(0)), view = new DataView(bytes.buffer);
    return Float64Array.from({ length: bytes.length / 4 }, (_, i) => view.getFloat32(4 * i, true));
  }
  // A module of seedslib.export.to_js from its text: a page from a folder can not import a file.
  const filter = (module) => new Function(`${module.replace(/^export /gm, "")}\nreturn { init, run, step };`)();
  function erf(x) { // a series near zero, a continued fraction farther out
    const a = Math.abs(x);
    if (a > 6) return Math.sign(x);
    if (a < 2.5) {
      let term = x, sum = x;
      for (let k = 1; Math.abs(term) > 1e-17 * Math.abs(sum); k++) sum += (term *= -x * x / k) / (2 * k + 1);
      return 2 / Math.sqrt(Math.PI) * sum;
    }
    let c = 0;
    for (let k = 60; k > 0; k--) c = k / 2 / (a + c);
    return Math.sign(x) * (1 - Math.exp(-a * a) / Math.sqrt(Math.PI) / (a + c));
  }
  function bisect(f, a, b) { // where f changes its sign between a and b
    const side = f(a) > 0;
    for (let k = 0; k < 40; k++) f((a + b) / 2) > 0 === side ? a = (a + b) / 2 : b = (a + b) / 2;
    return (a + b) / 2;
  }

  // --- the hand -----------------------------------------------------------------------------------
  const whole = ({ W, H, svg }, inner = "", more = 'role="img"') =>
    `<svg xmlns="${NS}" viewBox="0 0 ${W} ${H}" ${more}><g>${svg}</g>${inner}</svg>`;
  const dot = '<circle class="hit" r="20"/><circle class="halo" r="11"/><circle class="disc" r="6.5"/>';
  // A still picture, for readers without scripts.
  function still(picture, W, label) {
    const view = picture.view(W), seen = view.handles.map(({ at, kind = "" }) =>
      `<circle class="disc ${kind}" cx="${at[0].toFixed(1)}" cy="${at[1].toFixed(1)}" r="5.5"/>`);
    return { svg: whole(view, seen.join(""), `role="img" aria-label="${label}"`), words: view.words };
  }

  function attach(figure) {
    const data = figure.querySelector('script[type="application/json"]');
    const picture = pictures[figure.id.slice(5)](JSON.parse(data?.textContent ?? "{}"));
    const stage = figure.querySelector(".live-stage"), find = (kind) => [...figure.querySelectorAll(kind)];
    let view, handles = [], svg, W = 0, playing = 0;
    figure.classList.add("live-on");
    find("button").forEach((b) => { b.disabled = false; });

    function draw(begin = performance.now()) {
      view = picture.view(W);
      if (!svg || handles.length !== view.handles.length) build();
      svg.setAttribute("viewBox", `0 0 ${W} ${view.H}`);
      svg.firstChild.innerHTML = view.svg;
      view.handles.forEach((h, i) => {
        const set = { transform: `translate(${h.at[0].toFixed(1)} ${h.at[1].toFixed(1)})`, class: `handle ${h.kind ?? ""}`,
          "aria-label": h.label, "aria-valuemin": h.min, "aria-valuemax": h.max, "aria-valuenow": +h.now.toFixed(3),
          "aria-valuetext": h.text, tabindex: view.focus === undefined || view.focus === i ? 0 : -1 };
        for (const key in set) handles[i].setAttribute(key, set[key]);
      });
      for (const out of find("[data-out]")) {
        const words = view.words[out.dataset.out];
        if (out.innerHTML !== words) out.innerHTML = words;
      }
      for (const b of find("[data-guess], [data-set]"))
        b.setAttribute("aria-pressed", String(view.pressed.includes(b.dataset.guess ?? b.dataset.set)));
      figure.dataset.took = (performance.now() - begin).toFixed(2);
    }
    function build() {
      stage.innerHTML = whole({ W, H: view.H, svg: "" }, "", `role="group" aria-label="${stage.dataset.label}"`);
      svg = stage.firstChild;
      handles = view.handles.map((_, i) => {
        const g = document.createElementNS(NS, "g");
        g.setAttribute("role", "slider");
        g.innerHTML = dot;
        g.addEventListener("pointerdown", grab);
        g.addEventListener("touchstart", (e) => e.preventDefault(), { passive: false }); // a drag is no scroll
        g.addEventListener("keydown", (e) => key(e, i));
        g.addEventListener("focus", () => { if (picture.select && view.focus !== i) { picture.select(i); draw(); } });
        svg.append(g);
        return g;
      });
    }
    function grab(event) {
      if (event.button) return;
      event.preventDefault();
      stop();
      const box = svg.getBoundingClientRect(), scale = W / box.width;
      const away = (h) => Math.hypot((event.clientX - box.left) * scale - h.at[0], (event.clientY - box.top) * scale - h.at[1]);
      const near = view.handles.map(away), i = near.indexOf(Math.min(...near)), g = handles[i], [x, y] = view.handles[i].at;
      g.focus({ preventScroll: true });
      event.currentTarget.setPointerCapture(event.pointerId);
      // by how far the hand has gone, so that nothing that moves the picture moves the handle
      const drag = (e) => {
        const begin = performance.now();
        view.handles[i].to(x + (e.clientX - event.clientX) * scale, y + (e.clientY - event.clientY) * scale);
        draw(begin);
      };
      const owner = event.currentTarget, ends = ["pointerup", "pointercancel"];
      const end = () => {
        owner.removeEventListener("pointermove", drag); ends.forEach((name) => owner.removeEventListener(name, end));
        if (view.handles[i].drop) { view.handles[i].drop(); draw(); }
      };
      owner.addEventListener("pointermove", drag);
      ends.forEach((name) => owner.addEventListener(name, end));
    }
    function key(event, i) {
      const by = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1], PageUp: [0, 5], PageDown: [0, -5] }[event.key];
      if (!by || event.altKey || event.ctrlKey || event.metaKey) return;
      event.preventDefault();
      stop();
      const begin = performance.now(), next = view.handles[i].by(...by);
      if (handles[next]) handles[next].focus();
      draw(begin);
    }
    const stop = () => { cancelAnimationFrame(playing); };
    function play(moves) { // moves(s), s from 0 to 1
      const begin = performance.now(), length = matchMedia("(prefers-reduced-motion: reduce)").matches ? 1 : moves.length_ms;
      const tick = (now) => {
        const s = clamp((now - begin) / length, 0, 1);
        moves.at(s);
        draw();
        if (s < 1) playing = requestAnimationFrame(tick);
      };
      playing = requestAnimationFrame(tick);
    }
    figure.addEventListener("click", (event) => {
      const b = event.target.closest("button");
      if (!b) return;
      stop();
      const { guess, set, act } = b.dataset;
      if (guess) picture.guess(guess);
      else if (set) picture.set(set);
      else { const moves = picture.acts[act](); if (moves) return play(moves); }
      draw();
    });
    new ResizeObserver(() => {
      const wide = Math.max(280, Math.floor(stage.clientWidth));
      if (wide !== W) { W = wide; draw(); }
    }).observe(stage);
    figure.picture = picture;
  }
  return { pictures, num, clamp, path, line, text, marks, choose, floats, filter, erf, bisect, still, attach };
})();
if (typeof module === "object") {
  module.exports = globalThis.live;
  if (require.main === module) { // node live.js: the still pictures of one script, as JSON
    const { name, script, data, label, widths } = JSON.parse(require("fs").readFileSync(0, "utf8"));
    new Function("live", "document", script)({ ...live, attach() {} }, { currentScript: { closest() {} } });
    const drawn = Object.entries(widths).map(([key, W]) => [key, live.still(live.pictures[name](data), W, label)]);
    console.log(JSON.stringify(Object.fromEntries(drawn)));
  }
}
