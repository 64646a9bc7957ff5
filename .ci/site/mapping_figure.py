"""The figure of docs/how-it-maps.md, drawn from a recording and its map: scan, track, graph, grid.

python .ci/site/mapping_figure.py RECORD_DIR MAP_DIR FILE.svg
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import turtlebag as tb

WIDE, HIGH, GAP, TITLE, FOOT = 236, 170, 10, 28, 26
STYLE = """
.card { fill: #ffffff; stroke: #d0d7de } .text { fill: #1f2328; font: 600 13px sans-serif }
.note { fill: #59636e; font: 11px sans-serif } .beam { stroke: #d0d7de } .wall { stroke: #1f2328 }
.dot { fill: #0969da } .wheels { stroke: #8250df } .track { stroke: #0969da } .pair { stroke: #54aeff }
.loop { stroke: #bc4c00 } .free { fill: #dfe5eb } .full { fill: #1f2328 }
@media (prefers-color-scheme: dark) {
  .card { fill: #161b22; stroke: #3d444d } .text { fill: #f0f6fc } .note { fill: #9198a1 }
  .beam { stroke: #3d444d }
  .wall { stroke: #f0f6fc } .dot { fill: #4493f8 } .wheels { stroke: #ab7df8 } .track { stroke: #4493f8 }
  .pair { stroke: #316dca } .loop { stroke: #db6d28 } .free { fill: #2f3742 } .full { fill: #f0f6fc }
}
""".strip()


def path(points, kind, width=1.0):
    """Segments or a line, (n, 2) each, in pixels."""
    text = "".join("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in np.asarray(line)) for line in points)
    return f'<path class="{kind}" fill="none" stroke-width="{width}" stroke-linejoin="round" d="{text}"/>'


def dots(points, kind, radius):
    """A disc at each point (n, 2) in pixels."""
    text = "".join(
        f"M{x - radius:.1f} {y:.1f}a{radius} {radius} 0 1 0 {2 * radius} 0"
        f"a{radius} {radius} 0 1 0 {-2 * radius} 0"
        for x, y in points
    )
    return f'<path class="{kind}" d="{text}"/>'


def cells(mask, kind, at, size):
    """Runs of cells of a row as one path; row 0 is the lowest."""
    text = []
    for row in range(len(mask)):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], mask[row].astype(int), [0]])))
        for first, last in edges.reshape(-1, 2):
            x, y = at(np.array([first, row + 1]))
            text.append(
                f"M{x:.1f} {y:.1f}h{(last - first) * size:.1f}v{size:.2f}h{-(last - first) * size:.1f}z"
            )
    return f'<path class="{kind}" d="{"".join(text)}"/>'


def fitted(low, high):
    """A function from metres (n, 2) to the pixels of a panel, and the pixels of a metre."""
    scale = min(np.array([WIDE - 20, HIGH - 4]) / (high - low))
    middle = 0.5 * (low + high)
    half = np.array([WIDE / 2, TITLE + HIGH / 2])
    return (lambda xy: half + (np.asarray(xy) - middle) * [scale, -scale]), scale


def thinned(line, apart):
    """Of a path (n, 2) the points at least so far apart [m]."""
    kept = [line[0]]
    for point in line:
        if np.hypot(*(point - kept[-1])) >= apart:
            kept.append(point)
    return np.array([*kept, line[-1]])


def scan_panel(bag, made):
    """A scan with its beams, and the walls that were seen before."""
    number = 1500
    lidar, ranges = bag.recording.lidar, bag.ranges[number]
    T_map_base = tb.SE2(np.asarray(made.trajectory)[number])
    here = T_map_base @ bag.recording.T_base_lidar
    seen = np.isfinite(ranges) & (ranges > lidar.range_min) & (ranges < 3.4)
    ends = here @ (ranges[seen, None] * lidar.directions[seen])
    reach = np.array([4.0, 2.9])
    at, _ = fitted(here.xy - reach, here.xy + reach)
    rows, columns = np.nonzero(made.grid == 100)
    walls = np.asarray(made.origin[:2]) + made.resolution * (np.column_stack([columns, rows]) + 0.5)
    walls = walls[(np.abs(walls - here.xy) < reach).all(axis=1)]
    near = [
        [at(a), at(b)]
        for i, j in cKDTree(walls).query_pairs(1.5 * made.resolution)
        for a, b in [(walls[i], walls[j])]
    ]
    beams = [[at(here.xy), at(end)] for end in ends[::3]]
    inside = ends[(np.abs(ends - here.xy) < reach).all(axis=1)]
    return path(beams, "beam", 0.7) + path(near, "wall", 1.0) + dots(at(inside), "dot", 1.6)


def track_panel(bag, made, at):
    """The path by the wheels and that by the scans."""
    wheels = thinned(np.asarray(bag.odometry)[:, :2], 0.1)
    return path([at(wheels)], "wheels", 1.2) + path(
        [at(thinned(np.asarray(made.trajectory)[:, :2], 0.1))], "track", 1.6
    )


def graph_panel(folder, at):
    """Key scans, pairs between them, accepted loops."""
    lines = [line.split() for line in (folder / "graph.g2o").read_text().splitlines()]
    keys = np.array([line[2:4] for line in lines if line[0] == "VERTEX_SE2"], dtype=float)
    pairs = {(int(line[1]), int(line[2])) for line in lines if line[0] == "EDGE_SE2"}
    far = sorted((i, j) for i, j in pairs if abs(i - j) > 2)
    loops = json.loads((folder / "graph.json").read_text())["loops"]
    closed = [(loop["i"], loop["j"]) for loop in loops if loop["verdict"] == "accepted"]
    drawn = path([at(keys[list(pair)]) for pair in far[::2]], "pair", 0.6) + path([at(keys)], "track", 0.8)
    return drawn + dots(at(keys), "dot", 1.5) + path([at(keys[list(loop)]) for loop in closed], "loop", 1.8)


def main(record, folder, file):
    """Draw the figure of a recording's folder and its map's folder."""
    bag, made = tb.Bag(record), tb.Map(folder)
    rows, columns = np.nonzero(made.grid >= 0)
    origin = np.asarray(made.origin[:2])
    low = origin + made.resolution * np.array([columns.min(), rows.min()])
    high = origin + made.resolution * np.array([columns.max() + 1, rows.max() + 1])
    at, scale = fitted(low, high)
    pixels = lambda cell: at(origin + made.resolution * cell)  # noqa: E731
    size = made.resolution * scale
    grid = cells(made.grid == 0, "free", pixels, size) + cells(made.grid == 100, "full", pixels, size)
    panels = [
        ("1  Scan", scan_panel(bag, made), [("dot", "points"), ("wall", "lines")]),
        ("2  Track", track_panel(bag, made, at), [("wheels", "wheels"), ("track", "scans")]),
        (
            "3  Graph",
            graph_panel(Path(folder), at),
            [("dot", "key scans"), ("pair", "pairs"), ("loop", "loops")],
        ),
        ("4  Grid", grid, [("full", "occupied"), ("free", "free")]),
    ]
    width = len(panels) * WIDE + (len(panels) - 1) * GAP + 2
    height = TITLE + HIGH + FOOT + 2
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}"><style>{STYLE}</style>'
    ]
    for k, (title, drawing, legend) in enumerate(panels):
        out.append(
            f'<g transform="translate({1 + k * (WIDE + GAP)} 1)">'
            f'<rect class="card" width="{WIDE}" height="{TITLE + HIGH + FOOT}" rx="6"/>'
            f'<text class="text" x="12" y="19">{title}</text>{drawing}'
        )
        x = 12
        for kind, name in legend:
            y = TITLE + HIGH + 12
            mark = f'<rect class="{kind}" x="{x}" y="{y - 5}" width="10" height="10"/>'
            if kind in ("wall", "wheels", "track", "pair", "loop"):
                mark = path([[(x, y), (x + 12, y)]], kind, 2)
            elif kind == "dot":
                mark = dots([(x + 5, y)], kind, 3)
            out.append(f'{mark}<text class="note" x="{x + 16}" y="{y + 4}">{name}</text>')
            x += 26 + 6.2 * len(name)
        out.append("</g>")
    Path(file).write_text("\n".join([*out, "</svg>"]) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
