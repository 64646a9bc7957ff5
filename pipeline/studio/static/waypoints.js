// The list of waypoints being edited: on the map by the tool, here by number.

import { button, refill } from "./elements.js";
import { numbers, words } from "./words.js";

const KEPT = "turtlebag-waypoints";

export class Waypoints {
  /** `list` is an <ol>; `changed` is called after each change, `refuse` with what is wrong. */
  constructor(rows, changed, refuse) {
    Object.assign(this, { rows, changed, refuse, list: [], chosen: -1 });
    // A reload loses nothing.
    try { this.list = JSON.parse(sessionStorage.getItem(KEPT)) ?? []; } catch { /* nothing kept */ }
    this.build();
  }

  replace(list) {
    this.list = list;
    this.choose(-1);
  }

  add(pose) {
    this.choose(this.list.push({ pose, wait: null }) - 1);
  }

  move(k, pose) {
    this.list[k].pose = pose;
    this.choose(k);
  }

  swap(k, other) {
    [this.list[k], this.list[other]] = [this.list[other], this.list[k]];
    this.choose(other, other - k);
  }

  remove(k) {
    this.list.splice(k, 1);
    this.choose(-1);
  }

  /** `down`: how many rows the one that is worked on has moved. */
  choose(k, down = 0) {
    this.chosen = k;
    this.keep();
    this.build(down);
    if (k >= 0) this.rows.children[k].scrollIntoView({ block: "nearest" });
  }

  keep() {
    try { sessionStorage.setItem(KEPT, JSON.stringify(this.list)); } catch { /* not allowed here */ }
    this.changed();
  }

  build(down = 0) {
    const rows = this.list.map((_, k) => this.row(k));
    refill(this.rows, rows, "None yet. Choose Waypoint and click the map, or load a file.", down);
  }

  row(k) {
    const row = document.createElement("li");
    row.classList.toggle("chosen", k === this.chosen);
    const where = field(() => words(this.list[k].pose), `Waypoint ${k + 1}: x, y, heading`, (text) => {
      const found = numbers(text, 3);
      if (!found) return this.refuse(`waypoint ${k + 1}: "${text}" is not x, y, heading`);
      this.list[k].pose = found;
      this.keep();
    });
    const pause = field(() => this.list[k].wait ?? "", `Waypoint ${k + 1}: wait in seconds`, (text) => {
      if (!(Number(text) >= 0)) return this.refuse(`waypoint ${k + 1}: a wait is a number of seconds, not "${text}"`);
      this.list[k].wait = text ? Number(text) : null;
      this.keep();
    });
    pause.title = "Wait there, in seconds; empty: as long as patrols do";
    pause.placeholder = "wait";
    pause.inputMode = "decimal";
    row.append(String(k + 1), where, pause,
      button("↑", `Move waypoint ${k + 1} up`, () => this.swap(k, k - 1), k === 0),
      button("↓", `Move waypoint ${k + 1} down`, () => this.swap(k, k + 1), k === this.list.length - 1),
      button("×", `Delete waypoint ${k + 1}`, () => this.remove(k)));
    return row;
  }
}

function field(read, name, take) {
  const made = document.createElement("input");
  made.value = read();
  made.ariaLabel = name;
  made.addEventListener("change", () => { take(made.value.trim()); made.value = read(); });
  return made;
}
