/* Ranking and excerpts of the search page, from texts.js: a page opened from a file may fetch nothing. */
"use strict";

var Scorer = {
  objNameMatch: 11, objPartialMatch: 6, objPrio: {0: 15, 1: 5, 2: -5}, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
  // Chapters before how-to and reference, those before the record; then by how often the words stand there.
  score: ([docname, title, anchor, descr, score]) => {
    const page = TEXTS[docname];
    if (!page) return score;
    const words = queryWords(), text = page.text.toLowerCase(), name = title.toLowerCase();
    const often = words.map((word) => text.split(word).length - 1);
    const titled = words.filter((word) => name.includes(word)).length / (words.length || 1);
    const phrase = words.length > 1 && text.includes(words.join(" ")) ? 15 : 0;
    const found = often.reduce((sum, n) => sum + Math.log1p(n), 0);
    return page.weight * (10 * found + phrase + 40 * titled) + (descr ? 0 : 1) - (anchor ? 2 : 0);
  },
};

function queryWords() {
  const query = new URLSearchParams(location.search).get("q") || "";
  return query.toLowerCase().split(/[^\p{L}\p{N}_]+/u).filter((word) => word.length > 1);
}

/* The stretch of a page where most of the words stand, each word marked. */
function excerpt(text, words) {
  const lower = text.toLowerCase(), starts = [];
  for (const word of words)
    for (let at = lower.indexOf(word); at >= 0 && starts.length < 200; at = lower.indexOf(word, at + 1)) starts.push(at);
  const kinds = (at) => words.filter((word) => lower.slice(at, at + 180).includes(word)).length;
  const best = starts.sort((a, b) => kinds(b) - kinds(a) || a - b)[0];
  if (best === undefined) return null;
  const from = best < 60 ? 0 : text.indexOf(" ", best - 60) + 1;
  const shown = text.slice(from, text.indexOf(" ", from + 220) < 0 ? undefined : text.indexOf(" ", from + 220));
  const line = document.createElement("p");
  line.className = "context";
  const pattern = new RegExp(`(${words.map((word) => word.replace(/[.*+?^${}()|[\]\\]/g, "\\$&")).join("|")})`, "gi");
  shown.split(pattern).forEach((part, k) => {
    line.append(k % 2 ? Object.assign(document.createElement("mark"), {textContent: part}) : part);
  });
  return line;
}

addEventListener("DOMContentLoaded", () => {
  const results = document.getElementById("search-results"), words = queryWords();
  if (!results || !words.length) return;
  const explain = () => {
    for (const link of results.querySelectorAll("li > a:only-child")) {
      const page = TEXTS[link.getAttribute("href").replace(/\.html.*/, "")];
      const line = page && excerpt(page.text, words);
      if (line) link.parentElement.append(line);
    }
  };
  explain();
  new MutationObserver(explain).observe(results, {childList: true, subtree: true});
});
