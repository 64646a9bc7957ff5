"use strict";
// Into the clipboard; the old way too, for pages that came over plain http.
const copy = async (text) => {
  try { await navigator.clipboard.writeText(text); return true; } catch { /* not allowed here */ }
  const field = document.createElement("textarea");
  field.value = text;
  field.style.position = "fixed";
  field.style.opacity = "0";
  document.body.append(field);
  field.select();
  const done = document.execCommand("copy");
  field.remove();
  return done;
};
// Maps that answer the mouse: coordinates under it, a click as --goal, a drag as a pose with heading.
for (const box of document.querySelectorAll(".pointer")) {
  const svg = box.querySelector("svg"), out = box.querySelector("output"), arrow = box.querySelector(".aim");
  const data = svg.dataset, size = Number(data.resolution), columns = Number(data.columns), rows = Number(data.rows);
  const [ox, oy, yaw] = data.origin.split(",").map(Number);
  const image = new Image();
  let pixels = null, start = null, kept = "";
  image.onload = () => {
    const canvas = document.createElement("canvas");
    canvas.width = columns; canvas.height = rows;
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    pixels = context.getImageData(0, 0, columns, rows).data;
  };
  image.src = svg.querySelector("image").getAttribute("href");

  const world = (event) => {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    return { x: point.x, y: -point.y };
  };
  const place = (p) => {
    const dx = p.x - ox, dy = p.y - oy;
    const column = Math.floor((Math.cos(yaw) * dx + Math.sin(yaw) * dy) / size);
    const row = Math.floor((Math.cos(yaw) * dy - Math.sin(yaw) * dx) / size);
    if (!pixels || column < 0 || row < 0 || column >= columns || row >= rows) return "off the map";
    const value = pixels[4 * ((rows - 1 - row) * columns + column)];
    return value < 100 ? "occupied" : value < 245 ? "unknown" : "free";
  };
  const show = (text) => { out.textContent = text; };
  const number = (value) => (Math.abs(value) < 0.005 ? 0 : value).toFixed(2);
  const heading = (a, b) => (Math.hypot(b.x - a.x, b.y - a.y) < 0.1 ? 0 : Math.atan2(b.y - a.y, b.x - a.x));
  const aim = (a, b) => {
    arrow.setAttribute("x1", a.x); arrow.setAttribute("y1", -a.y);
    arrow.setAttribute("x2", b.x); arrow.setAttribute("y2", -b.y);
    arrow.style.visibility = "visible";
  };

  svg.addEventListener("pointermove", (event) => {
    const p = world(event);
    if (start) { aim(start, p); show(`${number(start.x)}, ${number(start.y)}, yaw ${number(heading(start, p))}`); return; }
    show(`x ${number(p.x)}  y ${number(p.y)}  ${place(p)}${kept && "   |   last: " + kept}`);
  });
  svg.addEventListener("pointerdown", (event) => {
    // Two fingers move and zoom the page.
    if (!event.isPrimary) { start = null; arrow.style.visibility = "hidden"; return; }
    if (event.button !== 0) return;
    event.preventDefault();
    start = world(event);
    svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointerup", async (event) => {
    if (!start || !event.isPrimary) return;
    const p = world(event), turn = heading(start, p);
    const tip = { x: start.x + 0.4 * Math.cos(turn), y: start.y + 0.4 * Math.sin(turn) };
    aim(start, tip);
    kept = `--goal=${number(start.x)},${number(start.y)},${number(turn)}`;
    const where = place(start), goal = kept;
    start = null;
    show(`${goal}   (${where}${where === "free" ? "" : ": not a place to go"})`);
    if (await copy(goal) && kept === goal) show(`${out.textContent}   copied`);
  });
  svg.addEventListener("pointercancel", () => { start = null; });
}

// Tables that sort by the column whose head is pressed.
for (const table of document.querySelectorAll("table.sortable")) {
  table.querySelectorAll("thead th").forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      table.querySelectorAll("th").forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const key = (row) => row.cells[column].dataset.sort ?? row.cells[column].textContent.trim();
      const order = (a, b) => {
        const p = key(a), q = key(b);
        if ((p === "") !== (q === "")) return p === "" ? 1 : -1;
        const sign = up ? 1 : -1;
        return p !== "" && !isNaN(p) && !isNaN(q) ? sign * (p - q) : sign * p.localeCompare(q);
      };
      const body = table.tBodies[0];
      body.append(...[...body.rows].sort(order));
    });
  });
}

// A table of many lines shows those that hold every word typed above it.
for (const field of document.querySelectorAll(".filter")) {
  const rows = [...document.querySelector("table.sortable").tBodies[0].rows];
  const count = document.querySelector(".count");
  field.addEventListener("input", () => {
    const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
      shown += !row.hidden;
    }
    count.textContent = words.length ? `${shown} of ${rows.length}` : "";
  });
}
