// The leaderboard: every table, one protocol each, as the statistics allow to rank it.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  const FIRST = ["render_ms"]; // speed always stands beside the error
  const ordered = (table) => {
    const [main, ...others] = table.columns;
    const speed = others.filter((c) => FIRST.includes(c.key));
    return [main, ...speed, ...others.filter((c) => !FIRST.includes(c.key))];
  };
  // How many columns fit: the first is wide for its interval.
  const fitting = (table, width, all) => {
    const columns = ordered(table);
    if (all) return columns;
    const left = width < 640 ? width - 310 : width - 680; // what rank, name, first column, interval and seeds take
    return columns.slice(0, 1 + Math.max(1, Math.floor(left / 108)));
  };
  const sorted = (table, key, down) => {
    if (!key) return table.rows;
    const of = key === "label" ? (r) => r.label : key === "seeds" ? (r) => r.seeds : (r) => r.cells[key]?.[0];
    return [...table.rows].sort((a, b) => S.order(of(a), of(b), down));
  };
  S.tableLink = (table) => S.link("board", { suite: table.suite, scene: table.scene || "(mean)", protocol: table.protocol });
  S.sceneName = (table) => table.scene || "mean over scenes";
  S.views.board = (values) => {
    const K = S.known, matches = S.matches(values.q);
    const all = values.columns === "all", down = values.dir === "desc";
    const options = (name, of) => [...new Set(K.runs.tables.map(of))].sort((a, b) => S.order(a, b)).map((t) => (name === "scene" && t === "(mean)" ? [t, "mean over scenes"] : t));
    const labels = [...new Set(K.runs.tables.flatMap((t) => t.rows.map((r) => r.label)))].sort((a, b) => S.order(a, b));
    const bar = h("form.filters", { role: "search", "aria-label": "Filters", onsubmit: (e) => e.preventDefault() },
      S.search(values.q, "Text"),
      S.choice("Suite", "suite", options("suite", (t) => t.suite), { value: values.suite, any: "all" }),
      S.choice("Scene", "scene", options("scene", (t) => t.scene || "(mean)"), { value: values.scene, any: "all" }),
      S.choice("Protocol", "protocol", options("protocol", (t) => t.protocol), { value: values.protocol, any: "all" }),
      S.choice("Row", "row", labels, { value: values.row, any: "all" }),
      h("label.check", {}, h("input", { type: "checkbox", checked: all, onchange: (e) => S.change({ columns: e.target.checked ? "all" : "" }) }), "all columns"),
      h("output.count", { "aria-live": "polite" }));
    const list = S.virtual({ label: "Leaderboard", draw: (item) => item.draw() });
    const fill = () => {
      const items = [], width = list.element.clientWidth || innerWidth;
      let tables = 0, rows = 0;
      for (const table of K.runs.tables) {
        if (values.suite && table.suite !== values.suite) continue;
        if (values.scene && (table.scene || "(mean)") !== values.scene) continue;
        if (values.protocol && table.protocol !== values.protocol) continue;
        const own = sorted(table, values.sort, down).filter((row) =>
          (!values.row || row.label === values.row) && matches(`${table.suite} ${S.sceneName(table)} ${table.protocol} ${row.label}`));
        if (!own.length) continue;
        tables++;
        rows += own.length;
        const columns = fitting(table, width, all), main = table.columns[0], narrow = width < 640;
        const grid = narrow ? `2rem minmax(0, 1fr) 6.7rem ${columns.slice(1).map(() => "5.2rem").join(" ")}`
          : `2.6rem minmax(12rem, 1fr) 9.4rem ${all ? "" : "6.8rem "}${columns.slice(1).map(() => "minmax(5.9rem, 7rem)").join(" ")} 3.4rem`;
        const whiskers = !narrow && !all ? own.length > 1 ? whisker(own, main.key) : () => "" : null;
        items.push({ height: 58, draw: () => head(table) });
        for (const warning of table.warnings) items.push({ height: 26, draw: () => h("div.warning", { title: warning }, h("span", { role: "gridcell" }, `⚠ ${warning}`)) });
        items.push({ height: 44, draw: () => heads(table, columns, grid, values, narrow, whiskers) });
        for (const row of own) items.push({
          height: row.note ? 50 : 34,
          open: () => { location.hash = S.link("row", { t: table.id, r: row.label }); },
          draw: () => line(table, row, columns, grid, narrow, whiskers),
        });
      }
      list.set(items, true);
      bar.querySelector("output").textContent = `${S.plural(rows, "row")} · ${S.plural(tables, "table")}`;
      if (!items.length) list.element.firstChild.replaceChildren(S.empty("Nothing fits these filters. ", h("a", { href: S.link("board") }, "Show all")));
    };
    let width = 0;
    new ResizeObserver(() => { const now = list.element.clientWidth; if (now !== width) { width = now; fill(); } }).observe(list.element);
    return {
      element: h("section.listing", {}, h("h1.hidden", {}, "Leaderboard"), bar, list.element),
      list, filled: fill,
      escape: () => { if (values.q || values.row || values.suite || values.scene || values.protocol) S.change({ q: "", row: "", suite: "", scene: "", protocol: "" }); },
    };
  };
  const head = (table) => h("div.table-head", {},
    h("h2", { role: "gridcell" }, h("a", { href: S.tableLink(table) }, h("bdi", {}, S.sceneName(table))), h("small", {}, h("bdi", {}, `${table.suite} · ${table.protocol}`))),
    h("span.links", { role: "gridcell" }, h("a", { href: S.link("plots", { t: table.id }) }, "plots"),
      table.scene && h("a", { href: S.link("view", { t: table.id }) }, "images")));
  const heads = (table, columns, grid, values, narrow, whiskers) => {
    const sorter = (key, text, about, first) => {
      const on = values.sort === key || (!values.sort && first);
      const down = values.sort ? values.dir === "desc" : table.columns[0].better === true;
      const up = on && !down;
      return h("span", { role: "columnheader", "aria-sort": on ? (up ? "ascending" : "descending") : null, className: key === "label" ? "text" : "" },
        h("button", { type: "button", title: about, onclick: () => S.change({ sort: key, dir: values.sort === key && values.dir !== "desc" ? "desc" : values.sort === key ? "" : startsDown(table, key) ? "desc" : "" }) }, S.breaking(text)));
    };
    return h("div.line.heads", { style: { "--grid": grid } },
      h("span", { role: "columnheader" }, narrow ? "#" : "rank"), sorter("label", "row", "The method with its variant"),
      columns.map((c, i) => [sorter(c.key, S.heading(c), c.about, i === 0), i === 0 && whiskers ? h("span", { role: "columnheader", title: "Mean and 95 % interval of the first column on this table's scale" }, "interval") : null]),
      narrow ? null : sorter("seeds", "seeds", "Finished runs that differ by their random draws alone"));
  };
  const startsDown = (table, key) => table.columns.find((c) => c.key === key)?.better === true;
  const line = (table, row, columns, grid, narrow, whiskers) => h(`div.line.row${row.rank === null ? ".unranked" : ""}`, { style: { "--grid": grid }, onclick: (e) => { if (!e.target.closest("a")) location.hash = S.link("row", { t: table.id, r: row.label }); } },
    h("span.rank", { role: "gridcell" }, row.rank ?? "–"),
    h("span.text", { role: "rowheader" }, h("a.label", { href: S.link("row", { t: table.id, r: row.label }), title: row.label }, h("bdi", {}, row.label)), row.note && h("small", { title: row.note }, row.note)),
    columns.map((c, i) => [h(`span${row.best.includes(c.key) ? ".best" : ""}`, { role: "gridcell" },
      row.cells[c.key] ? (i === 0 ? S.interval(row.cells[c.key], c.digits) : S.number(row.cells[c.key][0], c.digits)) : "–"),
    i === 0 && whiskers ? h("span", { role: "gridcell", "aria-hidden": "true" }, whiskers(row)) : null]),
    narrow ? null : h("span", { role: "gridcell" }, row.seeds));
  // A mark and a bar of each row's interval, all on one scale.
  const whisker = (rows, key) => {
    const ends = rows.flatMap((r) => (r.cells[key] ?? []).map(Number).filter(Number.isFinite));
    const low = Math.min(...ends), high = Math.max(...ends), span = high - low || 1;
    const at = (v) => `${(100 * (v - low)) / span}%`;
    return (row) => {
      const cell = row.cells[key];
      if (!cell || !Number.isFinite(Number(cell[0])) || cell[0] === null) return h("i.whisker");
      const [mean, from, to] = cell;
      return h("i.whisker", {}, from !== null && h("i.bar", { style: { left: at(from), width: `${(100 * (to - from)) / span}%` } }), h("i.dot", { style: { left: at(mean) } }));
    };
  };
  S.orderedColumns = ordered;
})();
