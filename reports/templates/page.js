"use strict";
const pictures = JSON.parse(document.getElementById("pictures").textContent);
const views = JSON.parse(document.getElementById("views").textContent);

for (const box of document.querySelectorAll(".compare")) {
  const data = views[box.dataset.view];
  const find = (selector) => box.querySelector(selector);
  const image = find("select.image"), row = find("select.row"), against = find("select.against");
  const stage = find(".stage"), range = find("input[type=range]");
  const tables = document.querySelector(`.images[data-view="${box.dataset.view}"]`);

  const put = (element, key, what) => {
    element.hidden = key === null;
    element.alt = key === null ? "" : what;
    if (key === null) element.removeAttribute("src");
    else element.src = pictures[key];
  };

  function show() {
    const name = image.value, label = row.value, keys = data.pictures[name][label];
    const other = Number(against.value), named = ["Truth", "Render", "Error map"];
    const what = (kind) => `${named[kind]} of ${name}` + (kind ? `, ${label}` : "");
    put(find(".over"), keys[0], what(0));
    put(find(".under"), keys[other], what(other));
    box.querySelectorAll(".three img").forEach((element, kind) => put(element, keys[kind], what(kind)));
    find(".tag.right").textContent = named[other].toLowerCase();
    const own = [...tables.querySelectorAll(".own")].find((table) => table.dataset.row === label);
    tables.querySelectorAll(".own").forEach((table) => { table.hidden = table !== own; });
    let told = "";
    for (const line of tables.querySelectorAll("tr[data-image]")) {
      const current = line.dataset.image === name;
      line.classList.toggle("current", current);
      if (current && own.contains(line)) told = line.dataset.told;
    }
    find(".slider figcaption").textContent =
      `${name}, ${label}, picture of seed ${data.seeds[label]} · mean over seeds: ${told}`;
  }

  const step = (by) => {
    const count = image.options.length;
    image.selectedIndex = (image.selectedIndex + by + count) % count;
    show();
  };
  find(".previous").addEventListener("click", () => step(-1));
  find(".next").addEventListener("click", () => step(1));
  for (const select of [image, row, against]) select.addEventListener("change", show);
  range.addEventListener("input", () => stage.style.setProperty("--cut", `${range.value}%`));
  tables.addEventListener("click", (event) => {
    const button = event.target.closest(".show");
    if (!button) return;
    image.value = button.closest("tr").dataset.image;
    show();
    box.scrollIntoView({ block: "start" });
  });
  // small pictures are shown at no more than 2.5 times their size
  find(".under").addEventListener("load", (event) => {
    stage.style.maxWidth = `${2.5 * event.target.naturalWidth}px`;
  });
  show();
}

for (const table of document.querySelectorAll(".sortable")) {
  const heads = [...table.querySelectorAll("thead th")], body = table.tBodies[0];
  heads.forEach((head, column) => head.addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const value = (line) => line.cells[column].dataset.v;
    const compare = column === 0
      ? (a, b) => value(a).localeCompare(value(b), "en", { numeric: true })
      : (a, b) => {
          const [x, y] = [a, b].map((line) => Number(value(line).replace("inf", "Infinity")));
          if (Number.isNaN(x) || Number.isNaN(y)) return (Number.isNaN(x) - Number.isNaN(y)) * (down ? -1 : 1);
          return x === y ? 0 : x - y;
        };
    const sorted = [...body.rows].sort((a, b) => (down ? -1 : 1) * compare(a, b));
    body.append(...sorted);
  }));
}
