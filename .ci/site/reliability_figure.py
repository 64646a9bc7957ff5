"""The figure of docs/how-it-maps.md that shows how many poses the ellipses hold, from rows of bench-coverage.

python .ci/site/reliability_figure.py data/benchmarks/coverage FILE.svg
"""

import json
import sys
from pathlib import Path

import numpy as np

SIZE, LEFT, TOP = 220, 46, 12
LEVELS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99])
STYLE = """
text { fill: #59636e; font: 11px sans-serif } .axis { stroke: #d0d7de } .maps { stroke: #0969da }
.localise { stroke: #bc4c00 } .maps-text { fill: #0969da } .localise-text { fill: #bc4c00 }
@media (prefers-color-scheme: dark) {
  text { fill: #9198a1 } .axis { stroke: #3d444d } .maps { stroke: #4493f8 } .localise { stroke: #db6d28 }
  .maps-text { fill: #4493f8 } .localise-text { fill: #db6d28 }
}
""".strip()


def held(squares):
    """The share of poses within the ellipse of each level, of squared Mahalanobis distances in the plane."""
    return [float(np.mean(squares < -2.0 * np.log(1.0 - level))) for level in LEVELS]


def at(x, y):
    """Shares as a point of the figure."""
    return f"{LEFT + SIZE * x:.1f},{TOP + SIZE * (1.0 - y):.1f}"


def main(folder, out):
    """Draw a curve for each suite that there is."""
    corner, far = at(0, 0), at(1, 1)
    lines = [
        f'<polyline class="axis" fill="none" points="{at(0, 1)} {corner} {at(1, 0)}"/>',
        f'<polyline class="axis" fill="none" stroke-dasharray="3" points="{corner} {far}"/>',
    ]
    for k, (suite, name) in enumerate((("maps", "maps"), ("localise", "localisations"))):
        file = Path(folder, "rows", f"{suite}.jsonl")
        rows = {row["case"]: row for row in map(json.loads, file.read_text().splitlines())}.values()
        squares = np.concatenate([row["d2"] for row in rows if "d2" in row])
        points = " ".join(at(*pair) for pair in zip(LEVELS, held(squares), strict=True))
        lines.append(f'<polyline class="{suite}" fill="none" stroke-width="2" points="{points}"/>')
        lines.append(f'<text class="{suite}-text" x="{LEFT + 10}" y="{TOP + 14 + 15 * k}">{name}</text>')
    for share in (0, 0.5, 1):
        x, y = at(share, share).split(",")
        lines.append(f'<text x="{x}" y="{TOP + SIZE + 15}" text-anchor="middle">{share:.0%}</text>')
        lines.append(f'<text x="{LEFT - 6}" y="{float(y) + 4:.1f}" text-anchor="end">{share:.0%}</text>')
    foot = f'<text x="{LEFT + SIZE / 2}" y="{TOP + SIZE + 31}" text-anchor="middle">'
    lines.append(f"{foot}poses that the ellipse should hold, and does</text>")
    wide, high = LEFT + SIZE + 24, TOP + SIZE + 40
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" width="{wide}">'
    Path(out).write_text("\n".join([head, f"<style>{STYLE}</style>", *lines, "</svg>"]) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
