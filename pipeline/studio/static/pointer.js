// Mouse and touch on the map: one finger uses the tool or pans, two pinch, the wheel zooms.

import { pan, toWorld, view, zoom } from "./view.js";

/** `desk` has the tool, `may` says whether it may be used now, `changed` asks for a redraw, `over` receives the position of the mouse. */
export function listen(canvas, desk, may, changed, over) {
  const down = new Map();
  let panning = false;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  canvas.addEventListener("pointerdown", (event) => {
    const at = place(event);
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, at);
    if (down.size > 1) desk.drop();
    panning = down.size > 1 || event.button !== 0 || desk.name === "view" || !may();
    if (!panning) desk.press(toWorld(...at), at);
    changed();
  });

  canvas.addEventListener("pointermove", (event) => {
    const at = place(event), before = down.get(event.pointerId);
    over(toWorld(...at));
    if (before && panning) {
      const other = [...down].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const apart = ([x, y]) => Math.hypot(x - other[0], y - other[1]);
        zoom(apart(at) / Math.max(apart(before), 1), (at[0] + other[0]) / 2, (at[1] + other[1]) / 2);
      }
      pan((at[0] - before[0]) / down.size, (at[1] - before[1]) / down.size);
    } else desk.move(toWorld(...at));
    if (before) down.set(event.pointerId, at);
    changed();
  });

  canvas.addEventListener("pointerup", (event) => {
    const at = place(event);
    if (!panning && down.has(event.pointerId)) desk.release(toWorld(...at), at);
    down.delete(event.pointerId);
    changed();
  });
  canvas.addEventListener("pointercancel", (event) => {
    down.delete(event.pointerId);
    desk.drop();
    changed();
  });
  canvas.addEventListener("pointerleave", () => over(null));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const at = view.follow ? [] : place(event);
    zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), ...at);
    changed();
  }, { passive: false });
}
