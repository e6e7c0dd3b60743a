// Parts that several views are made of.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  // A select that writes its choice into the link. options: texts, or [value, text] pairs, or {group, options}.
  S.choice = (label, name, options, { value, any, onpick, wide } = {}) => {
    const one = (o) => (o.options ? h("optgroup", { label: o.group }, o.options.map(one))
      : h("option", { value: Array.isArray(o) ? o[0] : o }, Array.isArray(o) ? o[1] : o));
    const select = h("select", { name }, any !== undefined && h("option", { value: "" }, any), options.map(one));
    select.value = value ?? "";
    if (select.selectedIndex < 0) select.selectedIndex = 0;
    select.addEventListener("change", () => (onpick ? onpick(select.value) : S.change({ [name]: select.value })));
    return h(`label.field${wide ? ".wide" : ""}`, {}, h("span", {}, label), select);
  };
  S.search = (value, what, onpick) => {
    let wait;
    const input = h("input", { type: "search", name: "q", value: value ?? "", placeholder: "Filter  /", autocomplete: "off", spellcheck: false });
    input.addEventListener("input", () => {
      clearTimeout(wait);
      wait = setTimeout(() => (onpick ? onpick(input.value) : S.change({ q: input.value })), 120);
    });
    return h("label.field.search", {}, h("span", {}, what), input);
  };
  // Buttons of which one is pressed.
  S.segments = (label, options, value, onpick) => h("div.segments", { role: "group", "aria-label": label },
    options.map(([key, text, title]) => h("button", { type: "button", title, "aria-pressed": String(key === value), "data-value": key, onclick: () => onpick(key) }, text)));
  S.matches = (query) => {
    const words = (query ?? "").toLowerCase().split(/\s+/).filter(Boolean);
    return (text) => { const low = text.toLowerCase(); return words.every((w) => low.includes(w)); };
  };
  // A short table of elements; columns: [heading, of(row), {text}].
  S.table = (caption, columns, rows, { sort } = {}) => {
    const body = h("tbody"), heads = [];
    let by = sort?.[0] ?? -1, down = sort?.[1] ?? false;
    const fill = () => {
      const list = rows.map((r) => r);
      if (by >= 0) {
        const of = columns[by][2]?.value ?? columns[by][1];
        list.sort((a, b) => S.order(of(a), of(b), down));
      }
      body.replaceChildren(...list.map((row) => h("tr", {}, columns.map(([, of, how], i) => {
        const cell = of(row);
        return h(i === 0 ? "th" : "td", { scope: i === 0 ? "row" : null, className: how?.text ? "text" : "" }, cell);
      }))));
      heads.forEach((th, i) => { if (i === by) th.setAttribute("aria-sort", down ? "descending" : "ascending"); else th.removeAttribute("aria-sort"); });
    };
    const head = h("tr", {}, columns.map(([name, , how], i) => {
      const th = h("th", { scope: "col", className: how?.text ? "text" : "", title: how?.title },
        how?.value ? h("button", { type: "button", onclick: () => { down = by === i ? !down : false; by = i; fill(); } }, name) : name);
      heads.push(th);
      return th;
    }));
    fill();
    return h("div.scroll", { tabIndex: 0, role: "region", "aria-label": caption }, h("table", {}, h("caption", {}, caption), h("thead", {}, head), body));
  };
  // Undefined values stand last whichever way a column is sorted.
  S.order = (a, b, down) => {
    const none = (v) => v === null || v === undefined || (typeof v === "number" && Number.isNaN(v)) || v === "";
    if (none(a) || none(b)) return none(a) - none(b);
    const [x, y] = [a, b].map((v) => (typeof v === "string" && v.endsWith("Infinity") ? Number(v) : v));
    const sign = down ? -1 : 1;
    return sign * (typeof x === "string" ? x.localeCompare(y, "en", { numeric: true }) : x - y);
  };
  S.copied = (text) => {
    const button = h("button.copy", { type: "button", "aria-label": `Copy: ${text}`, title: "Copy" }, "copy");
    button.onclick = async () => {
      try { await navigator.clipboard.writeText(text); button.textContent = "copied"; }
      catch { getSelection().selectAllChildren(code); button.textContent = "marked"; }
      setTimeout(() => { button.textContent = "copy"; }, 1500);
    };
    const code = h("code", {}, text);
    return h("div.command", {}, code, button);
  };
  S.swatch = (i) => h("i.swatch", { "aria-hidden": "true", style: { "--c": `var(--c${i % 8})` } });
  S.verdict = (text) => h(`span.verdict.${text.replaceAll(" ", "-")}`, {}, text);
  S.note = (...text) => h("p.note", {}, ...text);
  S.empty = (...text) => h("div.empty", {}, ...text);
  S.title = (title, about, ...actions) => h("header.title", {}, h("div", {}, h("h1", {}, h("bdi", {}, title)), about && h("p.about", {}, about)), h("div.actions", {}, actions));
  S.button = (text, href, title) => h("a.button", { href, title }, text);
  S.recordLink = (run, text = "record.json") => h("a", { href: `record/${run}.json`, target: "_blank", rel: "noopener" }, text);
  // Number of differing values -> the plain text of one
  S.plain = (value) => (Array.isArray(value) ? (value.length ? value.map(S.plain).join(", ") : "none") : value === null ? "none" : typeof value === "object" ? JSON.stringify(value) : String(value));
})();
