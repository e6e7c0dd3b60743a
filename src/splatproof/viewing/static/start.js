// Reads what there is to see, and starts; while a model trains, looks for newer snapshots.
"use strict";
(async () => {
  const S = splatproof, EVERY_MS = 2000;
  const read = async () => (await fetch("state.json")).json();
  const about = () => {
    const steps = (m) => (m.step === null ? "" : ` · step ${m.step} of ${m.steps}`);
    document.querySelector(".about-store").replaceChildren(...S.state.models.map((m) =>
      S.h("span", {}, `${m.name}: ${m.primitives.toLocaleString("en")} primitives (${m.kind})${steps(m)}`)));
  };
  S.toStart = () => {
    S.camera = new S.Camera(S.state.place, S.state.fov);
    if (S.state.start !== null) S.camera.stand(S.state.views[S.state.start]);
    S.frames.wish();
  };
  S.state = await read();
  document.querySelector(".scene").textContent = S.state.scene ?? "no scene";
  document.title = `${S.state.models[0].name} · splatproof view`;
  S.overlay.prepare();
  S.camera = new S.Camera(S.state.place, S.state.fov);
  S.panel.build();
  S.toStart();
  about();
  while (S.state.models.some((m) => m.step !== null && m.step < m.steps)) {
    await new Promise((done) => setTimeout(done, EVERY_MS));
    const before = JSON.stringify(S.state.models);
    try { S.state.models = (await read()).models; } catch { continue; }
    if (JSON.stringify(S.state.models) !== before) { about(); S.frames.wish(true); S.beside.refresh(); }
  }
})();
