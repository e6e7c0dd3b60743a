// The choices beside the picture, and what is read of it.
"use strict";
(() => {
  const S = splatproof, { h } = S;
  const parts = {};
  let playing = 0;
  const choice = S.choice = { mode: "colour", model: 0, other: null, split: 0.5, time: null, light: "", cameras: true, flies: false };

  const models = () => {
    const pick = (value, chosen) => {
      const select = h("select", { onchange: () => chosen(Number(select.value)) },
        S.state.models.map((m, i) => h("option", { value: i, selected: i === value }, m.name)));
      return select;
    };
    if (S.state.models.length < 2) return null;
    const split = parts.split = h("button", { type: "button", "aria-pressed": "false", onclick: () => S.panel.setSplit(choice.other === null) }, "Split (x)");
    return h("fieldset", {}, h("legend", {}, "Models"),
      parts.first = pick(choice.model, (i) => { choice.model = i; S.panel.changed(); }),
      parts.second = pick(1, (i) => { if (choice.other !== null) choice.other = i; S.panel.changed(); }), split);
  };
  const modes = () => {
    parts.modes = S.state.modes.map((mode, i) => {
      const radio = h("input", { type: "radio", name: "mode", value: mode.name, checked: mode.name === choice.mode, onchange: () => S.panel.setMode(mode.name) });
      return { mode, radio, label: h("label", {}, radio, mode.label, h("kbd", {}, String(i + 1))) };
    });
    return h("fieldset", {}, h("legend", {}, "Show"), parts.modes.map((m) => m.label), parts.meaning = h("p.meaning"));
  };
  const time = () => {
    if (!S.state.times) return null;
    const [first, last] = S.state.times;
    choice.time = first;
    parts.time = h("input", { type: "range", "aria-label": "Time in seconds", min: first, max: last, step: (last - first) / 500, value: first,
      oninput: () => S.panel.setTime(Number(parts.time.value)) });
    parts.when = h("output");
    parts.play = h("button", { type: "button", "aria-pressed": "false", onclick: () => S.panel.play() }, "Play");
    return h("fieldset", {}, h("legend", {}, "Time"), parts.time, h("div.row", {}, parts.play, parts.when));
  };
  const light = () => {
    if (!S.state.lights.length) return null;
    const select = parts.light = h("select", { "aria-label": "Light of a photo", onchange: () => { choice.light = select.value; S.panel.changed(); } },
      h("option", { value: "" }, "neutral"), S.state.lights.map((name) => h("option", { value: name }, name)));
    return h("fieldset", {}, h("legend", {}, "Light of"), select);
  };
  const moving = () => {
    const cameras = parts.cameras = h("input", { type: "checkbox", checked: choice.cameras, onchange: () => S.panel.setCameras(cameras.checked) });
    const flies = parts.flies = h("input", { type: "checkbox", checked: false, onchange: () => S.panel.setFlies(flies.checked) });
    return h("fieldset", {}, h("legend", {}, "Camera"),
      S.state.views.length ? h("label", {}, cameras, "Cameras of the scene", h("kbd", {}, "c")) : null,
      h("label", {}, flies, "Fly instead of orbit", h("kbd", {}, "f")),
      h("button", { type: "button", onclick: () => S.toStart() }, "Back to the start (r)"));
  };
  S.panel = {
    build() {
      document.querySelector(".panel").replaceChildren(...[models(), modes(), time(), light(), moving(), parts.told = h("dl.told")].filter(Boolean));
      S.panel.changed();
    },
    changed() {
      const both = [choice.model, ...(choice.other === null ? [] : [choice.other])].map((i) => S.state.models[i]);
      for (const { mode, radio, label } of parts.modes) {
        const missing = both.map((m) => m.missing[mode.name]).find(Boolean) ?? "";
        radio.disabled = Boolean(missing);
        label.title = missing || mode.legend;
        label.classList.toggle("off", Boolean(missing));
        if (missing && mode.name === choice.mode) { S.panel.setMode("colour"); return; }
        radio.checked = mode.name === choice.mode;
      }
      parts.meaning.textContent = S.state.modes.find((m) => m.name === choice.mode).legend;
      const split = choice.other !== null;
      document.querySelector(".divider").hidden = !split;
      if (parts.split) parts.split.setAttribute("aria-pressed", String(split));
      for (const [side, i] of [["left", choice.model], ["right", choice.other]]) {
        const label = document.querySelector(`.side.${side}`);
        label.hidden = !split;
        label.textContent = split ? S.state.models[i].name : "";
      }
      if (parts.when) parts.when.textContent = `${choice.time.toFixed(2)} s`;
      S.frames.wish();
      S.beside.refresh();
    },
    setMode(name) {
      const found = parts.modes.find((m) => m.mode.name === name);
      if (!found || (found.radio.disabled && name !== "colour")) return;
      choice.mode = name;
      S.panel.changed();
    },
    setSplit(on) {
      if (S.state.models.length < 2) return;
      choice.other = on ? Number(parts.second.value) : null;
      S.setSplit(choice.split);
      S.panel.changed();
    },
    setTime(seconds) {
      choice.time = seconds;
      parts.time.value = seconds;
      parts.when.textContent = `${seconds.toFixed(2)} s`;
      S.frames.wish();
    },
    play() {
      if (!S.state.times) return;
      const [first, last] = S.state.times, start = performance.now(), from = choice.time >= last ? first : choice.time;
      const mine = playing ? 0 : start;
      playing = mine;
      parts.play.setAttribute("aria-pressed", String(Boolean(mine)));
      parts.play.textContent = mine ? "Stop" : "Play";
      const step = (now) => {
        if (playing !== mine || !mine) return;
        S.panel.setTime(first + (from - first + Math.max(0, now - start) / 1000) % (last - first));
        requestAnimationFrame(step);
      };
      requestAnimationFrame(step);
    },
    setCameras(on) { choice.cameras = on; parts.cameras.checked = on; S.overlay.draw(); },
    setFlies(on) { choice.flies = on; parts.flies.checked = on; },
    tell({ facts, size, ms }) {
      const rows = { size: `${size[0]} × ${size[1]}`, frame: `${ms.toFixed(0)} ms (render ${facts.render_ms.toFixed(0)})`, ...facts.told };
      parts.told.replaceChildren(...Object.entries(rows).flatMap(([name, text]) => [h("dt", {}, name), h("dd", {}, text)]));
    },
  };
})();
