// What there is to draw: the last hello, the last frame's header, and all data received in frames.

import { Grid } from "./grid.js";

export const dark = matchMedia("(prefers-color-scheme: dark)");

export const scene = { hello: null, head: {}, blobs: {}, grids: {}, keepouts: [] };

dark.addEventListener("change", () => {
  for (const grid of Object.values(scene.grids)) grid.recolour(dark.matches);
});

/** A new connection: everything is sent again. */
export function begin(hello, blobs) {
  Object.assign(scene, { hello, head: hello, blobs, grids: {}, keepouts: [] });
}

/** A frame: its header replaces the last one, its blobs those of the same name. */
export function take(header, blobs) {
  scene.head = header;
  for (const [name, told] of Object.entries(header.grids ?? {})) {
    if (scene.grids[name]?.version !== told.version) scene.grids[name] = new Grid(name, told, dark.matches);
    if (blobs[`${name}_tiles`]) scene.grids[name].patch(told.tiles, blobs[`${name}_tiles`]);
  }
  for (const [name, values] of Object.entries(blobs)) {
    const from = header.append?.[name];
    scene.blobs[name] = from ? joined(scene.blobs[name], 2 * from, values) : values;
  }
  if (header.keepout_sizes) scene.keepouts = outlines(scene.blobs.keepout, header.keepout_sizes);
}

function joined(before, keep, values) {
  const all = new Float32Array(keep + values.length);
  all.set(before.subarray(0, keep));
  all.set(values, keep);
  return all;
}

function outlines(corners, sizes) {
  let from = 0;
  return sizes.map((size) => Array.from({ length: size }, () => [corners[from++], corners[from++]]));
}
