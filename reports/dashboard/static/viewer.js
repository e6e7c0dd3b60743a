// Pictures of a scene: any two runs, or a run and the truth, on the same pixels.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  const MODES = [["split", "Split", "1"], ["flip", "Flip", "2"], ["side", "Side by side", "3"], ["error", "Error map", "4"]];
  S.views.view = (values) => {
    const K = S.known, table = K.tables.get(values.t) ?? K.runs.tables.find((t) => t.scene && t.rows.some((r) => r.runs.length));
    if (!table) return { element: S.empty("No picture has been scored yet.") };
    const runs = table.rows.flatMap((row) => row.runs.map((run) => [row, run]));
    const ids = runs.map(([, r]) => r), pick = (v, other) => (v === "truth" || ids.includes(v) ? v : other);
    const a = pick(values.a, "truth"), b = pick(values.b, ids.find((r) => r !== a) ?? ids[0]);
    const mode = MODES.some(([m]) => m === values.mode) ? values.mode : "split";
    const label = (id) => { if (id === "truth") return "truth"; const [row] = runs.find(([, r]) => r === id); return `${row.label} · seed ${K.runs.seed[K.place.get(id)]}`; };
    const options = [["truth", "truth"], ...table.rows.filter((r) => r.runs.length).map((r) => ({ group: r.label, options: r.runs.map((id) => [id, label(id)]) }))];
    const caption = h("div.caption", { "aria-live": "polite" }), stage = h("div.stage"), modes = h("div.modes");
    const list = S.virtual({ label: "Images of the scene", role: "listbox", draw: (item) => item.draw(), onchosen: (item) => { if (item.name !== current) go({ i: item.name }); } });
    const sorter = h("div.sorter");
    const page = h("section.viewer", {},
      h("header.bar", {}, h("h1", {}, h("a", { href: S.tableLink(table) }, h("bdi", {}, S.sceneName(table))), h("small", {}, h("bdi", {}, `${table.suite} · ${table.protocol}`))),
        S.choice("Scene", "t", K.runs.tables.filter((t) => t.scene && t.suite === table.suite).map((t) => [t.id, `${t.scene} · ${t.protocol}`]), { value: table.id, onpick: (t) => S.change({ t, i: "", a: "truth", b: "" }, false) }),
        S.choice("A", "a", options, { value: a, onpick: (v) => go({ a: v }) }), S.choice("B", "b", options, { value: b, onpick: (v) => go({ b: v }) }),
        h("button.button", { type: "button", title: "x", onclick: () => swap() }, "Swap"), modes),
      h("aside", {}, sorter, list.element), h("div.main", {}, stage, caption));
    let current = values.i, flipped = false, now = { a, b, mode, by: values.by ?? "name", dir: values.dir ?? "" }, data, order = [], cut = 50;
    const zoom = S.zoom(() => stage.querySelectorAll(".pane"));
    const go = (change) => {
      const needsOther = "i" in change ? false : true;
      now = { ...now, ...change };
      if (change.i) current = change.i;
      history.replaceState(null, "", S.link("view", { t: table.id, i: current, a: now.a, b: now.b, mode: now.mode === "split" ? "" : now.mode, by: now.by === "name" ? "" : now.by, dir: now.dir }));
      if ("a" in change || "b" in change) return load();
      if ("by" in change || "dir" in change) arrange();
      show();
      return needsOther;
    };
    const swap = () => { const { a, b } = now; for (const [n, v] of [["a", b], ["b", a]]) page.querySelector(`select[name=${n}]`).value = v; go({ a: b, b: a }); };
    const scored = () => (now.b === "truth" ? now.a : now.b);
    const load = async () => {
      const [one, two] = await Promise.all([now.a, now.b].map((id) => (id === "truth" ? null : S.scores(id))));
      const main = two ?? one ?? await S.scores(ids[0]);
      const metrics = Object.keys(main.values);
      data = { one, two, main, metrics };
      const both = one && two ? metrics.filter((m) => one.values[m]) : [];
      const keys = [["name", "name"], ...metrics.map((m) => [m, m]), ...both.map((m) => [`${m}-difference`, `${m}: B − A`])];
      if (!keys.some(([k]) => k === now.by)) now.by = "name";
      sorter.replaceChildren(S.choice("Sort by", "by", keys, { value: now.by, onpick: (by) => go({ by }) }),
        h("button.button", { type: "button", "aria-label": "Turn the order round", title: "turn the order round", onclick: () => go({ dir: now.dir ? "" : "desc" }) }, "⇅"));
      if (!main.names.includes(current)) current = undefined;
      arrange();
      show();
    };
    const score = (side, metric, n) => { if (!side) return null; const at = side.names === data.main.names ? n : side.names.indexOf(data.main.names[n]); return at < 0 ? null : side.values[metric]?.[at] ?? null; };
    const key = (n) => {
      if (now.by === "name") return data.main.names[n];
      const [metric, diff] = now.by.split("-");
      if (!diff) return score(data.main, metric, n);
      const x = score(data.one, metric, n), y = score(data.two, metric, n);
      return x === null || y === null ? null : y - x;
    };
    const arrange = () => {
      const keys = data.main.names.map((_, n) => key(n));
      order = data.main.names.map((_, n) => n).sort((x, y) => S.order(keys[x], keys[y], now.dir === "desc") || x - y);
      if (current === undefined && order.length) current = data.main.names[order[0]];
      const metric = now.by === "name" ? data.metrics[0] : now.by.split("-")[0];
      list.set(order.map((n) => ({ height: 60, name: data.main.names[n], open: () => go({ i: data.main.names[n] }), draw: () => h("div.entry", { role: "option", "aria-selected": "false", onclick: () => list.select(order.indexOf(n)) },
        S.thumb(scored() === "truth" ? ids[0] : scored(), data.main.names[n], n), h("div", {}, h("span.label", { title: data.main.names[n] }, h("bdi", {}, data.main.names[n])), h("small", {}, now.by.endsWith("-difference") ? `${metric} ${S.signed(keys[n], S.digits(metric))}` : metric ? `${metric} ${S.number(score(data.main, metric, n), S.digits(metric))}` : ""))) })));
    };
    const pane = (what, image, tag, kind) => {
      const n = data.main.names.indexOf(image), src = what === "truth" ? S.picture(scored() === "truth" ? ids[0] : scored(), "truth", image, n) : S.picture(what, kind ?? "render", image, n);
      const name = kind === "error" ? `error map of ${label(what)}` : label(what);
      const box = h("div.pane", {}, h("span.tag", {}, tag ? `${tag} · ` : "", h("bdi", {}, name)));
      if (!src) { box.append(h("p.missing", {}, "This page was built without it; the store has it.")); return box; }
      const img = h("img", { src, alt: `${name}: ${image}`, draggable: false });
      img.onerror = () => { img.remove(); box.append(h("p.missing", {}, "The store has no such picture.")); };
      box.prepend(img);
      return box;
    };
    const split = (image) => {
      const box = h("div.both"), under = pane(now.b, image, "B"), over = pane(now.a, image, "A");
      under.classList.add("under");
      over.classList.add("over");
      const slider = h("input.cut", { type: "range", min: 0, max: 100, step: 0.5, value: cut, "aria-label": "How much of the width shows A, in per cent" });
      const handle = h("div.handle", { "aria-hidden": "true" });
      const set = (v) => { cut = Math.min(100, Math.max(0, v)); slider.value = cut; box.style.setProperty("--cut", `${cut}%`); };
      slider.addEventListener("input", () => set(Number(slider.value)));
      let held = false;
      box.addEventListener("pointerdown", (e) => { held = e.target === handle || (zoom.scale === 1 && e.isPrimary); if (held) { move(e); box.setPointerCapture(e.pointerId); } }, true);
      const move = (e) => { const r = box.getBoundingClientRect(); set((100 * (e.clientX - r.left)) / r.width); };
      box.addEventListener("pointermove", (e) => { if (held) move(e); });
      for (const end of ["pointerup", "pointercancel"]) box.addEventListener(end, () => { held = false; });
      box.append(under, over, slider, handle);
      box.nudge = (by) => set(cut + by);
      set(cut);
      return box;
    };
    const show = () => {
      const image = current;
      modes.replaceChildren(S.segments("How to compare", MODES.map(([m, t, k]) => [m, t, `key ${k}`]), now.mode, (m) => go({ mode: m })));
      if (!image) { stage.replaceChildren(S.empty("This run has no scored images.")); return; }
      const place = order.indexOf(data.main.names.indexOf(image));
      const boxes = {
        split: () => [split(image)],
        flip: () => [flipped ? pane(now.b, image, "B") : pane(now.a, image, "A")],
        side: () => [pane(now.a, image, "A"), pane(now.b, image, "B")],
        error: () => [...new Set([now.a, now.b])].filter((id) => id !== "truth").map((id) => pane(id, image, id === now.a ? "A" : "B", "error")),
      }[now.mode]();
      stage.className = `stage ${now.mode}`;
      stage.replaceChildren(...boxes);
      if (now.mode === "flip") { // the other one is fetched now, so that flipping shows it at once
        const ahead = pane(flipped ? now.a : now.b, image);
        ahead.classList.add("ahead");
        ahead.setAttribute("aria-hidden", "true");
        stage.append(ahead);
        boxes[0].addEventListener("click", () => { if (zoom.scale === 1) flip(); });
      }
      for (const box of boxes) zoom.listen(box, box.classList.contains("both") ? (e) => zoom.scale === 1 || e.target.classList.contains("handle") : undefined);
      zoom.apply();
      const n = data.main.names.indexOf(image);
      const scores = (id, side, tag) => (side ? h("div", {}, h("b", {}, tag), " ", h("a", { href: S.link("run", { id }) }, h("bdi", {}, label(id))), " ", data.metrics.map((m) => h("span.score", {}, `${m} `, h("strong", {}, S.number(score(side, m, n), S.digits(m))))), " ", S.recordLink(id)) : null);
      const differences = data.one && data.two ? h("div", {}, h("b", {}, "B − A"), " ", data.metrics.map((m) => { const x = score(data.one, m, n), y = score(data.two, m, n); const d = x === null || y === null ? null : y - x, better = S.known.columns.get(m)?.better; return h(`span.score${d && better !== null && better !== undefined ? ((d > 0) === better ? ".good" : ".bad") : ""}`, {}, `${m} `, h("strong", {}, S.signed(d, S.digits(m)))); })) : null;
      caption.replaceChildren(h("div.which", {}, h("button.button", { type: "button", "aria-label": "Previous image", onclick: () => step(-1) }, "‹"), h("button.button", { type: "button", "aria-label": "Next image", onclick: () => step(1) }, "›"), h("bdi", {}, image), h("small", {}, `${place + 1} of ${order.length}`)),
        ...[scores(now.a, data.one, "A"), scores(now.b, data.two, "B"), differences].filter(Boolean));
      const nextName = data.main.names[order[place + 1]];
      if (nextName) for (const id of [now.a, now.b]) { const src = S.picture(id === "truth" ? scored() : id, id === "truth" ? "truth" : "render", nextName, order[place + 1]); if (src) new Image().src = src; }
      if (list.current?.name !== image) list.select(place);
    };
    const step = (by) => { const place = order.indexOf(data.main.names.indexOf(current)), next = order[(place + by + order.length) % order.length]; if (next !== undefined) go({ i: data.main.names[next] }); };
    const flip = () => { flipped = !flipped; if (now.mode === "flip") show(); else go({ mode: "flip" }); };
    load().catch(S.failed(stage));
    const nudge = (by) => stage.querySelector(".both")?.nudge(by);
    return {
      element: page, list,
      keys: { ArrowLeft: () => step(-1), ArrowRight: () => step(1), f: flip, " ": flip, 1: () => go({ mode: "split" }), 2: () => go({ mode: "flip" }), 3: () => go({ mode: "side" }), 4: () => go({ mode: "error" }), x: swap, "[": () => nudge(-5), "]": () => nudge(5), "+": () => zoom.around(1.5, 0.5, 0.5), "=": () => zoom.around(1.5, 0.5, 0.5), "-": () => zoom.around(1 / 1.5, 0.5, 0.5), 0: () => zoom.reset() },
      escape: () => { if (zoom.scale > 1) zoom.reset(); else history.back(); },
    };
  };
})();
