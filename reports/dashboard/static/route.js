// Every view and filter is a link: #/view?name=value.
"use strict";
(() => {
  const S = splatproof;
  S.link = (view, values = {}) => {
    const query = new URLSearchParams();
    for (const [k, v] of Object.entries(values)) if (v !== "" && v !== null && v !== undefined) query.set(k, v);
    const text = query.toString();
    return `#/${view}${text ? `?${text}` : ""}`;
  };
  S.route = () => {
    const [path, query = ""] = location.hash.replace(/^#\/?/, "").split(/\?(.*)/s);
    return { view: path in S.views ? path : "board", values: Object.fromEntries(new URLSearchParams(query)) };
  };
  // Change some values of the link that is shown; typing replaces it, so that "back" leaves the view.
  S.change = (values, replace = true) => {
    const { view, values: old } = S.route();
    const hash = S.link(view, { ...old, ...values });
    if (hash === location.hash) return;
    if (replace) {
      history.replaceState(null, "", hash);
      S.show(true);
    } else location.hash = hash;
  };
})();
