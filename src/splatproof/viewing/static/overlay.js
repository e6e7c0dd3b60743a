// The scene's cameras drawn over the picture, and which of them is under the pointer.
"use strict";
(() => {
  const S = splatproof, V = S.vector, REACH = 16;
  let placed = [];
  const frustum = (view, size) => {
    const [right, down, forward] = view.rotation, [fx, fy] = view.focal;
    const corner = (x, y) => V.add(view.centre, V.add(V.mul(forward, size),
      V.add(V.mul(right, x * size * view.width / 2 / fx), V.mul(down, y * size * view.height / 2 / fy))));
    return [view.centre, corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1), corner(0, -1.35)];
  };
  const EDGES = [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1], [1, 5], [5, 2]];
  // A frustum for a camera stands a fifth of the usual distance between neighbours wide.
  const usualSize = (views, radius) => {
    if (views.length < 2) return 0.1 * radius;
    const some = views.filter((_, i) => i % Math.ceil(views.length / 60) === 0);
    const gaps = some.map((v) => Math.min(...views.filter((w) => w !== v).map((w) => Math.hypot(...V.sub(v.centre, w.centre)))));
    gaps.sort((a, b) => a - b);
    return Math.min(0.12 * radius, Math.max(0.01 * radius, 0.5 * gaps[gaps.length >> 1]));
  };
  let size = 0;
  S.overlay = {
    hovered: -1,
    prepare() { size = usualSize(S.state.views, S.state.place.radius); },
    draw() {
      const canvas = document.querySelector("canvas.overlay"), box = canvas.getBoundingClientRect(), scale = devicePixelRatio || 1;
      canvas.width = Math.round(box.width * scale);
      canvas.height = Math.round(box.height * scale);
      const pen = canvas.getContext("2d"), camera = S.frames.shown?.camera;
      pen.scale(scale, scale);
      placed = [];
      if (!camera || !S.choice.cameras) return;
      const extent = [box.width, box.height], near = 0.02 * size;
      S.state.views.forEach((view, i) => {
        const points = frustum(view, size).map((p) => S.project(camera, extent, p));
        if (points.some((p) => p[2] < near)) return; // a camera that one stands in hides the picture
        const [x, y] = points[0].map((_, k) => (points[1][k] + points[3][k]) / 2);
        if (x < -50 || y < -50 || x > extent[0] + 50 || y > extent[1] + 50) return;
        const reach = Math.max(REACH, Math.hypot(points[1][0] - points[3][0], points[1][1] - points[3][1]) / 2);
        placed.push({ i, x, y, z: points[0][2], reach });
        const chosen = i === S.overlay.hovered || i === S.beside.view;
        pen.beginPath();
        for (const [a, b] of EDGES) { pen.moveTo(points[a][0], points[a][1]); pen.lineTo(points[b][0], points[b][1]); }
        pen.lineWidth = chosen ? 4 : 3; pen.strokeStyle = "#000a"; pen.stroke();
        pen.lineWidth = chosen ? 2.5 : 1.3; pen.strokeStyle = chosen ? "#fff" : view.trains ? "#4cc2ff" : "#ffb347"; pen.stroke();
        if (chosen) { pen.font = "12px system-ui"; pen.fillStyle = "#fff"; pen.strokeStyle = "#000"; pen.lineWidth = 3; pen.strokeText(view.name, x + 10, y - 8); pen.fillText(view.name, x + 10, y - 8); }
      });
    },
    // Number of the view under a place of the page; -1: none. The nearest camera of those that cover it.
    at(clientX, clientY) {
      const box = document.querySelector("canvas.overlay").getBoundingClientRect();
      const x = clientX - box.left, y = clientY - box.top;
      const under = placed.filter((p) => Math.hypot(p.x - x, p.y - y) <= p.reach);
      under.sort((a, b) => Math.hypot(a.x - x, a.y - y) - Math.hypot(b.x - x, b.y - y) || a.z - b.z);
      return under.length ? under[0].i : -1;
    },
    // For tests and keyboards: where the cameras are on the page.
    places() {
      const box = document.querySelector("canvas.overlay").getBoundingClientRect();
      return placed.map((p) => ({ i: p.i, x: p.x + box.left, y: p.y + box.top }));
    },
  };
})();
