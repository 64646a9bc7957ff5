// The texts of the page: status, advice, lists and the event log.

import { bagAdvice, bagged, showBag } from "./bag.js";
import { button, byId, put, refill } from "./elements.js";
import { scene } from "./scene.js";

const MOST_LINES = 500;
const text = (id, words) => put(byId(id), "textContent", words);
export const capital = (words) => words.charAt(0).toUpperCase() + words.slice(1);

/** Whether there is a map, finished or growing; no map is sent as one cell. */
const mapped = () => scene.grids.map?.w > 1;

/** What to do first, or next. */
function advice({ map, mapping, localised, lost, task, goals, cmd, comparing }) {
  if (comparing) return "Paused: does the scan lie on the walls? Wiggle lets the particles converge, Resume goes on.";
  if (task) return "";
  if (mapping) return cmd.some(Boolean) ? "" : "Drive with W A S D: the map grows with what the robot sees. Save it when it is complete.";
  if (map == null && mapped()) return "Save the map and load it: then the robot can localise on it and drive to goals.";
  if (map == null) return "No map yet. Start mapping, then drive with W A S D.";
  if (!localised) return "Where is the robot? Choose Pose, press where it stands and drag in the direction it faces.";
  if (lost) return `Poorly localised: ${lost}. Wiggle, or set a better pose.`;
  return goals.length ? "" : "Choose Goal, press on the map and drag for the heading; or click waypoints and patrol.";
}

function options(select, names, empty) {
  const told = names.join("\n") || "-";
  if (select.dataset.told === told) return;
  const before = select.value;
  select.dataset.told = told;
  select.replaceChildren(...names.map((name) => new Option(name || empty, name)));
  if (!names.length) select.append(new Option("none saved yet"));
  for (const part of select.form.elements) part.disabled = !names.length;
  if (names.includes(before)) select.value = before;
}

/** Update the controls after each frame. */
export function show(head, deskName) {
  text("clock", `${head.t.toFixed(1)} s`);
  text("factor", head.paused ? "paused" : `${head.factor.toFixed(head.factor < 10 ? 2 : 0)}×`);
  const doing = head.owner === "teleop" ? "teleop" : head.state;
  text("state", capital([head.task, doing !== head.task && doing].filter(Boolean).join(": ")));
  put(byId("pause"), "textContent", head.paused ? "Resume" : "Pause");
  put(byId("pause"), "ariaPressed", String(head.paused));
  if (document.activeElement !== byId("speed")) put(byId("speed"), "value", String(head.asked));
  pills([[head.recording != null, "rec", `Rec ${head.recording}`], [head.mapping, "map", "Mapping"], [head.lost, "bad", "Poorly localised"], [head.busy, "busy", busyWith(head.busy)]]);
  text("mapping", head.mapping ? "Stop mapping" : "Start mapping");
  put(byId("mapping"), "disabled", bagged() && head.state === "at its end" && !head.mapping);
  put(byId("mapping").dataset, "on", String(head.mapping));
  const bag = byId("bag");
  if (bag.dataset.open !== String(head.recording)) {
    bag.dataset.open = String(head.recording);
    bag.elements[1].textContent = head.recording == null ? "Record bag" : "Stop bag";
    bag.elements[0].disabled = head.recording != null;
  }
  // Another page may have taken a name as well.
  if (head.recording == null && document.activeElement !== bag.elements[0]) while (head.bags?.includes(bag.elements[0].value)) bag.elements[0].value = nextName(bag.elements[0].value);
  options(byId("maps"), head.maps ?? [], "the initial map");
  options(byId("files"), head.waypoint_files ?? [], "the tutorial's");
  put(byId("sure"), "value", head.lost ? 0 : head.sure ?? 0);
  text("place", placeOf(head));
  put(byId("cancel"), "disabled", !head.task);
  sectors(head.sectors);
  if (deskName === "view") text("advice", bagged() ? bagAdvice(head) : advice(head));
  showBag(head);
  put(byId("stage").dataset, "blank", String(!mapped()));
  put(byId("watching"), "hidden", head.driver);
  allow(head.driver);
}

/** Enable or disable everything that controls the robot. */
export function allow(may) {
  put(byId("controls"), "disabled", !may);
  for (const tool of document.querySelectorAll("#tools [data-acts]")) put(tool, "disabled", !may);
}

const nextName = (name) => name.replace(/(\d*)$/, (digits) => digits ? Number(digits) + 1 : "_2");

/** What has blocked the session for more than a second. */
const busyWith = (what) => what === "tick" ? "Computing …" : `Busy: ${what?.replaceAll("_", " ")} …`;

function placeOf({ map, localised, sure, lost, mapping }) {
  if (lost) return lost;
  if (sure != null) return `${Math.round(100 * sure)} % of the scan fits the map`;
  if (mapping) return "on the growing map";
  return map == null ? "no map" : localised ? "fit not known: it has not moved yet" : "no pose yet";
}

function pills(told) {
  const shown = told.filter(([on]) => on), key = shown.map(([, , words]) => words).join("|");
  if (byId("pills").dataset.key === key) return;
  byId("pills").dataset.key = key;
  byId("pills").replaceChildren(...shown.map(([, kind, words]) => {
    const pill = document.createElement("span");
    pill.className = kind;
    pill.textContent = words;
    return pill;
  }));
}

function sectors(told) {
  put(byId("sectors"), "hidden", !told?.decision);
  if (!told?.decision) return;
  const far = (distance) => distance == null ? "free" : `${distance.toFixed(2)} m`;
  text("sectors", `Left ${far(told.left)}, front ${far(told.front)}, right ${far(told.right)}: ${told.decision}`);
}

let following = true;

/** The log follows its end, also when its size changes, until somebody scrolls up in it. */
function toEnd() {
  if (following) byId("lines").scrollTop = byId("lines").scrollHeight;
}
byId("lines").addEventListener("scroll", ({ target }) => {
  following = target.scrollTop + target.clientHeight > target.scrollHeight - 8;
});
new ResizeObserver(toEnd).observe(byId("lines"));

/** Lines of the event log: [t, text, level]. */
export function log(events) {
  const lines = byId("lines");
  for (const [t, words, level] of events) {
    const line = document.createElement("li"), time = document.createElement("time");
    time.textContent = t.toFixed(1);
    line.className = level;
    // Some lines begin with the time, for the terminal.
    line.append(time, ` ${words.replace(/^[\d.]+ s:? +/, "")}`);
    lines.append(line);
  }
  while (lines.childElementCount > MOST_LINES) lines.firstChild.remove();
  toEnd();
}

/** Show a refusal on the map; an empty one clears it. */
export function refuse(words) {
  put(byId("error"), "hidden", !words);
  text("error", words);
}

/** The list of keep-out areas, each with a button that deletes it. */
export function keepouts(send) {
  const rows = scene.keepouts.map((outline, k) => {
    const row = document.createElement("li");
    row.append(`${k + 1}: ${outline.length} corners`, button("×", `Delete keep-out ${k + 1}`, () =>
      send({ do: "keepout", outlines: scene.keepouts.filter((_, other) => other !== k) })));
    return row;
  });
  refill(byId("keepouts"), rows, "None. Choose Keep out and click the corners of an area; Save map saves it too.");
}
