// The page: connects the socket, the scene, the drawing and the controls.

import { attachBag, bagged } from "./bag.js";
import { draw, LAYERS, readColours } from "./draw.js";
import { Drive } from "./drive.js";
import { byId, put } from "./elements.js";
import { allow, capital, keepouts, log, refuse, show } from "./panel.js";
import { listen } from "./pointer.js";
import { begin, dark, scene, take } from "./scene.js";
import { Connection } from "./socket.js";
import { Desk, KEYS } from "./tools.js";
import { fit, pan, toWorld, view, zoom } from "./view.js";
import { Waypoints } from "./waypoints.js";
import { words } from "./words.js";

const MOVES = ["goal", "patrol", "avoid", "explore", "wiggle"];
const stage = byId("stage"), readout = byId("readout");
const shown = new Set(kept());
let due = false, fitted = false, comparing = false, cursor = null, copied = "";

function kept() {
  try { return JSON.parse(localStorage.getItem("turtlebag-layers")) ?? first(); } catch { return first(); }
}

function first() {
  return LAYERS.filter(([, , , on]) => on).map(([name]) => name);
}

/** Draw at the next animation frame, once. */
function changed() {
  if (due) return;
  due = true;
  requestAnimationFrame(drawNow);
}

function drawNow() {
  due = false;
  if (view.follow && scene.head.pose) [view.x, view.y] = scene.head.pose;
  draw(stage, shown, waypoints, desk.doing);
  read();
}

function read() {
  const value = cursor && scene.grids.map?.at(...cursor);
  const cell = value === undefined || value === null ? "" : value === 255 ? "unknown" : value === 0 ? "free" : `occupied ${value}`;
  const place = cursor ? [words(cursor), cell].filter(Boolean).join("  ") : "";
  if (readout.value !== (copied || place)) readout.value = copied || place;
}

/** Send an input. Tasks end teleop first, because teleop has priority over any task. */
function send(message) {
  const { do: name } = message;
  refuse("");
  if (MOVES.includes(name)) drive.release();
  if (name === "localise_global") goOn();
  if (name === "pause" || name === "resume") comparing = false;
  if (name === "waypoints_load") waypoints.sent = "";
  if (!connection.send(message)) refuse("Not connected: nothing was sent.");
  else if (name === "pose_estimate" && !scene.head.paused) comparing = connection.send({ do: "pause" });
  return true;
}

/** Time stands still after a pose was set, or the filter would correct a wrong one before anybody sees it. */
function goOn() {
  if (comparing) connection.send({ do: "resume" });
  comparing = false;
}

async function copy(place) {
  try {
    await navigator.clipboard.writeText(place);
    copied = `${place}  copied`;
  } catch {
    copied = `${place}  (the browser does not let it be copied)`;
  }
  setTimeout(() => { copied = ""; read(); }, 2500);
  read();
}

const speeds = (v, w) => put(byId("cmd"), "textContent", `${v.toFixed(2)} m/s, ${w.toFixed(1)} rad/s`);
const drive = new Drive((message) => { goOn(); connection.send(message); }, speeds);
const waypoints = new Waypoints(byId("waypoints"), (list) => connection.send({ do: "waypoints", waypoints: list }), changed, refuse);
const desk = new Desk({ send, copy, refuse, waypoints, size: () => Number(byId("size").value), width: () => Number(byId("width").value), chosen });
const connection = new Connection(arrived, told);

function chosen(name, tool) {
  for (const other of document.querySelectorAll("[data-tool]")) other.ariaPressed = String(other.dataset.tool === name);
  stage.dataset.tool = name;
  byId("advice").textContent = tool.hint;
  byId("typing").hidden = !tool.form;
  byId("typed").value = "";
  byId("typed").placeholder = byId("typed").ariaLabel = tool.form ?? "";
  changed();
}

function arrived(header, blobs) {
  if (header.kind === "hello") {
    begin(header, blobs);
    drive.learn(header);
    byId("where").textContent = bagged() ? header.world : `${header.world} · ${header.robot} · seed ${header.seed}`;
    document.body.classList.toggle("bagged", bagged());
    byId("lines").replaceChildren();
    waypoints.sent = "";
    const { world } = header, name = document.querySelector("[data-do=map_save]").elements.name;
    name.value ||= `map_${world.replace("turtlebot3_", "").replace(/[^A-Za-z0-9_-]+/g, "_") || "1"}`;
    wanted();
    if (!fitted) showAll();
  } else {
    const { keepouts: before, head: { map } } = scene;
    take(header, blobs);
    show({ ...header, comparing: comparing && header.paused }, desk.name);
    if (!header.driver && (drive.v || drive.w)) drive.forget();
    if (!drive.v && !drive.w) speeds(...header.cmd);
    if (scene.keepouts !== before) keepouts(send);
    if (header.map != null && header.map !== map) showAll();
    if (!fitted) showFirst();
    if (header.error || !header.driver) waypoints.sent = "";
    if (header.waypoints) waypoints.arrived(header.waypoints);
    if (header.events?.length) log(header.events);
    if (header.error) refuse(header.error), goOn();
  }
  changed();
}

/** The socket opened, or closed with a reason. */
function told(open, reason, after = []) {
  const [where, ...commands] = after, over = byId("over");
  over.hidden = !after.length;
  over.querySelector("strong").textContent = capital(`${reason}.`);
  over.querySelector("p").textContent = where ?? "";
  over.querySelector("pre").textContent = commands.join("\n");
  byId("broken").hidden = open || after.length > 0;
  document.body.classList.toggle("away", !open);
  byId("again").hidden = !reason;
  byId("broken").firstElementChild.textContent = reason ? `Closed: ${reason}` : "Connection lost. The robot is stopped. Reconnecting …";
  if (open) return;
  drive.forget();
  desk.choose("view");
  scene.head = { ...scene.head, driver: false };
  allow(false);
}

function wanted() {
  connection.send({ do: "layers", layers: [...shown] });
}

function showAll() {
  const [x0, y0, x1, y1] = scene.hello?.bounds ?? [-3, -3, 3, 3];
  const known = scene.grids.map?.corners() ?? [];
  fit(known.length ? known : [[x0, y0], [x1, y1]]);
  follow(false);
}

/** What there is, once both the first frame and the size of the window are known. */
function showFirst() {
  if (!scene.head.pose || view.width < 2) return;
  fitted = true;
  showAll();
}

function follow(on) {
  view.follow = on;
  byId("follow").ariaPressed = String(on);
  changed();
}

// Buttons and forms that send an input of the session unchanged.
let armed = null;
document.addEventListener("click", ({ target, detail }) => {
  const pressed = target.closest("button, summary");
  if (!pressed) return;
  const { tool, do: name, sure, key } = pressed.dataset, again = armed?.pressed === pressed;
  armed?.drop();
  if (tool) desk.choose(desk.name === tool ? "view" : tool);
  else if (key) drive.press(key);
  else if (sure && !again) arm(pressed);
  else if (name) send({ do: name });
  // After a click, keys must drive and not press the button again.
  if (detail > 0 && pressed.tagName === "BUTTON" && !pressed.form) stage.focus({ preventScroll: true });
});

/** Irreversible actions need a second click within three seconds. */
function arm(pressed) {
  const before = pressed.textContent;
  const timer = setTimeout(() => armed.drop(), 3000);
  armed = { pressed, drop() { clearTimeout(timer); armed = null; pressed.textContent = before; } };
  pressed.textContent = pressed.dataset.sure;
}

let byPointer = false, entered = false;
addEventListener("pointerdown", () => { byPointer = true; }, true);
addEventListener("keydown", () => { byPointer = false; }, true);
addEventListener("focusin", () => { entered = byPointer; });
document.addEventListener("submit", (event) => {
  const form = event.target;
  event.preventDefault();
  if (form.id === "hint") {
    if (desk.type(byId("typed").value)) byId("typed").value = "";
    else refuse(`"${byId("typed").value}" is not ${desk.tool.form}`);
  } else if (form.id === "bag") send(scene.head.recording == null ? { do: "record", name: form.elements.name.value } : { do: "record_stop" });
  else if (form.id === "waypoints_save") send({ do: "waypoints_save", name: form.elements.name.value, waypoints: waypoints.plain() });
  else send({ do: form.dataset.do, name: form.elements.name.value });
  if (entered) stage.focus({ preventScroll: true });
  changed();
});

const presses = {
  pause: () => send({ do: scene.head.paused ? "resume" : "pause" }),
  step: () => send({ do: "step" }),
  mapping: () => send({ do: scene.head.mapping ? "map_stop" : "map_start" }),
  patrol: () => waypoints.list.length
    ? send({ do: "patrol", waypoints: waypoints.plain(), laps: Number(byId("laps").value) })
    : refuse("No waypoints yet: choose Waypoint and click the map, or load a file."),
  clear: () => waypoints.clear(),
  take: () => send({ do: "take_control" }),
  again: () => connection.open(),
  in: () => zoom(1.3),
  out: () => zoom(1 / 1.3),
  fit: showAll,
  follow: () => follow(!view.follow),
  fold: () => flip("fold", "folded"),
  unfold: () => flip("unfold", "short"),
};
for (const [id, press] of Object.entries(presses)) byId(id).addEventListener("click", () => { press(); changed(); });
byId("speed").addEventListener("change", ({ target }) => {
  send({ do: "speed", factor: Number(target.value) });
  if (entered) stage.focus();
});

function flip(id, name, on) {
  byId(id).ariaExpanded = String(!document.body.classList.toggle(name, on));
}

document.addEventListener("keydown", (event) => {
  const { target, key } = event;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (target.matches("input:not([type=checkbox]), select")) {
    if (key === "Escape") stage.focus();
    return;
  }
  const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }[key];
  const zooms = { "+": 1.3, "=": 1.3, "-": 1 / 1.3 }[key], low = key.toLowerCase();
  const natural = key === " " && target.matches("button, summary, input");
  if (!natural && scene.head.driver && drive.press(low)) event.preventDefault();
  else if (moves && target === stage) pan(...moves), event.preventDefault();
  else if (zooms) zoom(zooms);
  else if (key === "0") showAll();
  else if (low === "f") follow(!view.follow);
  else if (key === "Backspace") desk.tool.back?.(desk);
  else if (key === "Enter" && !target.matches("button, summary") && desk.tool.enter?.(desk)) event.preventDefault();
  else if (key === "Enter" && target === stage && desk.tool.form) byId("typed").focus(), event.preventDefault();
  else if (key === "Escape") desk.drop() || desk.choose("view");
  else if (KEYS[low] && !document.querySelector(`#tools [data-tool=${KEYS[low]}]`).disabled) desk.choose(KEYS[low]);
  changed();
});

byId("layers").querySelector("ul").append(...[...LAYERS].reverse().map(([name, text]) => {
  const row = document.createElement("li"), label = document.createElement("label"), box = document.createElement("input");
  Object.assign(box, { type: "checkbox", checked: shown.has(name), name: `layer-${name}` });
  row.dataset.layer = name;
  box.addEventListener("change", () => {
    shown[box.checked ? "add" : "delete"](name);
    try { localStorage.setItem("turtlebag-layers", JSON.stringify([...shown])); } catch { /* not allowed here */ }
    wanted();
    changed();
  });
  label.append(box, text);
  row.append(label);
  return row;
}));

for (const [small, ...folds] of [["(max-height: 500px)", "unfold", "short"], ["(max-width: 600px)", "fold", "folded"]]) {
  const media = matchMedia(small), fit = () => flip(...folds, media.matches);
  media.addEventListener("change", fit);
  fit();
}
listen(stage, desk, () => scene.head.driver || desk.name === "point", changed, (place) => { cursor = place; });
attachBag(send);
drive.attach(byId("pad"), byId("knob"));
keepouts(send);
desk.choose("view");
readColours();
dark.addEventListener("change", () => { readColours(); changed(); });
new ResizeObserver(([{ contentRect: { width, height } }]) => {
  Object.assign(view, { width, height });
  if (!fitted) showFirst();
  stage.width = Math.round(width * devicePixelRatio);
  stage.height = Math.round(height * devicePixelRatio);
  drawNow(); // a new size has cleared it, and is shown before the next animation frame
}).observe(stage);
