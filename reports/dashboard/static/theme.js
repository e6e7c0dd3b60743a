// Light or dark: as the system has it until the switch says otherwise.
"use strict";
(() => {
  const S = splatproof, KEEP = "splatproof-theme";
  const kept = () => { try { return localStorage.getItem(KEEP); } catch { return null; } };
  S.dark = () => (document.documentElement.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  S.switchTheme = () => {
    const theme = S.dark() ? "light" : "dark";
    document.documentElement.dataset.theme = theme;
    try { localStorage.setItem(KEEP, theme); } catch { /* pages from disk may have no storage */ }
    S.view?.restyle?.();
  };
  if (kept()) document.documentElement.dataset.theme = kept();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => S.view?.restyle?.());
  S.colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  S.series = (i) => S.colour(`c${((i % 8) + 8) % 8}`);
})();
