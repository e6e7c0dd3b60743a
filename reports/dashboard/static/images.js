// Every scored image of the store, sorted by any metric.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  S.views.images = (values) => {
    const K = S.known;
    const bar = h("form.filters", { role: "search", "aria-label": "Filters", onsubmit: (e) => e.preventDefault() }, S.search(values.q, "Text"),
      ...["suite", "scene", "protocol", "row"].map((n) => S.choice(n[0].toUpperCase() + n.slice(1), n, K.options(n), { value: values[n], any: "all" })));
    const count = h("output.count", { "aria-live": "polite" });
    const list = S.virtual({ label: "Images", draw: (item) => item.draw() });
    const page = h("section.listing", {}, h("h1.hidden", {}, "Images"), bar, list.element);
    let fill = () => {};
    S.imageData().then((all) => {
      const metrics = Object.keys(all.values), by = metrics.includes(values.by) ? values.by : metrics.includes("psnr") ? "psnr" : metrics[0];
      const better = K.columns.get(by)?.better, worst = values.dir !== "best";
      bar.append(S.choice("Sort by", "by", metrics.map((m) => [m, m]), { value: by }),
        S.choice("First", "dir", [["", "worst"], ["best", "best"]], { value: values.dir }), count);
      const matches = S.matches(values.q), narrow = innerWidth < 640;
      const others = metrics.filter((m) => m !== by).slice(0, narrow ? 0 : 4);
      const grid = narrow ? "4.6rem minmax(0, 1fr) 5rem" : `4.6rem minmax(7rem, 1.3fr) minmax(7rem, 1fr) minmax(6rem, 1fr) 3rem 5.4rem ${others.map(() => "5.4rem").join(" ")}`;
      fill = () => {
        const runs = [], wanted = ["suite", "scene", "protocol", "row"].filter((n) => values[n]);
        all.run.forEach((run, r) => {
          const i = K.place.get(run);
          if (i !== undefined && wanted.every((n) => K.text(n, i) === values[n])) runs.push([run, i, all.at.get(run)]);
        });
        // places in the columns and of the runs, as numbers: 100,000 objects would take longer than all else
        const column = all.values[by] ?? [], at = new Uint32Array(all.count), of = new Uint32Array(all.count);
        let total = 0;
        runs.forEach(([, i, { names, start }], r) => {
          const own = values.q ? `${K.text("suite", i)} ${K.text("scene", i)} ${K.text("row", i)} seed${K.runs.seed[i]} ` : "";
          for (let n = 0; n < names.length; n++) if (!values.q || matches(own + names[n])) { at[total] = start + n; of[total++] = r; }
        });
        const down = better === false ? worst : !worst;
        // numbers by their own order, undefined ones last: the general comparison is slow for 100,000
        const key = (v) => (v === null || v === undefined ? (down ? -Infinity : Infinity) : Number(v));
        const keys = new Float64Array(total), order = new Uint32Array(total);
        for (let n = 0; n < total; n++) { keys[n] = key(column[at[n]]); order[n] = n; }
        order.sort(down ? (a, b) => keys[b] - keys[a] || a - b : (a, b) => keys[a] - keys[b] || a - b);
        list.set({ length: total, height: 56, at: (place) => {
          const where = at[order[place]], [run, i, { names, start }] = runs[of[order[place]]], n = where - start;
          return { height: 56, open: () => { location.hash = go(run, names[n]); }, draw: () => line([column[where], run, i, n, names[n], where]) };
        } }, true);
        count.textContent = S.plural(total, "image");
      };
      const go = (run, name) => S.link("view", { t: K.rowOf.get(run)?.[0].id, i: name, a: "truth", b: run });
      const line = ([score, run, i, n, name, at]) => {
        const href = go(run, name);
        return h("div.line.row", { style: { "--grid": grid }, onclick: (e) => { if (!e.target.closest("a")) location.hash = href; } },
          h("span", { role: "gridcell" }, S.thumb(run, name, n)),
          h("span.text", { role: "rowheader" }, h("a.label", { href }, h("bdi", {}, name)), h("small", {}, narrow && [h("bdi", {}, K.text("scene", i)), " · "], h("bdi", {}, narrow ? `${K.text("row", i)}, seed ${K.runs.seed[i]}` : K.text("suite", i)))),
          narrow ? null : [h("span.text", { role: "gridcell" }, h("bdi", {}, K.text("scene", i)), h("small", {}, K.text("protocol", i))), h("span.text", { role: "gridcell" }, h("bdi", {}, K.text("row", i))), h("span", { role: "gridcell" }, K.runs.seed[i])],
          h("span.best", { role: "gridcell" }, S.number(score, S.digits(by)), h("small", {}, by)),
          others.map((m) => h("span", { role: "gridcell" }, S.number(all.values[m][at], S.digits(m)), h("small", {}, m))));
      };
      fill();
    }).catch(S.failed(page));
    return { element: page, list, filled: () => fill() };
  };
  S.thumb = (run, name, place) => {
    const src = S.picture(run, "render", name, place, true);
    if (!src) return h("span.thumb.none", { title: "this page was built without it" });
    const img = h("img.thumb", { src, alt: "", loading: "lazy", decoding: "async", width: 64, height: 48 });
    img.onerror = () => img.replaceWith(h("span.thumb.none", { title: "not in the store" }));
    return img;
  };
})();
