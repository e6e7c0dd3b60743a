// A list of any length of which only what is in sight is in the document.
"use strict";
(() => {
  const S = splatproof, AHEAD = 400; // pixels above and below that are ready before they are scrolled to
  // Items are [{height, open}], or {length, height, at(place)} where all have one height and are only made
  // when they are shown; draw(item, place) gives the element of one.
  S.virtual = ({ label, draw, role = "grid", onchosen }) => {
    const space = S.h("div.space"), box = S.h("div.virtual", { tabIndex: 0, role, "aria-label": label }, space);
    let items = [], tops = [0], even = 0, shown = new Map(), current = -1;
    const top = (i) => (even ? i * even : tops[i]), get = (i) => (i < 0 || i >= items.length ? undefined : items.at(i));
    const at = (y) => {
      let low = 0, high = items.length;
      while (low < high) { const mid = (low + high) >> 1; if (top(mid + 1) <= y) low = mid + 1; else high = mid; }
      return low;
    };
    const paint = () => {
      const from = at(box.scrollTop - AHEAD), until = Math.min(items.length, at(box.scrollTop + box.clientHeight + AHEAD) + 1);
      for (const [i, node] of shown) if (i < from || i >= until) { node.remove(); shown.delete(i); }
      for (let i = from; i < until; i++) {
        if (shown.has(i)) continue;
        const item = get(i), node = draw(item, i);
        node.classList.add("item");
        node.style.transform = `translateY(${top(i)}px)`;
        node.style.height = `${item.height}px`;
        if (role === "grid") { node.setAttribute("role", "row"); node.setAttribute("aria-rowindex", i + 1); }
        if (i === current) mark(node, true);
        shown.set(i, node);
        // in the order of the list, so that the tab key and screen readers follow it
        const next = [...shown.keys()].filter((k) => k > i).sort((a, b) => a - b)[0];
        space.insertBefore(node, next === undefined ? null : shown.get(next));
      }
    };
    const mark = (node, on) => { node?.classList.toggle("current", on); if (on) node?.setAttribute("aria-selected", "true"); else node?.removeAttribute("aria-selected"); };
    const select = (place) => {
      mark(shown.get(current), false);
      current = place;
      if (place < 0) return;
      const above = top(place), bottom = top(place + 1);
      if (above < box.scrollTop) box.scrollTop = above;
      else if (bottom > box.scrollTop + box.clientHeight) box.scrollTop = bottom - box.clientHeight;
      paint();
      mark(shown.get(place), true);
      onchosen?.(get(place), place);
    };
    box.addEventListener("scroll", paint, { passive: true });
    new ResizeObserver(paint).observe(box);
    return {
      element: box,
      set(list, keep = false) {
        items = list;
        even = Array.isArray(list) ? 0 : list.height;
        tops = [0];
        if (!even) for (let i = 0; i < list.length; i++) tops.push(tops[i] + list[i].height);
        space.style.height = `${top(list.length)}px`;
        for (const node of shown.values()) node.remove();
        shown = new Map();
        current = -1;
        if (!keep) box.scrollTop = 0;
        if (role === "grid") box.setAttribute("aria-rowcount", list.length);
        paint();
      },
      // to the next item that can be opened, by so many
      move(by) {
        let place = current;
        for (let i = place + by; i >= 0 && i < items.length; i += by) if (get(i).open) { place = i; break; }
        if (place !== current) select(place);
      },
      select,
      paint,
      get current() { return get(current); },
      open() { get(current)?.open?.(); },
    };
  };
})();
