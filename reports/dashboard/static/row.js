// A row of a table: what its number is made of, and how to have it again.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  S.views.row = (values) => {
    const K = S.known, table = K.tables.get(values.t), row = table?.rows.find((r) => r.label === values.r);
    if (!row) return { element: S.empty("There is no such row any more. ", h("a", { href: S.link("board") }, "Leaderboard")) };
    const places = row.runs.map((r) => K.place.get(r)), first = places[0];
    const about = [h("a", { href: S.tableLink(table) }, h("bdi", {}, `${table.suite} · ${S.sceneName(table)} · ${table.protocol}`)), ` · ${S.plural(row.seeds, "seed")}`];
    const facts = S.orderedColumns(table).slice(0, 8).map((c) => h(`div.fact${row.best.includes(c.key) ? ".best" : ""}`, { title: c.about },
      h("span", {}, S.heading(c)), h("strong", {}, S.interval(row.cells[c.key], c.digits))));
    const side = row.side;
    const page = h("section.page", {},
      S.title(row.label, about,
        table.scene && first !== undefined && S.button("Images", S.link("view", { t: table.id, a: "truth", b: row.runs[0] })),
        S.button("Compare", S.link("compare", { a: side, b: other(table, row)?.side })),
        table.scene && first !== undefined && S.button("History", S.link("history", { s: K.text("series", first) })),
        S.button("Plots", S.link("plots", { t: table.id }))),
      row.note && h("p.warning", {}, row.note),
      table.warnings.map((w) => h("p.warning", {}, w)),
      h("div.facts", {}, h("div.fact", {}, h("span", {}, "rank"), h("strong", {}, row.rank ?? "–")), facts));
    if (first !== undefined) page.append(
      h("h2", {}, "Run it again"),
      S.copied(S.command(table.suite, table.scene || "*", K.text("row", first), table.protocol, "*").replaceAll("[*]", "*")),
      S.note(`The suite's own seeds. Recorded at commit ${[...new Set(places.map((i) => S.commit(K.text("commit", i))))].join(", ")}.`),
      h("h2", {}, "Runs"), runs(table, places));
    const rest = h("div", {});
    page.append(rest);
    S.data(`table/${table.id}`).then((full) => {
      rest.append(differences(table, row, full), settings(table, row, full));
      if (table.scene && first !== undefined) {
        rest.append(h("h2", {}, "While it trained"), S.curves(table, full, [row]));
        rest.append(images(table, row));
      }
    }).catch(S.failed(rest));
    return { element: page, restyle: () => S.redraw(page), escape: () => history.back() };
  };
  const other = (table, row) => table.rows.find((r) => r !== row && r.runs.length);
  const runs = (table, places) => {
    const K = S.known, metrics = table.columns.slice(0, 6).filter((c) => places.some((i) => K.value(c.key, i) !== undefined && K.value(c.key, i) !== null));
    return S.table("Runs behind this row", [
      [table.scene ? "seed" : "scene, seed", (i) => h("a", { href: S.link("run", { id: K.runs.run[i] }) }, table.scene ? `seed ${K.runs.seed[i]}` : h("bdi", {}, `${K.text("scene", i)}, seed ${K.runs.seed[i]}`)), { value: (i) => (table.scene ? K.runs.seed[i] : K.text("scene", i)), text: true }],
      ...metrics.map((c) => [S.heading(c), (i) => S.number(K.value(c.key, i), c.digits), { value: (i) => K.value(c.key, i), title: c.about }]),
      ["ended", (i) => S.date(K.runs.ended[i]), { value: (i) => K.runs.ended[i] }],
      ["commit", (i) => S.commit(K.text("commit", i)), { text: true }],
      ["record", (i) => S.recordLink(K.runs.run[i]), { text: true }],
    ], places);
  };
  const differences = (table, row, full) => {
    const me = table.rows.indexOf(row), main = table.columns[0], found = [];
    // places in the file are those of the table
    for (const [one, two, mean, low, high, verdict, count, detectable] of full.differences) {
      if (one !== me && two !== me) continue;
      const sign = one === me ? 1 : -1, ends = [sign * low, sign * high].sort((a, b) => a - b);
      found.push({ other: table.rows[one === me ? two : one], mean: sign * mean, low: low === null ? null : ends[0], high: low === null ? null : ends[1], verdict: { higher: sign > 0 ? "higher" : "lower", lower: sign > 0 ? "lower" : "higher" }[verdict] ?? verdict, count, detectable });
    }
    if (!found.length) return h("div");
    const good = (v) => (v === "higher" || v === "lower" ? ((v === "higher") === (main.better !== false) ? "better" : "worse") : v);
    return h("div", {}, h("h2", {}, `Against the other rows in ${main.title}`), S.table(`This row minus the other, ${S.heading(main)}, 95 % interval over images and seeds`, [
      ["other row", (d) => h("a", { href: S.link("row", { t: table.id, r: d.other.label }) }, h("bdi", {}, d.other.label)), { text: true, value: (d) => d.other.label }],
      ["verdict", (d) => S.verdict(good(d.verdict)), { text: true, value: (d) => d.verdict }],
      ["difference", (d) => S.signed(d.mean, main.digits), { value: (d) => d.mean }],
      ["interval", (d) => (d.low === null ? "–" : `[${S.signed(d.low, main.digits)}, ${S.signed(d.high, main.digits)}]`)],
      ["would have shown", (d) => S.number(d.detectable, main.digits), { title: "Smallest true difference that such samples show in 80 % of all experiments" }],
      ["", (d) => h("a", { href: S.link("compare", { a: d.other.side, b: row.side }) }, "compare"), { text: true }],
    ], found));
  };
  const settings = (table, row, full) => {
    const own = full.settings.values[row.label] ?? {}, names = Object.keys(own);
    const odd = new Set(full.settings.odd);
    const list = (chosen) => h("dl.values", {}, chosen.map((n) => [h("dt", {}, h("bdi", {}, n)), h("dd", {}, h("bdi", {}, S.plain(own[n])))]));
    const differing = names.filter((n) => odd.has(n));
    return h("div", {}, h("h2", {}, "Settings"),
      differing.length ? [S.note("What differs between the rows of this table:"), S.table("Settings that differ", [
        ["setting", (n) => h("bdi", {}, n), { text: true }], ["this row", (n) => h("bdi", {}, S.plain(own[n])), { text: true }],
        ["other rows", (n) => h("bdi", {}, [...new Set(table.rows.filter((r) => r !== row).map((r) => full.settings.values[r.label]?.[n]).filter((v) => v !== undefined).map(S.plain))].join(" | ") || "not a setting of theirs"), { text: true }],
      ], differing)] : S.note("No setting differs from the other rows."),
      h("details", {}, h("summary", {}, `All ${names.length} settings`), list(names)),
      h("details", {}, h("summary", {}, `Rules of protocol ${table.protocol}`), h("dl.values", {}, Object.entries(full.rules).map(([n, v]) => [h("dt", {}, n), h("dd", {}, h("bdi", {}, S.plain(v)))]))));
  };
  const images = (table, row) => {
    const box = h("div", {}, h("h2", {}, "Images"));
    const run = row.runs[0];
    S.scores(run).then(({ names, values }) => {
      const metrics = Object.keys(values);
      box.append(S.note(`Seed ${S.known.runs.seed[S.known.place.get(run)]}; choose any run and any pair in the viewer.`), S.table(`${S.plural(names.length, "scored image")}`, [
        ["image", (n) => h("a.pictured", { href: S.link("view", { t: table.id, i: names[n], a: "truth", b: run }) }, S.thumb(run, names[n], n), h("bdi", {}, names[n])), { text: true, value: (n) => names[n] }],
        ...metrics.map((m) => [m, (n) => S.number(values[m][n], S.digits(m)), { value: (n) => values[m][n] }]),
      ], names.slice(0, 400).map((_, n) => n)), names.length > 400 ? S.note(h("a", { href: S.link("images", { suite: table.suite, scene: table.scene, protocol: table.protocol }) }, `All ${names.length} images`)) : "");
    }).catch(S.failed(box));
    return box;
  };
})();
