// Map tools: the meaning of press, drag, release and typed numbers for each of them.

import { loopAt, nodeAt, nodePose, scanOf } from "./bag.js";
import { scene } from "./scene.js";
import { flagSize, toScreen } from "./view.js";
import { numbers, round3, words } from "./words.js";

const NEAR = 14;
const near = ([x, y], [px, py]) => {
  const [qx, qy] = toScreen(x, y);
  return Math.hypot(qx - px, qy - py) < NEAR;
};
const turned = ([x, y], [tx, ty]) => Math.atan2(ty - y, tx - x);

/** Pose from where a drag began to where it points; a press alone keeps the heading `otherwise`. */
function aimed(from, to, otherwise) {
  const far = Math.hypot(...toScreen(...from).map((value, k) => value - toScreen(...to)[k])) > NEAR;
  return [...from, far ? turned(from, to) : otherwise];
}

/** Press, drag, release: a pose. */
const arrow = (send, otherwise) => ({
  form: "x, y, heading",
  press(desk, at) { this.from = at; desk.doing = { arrow: [...at, otherwise(at)] }; },
  move(desk, at) { desk.doing = { arrow: aimed(this.from, at, otherwise(this.from)) }; },
  release(desk) { send(desk, round3(desk.doing.arrow)); },
  typed(desk, text) { return send(desk, numbers(text, 3)); },
});

/** Press, drag, release: a straight stroke; a press alone is a spot. */
const stroke = (name, hint, width) => ({
  hint,
  form: "x, y, x, y",
  press(desk, at) { this.move(desk, at, this.from = at); },
  move(desk, at) { desk.doing = { stroke: [this.from, at], erased: name === "wall_erase", width: width(desk) }; },
  release(desk) { this.send(desk, desk.doing.stroke.map(round3)); },
  typed(desk, text) { const flat = numbers(text, 4); return flat && this.send(desk, [flat.slice(0, 2), flat.slice(2)]); },
  send: (desk, points) => desk.send({ do: name, points, width: width(desk) }),
});

const heading = () => scene.head.pose?.[2] ?? 0;
const ahead = (at) => (scene.head.pose ? turned(scene.head.pose, at) : 0);

const TOOLS = {
  view: { hint: "" },
  pose: {
    ...arrow((desk, pose) => pose && desk.send({ do: "pose_estimate", pose }), heading),
    hint: "2D Pose Estimate: press where the robot is, drag in the direction it faces, release.",
  },
  goal: {
    ...arrow((desk, pose) => pose && desk.send({ do: "goal", pose }), ahead),
    hint: "2D Nav Goal: press where the robot should go, drag for the heading, release.",
  },
  point: {
    hint: "Publish Point: click to copy x, y.",
    form: "x, y",
    release(desk, at) { desk.copy(words(at)); },
    typed(desk, text) { const at = numbers(text, 2); return at && desk.copy(words(at)); },
  },
  waypoint: {
    hint: "Waypoints: press, drag for the heading, release. Drag a disc to move it, its arrow to turn it.",
    form: "x, y, heading",
    press(desk, at, pixel) {
      const { list } = desk.waypoints;
      const tip = ([x, y, yaw]) => toScreen(x, y).map((value, k) => value + 26 * flagSize() * (k ? -Math.sin(yaw) : Math.cos(yaw)));
      this.turning = list.findIndex(({ pose }) => Math.hypot(tip(pose)[0] - pixel[0], tip(pose)[1] - pixel[1]) < 9);
      this.moving = this.turning < 0 ? list.findIndex(({ pose }) => near(pose, pixel)) : -1;
      this.from = at;
      if (this.turning < 0 && this.moving < 0) desk.doing = { arrow: [...at, this.onward(desk, at)] };
    },
    onward(desk, at) { const last = desk.waypoints.list.at(-1); return last ? turned(last.pose, at) : ahead(at); },
    move(desk, at) {
      const { list } = desk.waypoints;
      if (this.turning >= 0) {
        const pose = list[this.turning].pose;
        desk.waypoints.move(this.turning, round3([pose[0], pose[1], turned(pose, at)]));
      } else if (this.moving >= 0) desk.waypoints.move(this.moving, round3([...at, list[this.moving].pose[2]]));
      else desk.doing = { arrow: aimed(this.from, at, this.onward(desk, this.from)) };
    },
    release(desk) {
      if (desk.doing.arrow) desk.waypoints.add(round3(desk.doing.arrow));
      else desk.waypoints.dropped(Math.max(this.moving, this.turning));
    },
    drop(desk) { if (desk.waypoints.moving) desk.waypoints.dropped(-1); },
    typed(desk, text) { const pose = numbers(text, 3); if (pose) desk.waypoints.add(pose); return pose; },
  },
  keepout: {
    hint: "Keep-out: click its corners, then press Enter or click the first one again. Backspace removes the last.",
    form: "x, y, x, y, x, y, ...",
    outline: [],
    hover(desk, at) { desk.doing = { outline: this.outline, tip: at }; },
    release(desk, at, pixel) {
      if (this.outline.length > 2 && near(this.outline[0], pixel)) this.close(desk);
      else {
        this.outline.push(round3(at));
        desk.doing = { outline: this.outline };
      }
    },
    back(desk) { this.outline.pop(); desk.doing = { outline: this.outline }; },
    enter(desk) {
      if (this.outline.length < 3) return false;
      this.close(desk);
      return true;
    },
    close(desk) {
      desk.send({ do: "keepout", outlines: [...scene.keepouts.map((area) => area.map(round3)), this.outline] });
      this.drop(desk);
    },
    drop(desk) { this.outline = []; desk.doing = {}; },
    typed(desk, text) {
      const count = text.trim().split(/[\s,;]+/).length;
      const flat = !text.trim() ? this.outline.flat() : numbers(text, count);
      if (!flat || flat.length < 6 || flat.length % 2) return null;
      this.outline = Array.from({ length: flat.length / 2 }, (_, k) => [flat[2 * k], flat[2 * k + 1]]);
      this.close(desk);
      return flat;
    },
  },
  box: {
    hint: "Box: click to drop one on the floor.",
    form: "x, y",
    release(desk, at) { desk.send({ do: "box", xy: round3(at), size: desk.size() }); },
    typed(desk, text) { const xy = numbers(text, 2); return xy && desk.send({ do: "box", xy, size: desk.size() }); },
  },
  loop: {
    hint: "Loops: click one to overlay its two scans.",
    form: "scan, place",
    release(desk, at, pixel) {
      const found = loopAt(pixel);
      if (found) desk.send({ do: "loop_show", ...found });
      else desk.refuse("No loop here: click on a line between two parts of the path.");
    },
    typed(desk, text) { const [scan, place] = numbers(text, 2) ?? []; return place !== undefined && desk.send({ do: "loop_show", scan, place }); },
  },
  join: {
    hint: "Join: drag a node of the graph onto a node of the same place on another visit.",
    form: "scan, place, x, y, heading",
    press(desk, at, pixel) {
      this.node = nodeAt(pixel);
      if (this.node < 0) desk.refuse("No node here: press on one of the dots of the path.");
    },
    move(desk, at) { if (this.node >= 0) desk.doing = { arrow: [...at, nodePose(this.node)[2]] }; },
    release(desk, at, pixel) {
      const place = nodeAt(pixel, 60);
      if (this.node < 0 || place < 0 || place === this.node) return;
      const pose = seenFrom(nodePose(place), [...at, nodePose(this.node)[2]]);
      desk.send({ do: "loop_add", scan: scanOf(this.node), place: scanOf(place), pose: round3(pose) });
    },
    typed(desk, text) {
      const [scan, place, ...pose] = numbers(text, 5) ?? [];
      return pose.length === 3 && desk.send({ do: "loop_add", scan, place, pose });
    },
  },
  wall: stroke("wall_draw", "Draw a wall: press, drag, release.", () => 0),
  erase: stroke("wall_erase", "Erase walls: press, drag, release; or click a spot.", (desk) => desk.width()),
  carry: {
    hint: "Carry: drag the robot to another place; or press, drag for the heading, release.",
    form: "x, y, heading",
    press(desk, at, pixel) {
      this.from = at;
      this.held = scene.head.pose && near(scene.head.pose, pixel);
      desk.doing = { carried: this.held ? scene.head.pose : [...at, heading()] };
    },
    move(desk, at) { desk.doing = { carried: this.held ? [...at, heading()] : aimed(this.from, at, heading()) }; },
    release(desk) { desk.send({ do: "kidnap", pose: round3(desk.doing.carried) }); },
    typed(desk, text) { const pose = numbers(text, 3); return pose && desk.send({ do: "kidnap", pose }); },
  },
};

/** Pose b relative to pose a. */
function seenFrom([ax, ay, at], [bx, by, bt]) {
  const c = Math.cos(at), s = Math.sin(at), [dx, dy] = [bx - ax, by - ay];
  return [c * dx + s * dy, c * dy - s * dx, Math.atan2(Math.sin(bt - at), Math.cos(bt - at))];
}

export const KEYS = { l: "loop", j: "join", m: "wall", e: "erase", v: "view", p: "pose", g: "goal", n: "waypoint", c: "point", k: "keepout", b: "box", r: "carry" };

/** The current tool; `doing` is the preview that draw.js paints. */
export class Desk {
  /** `helpers`: send, copy, size (of a box), width (of the eraser), waypoints, chosen (told the tool). */
  constructor(helpers) {
    Object.assign(this, helpers, { doing: {}, name: "view", busy: false });
  }

  get tool() { return TOOLS[this.name]; }

  choose(name) {
    this.drop();
    this.name = name;
    this.chosen(name, this.tool);
  }

  press(at, pixel) { this.busy = true; this.tool.press?.(this, at, pixel); }
  move(at) { if (this.busy) this.tool.move?.(this, at); else this.tool.hover?.(this, at); }
  release(at, pixel) {
    if (!this.busy) return;
    this.busy = false;
    this.tool.release(this, at, pixel);
    if (!this.doing.outline) this.doing = {};
    // Pose, goal and carry are used once; the other tools stay active.
    if (["pose", "goal", "carry"].includes(this.name)) this.choose("view");
  }

  /** Cancel the current action: a second finger, Escape or another tool. */
  drop() {
    const begun = this.busy || this.doing.outline?.length > 0;
    this.busy = false;
    this.doing = {};
    this.tool.drop?.(this);
    return begun;
  }

  /** Numbers instead of a drag; false if they do not suit the tool. */
  type(text) { return Boolean(this.tool.typed(this, text)); }
}
