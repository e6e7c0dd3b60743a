// Keys that work everywhere, those of the view, and the list of all of them.
"use strict";
(() => {
  const S = splatproof;
  const typing = (target) => target.closest?.("input:not([type=range]), select, textarea, [contenteditable]");
  const KEYS = [
    ["/", "filter by text"], ["j or ↓, k or ↑", "next and previous row"], ["Enter", "open it"],
    ["Esc", "leave the field, or go back"], ["g then b, r, i, p, h, c, v", "leaderboard, runs, images, plots, history, compare, claims (verdicts)"],
    ["t", "light or dark"], ["?", "this list"],
  ];
  const VIEWER = [
    ["← →", "previous and next image"], ["f or space", "flip between A and B"], ["1 2 3 4", "split, flip, side by side, error map"],
    ["[ ]", "move the split"], ["+ − 0", "zoom in, out, all of it"], ["x", "swap A and B"],
  ];
  const GO = { b: "board", r: "runs", i: "images", p: "plots", h: "history", c: "compare", v: "claims" };
  let going = 0;
  S.help = () => {
    const old = document.querySelector("dialog[open]");
    if (old) { old.close(); return; }
    const list = (rows) => S.h("dl.keys", {}, rows.map(([k, what]) => [S.h("dt", {}, S.h("kbd", {}, k)), S.h("dd", {}, what)]));
    const dialog = S.h("dialog", { "aria-labelledby": "help-title", onclose: () => dialog.remove() },
      S.h("h2", { id: "help-title" }, "Keys"), list(KEYS), S.h("h3", {}, "In the image viewer"), list(VIEWER),
      S.h("button.button", { type: "button", onclick: () => dialog.close() }, "Close"));
    dialog.addEventListener("click", (e) => { if (e.target === dialog) dialog.close(); });
    document.body.append(dialog);
    dialog.showModal();
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const { key } = event;
    if (key === "Escape") {
      if (typing(event.target)) event.target.blur();
      else if (S.view?.escape) S.view.escape();
      return;
    }
    if (typing(event.target)) {
      if (key === "Enter" && event.target.type === "search") { event.target.blur(); S.view?.list?.move(1); event.preventDefault(); }
      return;
    }
    if (going && Date.now() - going < 1200 && GO[key]) { going = 0; location.hash = S.link(GO[key]); event.preventDefault(); return; }
    going = key === "g" ? Date.now() : 0;
    if (S.view?.keys?.[key]) { S.view.keys[key](event); event.preventDefault(); return; }
    const list = S.view?.list, onControl = event.target.closest?.("a, button, summary");
    const act = {
      "/": () => document.querySelector("input[type=search]")?.focus(),
      "?": S.help, t: S.switchTheme,
      j: () => list?.move(1), ArrowDown: () => list?.move(1), k: () => list?.move(-1), ArrowUp: () => list?.move(-1),
      Enter: () => list?.open(),
    }[key];
    if (!act || (key === "Enter" && onControl) || (key.startsWith("Arrow") && !list)) return;
    act();
    event.preventDefault();
  });
})();
