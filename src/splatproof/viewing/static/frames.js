// Asks for frames: smaller ones while something moves, a sharp one when it stands still.
"use strict";
(() => {
  const S = splatproof, WISHED_MS = 66, STILL_MS = 160, WIDEST = 1600, AT_ONCE = 2;
  const page = Math.random().toString(36).slice(2);
  let turn = 0, asked = 0, moved = 0, dirty = true, sharp = false, scale = 0.6, timer = 0;

  const address = (size, camera, quality) => {
    const { choice } = S, three = (v) => v.map((x) => x.toPrecision(9)).join(",");
    const query = new URLSearchParams({
      eye: three(camera.eye), forward: three(camera.forward), up: three(camera.up), fov: camera.fov.toPrecision(9),
      width: size[0], height: size[1], mode: choice.mode, model: choice.model, quality, page, turn: ++turn,
    });
    if (choice.other !== null) { query.set("other", choice.other); query.set("split", choice.split.toFixed(4)); }
    if (choice.time !== null) query.set("time", choice.time.toFixed(4));
    if (choice.light) query.set("light", choice.light);
    return `frame?${query}`;
  };
  const wanted = (still) => {
    const box = document.querySelector(".stage").getBoundingClientRect(), dots = Math.min(2, devicePixelRatio || 1);
    const width = Math.max(16, Math.min(WIDEST, Math.round(box.width * dots * (still ? 1 : scale / dots))));
    return [width, Math.max(16, Math.min(WIDEST, Math.round(width * box.height / Math.max(1, box.width))))];
  };
  const trouble = (text) => {
    const line = document.querySelector(".trouble");
    line.textContent = text;
    line.hidden = !text;
  };
  const take = async (mine, camera, still, size, answer, began) => {
    if (answer.status === 204) return;
    if (!answer.ok) throw new Error((await answer.text()).trim());
    const facts = JSON.parse(answer.headers.get("X-Frame")), image = await createImageBitmap(await answer.blob());
    const ms = performance.now() - began;
    if (!still) scale = Math.max(0.15, Math.min(1, scale * Math.min(1.15, Math.max(0.75, Math.sqrt(WISHED_MS / facts.render_ms)))));
    if (S.frames.shown && mine < S.frames.shown.turn) return;
    trouble("");
    S.frames.shown = { turn: mine, camera, still, size, facts, ms, image };
    S.frames.count += 1;
    S.frames.paint();
    S.overlay.draw();
    S.panel.tell(S.frames.shown);
  };
  const ask = async (still) => {
    const camera = S.camera.now(), size = wanted(still), path = address(size, camera, still ? 92 : 80), mine = turn;
    asked += 1;
    const began = performance.now();
    try {
      await take(mine, camera, still, size, await fetch(path), began);
    } catch (error) {
      trouble(error instanceof TypeError ? "The viewer does not answer; is bench view still running?" : error.message);
    } finally {
      asked -= 1;
      pump();
    }
  };
  const pump = () => {
    clearTimeout(timer);
    const still = performance.now() - moved >= STILL_MS;
    if (dirty && asked < AT_ONCE && !still) { dirty = false; sharp = false; ask(false); return; }
    if (still && !sharp && asked === 0) { dirty = false; sharp = true; ask(true); return; }
    if (!sharp) timer = setTimeout(pump, Math.max(5, STILL_MS - (performance.now() - moved)));
  };
  S.frames = {
    shown: null, count: 0,
    // Something that the picture depends on has changed; `still`: nothing moves, so a sharp one at once.
    wish(still = false) {
      dirty = true;
      sharp = false;
      if (!still) moved = performance.now();
      pump();
    },
    // Whether the sharp frame of what is wished now is on the page.
    rests() { return sharp && !dirty && asked === 0 && Boolean(S.frames.shown?.still); },
    paint() {
      const canvas = document.querySelector("canvas.picture"), { image } = S.frames.shown;
      canvas.width = image.width;
      canvas.height = image.height;
      canvas.getContext("2d").drawImage(image, 0, 0);
    },
  };
})();
