"""Whose error is it: the map's or the relations'?

python -m benchmarks.slam_relations [--out DIR] [LOG ...]

Each hand-made relation names two scans. Those two scans alone say where the one lies as seen from the
other: matched point to line, and by Open3D point to point, both started AT the relation and without
anything of our map. Where both see all directions and overlap well, the table says how far the relation,
the two matches and our map are from each other, and how far the relations are from a fit to themselves
(a graph of relations alone: their loops do not close). The picture draws our map's disagreement with
each relation against that of its two scans alone. Logs are read from TURTLEBAG_DATA.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from benchmarks.slam_cases import mapped
from benchmarks.slam_public import public_data
from benchmarks.slam_rows import Row, write
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.relations import Relations, load_relations
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.pipeline.slam.clouds import Clouds, make_clouds
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.open3d_icp import match_points
from turtlebag.pipeline.slam.pose_graph import optimise
from turtlebag.pipeline.slam.refine import linearise_pairs
from turtlebag.reports.metrics.relations import nearest

GATES_M = (0.3, 0.15, 0.1, 0.1, 0.1)
MIN_OVERLAP = 0.6
# A relation's weight in the graph of relations: 2 cm, 0.3 degrees, heavy-tailed.
INFORMATION = np.diag([0.02**-2, 0.02**-2, 0.005**-2])


@dataclass(frozen=True, eq=False)
class Witnesses:
    """Relative poses (n,) of the same pairs of scans by different witnesses; `sure` says which to count."""

    relation: SE2
    ours: SE2
    lines: SE2
    points: SE2
    sure: NDArray[np.bool_]


def witnesses(folder: Path, name: str) -> Witnesses:
    """All witnesses of a log's relations."""
    recording = load_recording(folder / f"{name}.clf.bz2")
    relations = load_relations(folder / f"{name}.relations")
    poses = mapped(recording)[0].trajectory.poses
    a, b = (nearest(recording.stamps_ns, s)[0] for s in (relations.stamps_a_ns, relations.stamps_b_ns))
    clouds = make_clouds(recording, 30.0)
    lines, sure = _by_lines(clouds, a, b, relations.T_a_b)
    points, overlap = _by_points(clouds, a, b, relations.T_a_b)
    ours = poses[a].inverse() @ poses[b]
    return Witnesses(relations.T_a_b, ours, lines, points, sure & (overlap > MIN_OVERLAP))


def _by_lines(
    clouds: Clouds, a: NDArray[np.int64], b: NDArray[np.int64], start: SE2
) -> tuple[SE2, NDArray[np.bool_]]:
    """Each pair of scans matched point to line, and whether it overlaps and sees all directions."""
    scans, pairs = np.stack([a, b], axis=1).ravel(), np.arange(2 * len(a)).reshape(-1, 2)
    T = start.xyt.copy()
    for gate in GATES_M:
        poses = np.zeros((2 * len(a), 3))
        poses[1::2] = T
        T, information, overlap = linearise_pairs(
            clouds, scans, poses, pairs, gate, 0.03,
        )  # fmt: skip
    seen = np.linalg.eigvalsh(information[:, :2, :2])
    return SE2.from_array(T), (overlap > MIN_OVERLAP) & (seen[:, 0] > 0.05 * seen[:, 1])


def _by_points(clouds: Clouds, a: NDArray[np.int64], b: NDArray[np.int64], start: SE2) -> tuple[SE2, Array]:
    """Each pair of scans matched by Open3D, points only, and the share of points matched."""
    T, overlap = [], []
    for i, j, guess in zip(a, b, start.xyt, strict=True):
        wide = match_points(clouds.of(j), clouds.of(i), guess, 0.3, 30)
        found = match_points(clouds.of(j), clouds.of(i), wide.T_target_source, 0.1, 30)
        T.append(found.T_target_source)
        overlap.append(found.overlap)
    return SE2.from_array(np.array(T)), np.array(overlap)


def apart(x: SE2, y: SE2) -> str:
    """Mean distance [m] / [deg] of relative poses, component-wise."""
    metres = np.linalg.norm(x.xy - y.xy, axis=1).mean()
    return f"{metres:.4f} / {np.degrees(np.abs(wrap(x.yaw - y.yaw))).mean():.3f}"


def row(name: str, relations: Relations, found: Witnesses) -> Row:
    """The table's row."""
    k = found.sure
    relation, ours, lines, points = (T[k] for T in (found.relation, found.ours, found.lines, found.points))
    against_ours, against_lines = (np.degrees(wrap(T.yaw - relation.yaw)) for T in (ours, lines))
    return {
        "log": name,
        "all: relation - ours [m / deg]": apart(found.relation, found.ours),
        "pairs that see": f"{int(k.sum())} of {len(k)}",
        "relation - ours": apart(relation, ours),
        "relation - two scans": apart(relation, lines),
        "relation - Open3D": apart(relation, points),
        "two scans - ours": apart(lines, ours),
        "Open3D - ours": apart(points, ours),
        "correlation": f"{np.corrcoef(against_ours, against_lines)[0, 1]:.2f}",
        "relations - their own fit": own_fit(relations),
    }


def own_fit(relations: Relations) -> str:
    """How far the relations are from the poses that fit all of them best, and how redundant they are."""
    stamps = np.unique(np.concatenate([relations.stamps_a_ns, relations.stamps_b_ns]))
    i, j = (np.searchsorted(stamps, s) for s in (relations.stamps_a_ns, relations.stamps_b_ns))
    n, z = len(stamps), relations.T_a_b
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(n, n)).tocsr()
    count, part = connected_components(graph, directed=False)
    edges = {(int(p), int(q)): z[k] for k, (p, q) in enumerate(zip(i, j, strict=True))}
    edges |= {(q, p): T.inverse() for (p, q), T in list(edges.items()) if (q, p) not in edges}
    poses = np.zeros((n, 3))
    ties = []
    for label in range(count):
        root = int(np.flatnonzero(part == label)[0])
        order, before = breadth_first_order(graph, root, directed=False)
        for node in order[1:]:
            poses[node] = (SE2(poses[before[node]]) @ edges[int(before[node]), int(node)]).xyt
        if root != 0:
            ties.append(Constraint(0, root, poses[root], np.eye(3), "step"))
    constraints = [
        Constraint(int(p), int(q), z.xyt[k], INFORMATION, "loop", 2.0)
        for k, (p, q) in enumerate(zip(i, j, strict=True))
    ]
    best = optimise(SE2(poses), [*constraints, *ties])
    redundancy = 1.0 - (n - count) / len(i)
    return f"{apart(best[i].inverse() @ best[j], z)} ({100 * redundancy:.0f} % redundant)"


def picture(found: Witnesses, name: str, file: Path) -> None:
    """Our disagreement with each relation against that of its two scans alone [deg]."""
    k, limit = found.sure, 2.0
    ours, lines, points = (
        np.degrees(wrap(T.yaw - found.relation.yaw))[k] for T in (found.ours, found.lines, found.points)
    )
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 4.4), sharex=True, sharey=True, layout="constrained")
    for ax, other, label in ((axes[0], lines, "point to line"), (axes[1], points, "Open3D, point to point")):
        ax.plot([-limit, limit], [-limit, limit], color="0.7", linewidth=1)
        ax.plot(other, ours, ".", markersize=3, color="#2a6f97", alpha=0.5)
        ax.set(xlim=(-limit, limit), ylim=(-limit, limit), xlabel=f"its two scans alone, {label} [deg]")
        ax.set_aspect("equal")
    axes[0].set_ylabel("our map [deg]")
    figure.suptitle(f"{name}: how far each relation's turn is from the map and from its own two scans")
    figure.savefig(file, dpi=110, metadata={"Software": None})
    plt.close(figure)


def main() -> None:
    """Print and write the table and a picture a log."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="LOG")
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks/slam_relations"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    folder = public_data()
    if folder is None:
        print("TURTLEBAG_DATA is not set: there are no relations to judge")
        return
    rows = []
    for name in args.names or ["fr079", "intel", "mit-csail"]:
        found = witnesses(folder, name)
        rows.append(row(name, load_relations(folder / f"{name}.relations"), found))
        picture(found, name, args.out / f"{name}.png")
    write(args.out, "relations", rows)


if __name__ == "__main__":
    main()
