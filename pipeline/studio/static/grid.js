// A grid of cells as an offscreen canvas, patched tile by tile; row 0 is the bottom of the map.

function colours(kind, dark) {
  const table = new Uint8ClampedArray(1024);
  const put = (value, r, g, b, a = 255) => table.set([r, g, b, a], 4 * value);
  for (let value = 0; value < 256; value++) {
    const share = Math.min(value / 100, 1);
    if (kind === "costmap") put(value, 86, 180, 233, value > 0 ? 20 + 0.4 * value : 0);
    else if (dark) put(value, 36 + 184 * share, 42 + 181 * share, 48 + 179 * share);
    else put(value, 254 * (1 - share), 254 * (1 - share), 254 * (1 - share));
  }
  if (kind === "costmap") {
    put(253, 180, 85, 160, 60);
    put(254, 180, 85, 160, 90);
    put(255, 0, 0, 0, 0);
  } else {
    put(255, ...(dark ? [22, 26, 30] : [205, 205, 205]));
  }
  return new Uint32Array(table.buffer);
}

export class Grid {
  constructor(kind, told, dark) {
    Object.assign(this, told, { kind });
    this.cells = new Uint8Array(this.w * this.h).fill(kind === "costmap" ? 0 : 255);
    this.canvas = new OffscreenCanvas(this.w, this.h);
    this.pen = this.canvas.getContext("2d");
    this.recolour(dark);
  }

  /** All cells in the colours of the light or the dark page. */
  recolour(dark) {
    this.table = colours(this.kind, dark);
    this.paint(0, 0, this.w, this.h);
  }

  /** Take changed tiles [column, row, width, height], whose cells follow one another in `values`. */
  patch(tiles, values) {
    let from = 0;
    for (const [column, row, w, h] of tiles) {
      for (let y = 0; y < h; y++, from += w) this.cells.set(values.subarray(from, from + w), (row + y) * this.w + column);
      this.paint(column, row, w, h);
    }
  }

  paint(column, row, w, h) {
    const image = this.pen.createImageData(w, h);
    const pixels = new Uint32Array(image.data.buffer);
    for (let y = 0; y < h; y++) {
      const from = (row + h - 1 - y) * this.w + column;
      for (let x = 0; x < w; x++) pixels[y * w + x] = this.table[this.cells[from + x]];
    }
    this.pen.putImageData(image, column, this.h - row - h);
  }

  /** Value of the cell at a point in the map frame; undefined outside. */
  at(x, y) {
    const [x0, y0, yaw] = this.origin, c = Math.cos(yaw), s = Math.sin(yaw);
    const column = Math.floor((c * (x - x0) + s * (y - y0)) / this.resolution);
    const row = Math.floor((c * (y - y0) - s * (x - x0)) / this.resolution);
    return column >= 0 && row >= 0 && column < this.w && row < this.h ? this.cells[row * this.w + column] : undefined;
  }

  /** Corners [x, y] of the bounding box of all known cells, in the map frame; none if all are unknown. */
  corners() {
    let left = this.w, right = -1, low = this.h, high = -1;
    this.cells.forEach((value, k) => {
      if (value === 255) return;
      const row = Math.floor(k / this.w), column = k - row * this.w;
      left = Math.min(left, column); right = Math.max(right, column);
      low = Math.min(low, row); high = Math.max(high, row);
    });
    const [x0, y0, yaw] = this.origin, c = Math.cos(yaw) * this.resolution, s = Math.sin(yaw) * this.resolution;
    const corner = (u, v) => [x0 + c * u - s * v, y0 + s * u + c * v];
    return right < 0 ? [] : [corner(left, low), corner(right + 1, low), corner(right + 1, high + 1), corner(left, high + 1)];
  }
}
