// The frame around the views: it loads the index, follows links and says where the data is from.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  const NAV = [["board", "Leaderboard"], ["runs", "Runs"], ["images", "Images"], ["plots", "Plots"], ["history", "History"], ["compare", "Compare"], ["claims", "Claims"]];
  const WITHIN = { row: "board", run: "runs", view: "images" };
  const main = document.querySelector("main");
  S.failed = (box) => (error) => { box.append(h("p.warning", { role: "alert" }, `This part cannot be shown: ${error.message}. Is \`bench dashboard\` still running?`)); };
  S.show = (again = false) => {
    const { view, values } = S.route();
    const focus = again && document.activeElement?.name ? document.activeElement : null;
    const top = again && S.view?.list ? S.view.list.element.scrollTop : 0;
    document.querySelector("dialog")?.close();
    S.view = S.views[view](values);
    main.replaceChildren(S.view.element);
    main.className = `is-${view}`;
    S.view.filled?.();
    if (top && S.view.list) S.view.list.element.scrollTop = 0;
    for (const link of document.querySelectorAll("nav a")) {
      if (link.dataset.view === (WITHIN[view] ?? view)) link.setAttribute("aria-current", "page");
      else link.removeAttribute("aria-current");
    }
    const title = main.querySelector("h1")?.textContent;
    document.title = `${title ? `${title} · ` : ""}splatproof`;
    if (focus) {
      const same = main.querySelector(`[name="${CSS.escape(focus.name)}"]`);
      same?.focus({ preventScroll: true });
      if (same?.setSelectionRange && same.type === "search") same.setSelectionRange(focus.selectionStart, focus.selectionEnd);
    } else if (!again) main.focus({ preventScroll: true });
    document.dispatchEvent(new CustomEvent("splatproof:shown", { detail: view }));
  };
  const frame = () => {
    document.querySelector("nav").replaceChildren(...NAV.map(([view, text]) => h("a", { href: S.link(view), "data-view": view }, text)));
    document.querySelector(".switch").onclick = () => S.switchTheme();
    document.querySelector(".help").onclick = S.help;
    const { site } = S.known, about = document.querySelector(".about-store");
    about.replaceChildren(...[S.plural(S.known.count, "run"), S.plural(site.images, "image"), site.uri, `${site.mode === "static" ? "built" : "read"} ${S.date(site.made)}`, `splatproof ${site.version}`].map((t) => h("span", {}, h("bdi", {}, t))), ...(site.left_out ? [h("span", {}, site.left_out)] : []), ...(site.reading ? [h("span", {}, "new runs are being read: refresh in a while")] : []));
    if (site.mode === "served") about.append(h("button.linklike", { type: "button", onclick: refresh }, "refresh"));
  };
  const refresh = async () => {
    S.loaded.clear();
    S.waiting.clear();
    await begin(true);
  };
  const begin = async (fresh) => {
    try {
      S.read(await S.data("index", fresh));
      frame();
      S.show();
      performance.mark("splatproof:listed");
    } catch (error) {
      console.error(error);
      main.replaceChildren(S.empty(`The store cannot be shown: ${error.message}`));
    }
  };
  addEventListener("hashchange", () => S.show());
  // what the first view needs besides is fetched beside the index, not after it
  if (["images", "view"].includes(S.route().view)) S.data("images").catch(() => {});
  begin(false);
})();
