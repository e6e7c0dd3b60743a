// Mouse, touch and keys: orbit, fly, pan, zoom, click a camera, move the split.
"use strict";
(() => {
  const S = splatproof, stage = document.querySelector(".stage"), divider = document.querySelector(".divider");
  const TURN = 0.006, CLICK = 5;
  const pointers = new Map();
  let walked = 0, pinch = null;

  const moved = () => S.frames.wish();
  const pan = (dx, dy) => {
    const perPixel = 2 * S.camera.distance * Math.tan(S.camera.fov * Math.PI / 360) / Math.max(1, stage.clientHeight);
    S.camera.shift(-dx * perPixel, dy * perPixel, 0);
  };
  stage.addEventListener("pointerdown", (event) => {
    if (event.target.closest(".divider")) return;
    stage.focus({ preventScroll: true });
    stage.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size === 1) walked = 0;
    pinch = null;
    stage.classList.add("drags");
  });
  stage.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) {
      const under = S.overlay.at(event.clientX, event.clientY);
      stage.style.setProperty("cursor", under >= 0 ? "pointer" : "");
      if (under !== S.overlay.hovered) { S.overlay.hovered = under; S.overlay.draw(); }
      return;
    }
    const dx = event.clientX - last[0], dy = event.clientY - last[1];
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    walked += Math.abs(dx) + Math.abs(dy);
    if (walked < CLICK) return;
    if (pointers.size === 2) {
      const [a, b] = [...pointers.values()], gap = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (pinch) S.camera.zoom(pinch / Math.max(1, gap));
      pinch = gap;
      pan(dx / 2, dy / 2);
    } else if (event.buttons & 2 || event.shiftKey) {
      pan(dx, dy);
    } else if (S.choice.flies) {
      S.camera.turn(dx * TURN * 0.6, dy * TURN * 0.6, false);
    } else {
      S.camera.turn(-dx * TURN, -dy * TURN, true);
    }
    moved();
  });
  const released = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    if (!pointers.size) stage.classList.remove("drags");
    pinch = null;
    if (event.type === "pointerup" && walked < CLICK) {
      const under = S.overlay.at(event.clientX, event.clientY);
      if (under >= 0) S.beside.open(under);
    }
  };
  stage.addEventListener("pointerup", released);
  stage.addEventListener("pointercancel", released);
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    const steps = event.deltaY * (event.deltaMode ? 30 : 1);
    if (S.choice.flies) S.camera.shift(0, 0, -steps * 1e-3 * S.state.place.radius);
    else S.camera.zoom(Math.exp(steps * 1.2e-3));
    moved();
  }, { passive: false });

  // The split.
  S.setSplit = (share) => {
    S.choice.split = Math.max(0, Math.min(1, share));
    divider.style.setProperty("left", `${100 * S.choice.split}%`);
    divider.setAttribute("aria-valuenow", Math.round(100 * S.choice.split));
    moved();
  };
  divider.addEventListener("pointerdown", (event) => { divider.setPointerCapture(event.pointerId); event.preventDefault(); divider.focus(); });
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    const box = stage.getBoundingClientRect();
    S.setSplit((event.clientX - box.left) / box.width);
  });

  // Keys that are held down move; the others act once.
  const HELD = {
    w: (c, d) => c.shift(0, 0, d), s: (c, d) => c.shift(0, 0, -d), a: (c, d) => c.shift(-d, 0, 0), d: (c, d) => c.shift(d, 0, 0),
    e: (c, d) => c.shift(0, d, 0), q: (c, d) => c.shift(0, -d, 0),
    arrowleft: (c, _, a) => c.turn(a, 0, !S.choice.flies), arrowright: (c, _, a) => c.turn(-a, 0, !S.choice.flies),
    arrowup: (c, _, a) => c.turn(0, a, !S.choice.flies), arrowdown: (c, _, a) => c.turn(0, -a, !S.choice.flies),
    "+": (c, _, a) => c.zoom(Math.exp(-a)), "=": (c, _, a) => c.zoom(Math.exp(-a)), "-": (c, _, a) => c.zoom(Math.exp(a)),
  };
  const down = new Set();
  let before = 0, fast = false;
  const walk = (now) => {
    if (!down.size) { before = 0; return; }
    const seconds = before ? Math.min(0.1, (now - before) / 1000) : 1 / 60;
    before = now;
    const way = S.state.place.radius * 0.5 * seconds * (fast ? 4 : 1);
    for (const key of down) HELD[key](S.camera, way, 1.2 * seconds * (fast ? 2 : 1));
    moved();
    requestAnimationFrame(walk);
  };
  const KEYS = [
    ["drag", "turn round the scene; with f: look around"], ["right drag, Shift drag", "move sideways"], ["wheel, + −", "nearer, farther"],
    ["w a s d, q e", "walk; down and up (Shift: faster)"], ["arrows", "turn"], ["f", "orbit or fly"], ["r", "back to the start"],
    ["1 to 6", "colour, depth, blocks, seams, unseen, error"], ["c", "show or hide the scene's cameras"],
    ["n, p", "next and previous photo beside the render"], ["g", "stand where that photo was taken"], ["x", "split between two models"],
    ["[ ]", "move the split"], ["space", "play time"], ["Esc", "close the photo"], ["t", "light or dark"], ["?", "this list"],
  ];
  S.help = () => {
    const old = document.querySelector("dialog");
    if (old) { old.close(); return; }
    const { h } = S, rows = KEYS.map(([keys, what]) => [h("dt", {}, h("kbd", {}, keys)), h("dd", {}, what)]);
    const dialog = h("dialog", { "aria-labelledby": "help-title", onclose: () => dialog.remove() },
      h("h2", { id: "help-title" }, "Keys"), h("dl.keys", {}, rows),
      h("button.button", { type: "button", onclick: () => dialog.close() }, "Close"));
    dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
    document.body.append(dialog);
    dialog.showModal();
  };
  const ONCE = {
    f: () => S.panel.setFlies(!S.choice.flies), r: () => S.toStart(), c: () => S.panel.setCameras(!S.choice.cameras),
    n: () => S.beside.next(1), p: () => S.beside.next(-1), g: () => S.beside.go(), x: () => S.panel.setSplit(S.choice.other === null),
    "[": () => S.setSplit(S.choice.split - 0.05), "]": () => S.setSplit(S.choice.split + 0.05), " ": () => S.panel.play(),
    escape: () => S.beside.close(), t: () => S.switchTheme(), "?": () => S.help(),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog")) return;
    const key = event.key.toLowerCase(), target = event.target;
    const field = target.closest?.("input, select, textarea");
    if (field && key !== "escape" && (field.tagName !== "INPUT" || field.type === "range" || key.startsWith("arrow") || key === " ")) return;
    if (key === " " && target.closest?.("button")) return;
    if (target === divider && key.startsWith("arrow")) {
      S.setSplit(S.choice.split + (key === "arrowleft" || key === "arrowdown" ? -0.02 : 0.02));
    } else if (HELD[key]) {
      fast = event.shiftKey;
      if (!down.size) requestAnimationFrame(walk);
      down.add(key);
    } else if (ONCE[key]) {
      ONCE[key]();
    } else if (/^[1-9]$/.test(key)) {
      S.panel.setMode(S.state.modes[Number(key) - 1]?.name);
    } else {
      return;
    }
    event.preventDefault();
  });
  document.addEventListener("keyup", (event) => { down.delete(event.key.toLowerCase()); fast = event.shiftKey; });
  window.addEventListener("blur", () => down.clear());
  document.querySelector(".switch").addEventListener("click", () => S.switchTheme());
  document.querySelector(".help").addEventListener("click", () => S.help());
})();
