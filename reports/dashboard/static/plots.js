// Trade-offs of one table: every point is a row, and leads to it.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  let library;
  const plotly = () => (library ??= S.script("app/plotly.min.js").then(() => window.Plotly));
  const layout = (extra) => {
    const ink = S.colour("ink"), soft = S.colour("soft"), line = S.colour("line");
    const axis = (a = {}) => ({ gridcolor: line, zerolinecolor: line, linecolor: line, tickfont: { color: soft }, automargin: true, ...a, title: { standoff: 8, ...a.title, font: { color: soft, size: 12 } } });
    return { paper_bgcolor: "transparent", plot_bgcolor: "transparent", font: { color: ink, size: 12, family: getComputedStyle(document.body).fontFamily }, margin: { l: 56, r: 16, t: 16, b: 48 }, modebar: { bgcolor: "transparent", color: soft, activecolor: ink }, hovermode: "closest", hoverlabel: { font: { size: 12 } }, showlegend: false, ...extra, xaxis: axis(extra.xaxis), yaxis: axis(extra.yaxis) };
  };
  // traces and extra are functions: they are asked again when the theme changes.
  S.plot = (label, traces, extra, onpoint) => {
    const box = h("div.plot", { role: "img", "aria-label": label }, h("p.note", {}, "…"));
    box.draw = async () => {
      try {
        const P = await plotly();
        if (!box.isConnected) return;
        if (!box.classList.contains("js-plotly-plot")) box.replaceChildren();
        // names are text: Plotly reads a little markup in labels and hover texts
        await P.react(box, traces(), layout(extra()), { responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] });
        if (!box.listens) { box.listens = true; box.on("plotly_click", (e) => onpoint?.(e.points[0])); }
      } catch (error) { box.replaceChildren(S.note(`The plot cannot be drawn: ${error.message}`)); }
    };
    requestAnimationFrame(box.draw);
    return box;
  };
  S.redraw = (page) => { for (const box of page.querySelectorAll(".plot")) box.draw?.(); };
  const safe = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
  S.safe = safe;
  // Means over a tenth of the points around each; as they are where there are few.
  const smooth = (values) => {
    const reach = Math.floor(values.length / 20);
    return values.map((one, place) => {
      const near = values.slice(Math.max(0, place - reach), place + reach + 1).filter((v) => typeof v === "number");
      return one === null || !near.length ? one : near.reduce((a, b) => a + b) / near.length;
    });
  };
  // Curves of the runs of some rows of a table.
  S.curves = (table, full, rows) => {
    const runs = rows.flatMap((row) => row.runs.filter((r) => full.curves[r]).map((r) => [row, r]));
    const names = [...new Set(runs.flatMap(([, r]) => Object.keys(full.curves[r])))].filter((n) => n !== "step" && n !== "seconds");
    if (!names.length) return S.note("Nothing was logged while these runs trained.");
    let name = names.find((n) => n === "psnr") ?? names.find((n) => n === "photometric") ?? names[0], over = "seconds", plot;
    const box = h("div", {});
    const seconds = (r) => {
      const curve = full.curves[r];
      if (curve.seconds) return curve.seconds;
      const last = curve.step.at(-1) || 1, total = S.known.value("train_seconds", S.known.place.get(r));
      return total === null || total === undefined ? null : curve.step.map((s) => (s / last) * total);
    };
    const draw = () => {
      // a step's loss is that of one view: a mean over neighbours shows the way, what was measured stays faint behind it
      const traces = () => runs.flatMap(([row, r]) => {
        const x = over === "seconds" ? seconds(r) ?? full.curves[r].step : full.curves[r].step, y = full.curves[r][name];
        const line = (values, width, opacity) => ({ x, y: values, opacity, mode: "lines", name: safe(row.label), line: { width, color: S.series(table.rows.indexOf(row)) }, hovertemplate: `${safe(row.label)} seed ${S.known.runs.seed[S.known.place.get(r)]}<br>%{x:.4g}: %{y:.4g}<extra></extra>` });
        return [line(y, 1, 0.22), line(smooth(y), 1.8, 1)];
      });
      const log = ["loss", "photometric"].includes(name);
      plot = S.plot(`${name} over ${over}`, traces, () => ({ xaxis: { title: { text: over === "seconds" ? "seconds of training" : "step" } }, yaxis: { title: { text: name }, type: log ? "log" : "linear" } }), (p) => { location.hash = S.link("run", { id: runs[p.curveNumber >> 1][1] }); });
      const even = over === "seconds" && runs.some(([, r]) => !full.curves[r].seconds);
      box.replaceChildren(h("div.filters.plain", {}, S.choice("What", "", names, { value: name, onpick: (v) => { name = v; draw(); } }),
        S.segments("Over", [["seconds", "seconds"], ["step", "steps"]], over, (v) => { over = v; draw(); })), plot,
      S.note("Thick: means over a tenth of the points around each. Thin: what was logged."), even ? S.note("Seconds: the run's training time spread evenly over its steps, which is all that the record tells.") : "");
    };
    draw();
    return box;
  };
  const KINDS = { speed: ["render_ms", "speed against error"], rate: ["disk_mb", "rate-distortion"], train: ["train_seconds", "training time against error"], memory: ["peak_memory_mb", "memory against error"] };
  S.views.plots = (values) => {
    const K = S.known, tables = K.runs.tables.filter((t) => t.rows.some((r) => r.runs.length));
    const table = K.tables.get(values.t) ?? tables[0];
    if (!table) return { element: S.empty("No run has finished yet.") };
    const groups = new Map();
    for (const t of tables) { if (!groups.has(t.suite)) groups.set(t.suite, []); groups.get(t.suite).push([t.id, `${S.sceneName(t)} · ${t.protocol}`]); }
    const errors = table.columns.filter((c) => c.better !== null && !["render_ms", "disk_mb", "train_seconds", "peak_memory_mb"].includes(c.key));
    const error = errors.find((c) => c.key === values.y) ?? errors[0] ?? table.columns[0];
    const page = h("section.page", {}, S.title("Plots", h("a", { href: S.tableLink(table) }, h("bdi", {}, `${table.suite} · ${S.sceneName(table)} · ${table.protocol}`))),
      h("div.filters.plain", {}, S.choice("Table", "t", [...groups].map(([group, options]) => ({ group, options })), { value: table.id, wide: true, onpick: (t) => S.change({ t }, false) }),
        S.choice("Error", "y", errors.map((c) => [c.key, S.heading(c)]), { value: error.key })),
      h("ul.legend", {}, table.rows.filter((r) => r.runs.length).map((r) => h("li", {}, S.swatch(table.rows.indexOf(r)), h("a", { href: S.link("row", { t: table.id, r: r.label }) }, h("bdi", {}, r.label))))));
    const grid = h("div.plots", {});
    for (const [key, what] of Object.values(KINDS)) {
      const column = table.columns.find((c) => c.key === key), rows = table.rows.filter((r) => r.cells[key] && r.cells[error.key]);
      if (!column || !rows.length) continue;
      const spread = (r, k, end) => { const c = r.cells[k]; return c[end] === null ? 0 : Math.abs(c[end] - c[0]); };
      const traces = () => rows.map((r) => ({
        x: [r.cells[key][0]], y: [r.cells[error.key][0]], mode: rows.length <= 12 ? "markers+text" : "markers", text: [safe(r.label)], textposition: "top center", textfont: { size: 11, color: S.colour("soft") }, name: safe(r.label),
        marker: { size: 10, color: S.series(table.rows.indexOf(r)), symbol: r.rank === null ? "circle-open" : "circle" }, cliponaxis: false,
        error_y: { type: "data", symmetric: false, array: [spread(r, error.key, 2)], arrayminus: [spread(r, error.key, 1)], color: S.series(table.rows.indexOf(r)), thickness: 1 },
        error_x: { type: "data", symmetric: false, array: [spread(r, key, 2)], arrayminus: [spread(r, key, 1)], color: S.series(table.rows.indexOf(r)), thickness: 1 },
        hovertemplate: `${safe(r.label)}<br>${column.title} %{x:.4g} ${column.unit}<br>${error.title} %{y:.4g} ${error.unit}<extra></extra>`,
      }));
      const many = Math.max(...rows.map((r) => r.cells[key][0])) > 20 * Math.min(...rows.map((r) => r.cells[key][0]));
      grid.append(h("figure", {}, h("figcaption", {}, what), S.plot(`${what}: ${S.plural(rows.length, "row")}`, traces, () => ({ xaxis: { title: { text: S.heading(column) }, type: many ? "log" : "linear" }, yaxis: { title: { text: S.heading(error) } } }), (p) => { location.hash = S.link("row", { t: table.id, r: rows[p.curveNumber].label }); })));
    }
    page.append(grid, S.note("Bars are 95 % intervals over seeds. Open circles are unranked rows. Click a point for its row."));
    if (table.scene) {
      const rest = h("div", {}, h("h2", {}, "Time to quality"));
      page.append(rest);
      S.data(`table/${table.id}`).then((full) => rest.append(S.curves(table, full, table.rows))).catch(S.failed(rest));
    }
    return { element: page, restyle: () => S.redraw(page) };
  };
})();
