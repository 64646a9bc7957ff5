// The list of waypoints being edited: on the map by the tool, here by number.

import { button, byId, put, refill } from "./elements.js";
import { numbers, words } from "./words.js";

export class Waypoints {
  /** `rows` is an <ol>; `share` tells the session of each change, `changed` the drawing, `refuse` what is wrong. */
  constructor(rows, share, changed, refuse) {
    Object.assign(this, { rows, share, changed, refuse, list: [], chosen: -1, sent: "" });
    this.build();
  }

  /** What the session has: all pages edit one list. `stops`: x, y, yaw, wait and what stands in the way. */
  arrived(stops) {
    const list = stops.map(([x, y, yaw, wait]) => ({ pose: [x, y, yaw], wait }));
    if (JSON.stringify(list) === this.sent) this.sent = "";
    if (!this.sent && !this.moving && JSON.stringify(list) !== JSON.stringify(this.plain())) {
      this.list = list;
      this.chosen = -1;
      this.build();
    }
    if (this.list.length !== stops.length) return;
    for (const [k, stop] of stops.entries()) this.list[k].blocked = stop[4];
    this.mark();
    this.changed();
  }

  plain() { return this.list.map(({ pose, wait }) => ({ pose, wait })); }

  clear() {
    this.list = [];
    this.choose(-1);
  }

  add(pose) {
    this.choose(this.list.push({ pose, wait: null }) - 1);
  }

  /** Move one, while it is dragged; `dropped` ends that. */
  move(k, pose) {
    this.moving = true;
    this.list[k].pose = pose;
    this.choose(k);
  }

  dropped(k) {
    this.moving = false;
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

  /** Tell the session; until it answers with this list, what comes is older. */
  keep() {
    if (!this.moving) {
      this.sent = JSON.stringify(this.plain());
      this.share(this.plain());
    }
    this.changed();
  }

  /** Those where the robot cannot stand, in the list and in a sentence. */
  mark() {
    const blocked = [...this.list.entries()].filter(([, stop]) => stop.blocked);
    for (const [k, row] of [...this.rows.children].entries()) {
      row.classList.toggle("blocked", Boolean(this.list[k]?.blocked));
      row.title = this.list[k]?.blocked ?? "";
    }
    const more = blocked.length > 1 ? ` (and ${blocked.length - 1} more)` : "";
    const [[k, stop] = []] = blocked;
    put(byId("blocked"), "hidden", !stop);
    put(byId("blocked"), "textContent", stop ? `Waypoint ${k + 1} is ${stop.blocked}${more}: the robot cannot stop there.` : "");
  }

  build(down = 0) {
    const rows = this.list.map((_, k) => this.row(k));
    refill(this.rows, rows, "None yet. Choose Waypoint and click the map, or load a file.", down);
    this.mark();
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
