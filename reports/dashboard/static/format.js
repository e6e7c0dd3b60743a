// Numbers, times and names as people read them.
"use strict";
(() => {
  const S = splatproof;
  const missing = (v) => v === null || v === undefined || Number.isNaN(v);
  S.number = (value, digits = 4) => {
    if (missing(value)) return "–";
    const n = Number(value);
    if (!Number.isFinite(n)) return n > 0 ? "∞" : "−∞";
    return n.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits }).replace("-", "−");
  };
  S.signed = (value, digits) => (Number(value) > 0 ? "+" : "") + S.number(value, digits);
  S.interval = (cell, digits) => {
    if (!cell) return "–";
    const [mean, low, high] = cell;
    const half = missing(low) || missing(high) ? null : (high - low) / 2;
    return half === null ? S.number(mean, digits) : `${S.number(mean, digits)} ± ${S.number(half, digits)}`;
  };
  // A difference as it was compared: of logarithms it reads as a ratio, in per cent.
  S.difference = (value, digits, relative) => (value === null || value === undefined ? "–" : relative ? `${S.signed(100 * Math.expm1(value), 1)} %` : S.signed(value, digits));
  S.heading = (column) => column.title + (column.unit ? ` [${column.unit}]` : "") +
    (column.better === true ? " ↑" : column.better === false ? " ↓" : "");
  // Breaks behind underscores, and never before the arrow.
  S.breaking = (text) => text.replace(/ ([↑↓])$/, "\u00a0$1").split(/(?<=_)/).flatMap((part, i) => (i ? [document.createElement("wbr"), part] : [part]));
  S.date = (ms) => {
    if (!ms) return "–";
    const d = new Date(ms), two = (n) => String(n).padStart(2, "0");
    return `${d.getFullYear()}-${two(d.getMonth() + 1)}-${two(d.getDate())} ${two(d.getHours())}:${two(d.getMinutes())}`;
  };
  S.commit = (hash) => (hash ? hash.slice(0, 10) : "unknown");
  S.plural = (n, word) => `${n.toLocaleString("en")} ${word}${n === 1 ? "" : "s"}`;
  S.digits = (metric) => S.known?.columns.get(metric)?.digits ?? 4;
  // A word of a shell: quoted unless it is plain.
  S.quoted = (word) => (/^[\w@%+=:,./~-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);
  // A name inside a pattern of `--only`.
  S.literal = (name) => name.replace(/[[*?]/g, (c) => `[${c}]`);
  S.command = (suite, scene, row, protocol, seed) =>
    `bench run ${S.quoted(suite)} --only ${S.quoted([scene, row, protocol, `seed${seed}`].map((p, i) => (i < 3 ? S.literal(p) : p)).join("/"))}`;
})();
