// A played bag: its time, its loops, and their descriptions.

import { byId, put } from "./elements.js";
import { scene } from "./scene.js";
import { toScreen } from "./view.js";

const EVERY_MS = 150;
let held = false, sent = 0;

/** Whether a bag is played instead of a simulation. */
export const bagged = () => scene.hello?.robot === "";

/** The node of the graph under a pixel as its number, or -1. */
export function nodeAt([px, py], reach = 14) {
  const nodes = scene.blobs.graph_nodes ?? [];
  let best = -1;
  for (let k = 0; k < nodes.length; k += 3) {
    const [x, y] = toScreen(nodes[k], nodes[k + 1]), away = Math.hypot(x - px, y - py);
    if (away < reach) [best, reach] = [k / 3, away];
  }
  return best;
}

export const nodePose = (node) => [...scene.blobs.graph_nodes.subarray(3 * node, 3 * node + 3)];
export const scanOf = (node) => scene.blobs.graph_keys[node];

/** The loop under a pixel as `{scan, place}`, or null. */
export function loopAt(pixel, reach = 10) {
  const edges = scene.blobs.graph_edges ?? [];
  let best = null;
  for (let k = 0; k < edges.length; k += 3) {
    if (edges[k + 2] !== 1) continue;
    const away = fromSegment(pixel, toScreen(...nodePose(edges[k])), toScreen(...nodePose(edges[k + 1])));
    if (away < reach) [best, reach] = [{ scan: scanOf(edges[k]), place: scanOf(edges[k + 1]) }, away];
  }
  return best;
}

function fromSegment([px, py], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay], length = dx * dx + dy * dy;
  const along = length ? Math.min(Math.max(((px - ax) * dx + (py - ay) * dy) / length, 0), 1) : 0;
  return Math.hypot(px - ax - along * dx, py - ay - along * dy);
}

/** What to do first, or next. */
export function bagAdvice({ mapping, state }) {
  if (mapping) return "";
  if (state === "at its end" && !scene.blobs.graph_nodes?.length) return "End of the bag: go back with the bar below, or map the whole bag.";
  if (!scene.blobs.graph_nodes?.length) return "Start mapping to map the bag while it plays, or map the whole bag at once.";
  return state === "playing" ? "" : "Choose Loops and click a loop to overlay its two scans, or Draw and Erase to mend walls.";
}

const EDITS = {
  reject: (scan, place) => `Scans ${scan} and ${place} are kept apart`,
  add: (scan, place) => `Scans ${scan} and ${place} are joined`,
  draw: (scan) => `A wall is drawn near scan ${scan}`,
  erase: (scan) => `Walls are erased near scan ${scan}`,
};

/** Update the bag's controls after each frame. */
export function showBag(head) {
  const { bag } = head;
  if (!bag) return;
  put(byId("time"), "max", String(bag.duration));
  if (!held) put(byId("time"), "value", String(bag.position));
  put(byId("when"), "textContent", `${bag.position.toFixed(1)} of ${bag.duration.toFixed(1)} s`);
  const { loop } = bag;
  put(byId("told"), "textContent", loop ? `Scan ${loop.scan} on scan ${loop.place}: ${loop.told}.` : "No loop selected.");
  put(byId("reject"), "disabled", !loop);
  const list = byId("edits"), told = JSON.stringify(bag.edits);
  if (list.dataset.told === told) return;
  list.dataset.told = told;
  list.replaceChildren(...bag.edits.map(([kind, scan, place]) => {
    const row = document.createElement("li");
    row.textContent = EDITS[kind](scan, place);
    return row;
  }));
  put(byId("forget"), "disabled", !bag.edits.length);
  put(byId("undo"), "disabled", !bag.edits.some(([kind]) => kind === "draw" || kind === "erase"));
}

/** The controls that only a bag has. */
export function attachBag(send) {
  const seek = () => send({ do: "seek", t: Number(byId("time").value) });
  byId("time").addEventListener("input", () => {
    held = true;
    if (performance.now() - sent > EVERY_MS) { sent = performance.now(); seek(); }
  });
  byId("time").addEventListener("change", () => { held = false; seek(); });
  byId("reject").addEventListener("click", () => {
    const { scan, place } = scene.head.bag.loop;
    send({ do: "loop_reject", scan, place });
  });
}
