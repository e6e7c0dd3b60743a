// A row over commits: where it changed, and what else did.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  S.views.history = (values) => {
    const K = S.known, names = ["suite", "scene", "row", "protocol"];
    const count = new Map(), first = new Map();
    for (let i = 0; i < K.count; i++) {
      const id = K.text("series", i);
      if (!first.has(id)) { first.set(id, i); count.set(id, new Set()); }
      count.get(id).add(`${K.text("commit", i)} ${K.text("settings", i)} ${K.text("data", i)} ${K.text("environment", i)} ${K.text("rules", i)}`);
    }
    if (!values.s) return overview(values, first, count);
    const i = first.get(values.s);
    if (i === undefined) return { element: S.empty("There is no such row. ", h("a", { href: S.link("history") }, "All histories")) };
    const page = h("section.page", {}, S.title(`History of ${K.text("row", i)}`, [h("a", { href: S.link("history") }, "all histories"), " · ", h("bdi", {}, names.filter((n) => n !== "row").map((n) => K.text(n, i)).join(" · "))]));
    S.data(`history/${values.s}`).then((found) => page.append(shown(found, values))).catch(S.failed(page));
    return { element: page, restyle: () => S.redraw(page), escape: () => { location.hash = S.link("history"); } };
  };
  const overview = (values, first, count) => {
    const K = S.known, matches = S.matches(values.q);
    const bar = h("form.filters", { role: "search", "aria-label": "Filters", onsubmit: (e) => e.preventDefault() }, S.search(values.q, "Text"),
      ...["suite", "scene", "row"].map((n) => S.choice(n[0].toUpperCase() + n.slice(1), n, K.options(n), { value: values[n], any: "all" })), h("output.count"));
    const list = S.virtual({ label: "Histories", draw: (item) => item.draw() });
    const fill = () => {
      const found = [...first].filter(([, i]) => ["suite", "scene", "row"].every((n) => !values[n] || K.text(n, i) === values[n]) && matches(["suite", "scene", "row", "protocol"].map((n) => K.text(n, i)).join(" ")));
      found.sort((a, b) => count.get(b[0]).size - count.get(a[0]).size || S.order(K.text("row", a[1]), K.text("row", b[1])));
      bar.querySelector("output").textContent = S.plural(found.length, "row");
      list.set(found.map(([id, i]) => {
        const href = S.link("history", { s: id });
        return { height: 44, open: () => { location.hash = href; }, draw: () => h("div.line.row", { style: { "--grid": "minmax(0, 1fr) 8rem" }, onclick: (e) => { if (!e.target.closest("a")) location.hash = href; } },
          h("span.text", { role: "rowheader" }, h("a.label", { href }, h("bdi", {}, K.text("row", i))), h("small", {}, h("bdi", {}, ["suite", "scene", "protocol"].map((n) => K.text(n, i)).join(" · ")))),
          h("span", { role: "gridcell" }, S.plural(count.get(id).size, "version"))) };
      }), true);
    };
    return { element: h("section.listing", {}, h("h1.hidden", {}, "History"), bar, list.element), list, filled: fill };
  };
  const shown = (found, values) => {
    const metrics = found.metrics, metric = metrics.includes(values.m) ? values.m : metrics[0];
    if (!metric) return S.empty("No run of this row has finished.");
    const digits = S.digits(metric), changes = new Map((found.changes[metric] ?? []).map((c) => [c.at, c]));
    const box = h("div", {}, h("div.filters.plain", {}, S.choice("Metric", "m", metrics, { value: metric })));
    const points = found.versions.map((v) => v.values[metric] ?? [null, null, null]);
    const labels = found.versions.map((v, n) => `${n + 1} · ${S.commit(v.commit)}`);
    const traces = () => [
      { x: labels, y: points.map((p) => p[0]), mode: "lines+markers", line: { color: S.series(0), width: 1.5 }, marker: { size: 8, color: found.versions.map((_, n) => ({ better: S.colour("good"), worse: S.colour("bad") }[changes.get(n)?.verdict] ?? S.series(0))) },
        error_y: { type: "data", symmetric: false, array: points.map((p) => (p[2] === null ? 0 : p[2] - p[0])), arrayminus: points.map((p) => (p[1] === null ? 0 : p[0] - p[1])), color: S.series(0), thickness: 1 },
        hovertemplate: "%{x}<br>%{y}<extra></extra>", name: metric },
    ];
    const lines = () => [...changes.values()].filter((c) => c.verdict === "better" || c.verdict === "worse").map((c) => ({ type: "line", x0: c.at - 0.5, x1: c.at - 0.5, yref: "paper", y0: 0, y1: 1, line: { color: S.colour(c.verdict === "better" ? "good" : "bad"), width: 1, dash: "dot" } }));
    box.append(S.plot(`${metric} over versions`, traces, () => ({ xaxis: { type: "category" }, yaxis: { title: { text: S.heading(S.known.columns.get(metric) ?? { title: metric }) } }, shapes: lines() }), (p) => { location.hash = S.link("run", { id: found.versions[p.pointIndex].runs[0] }); }));
    box.append(S.note(found.rule), S.table("Versions, the newest first", [
      ["version", (n) => h("span", {}, `${n + 1} · `, h("code", {}, S.commit(found.versions[n].commit))), { text: true }],
      ["last run", (n) => S.date(found.versions[n].ended)],
      [metric, (n) => S.interval(found.versions[n].values[metric], digits)],
      ["change", (n) => { const c = changes.get(n); return c ? [S.verdict(c.verdict), c.low === null ? "" : ` ${S.difference(c.mean, digits, c.relative)} [${S.difference(c.low, digits, c.relative)}, ${S.difference(c.high, digits, c.relative)}]`] : "–"; }, { text: true }],
      ["what changed", (n) => whatChanged(found.versions[n]), { text: true }],
      ["runs", (n) => found.versions[n].runs.map((run, k) => [k ? " " : "", h("a", { href: S.link("run", { id: run }), title: `seed ${S.known.runs.seed[S.known.place.get(run)]}` }, `seed ${S.known.runs.seed[S.known.place.get(run)]}`)]), { text: true }],
      ["", (n) => (n ? h("a", { href: S.link("compare", { a: found.versions[n - 1].side, b: found.versions[n].side }) }, "compare") : ""), { text: true }],
    ], found.versions.map((_, n) => n).reverse()));
    return box;
  };
  const whatChanged = (version) => (version.changed.length ? h("div.changed", {}, version.changed.map(([what, list]) => (list.length
    ? h("details", {}, h("summary", {}, `${what} (${list.length})`), h("dl.values", {}, list.map(([n, a, b]) => [h("dt", {}, h("bdi", {}, n)), h("dd", {}, h("bdi", {}, `${S.plain(a)} → ${S.plain(b)}`))])))
    : h("span", {}, what)))) : "–");
})();
