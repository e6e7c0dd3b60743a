// What papers claim, and what the store's runs say of it.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  const ORDER = ["holds", "direction only", "no difference", "undecided", "contradicted", "too short to judge", "not testable here"];
  S.views.claims = (values) => {
    const page = h("section.page", {}, S.title("Claims", "What is printed of two rows, judged by the runs of this store"));
    S.data("claims").then(({ claims }) => {
      if (!claims.length) { page.append(S.empty("No suite of this store has claims.")); return; }
      const matches = S.matches(values.q), counts = {};
      for (const c of claims) counts[c.verdict] = (counts[c.verdict] ?? 0) + 1;
      const rows = claims.filter((c) => (!values.verdict || c.verdict === values.verdict) && (!values.paper || c.paper === values.paper) && matches(`${c.paper} ${c.text} ${c.row} ${c.other} ${c.metric} ${c.verdict}`));
      const number = (c, v) => (v === null ? "–" : c.relative ? `${S.signed(100 * v, 1)} %` : S.signed(v, S.digits(c.metric)));
      page.append(
        h("div.filters.plain", {}, S.search(values.q, "Text"), S.choice("Verdict", "verdict", ORDER.filter((v) => counts[v]).map((v) => [v, `${v} (${counts[v]})`]), { value: values.verdict, any: "all" }), S.choice("Paper", "paper", [...new Set(claims.map((c) => c.paper))], { value: values.paper, any: "all" })),
        h("div.cards", {}, rows.map((c) => h("article.claim", {}, h("header", {}, S.verdict(c.verdict), h("small", {}, `${c.paper} · ${c.suite}`)),
          h("p", {}, h("bdi", {}, c.text)), h("p.about", {}, h("bdi", {}, `${c.row} against ${c.other} in ${c.metric}`)),
          h("dl.values", {}, h("dt", {}, "claimed"), h("dd", {}, c.printed === null ? c.bar === null ? c.better : `at least ${number(c, c.bar)}` : number(c, c.printed)),
            h("dt", {}, "measured"), h("dd", {}, c.mean === null ? "–" : `${number(c, c.mean)}${c.low === null ? "" : ` [${number(c, c.low)}, ${number(c, c.high)}]`}`), h("dt", {}, "seeds"), h("dd", {}, c.seeds), h("dt", {}, "why"), h("dd", {}, c.reason)),
          h("footer", {}, c.links.map((l) => [l.sides && h("a", { href: S.link("compare", { a: l.sides[0], b: l.sides[1] }) }, "compare"), " ", l.table && l.runs[0] && l.runs[1] && h("a", { href: S.link("view", { t: l.table, a: l.runs[0], b: l.runs[1] }) }, `images of ${l.scene}`), " "]))))),
        rows.length ? "" : S.empty("Nothing fits these filters."));
    }).catch(S.failed(page));
    return { element: page };
  };
})();
