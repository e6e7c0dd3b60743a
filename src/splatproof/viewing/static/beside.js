// A photo of the scene beside the model from the same camera.
"use strict";
(() => {
  const S = splatproof, WIDEST = 1280;
  let turn = 0, url = "";
  const page = Math.random().toString(36).slice(2);
  const render = async (i) => {
    const view = S.state.views[i], mine = ++turn, { choice } = S;
    const query = new URLSearchParams({ photo: i, width: Math.min(WIDEST, view.width), mode: choice.mode, model: choice.model, quality: 92, page, turn: mine });
    if (choice.light) query.set("light", choice.light);
    const answer = await fetch(`frame?${query}`), image = document.querySelector(".beside img.render"), caption = document.querySelector(".beside .of-render");
    if (mine !== turn || !image || answer.status === 204) return;
    if (!answer.ok) { caption.textContent = (await answer.text()).trim(); return; }
    const { told } = JSON.parse(answer.headers.get("X-Frame"));
    URL.revokeObjectURL(url);
    url = URL.createObjectURL(await answer.blob());
    image.src = url;
    caption.textContent = [S.state.models[choice.model].name, ...Object.entries(told).map(([name, text]) => `${name} ${text}`)].join(" · ");
  };
  S.beside = {
    view: -1,
    open(i) {
      const view = S.state.views[i], box = document.querySelector(".beside"), { h } = S;
      S.beside.view = i;
      box.replaceChildren(
        h("figure", {}, h("img.photo", { src: `photo/${i}`, alt: `Photo ${view.name}` }), h("figcaption", {}, `${view.name} · ${view.trains ? "trained on" : "held out"}`)),
        h("figure", {}, h("img.render", { alt: `Render of ${view.name}` }), h("figcaption.of-render", {}, "…")),
        h("div.acts", {},
          h("button", { type: "button", onclick: () => S.beside.go() }, "Stand there"),
          h("button", { type: "button", onclick: () => S.beside.next(-1) }, "Previous"),
          h("button", { type: "button", onclick: () => S.beside.next(1) }, "Next"),
          h("button", { type: "button", onclick: () => S.beside.close() }, "Close")));
      box.hidden = false;
      render(i);
      S.overlay.draw();
    },
    refresh() { if (S.beside.view >= 0) render(S.beside.view); },
    go() {
      const view = S.state.views[S.beside.view];
      if (!view) return;
      S.camera.stand(view);
      if (view.time !== null && S.choice.time !== null) S.panel.setTime(view.time);
      S.frames.wish();
    },
    next(step) {
      const count = S.state.views.length;
      if (count) S.beside.open((Math.max(S.beside.view, step > 0 ? -1 : 0) + step + count) % count);
    },
    close() {
      S.beside.view = -1;
      turn += 1;
      document.querySelector(".beside").hidden = true;
      S.overlay.draw();
    },
  };
  new ResizeObserver(() => { if (S.frames.shown) S.frames.wish(true); }).observe(document.querySelector(".stage"));
})();
