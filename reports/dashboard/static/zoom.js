// One zoom for several panes: wheel, drag, pinch and keys move all of them alike.
"use strict";
(() => {
  const S = splatproof, MOST = 64;
  S.zoom = (panes) => {
    let scale = 1, x = 0, y = 0; // of a pane's width and height: what stands at its top left corner
    const pointers = new Map();
    const apply = () => {
      x = Math.min(Math.max(x, 0), 1 - 1 / scale);
      y = Math.min(Math.max(y, 0), 1 - 1 / scale);
      for (const pane of panes()) {
        pane.style.setProperty("--zoom", scale);
        pane.style.setProperty("--x", `${-100 * x}%`);
        pane.style.setProperty("--y", `${-100 * y}%`);
        pane.classList.toggle("pixels", scale >= 4);
      }
    };
    const around = (factor, u, v) => {
      const next = Math.min(Math.max(scale * factor, 1), MOST);
      x += u / scale - u / next;
      y += v / scale - v / next;
      scale = next;
      apply();
    };
    const place = (pane, e) => { const r = pane.getBoundingClientRect(); return [(e.clientX - r.left) / r.width, (e.clientY - r.top) / r.height]; };
    return {
      apply, around,
      get scale() { return scale; },
      reset() { scale = 1; x = y = 0; apply(); },
      listen(pane, still) {
        pane.addEventListener("wheel", (e) => { e.preventDefault(); around(2 ** (-e.deltaY / 300), ...place(pane, e)); }, { passive: false });
        pane.addEventListener("pointerdown", (e) => { if (still?.(e)) return; pane.setPointerCapture(e.pointerId); pointers.set(e.pointerId, place(pane, e)); });
        pane.addEventListener("pointermove", (e) => {
          const before = pointers.get(e.pointerId);
          if (!before) return;
          const now = place(pane, e);
          if (pointers.size === 2) {
            const [other] = [...pointers].filter(([id]) => id !== e.pointerId).map(([, p]) => p);
            const size = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1e-6;
            around(size(now) / size(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
          }
          x -= (now[0] - before[0]) / scale / pointers.size;
          y -= (now[1] - before[1]) / scale / pointers.size;
          pointers.set(e.pointerId, now);
          apply();
        });
        for (const end of ["pointerup", "pointercancel"]) pane.addEventListener(end, (e) => pointers.delete(e.pointerId));
        pane.addEventListener("dblclick", () => this.reset());
      },
    };
  };
})();
