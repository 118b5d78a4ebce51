// The claims page: buttons that show the rows of one verdict. All rows are there without it.
"use strict";
(() => {
  const place = document.getElementById("claims-filter");
  if (!place) return;
  const rows = [...document.querySelectorAll("tr[data-verdict]")];
  const words = ["all", ...new Set(rows.map((row) => row.dataset.verdict))];
  const said = document.createElement("output");
  const buttons = words.map((word) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = word;
    button.addEventListener("click", () => show(word));
    return button;
  });
  function show(word) {
    let count = 0;
    for (const row of rows) {
      row.hidden = word !== "all" && row.dataset.verdict !== word;
      count += !row.hidden;
    }
    for (const table of document.querySelectorAll("table:has(tr[data-verdict])")) {
      const empty = !table.querySelector("tr[data-verdict]:not([hidden])");
      (table.closest("section") ?? table).hidden = empty;
    }
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.textContent === word));
    said.textContent = `${count} claims`;
  }
  place.append(...buttons, said);
  show("all");
  // A link to a row that is hidden shows all rows again.
  addEventListener("hashchange", () => show("all"));
})();
