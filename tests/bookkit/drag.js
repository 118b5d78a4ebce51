// What a test asks of a page: where a handle is, how long each answer to a drag took, what a key does.
var watch = (id, handle) => {
  const figure = document.getElementById(id), seen = { attributes: true, attributeFilter: ["data-took"] };
  figure.scrollIntoView();
  figure.tooks = [];
  new MutationObserver(() => figure.tooks.push(+figure.dataset.took)).observe(figure, seen);
  const box = figure.querySelectorAll(".handle .hit")[handle].getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2];
};
var read = (id, handle) => {
  const figure = document.getElementById(id), g = figure.querySelectorAll(".handle")[handle];
  const now = () => +g.getAttribute("aria-valuenow"), all = [...document.querySelectorAll("[id]")];
  const before = now(), key = id === "live-memory" && !before ? "ArrowDown" : "ArrowUp";
  g.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  const sizes = [...figure.querySelectorAll("svg text")].map((e) => parseFloat(getComputedStyle(e).fontSize));
  return { tooks: figure.tooks, before, after: now(), words: g.getAttribute("aria-valuetext"), least: Math.min(...sizes),
    wide: document.documentElement.scrollWidth, ids: all.length, different: new Set(all.map((e) => e.id)).size };
};
