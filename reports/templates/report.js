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
// What a link leads to is unfolded first, and everything for print.
const reveal = () => {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  for (let box = target.closest("details"); box; box = box.parentElement.closest("details")) box.open = true;
  for (const box of target.querySelectorAll(":scope > details.rest, :scope.chapter > details.more")) box.open = true;
  target.scrollIntoView({ behavior: "instant" });
};
addEventListener("hashchange", reveal);
reveal();
const stages = [...document.querySelectorAll("details.rest")];
const unfold = document.querySelector("button.unfold");
unfold?.addEventListener("click", () => {
  const open = !stages.every((box) => box.open);
  for (const box of stages) box.open = open;
  unfold.textContent = open ? "Collapse all stages" : "Expand all stages";
});
let folded = [];
addEventListener("beforeprint", () => {
  folded = [...stages, ...document.querySelectorAll(".chapter > details.more")].filter((box) => !box.open);
  for (const box of folded) box.open = true;
});
addEventListener("afterprint", () => { for (const box of folded) box.open = false; });
// Cells stay sharp where they are enlarged; in a smaller picture a wall of one cell must not fall between pixels.
const sharpen = (image, size) => {
  const seen = new ResizeObserver(() => image.classList.toggle("enlarged", image.getBoundingClientRect().width >= size));
  seen.observe(image.closest("svg"));
};
for (const image of document.querySelectorAll("svg image")) {
  const picture = new Image();
  picture.onload = () => sharpen(image, picture.naturalWidth);
  picture.src = image.getAttribute("href") ?? image.getAttributeNS("http://www.w3.org/1999/xlink", "href");
}
// Maps that answer the mouse: coordinates under it, a click as a pose, a drag as a pose with heading.
for (const box of document.querySelectorAll(".pointer")) {
  const svg = box.querySelector("svg"), out = box.querySelector("output"), arrow = box.querySelector(".aim");
  const data = svg.dataset, size = Number(data.resolution), columns = Number(data.columns), rows = Number(data.rows);
  const [ox, oy, yaw] = data.origin.split(",").map(Number);
  const image = new Image();
  const picked = box.querySelector(".picked"), list = box.querySelector(".waypoints"), waypoints = [];
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

  // The list as a file for --waypoints, with a mark on the map for each entry.
  const written = () => "waypoints:\n" + waypoints.map((w) => `- {x: ${w.x}, y: ${w.y}, yaw: ${w.yaw}}\n`).join("");
  const mark = (w, place) => {
    const size = Number(picked.dataset.size), x = Number(w.x), y = -Number(w.y), yaw = Number(w.yaw);
    const add = (name, facts, text = "") => {
      const part = document.createElementNS("http://www.w3.org/2000/svg", name);
      for (const [key, value] of Object.entries(facts)) part.setAttribute(key, value);
      part.textContent = text;
      picked.append(part);
    };
    add("line", { x1: x, y1: y, x2: x + 2.2 * size * Math.cos(yaw), y2: y - 2.2 * size * Math.sin(yaw) });
    add("circle", { cx: x, cy: y, r: size });
    add("text", { x, y, "font-size": 1.4 * size }, String(place + 1));
  };
  const listed = () => {
    picked.replaceChildren();
    waypoints.forEach(mark);
    list.hidden = !waypoints.length;
    list.querySelector("pre").textContent = written();
    list.querySelector(".save").href = "data:text/yaml;charset=utf-8," + encodeURIComponent(written());
  };
  list.querySelector(".undo").addEventListener("click", () => { waypoints.pop(); listed(); });
  list.querySelector(".copy").addEventListener("click", async () => {
    if (await copy(written())) show(`${waypoints.length} waypoints   copied`);
  });

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
    const mode = box.querySelector(".modes input:checked").value, where = place(start);
    const pose = { x: number(start.x), y: number(start.y), yaw: number(turn) };
    start = null;
    const said = `(${where}${where === "free" ? "" : ": not a place to go"})`;
    if (mode === "waypoints") {
      arrow.style.visibility = "hidden";
      if (where === "free") { waypoints.push(pose); listed(); }
      show(where === "free" ? `waypoint ${waypoints.length}: ${pose.x}, ${pose.y}, yaw ${pose.yaw}` : `not added ${said}`);
      return;
    }
    const option = `--${mode}=${pose.x},${pose.y},${pose.yaw}`;
    kept = option;
    show(`${option}   ${said}`);
    if (await copy(option) && kept === option) show(`${out.textContent}   copied`);
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
