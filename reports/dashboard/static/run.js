// One run: its record as it is.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  S.views.run = (values) => {
    const K = S.known, i = K.place.get(values.id);
    if (i === undefined) return { element: S.empty("There is no such run in this store. ", h("a", { href: S.link("runs") }, "Runs")) };
    const of = (n) => K.text(n, i), seed = K.runs.seed[i], [table, row] = K.rowOf.get(values.id) ?? [];
    const page = h("section.page", {}, S.title(`${of("row")}, seed ${seed}`, h("bdi", {}, `${of("suite")} · ${of("scene")} · ${of("protocol")} · ended ${S.date(K.runs.ended[i])}`),
      row && S.button("Its row", S.link("row", { t: table.id, r: row.label })),
      row && S.button("Images", S.link("view", { t: table.id, a: "truth", b: values.id })),
      S.button("History", S.link("history", { s: of("series") })),
      h("a.button", { href: `record/${values.id}.json`, target: "_blank", rel: "noopener" }, "record.json")),
    of("error") && h("p.warning", {}, `failed: ${of("error")}`),
    !row && !of("error") && h("p.warning", {}, "A later run of this case stands in the leaderboard."),
    h("h2", {}, "Run it again"), S.copied(S.command(of("suite"), of("scene"), of("row"), of("protocol"), seed)),
    of("commit") && S.note("Recorded at commit ", h("code", {}, of("commit")), "."));
    const rest = h("div", {});
    page.append(rest);
    S.data(`run/${values.id}`).then((record) => {
      const values = (title, pairs, open) => h("details", { open }, h("summary", {}, title), h("dl.values", {}, pairs.map(([n, v]) => [h("dt", {}, h("bdi", {}, n)), h("dd", {}, h("bdi", {}, S.plain(v)))])));
      rest.append(
        values("Scores and costs", [...Object.entries(record.metrics).map(([n, v]) => [n, S.number(v, S.digits(n))]), ["render [ms]", S.number(record.render_ms, 2)], ["primitives", S.number(record.primitives, 0)], ["disk [MB]", S.number(record.bytes_on_disk / 2 ** 20, 2)], ["peak memory [MB]", S.number(record.peak_memory_mb, 0)], ["CPU seconds", S.number(record.cpu_seconds, 1)]], true),
        values("Seconds by stage", Object.entries(record.stages).map(([n, v]) => [n, S.number(v, 2)]), true),
        values("Settings", flat(record.settings)), values("Protocol", flat(record.protocol_rules)),
        values("Environment", Object.entries(record.environment), true), values("Scene", Object.entries(record.scene_facts)),
        values("Hashes", [["split", record.split_sha256], ["model", record.model_sha256]]),
        record.left_out.length ? values("Photos left out", record.left_out) : "");
    }).catch(S.failed(rest));
    return { element: page, escape: () => history.back() };
  };
  const flat = (o, before = "") => Object.entries(o).flatMap(([k, v]) => (v && typeof v === "object" && !Array.isArray(v) ? flat(v, `${before}${k}.`) : [[before + k, v]]));
})();
