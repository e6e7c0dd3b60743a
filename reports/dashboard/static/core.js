// The one global: data files hand themselves over to it, and every other file adds its part.
"use strict";
const splatproof = {
  views: {},
  waiting: new Map(),
  loaded: new Map(),
  // Called by data files: pages opened from disk may load scripts, but fetch nothing.
  take(name, text) {
    this.loaded.set(name, JSON.parse(text));
  },
  // A script's data, loaded once; `fresh` loads it again.
  data(name, fresh = false) {
    if (fresh) { this.loaded.delete(name); this.waiting.delete(name); }
    if (!this.waiting.has(name)) {
      this.waiting.set(name, this.script(`data/${name}.js${fresh ? `?${Date.now()}` : ""}`).then(() => {
        if (!this.loaded.has(name)) throw new Error(`${name} came without data`);
        return this.loaded.get(name);
      }).catch((error) => { this.waiting.delete(name); throw error; }));
    }
    return this.waiting.get(name);
  },
  script(path) {
    return new Promise((done, failed) => {
      const tag = document.createElement("script");
      tag.src = path;
      tag.onload = () => { tag.remove(); done(); };
      tag.onerror = () => { tag.remove(); failed(new Error(`${path} is not there`)); };
      document.head.append(tag);
    });
  },
  // An element; text is only ever set as text, so names of rows and scenes cannot become markup.
  h(tag, properties = {}, ...children) {
    const [name, ...classes] = tag.split(".");
    const element = document.createElement(name || "div");
    if (classes.length) element.className = classes.join(" ");
    for (const [key, value] of Object.entries(properties)) {
      if (value === undefined || value === null || value === false) continue;
      if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
      else if (key === "style") for (const [k, v] of Object.entries(value)) element.style.setProperty(k, v);
      else if (key in element && !key.startsWith("aria") && key !== "role" && key !== "list") element[key] = value;
      else element.setAttribute(key, value === true ? "" : value);
    }
    element.append(...children.flat(Infinity).filter((c) => c !== null && c !== undefined && c !== false));
    return element;
  },
};
