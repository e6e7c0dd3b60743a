// Every run of the store, those that a later one replaced included.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  S.views.runs = (values) => {
    const K = S.known, R = K.runs, matches = S.matches(values.q);
    const columns = [
      ["ended", "ended", (i) => R.ended[i], (i) => S.date(R.ended[i]), "8.6rem"],
      ["suite", "suite", (i) => K.text("suite", i), null, "minmax(4rem, .7fr)"],
      ["scene", "scene", (i) => K.text("scene", i), null, "minmax(5rem, 1fr)"],
      ["row", "row", (i) => K.text("row", i), null, "minmax(7rem, 1.4fr)"],
      ["protocol", "protocol", (i) => K.text("protocol", i), null, "minmax(4rem, .8fr)"],
      ["seed", "seed", (i) => R.seed[i], null, "3.2rem"],
      ["psnr", "psnr [dB] ↑", (i) => K.value("psnr", i), (i) => S.number(K.value("psnr", i), 2), "6rem"],
      ["render_ms", "render [ms] ↓", (i) => K.value("render_ms", i), (i) => S.number(K.value("render_ms", i), 1), "6.6rem"],
      ["train_seconds", "train [s] ↓", (i) => K.value("train_seconds", i), (i) => S.number(K.value("train_seconds", i), 1), "6rem"],
      ["commit", "commit", (i) => K.text("commit", i), (i) => S.commit(K.text("commit", i)), "6.6rem"],
    ];
    const narrow = innerWidth < 640;
    const shown = narrow ? columns.filter(([k]) => ["scene", "row", "seed", "psnr"].includes(k)) : columns;
    const grid = narrow ? "minmax(0, .8fr) minmax(0, 1.2fr) 2.6rem 5.2rem" : shown.map((c) => c[4]).join(" ");
    const by = columns.find((c) => c[0] === values.sort) ?? columns[0], down = values.sort ? values.dir === "desc" : true;
    const newest = new Set(R.newest);
    const bar = h("form.filters", { role: "search", "aria-label": "Filters", onsubmit: (e) => e.preventDefault() },
      S.search(values.q, "Text"),
      ...["suite", "scene", "protocol", "row", "commit"].map((n) => S.choice(n[0].toUpperCase() + n.slice(1), n, K.options(n).filter(Boolean).map((t) => [t, n === "commit" ? S.commit(t) : t]), { value: values[n], any: "all" })),
      S.choice("State", "state", [["newest", "in the leaderboard"], ["replaced", "replaced by a later run"], ["failed", "failed"]], { value: values.state, any: "all" }),
      h("output.count", { "aria-live": "polite" }));
    const list = S.virtual({ label: "Runs", draw: (item) => item.draw() });
    const heads = h("div.line.heads.fixed", { role: "row", style: { "--grid": grid } }, shown.map(([key, text]) => h("span", { role: "columnheader", className: typeof columns.find((c) => c[0] === key)[2](0) === "string" ? "text" : "", "aria-sort": by[0] === key ? (down ? "descending" : "ascending") : null },
      h("button", { type: "button", onclick: () => S.change({ sort: key, dir: by[0] === key && !down ? "desc" : by[0] === key && values.sort ? "" : ["psnr", "ended"].includes(key) && by[0] !== key ? "desc" : "" }) }, text))));
    const wanted = ["suite", "scene", "protocol", "row", "commit"].filter((n) => values[n]).map((n) => [R.texts[n].of, R.texts[n].known.indexOf(values[n])]);
    const fill = () => {
      let places = [];
      for (let i = 0; i < K.count; i++) {
        if (wanted.some(([of, code]) => of[i] !== code)) continue;
        const error = K.text("error", i);
        if (values.state === "failed" && !error) continue;
        if (values.state === "newest" && !newest.has(i)) continue;
        if (values.state === "replaced" && newest.has(i)) continue;
        if (values.q && !matches(`${K.text("suite", i)} ${K.text("scene", i)} ${K.text("row", i)} ${K.text("protocol", i)} seed${R.seed[i]} ${K.text("commit", i)} ${error}`)) continue;
        places.push(i);
      }
      const key = places.map(by[2]);
      places = places.map((p, i) => [p, key[i]]).sort((a, b) => S.order(a[1], b[1], down)).map(([p]) => p);
      list.set(places.map((i) => ({ height: 32, open: () => { location.hash = S.link("run", { id: R.run[i] }); }, draw: () => line(i) })), true);
      bar.querySelector("output").textContent = S.plural(places.length, "run");
    };
    const line = (i) => {
      const error = K.text("error", i), href = S.link("run", { id: R.run[i] });
      return h(`div.line.row${error ? ".failed" : newest.has(i) ? "" : ".replaced"}`, { style: { "--grid": grid }, title: error || (newest.has(i) ? "" : "a later run of this case stands in the leaderboard"), onclick: (e) => { if (!e.target.closest("a")) location.hash = href; } },
        shown.map(([key, , of, text]) => h(`span${typeof of(i) === "string" ? ".text" : ""}`, { role: "gridcell" }, key === "row" ? h("a.label", { href }, h("bdi", {}, of(i))) : h("bdi", {}, text ? text(i) : of(i)))));
    };
    return { element: h("section.listing", {}, h("h1.hidden", {}, "Runs"), bar, heads, list.element), list, filled: fill };
  };
})();
