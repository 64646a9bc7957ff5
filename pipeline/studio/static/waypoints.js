// The list of waypoints being edited: on the map by the tool, here by number.

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
    this.chosen = -1;
    this.update();
  }

  add(pose) {
    this.chosen = this.list.push({ pose, wait: null }) - 1;
    this.update();
  }

  move(k, pose) {
    this.list[k].pose = pose;
    this.chosen = k;
    this.update();
  }

  choose(k) {
    this.chosen = k;
    this.update();
  }

  swap(k, other) {
    [this.list[k], this.list[other]] = [this.list[other], this.list[k]];
    this.chosen = other;
    this.update();
  }

  remove(k) {
    this.list.splice(k, 1);
    this.chosen = -1;
    this.update();
  }

  update() {
    try { sessionStorage.setItem(KEPT, JSON.stringify(this.list)); } catch { /* not allowed here */ }
    this.build();
    this.changed();
  }

  build() {
    const rows = this.list.map((waypoint, k) => this.row(waypoint, k));
    if (!rows.length) {
      const empty = document.createElement("li");
      empty.className = "quiet";
      empty.textContent = "None yet. Choose Waypoint and click the map, or load a file.";
      rows.push(empty);
    }
    this.rows.replaceChildren(...rows);
  }

  row({ pose, wait }, k) {
    const row = document.createElement("li");
    row.classList.toggle("chosen", k === this.chosen);
    const where = field(words(pose), `Waypoint ${k + 1}: x, y, heading`, (text) => {
      const found = numbers(text, 3);
      if (found) this.move(k, found);
      else this.refuse(`waypoint ${k + 1}: "${text}" is not x, y, heading`);
    });
    const pause = field(wait ?? "", `Waypoint ${k + 1}: wait in seconds`, (text) => {
      if (Number(text) >= 0) this.list[k].wait = text ? Number(text) : null;
      else this.refuse(`waypoint ${k + 1}: a wait is a number of seconds, not "${text}"`);
      this.update();
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

function field(value, name, take) {
  const made = document.createElement("input");
  made.value = value;
  made.ariaLabel = name;
  made.addEventListener("change", () => take(made.value.trim()));
  return made;
}

/** A small button with a spoken name. */
export function button(text, name, press, disabled = false) {
  const made = document.createElement("button");
  made.type = "button";
  Object.assign(made, { textContent: text, ariaLabel: name, title: name, disabled });
  made.addEventListener("click", press);
  return made;
}
