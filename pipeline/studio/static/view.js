// The visible part of the map: metres to pixels and back, zoom, pan, fit.

export const view = { x: 0, y: 0, scale: 60, width: 1, height: 1, follow: false };

export const toScreen = (x, y) => [
  view.width / 2 + (x - view.x) * view.scale,
  view.height / 2 - (y - view.y) * view.scale,
];
export const toWorld = (px, py) => [
  view.x + (px - view.width / 2) / view.scale,
  view.y - (py - view.height / 2) / view.scale,
];

/** How large discs and arrows of poses are drawn: their arrow is 26 pixels times this long. */
export const flagSize = () => Math.min(Math.max(view.scale / 50, 0.7), 1);

/** Zoom about a fixed point of the screen. */
export function zoom(factor, px = view.width / 2, py = view.height / 2) {
  const [x, y] = toWorld(px, py);
  view.scale = Math.min(Math.max(view.scale * factor, 1), 2000);
  const [nx, ny] = toWorld(px, py);
  view.x += x - nx;
  view.y += y - ny;
}

export function pan(dx, dy) {
  view.x -= dx / view.scale;
  view.y += dy / view.scale;
  view.follow = false;
}

/** Show all of these places [x, y], below the line of advice. */
export function fit(places) {
  const margin = Math.min(48, 0.08 * view.height), top = 36;
  const xs = places.map(([x]) => x), ys = places.map(([, y]) => y);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const across = Math.max(view.width - 2 * margin, 80) / Math.max(x1 - x0, 0.5);
  const up = Math.max(view.height - top - 2 * margin, 80) / Math.max(y1 - y0, 0.5);
  const scale = Math.min(across, up, 400);
  Object.assign(view, { x: (x0 + x1) / 2, y: (y0 + y1 + top / scale) / 2, scale, follow: false });
}
