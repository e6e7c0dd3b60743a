// The runs and tables of the store, with the ways to look them up.
"use strict";
(() => {
  const S = splatproof;
  S.read = (data) => {
    const runs = data.runs;
    const text = (name, i) => runs.texts[name].known[runs.texts[name].of[i]];
    for (const table of runs.tables) {
      table.columns = table.columns.map((place) => runs.columns[place]);
      for (const row of table.rows) row.runs = row.runs.map((place) => runs.run[place]);
    }
    const columns = new Map();
    for (const table of runs.tables) for (const c of table.columns) if (!columns.has(c.key)) columns.set(c.key, c);
    const known = {
      site: data.site, runs, columns, text, count: runs.run.length,
      tables: new Map(runs.tables.map((t) => [t.id, t])),
      place: new Map(runs.run.map((id, i) => [id, i])),
      newest: runs.newest,
      value: (name, i) => runs.values[name]?.[i],
      options: (name) => runs.texts[name].known,
      sides: new Map(data.sides.map((s) => [s.id, s])),
    };
    // where a truth image lies is settled by the data's hash: all runs scored on it have the same pixels
    known.truth = new Map();
    for (const i of runs.newest) {
      const of = runs.texts.data.of[i];
      if (runs.images[i] && !known.truth.has(of) && S.hasPictures(known, runs.run[i])) known.truth.set(of, runs.run[i]);
    }
    known.rowOf = new Map();
    for (const table of runs.tables) {
      if (!table.scene) continue;
      for (const row of table.rows) for (const run of row.runs) known.rowOf.set(run, [table, row]);
    }
    S.known = known;
  };
  S.hasPictures = (known, run) => known.site.pictures === "all" || run in known.site.pictures;
  const stem = (name) => name.replace(/\.[^./]*$/, "").replaceAll("/", "-");
  // Address of a picture: kind is render, truth or error; null where this page was built without it.
  S.picture = (run, kind, image, place, small = false) => {
    const K = S.known, have = K.site.pictures;
    if (kind === "truth") {
      const at = K.place.get(run);
      run = (at === undefined ? null : K.truth.get(K.runs.texts.data.of[at])) ?? run;
    }
    if (have !== "all" && !(have[run] ?? []).includes(place)) return null;
    return `${small ? "thumb" : "picture"}/${run}/${kind}/${encodeURIComponent(stem(image))}.${small ? "jpg" : K.site.format}`;
  };
  // Names and scores of the images of a run.
  S.scores = async (run) => {
    const all = await S.imageData();
    const at = all.at.get(run);
    if (!at) return { names: [], values: {} };
    const values = {};
    const rank = (name) => { const at = [...S.known.columns.keys()].indexOf(name); return at < 0 ? 999 : at; };
    for (const [name, column] of Object.entries(all.values).sort(([a], [b]) => rank(a) - rank(b))) {
      const own = column.slice(at.start, at.start + at.names.length);
      if (own.some((v) => v !== null)) values[name] = own;
    }
    return { names: at.names, values };
  };
  S.imageData = async () => {
    const all = await S.data("images");
    if (!all.at) {
      all.at = new Map();
      let start = 0;
      all.run.forEach((run, i) => {
        const names = all.lists[all.list[i]];
        all.at.set(run, { names, start });
        start += names.length;
      });
      all.count = start;
    }
    return all;
  };
})();
