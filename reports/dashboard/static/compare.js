// Two rows, or one row at two commits: a verdict for each scene and metric.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  const named = (s) => (s.kind === "row" ? s.label : `${s.label} at ${S.commit(s.commit)}`);
  S.views.compare = (values) => {
    const K = S.known, all = [...K.sides.values()];
    const a = K.sides.get(values.a) ?? all[0], b = K.sides.get(values.b) ?? all.find((s) => s !== a && fits(s, a)) ?? a;
    if (!a) return { element: S.empty("No run has finished yet.") };
    const groups = (list) => {
      const found = new Map();
      for (const s of list) { const key = `${s.suite} · ${s.protocol}${s.kind === "row" ? "" : " · commits"}`; if (!found.has(key)) found.set(key, []); found.get(key).push([s.id, named(s)]); }
      return [...found].map(([group, options]) => ({ group, options }));
    };
    const fitting = all.filter((s) => fits(s, a));
    const bar = h("div.filters.plain", {}, S.choice("Base (A)", "a", groups(all), { value: a.id, wide: true, onpick: (id) => S.change({ a: id, b: fits(K.sides.get(id), b) ? b.id : "" }, false) }),
      S.choice("New (B)", "b", groups(fitting), { value: b.id, wide: true, onpick: (id) => S.change({ a: a.id, b: id }, false) }),
      S.button("Swap", S.link("compare", { a: b.id, b: a.id })));
    const page = h("section.page", {}, S.title("Compare", "Is B better than A? Paired over images, and over seeds"), bar);
    if (a === b) page.append(S.empty("Choose another row for B."));
    else S.data(`compare/${a.id}~${b.id}`).then((found) => page.append(shown(found, a, b, values))).catch(() => page.append(K.site.mode === "static"
      ? S.empty("This pair was not computed when the page was built: `bench dashboard` computes any pair on demand.") : S.empty("The server does not answer: is `bench dashboard` still running?")));
    return { element: page, escape: () => history.back() };
  };
  const fits = (s, a) => s.suite === a.suite && s.protocol === a.protocol && s.rules === a.rules;
  const shown = (found, a, b, values) => {
    const counts = {};
    for (const r of found.rows) counts[r.verdict] = (counts[r.verdict] ?? 0) + 1;
    const scene = values.scene ?? "", rows = found.rows.filter((r) => !scene || r.scene === scene);
    const images = (r) => { const t = S.known.tables.get(r.table); return t && r.runs[0] && r.runs[1] ? h("a", { href: S.link("view", { t: t.id, a: r.runs[0], b: r.runs[1], by: `${r.metric}-difference` }) }, "images") : ""; };
    return h("div", {},
      h("p.summary", {}, ["better", "worse", "equal", "undecided"].filter((v) => counts[v]).map((v) => h("span", {}, S.verdict(v), ` ${counts[v]} `))),
      found.notes.map((n) => h("p.warning", {}, n)),
      S.choice("Scene", "scene", [...new Set(found.rows.map((r) => r.scene))], { value: scene, any: "all" }),
      S.table("Verdict for each scene and metric", [
        ["metric", (r) => h("bdi", {}, r.metric), { text: true, value: (r) => r.metric }],
        ["scene", (r) => h("bdi", {}, r.scene), { text: true, value: (r) => r.scene }],
        ["verdict", (r) => h("span", { title: r.reason }, S.verdict(r.verdict)), { text: true, value: (r) => r.verdict }],
        ["A", (r) => S.number(r.a, r.digits), { value: (r) => r.a }], ["B", (r) => S.number(r.b, r.digits), { value: (r) => r.b }],
        ["B − A", (r) => S.difference(r.mean, r.digits, r.relative && r.low !== null), { value: (r) => r.mean }],
        ["interval", (r) => (r.low === null ? "–" : `[${S.difference(r.low, r.digits, r.relative)}, ${S.difference(r.high, r.digits, r.relative)}]`)],
        ["would have shown", (r) => (r.relative ? S.difference(r.detectable, r.digits, true) : S.number(r.detectable, r.digits)), { title: "Smallest true difference that such samples show in 80 % of all experiments" }],
        ["p", (r) => (r.p !== null && r.p < 0.0001 ? "< 0.0001" : S.number(r.p, 4)), { value: (r) => r.p, title: found.correction }],
        ["seeds", (r) => r.seeds.join(" / ")], ["", images, { text: true }],
      ], rows), S.note(found.correction),
      h("h2", {}, "What differs"), found.differed.length ? S.table("Between A and B", [["what", (d) => h("bdi", {}, d[0]), { text: true }], ["A", (d) => h("bdi", {}, S.plain(d[1])), { text: true }], ["B", (d) => h("bdi", {}, S.plain(d[2])), { text: true }]], found.differed) : S.note("Neither commit, settings, environment nor data."),
      h("h2", {}, "Runs"), [["A", a, found.runs[0]], ["B", b, found.runs[1]]].map(([side, s, ids]) => h("p", {}, `${side}, `, h("bdi", {}, named(s)), ": ", ids.map((id) => { const i = S.known.place.get(id); return [h("a", { href: S.link("run", { id }) }, h("bdi", {}, `${S.known.text("scene", i)} seed ${S.known.runs.seed[i]}`)), " "]; }))));
  };
})();
