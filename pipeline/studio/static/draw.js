// Painting: one function a layer, from the bottom up.

import { scene } from "./scene.js";
import { flagSize, toScreen, toWorld, view } from "./view.js";

const NAMES = ["ink", "muted", "paper", "rule", "link", "good", "bad", "truth", "odometry", "slam", "estimate", "scan", "loop", "plan"];
let pen, colour;

/** Colours of the page, light or dark. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  colour = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function trace(points, closed = false) {
  pen.beginPath();
  for (const [x, y] of points) pen.lineTo(...toScreen(x, y));
  if (closed) pen.closePath();
}

function stroke(style, width, dash = []) {
  pen.strokeStyle = style;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  pen.stroke();
  pen.setLineDash([]);
}

function fill(style, alpha = 1) {
  pen.globalAlpha = alpha;
  pen.fillStyle = style;
  pen.fill();
  pen.globalAlpha = 1;
}

/** Text with a halo, centred at a point of the screen. */
function label(text, px, py, style = colour.ink) {
  pen.lineWidth = 3;
  pen.strokeStyle = colour.paper;
  pen.strokeText(text, px, py);
  pen.fillStyle = style;
  pen.fillText(text, px, py);
}

function grid(name) {
  const found = scene.grids[name];
  if (!found) return;
  const cell = found.resolution * view.scale;
  pen.save();
  pen.translate(...toScreen(found.origin[0], found.origin[1]));
  pen.rotate(-found.origin[2]);
  pen.scale(cell, cell);
  pen.imageSmoothingEnabled = cell < 1;
  pen.drawImage(found.canvas, 0, -found.h);
  pen.restore();
}

/** A polyline of flat x, y pairs; points within a pixel of the last drawn one are left out. */
function path(name, style, width, dash) {
  const points = scene.blobs[name];
  if (!points?.length) return;
  let lastX = Infinity, lastY = Infinity;
  pen.beginPath();
  for (let k = 0; k < points.length; k += 2) {
    const [px, py] = toScreen(points[k], points[k + 1]);
    if (Math.abs(px - lastX) + Math.abs(py - lastY) < 1 && k + 2 < points.length) continue;
    pen.lineTo(px, py);
    [lastX, lastY] = [px, py];
  }
  stroke(style, width, dash);
}

function dots(name, step, size, style) {
  const points = scene.blobs[name] ?? [];
  pen.fillStyle = style;
  for (let k = 0; k < points.length; k += step) {
    const [px, py] = toScreen(points[k], points[k + 1]);
    pen.fillRect(px - size / 2, py - size / 2, size, size);
  }
}

function particles() {
  const points = scene.blobs.particles ?? [], length = 6;
  pen.beginPath();
  for (let k = 0; k < points.length; k += 3) {
    const [px, py] = toScreen(points[k], points[k + 1]);
    pen.moveTo(px, py);
    pen.lineTo(px + length * Math.cos(points[k + 2]), py - length * Math.sin(points[k + 2]));
  }
  pen.globalAlpha = 0.3;
  stroke(colour.estimate, 1);
  pen.globalAlpha = 1;
}

function graph() {
  const nodes = scene.blobs.graph_nodes, edges = scene.blobs.graph_edges ?? [];
  if (!nodes) return;
  for (const [kind, style, width] of [[0, colour.slam, 1], [1, colour.loop, 2]]) {
    pen.beginPath();
    for (let k = 0; k < edges.length; k += 3) {
      if (edges[k + 2] !== kind || 3 * Math.max(edges[k], edges[k + 1]) >= nodes.length) continue;
      pen.moveTo(...toScreen(nodes[3 * edges[k]], nodes[3 * edges[k] + 1]));
      pen.lineTo(...toScreen(nodes[3 * edges[k + 1]], nodes[3 * edges[k + 1] + 1]));
    }
    stroke(style, width);
  }
  dots("graph_nodes", 3, 4, colour.slam);
}

/** The two scans of the selected loop. */
function loop() {
  dots("loop_place", 2, 4, colour.good);
  dots("loop_scan", 2, 3, colour.odometry);
}

function ghost() {
  const { world_segments, world_circles, mover_segments, mover_circles } = scene.blobs;
  shapes(world_segments, world_circles);
  stroke(colour.truth, 2);
  shapes(mover_segments, mover_circles);
  fill(colour.truth, 0.3);
  stroke(colour.truth, 2);
  path("true_path", colour.truth, 4);
  if (scene.head.true_pose) body(scene.head.true_pose, colour.truth, 0.4);
}

/** Segments x0, y0, x1, y1 and circles x, y, radius, as one path. */
function shapes(segments = [], circles = []) {
  pen.beginPath();
  for (let k = 0; k < segments.length; k += 4) {
    pen.moveTo(...toScreen(segments[k], segments[k + 1]));
    pen.lineTo(...toScreen(segments[k + 2], segments[k + 3]));
  }
  for (let k = 0; k < circles.length; k += 3) {
    const [px, py] = toScreen(circles[k], circles[k + 1]), radius = circles[k + 2] * view.scale;
    pen.moveTo(px + radius, py);
    pen.arc(px, py, radius, 0, 2 * Math.PI);
  }
}

/** The robot's outline at a pose, with a line ahead. */
function body([x, y, yaw], style, alpha) {
  const outline = scene.blobs.outline;
  if (!outline) return;
  const c = Math.cos(yaw), s = Math.sin(yaw);
  const at = (u, v) => [x + c * u - s * v, y + s * u + c * v];
  const corners = Array.from({ length: outline.length / 2 }, (_, k) => at(outline[2 * k], outline[2 * k + 1]));
  const front = Math.max(...outline.filter((_, k) => k % 2 === 0)) + 8 / view.scale;
  for (const [line, wider] of [[colour.paper, 3], [style, 0]]) {
    trace(corners, true);
    stroke(line, 2 + wider);
    if (line === style) fill(style, alpha);
    trace([[x, y], at(front, 0)]);
    stroke(line, 3 + wider);
  }
}

function sectors() {
  const told = scene.head.sectors, pose = scene.head.pose;
  if (!told?.decision || !pose) return;
  const tint = (d) => (d < 0.5 ? colour.bad : d < 1 ? colour.loop : colour.good);
  for (const [name, middle] of [["front", 0], ["left", Math.PI / 2], ["right", -Math.PI / 2]]) {
    const distance = told[name], shown = Math.min(distance ?? 3.5, 3.5), angle = -(pose[2] + middle);
    const [px, py] = toScreen(pose[0], pose[1]), radius = shown * view.scale;
    pen.beginPath();
    pen.moveTo(px, py);
    pen.arc(px, py, radius, angle - Math.PI / 6, angle + Math.PI / 6);
    pen.closePath();
    fill(tint(shown), 0.1);
    stroke(tint(shown), 1);
    const out = Math.max(0.7 * radius, 34);
    label(distance == null ? "free" : distance.toFixed(2), px + out * Math.cos(angle), py + out * Math.sin(angle));
  }
}

/** A numbered disc with an arrow for the heading; smaller where the map is. */
function flag(x, y, yaw, text, style, { chosen = false, hollow = false } = {}) {
  const [dx, dy] = [Math.cos(yaw), -Math.sin(yaw)], size = flagSize();
  pen.save();
  pen.translate(...toScreen(x, y));
  pen.scale(size, size);
  pen.beginPath();
  pen.moveTo(9 * dx, 9 * dy);
  pen.lineTo(26 * dx, 26 * dy);
  pen.moveTo(20 * dx - 5 * dy, 20 * dy + 5 * dx);
  pen.lineTo(26 * dx, 26 * dy);
  pen.lineTo(20 * dx + 5 * dy, 20 * dy - 5 * dx);
  stroke(style, 2);
  pen.beginPath();
  pen.arc(0, 0, chosen ? 11 : 9, 0, 2 * Math.PI);
  fill(hollow ? colour.paper : style);
  stroke(style, 2);
  pen.fillStyle = hollow ? style : colour.paper;
  pen.fillText(text, 0, 0.5);
  pen.restore();
}

function goals() {
  const { goals: told = [], goal, goal_index: now } = scene.head;
  for (const [k, { x, y, yaw, status }] of told.entries()) {
    const open = status === "waiting" || status === "active";
    const [style, mark] = open ? [colour.link, String(k + 1)] : status === "reached" ? [colour.good, "✓"] : [colour.bad, "✗"];
    flag(x, y, yaw, mark, style, { chosen: k === now, hollow: status === "waiting" });
  }
  if (goal && !told.length) flag(...goal, "", colour.link, { chosen: true });
}

function area(outline) {
  trace(outline, true);
  fill(colour.bad, 0.14);
  stroke(colour.bad, 1.5, [6, 3]);
}

function boxes() {
  const told = scene.blobs.boxes ?? [];
  for (let k = 0; k < told.length; k += 4) {
    const [x, y, w, h] = told.subarray(k, k + 4);
    trace([[x - w / 2, y - h / 2], [x + w / 2, y - h / 2], [x + w / 2, y + h / 2], [x - w / 2, y + h / 2]], true);
    fill(colour.muted, 0.35);
    stroke(colour.muted, 1.5);
  }
}

function metres() {
  const step = [0.1, 0.5, 1, 5, 10, 50, 100].find((size) => size * view.scale >= 40) ?? 500;
  const [left, top] = toWorld(0, 0), [right, low] = toWorld(view.width, view.height);
  pen.beginPath();
  for (let x = Math.ceil(left / step) * step; x < right; x += step) {
    const px = Math.round(toScreen(x, 0)[0]) + 0.5;
    pen.moveTo(px, 0);
    pen.lineTo(px, view.height);
  }
  for (let y = Math.ceil(low / step) * step; y < top; y += step) {
    const py = Math.round(toScreen(0, y)[1]) + 0.5;
    pen.moveTo(0, py);
    pen.lineTo(view.width, py);
  }
  pen.globalAlpha = 0.12;
  stroke(colour.muted, 1);
  pen.globalAlpha = 1;
}

function scaleBar() {
  const size = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100].find((length) => length * view.scale >= 64) ?? 200;
  const length = size * view.scale, x = 14.5, y = view.height - 34.5;
  for (const [style, width] of [[colour.paper, 4], [colour.ink, 1.5]]) {
    pen.beginPath();
    pen.moveTo(x, y - 5);
    pen.lineTo(x, y);
    pen.lineTo(x + length, y);
    pen.lineTo(x + length, y - 5);
    stroke(style, width);
  }
  label(`${size} m`, x + length / 2, y - 10);
}

/** Layers from the bottom up: name, label, painter, shown by default. Server layers have the server's names. */
export const LAYERS = [
  ["map", "Map", () => grid("map"), true],
  ["grid", "Metre grid", metres, true],
  ["costmap", "Costmap", () => grid("costmap"), false],
  ["ghost", "True world (ghost)", ghost, false],
  ["keepout", "Keep-outs", () => scene.keepouts.forEach(area), true],
  ["boxes", "Boxes", boxes, true],
  ["odom_path", "Odometry path", () => path("odom_path", colour.odometry, 1.5), true],
  ["slam_path", "SLAM path", () => path("slam_path", colour.slam, 2), true],
  ["graph", "Pose graph, loops", graph, true],
  ["sectors", "Avoidance sectors", sectors, true],
  ["particles", "Particles", particles, true],
  ["scan", "Scan", () => dots("scan", 2, 3, colour.scan), true],
  ["plan", "Global plan", () => path("plan", colour.plan, 2, [7, 4]), true],
  ["local", "Local trajectory", () => path("local", colour.estimate, 3), true],
  ["waypoints", "Waypoints", null, true],
  ["goals", "Goals", goals, true],
  ["loop", "Selected loop", loop, true],
  ["robot", "Robot", () => scene.head.pose && body(scene.head.pose, colour.estimate, 0.6), true],
];

/** Preview of a tool: an arrow, the robot being carried, an outline, a stroke. */
function sketch({ arrow, carried, outline, tip, stroke: line, erased, width }) {
  if (line) {
    trace(line);
    stroke(erased ? colour.bad : colour.ink, Math.max(width * view.scale, 3));
  }
  if (arrow) flag(...arrow, "", colour.odometry, { hollow: true });
  if (carried) body(carried, colour.odometry, 0.3);
  if (outline?.length) {
    area(tip ? [...outline, tip] : outline);
    for (const [k, [x, y]] of outline.entries()) {
      pen.beginPath();
      pen.arc(...toScreen(x, y), k ? 3 : 6, 0, 2 * Math.PI);
      fill(colour.bad);
    }
  }
}

/** Paint everything that is shown: `shown` has the names of layers, `waypoints` the list being edited. */
export function draw(canvas, shown, waypoints, doing) {
  const ratio = devicePixelRatio || 1;
  pen ??= canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, view.width, view.height);
  Object.assign(pen, { font: "600 11px system-ui, sans-serif", textAlign: "center", textBaseline: "middle", lineJoin: "round", lineCap: "round" });
  for (const [name, , paint] of LAYERS) {
    if (!shown.has(name)) continue;
    if (paint) paint();
    else for (const [k, { pose, blocked }] of waypoints.list.entries()) flag(...pose, String(k + 1), blocked ? colour.bad : colour.plan, { hollow: true, chosen: k === waypoints.chosen });
  }
  sketch(doing);
  scaleBar();
}
