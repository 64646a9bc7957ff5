"""Accuracy and cost of the mapper, beside the published numbers.

python -m benchmarks.slam [--quick] [--part PART ...] [--world WORLD ...] [--sensors SET ...] [--again]
                          [--out DIR]

Parts: `public` logs (relations of Kuemmerle et al. 2009), simulated `worlds` (exact truth; with the
simulator's `realistic` sensors, its `clean` ones, or both), `ablation` (each part switched off, one at
a time), `growth` (cost of one, two, four times the drive). One parameter set throughout. Public logs
are read from the folder in TURTLEBAG_DATA (its `radish` folder); without it they are left out. Rows are
kept below DIR/cases and not measured twice (--again does). Times are CPU seconds of one process,
everything included but reading the file.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.slam_logs import LOGS, office_laps
from benchmarks.slam_scores import score
from benchmarks.slam_tables import Cases, Row, write
from datasets.grid import OccupancyGrid
from datasets.maps import load_map, save_map
from datasets.recordings import load_recording
from datasets.relations import load_relations
from datasets.trajectories import load_tum
from datasets.types import Recording, Trajectory
from pipeline.record import record
from pipeline.slam.slam import SlamConfig, SlamResult, run_slam
from reports.metrics.map import map_metrics, occupied, visible_surface
from reports.metrics.relations import relations_metrics
from reports.metrics.trajectory import ate
from sim.simulator import Sensors, SimConfig

# Mean translational [m] / rotational [deg] error as published: scan matching, gmapping (RBPF), Graph
# Mapping 2009, Cartographer 2016.
PUBLISHED = {
    "intel": ("0.220", "0.070", "0.031 / 1.3", "0.0229 / 0.453"),
    "fr079": ("0.258", "0.061", "0.056 / 0.6", "0.0452 / 0.538"),
    "mit-csail": ("0.106", "0.049", "0.004 / 0.05", "0.0319 / 0.369"),
    "aces": ("0.173", "0.060", "0.044 / 0.4", "0.0375 / 0.373"),
    "mit-killian": ("1.651", "0.122", "0.050 / 0.5", "0.0395 / 0.352"),
}
TUTORIAL = [(w, r) for w in ("turtlebot3_world", "turtlebot3_house") for r in ("burger", "waffle_pi")]
WORLDS = (
    *((world, robot, teleop, 1) for world, robot in TUTORIAL for teleop in ("tour", "fast", "spiral")),
    *((world, robot, "tour", seed) for world, robot in TUTORIAL for seed in (2, 3)),
    *((f"office:{seed}", "burger", "tour", seed) for seed in (31, 32, 33)),
)
OFF = {"enabled": False}
ABLATIONS: dict[str, dict[str, Any]] = {
    "everything": {},
    "no KISS-ICP": {"tracking": {"kiss": OFF}},
    "no Open3D": {"loops": {"open3d": False}, "refine": {"open3d": False}},
    "no loop closure": {"loops": OFF},
    "graph not robust": {"loops": {"soft": 0.0}, "refine": {"soft": 0.0}},
    "no joint refinement": {"refine": {"rounds": 0}},
    "no odometry calibration": {"tracking": {"calibration": False}},
    "no re-posing": {"posing": OFF},
    "no deskewing": {"deskew": False},
    "lidar only": {"sensors": "lidar"},
    "odometry only": {"sensors": "odometry"},
}
ABLATED = ("mit-csail", "fr079", "intel", "posts-1", "hall-2", "office-all-1", "rooms-1", "arena-fast-1")


def timed(recording: Recording, settings: dict[str, Any] | None = None) -> tuple[SlamResult, float]:
    """The result and the CPU seconds it took."""
    start = time.process_time()
    result = run_slam(recording, SlamConfig.model_validate(settings or {}))
    return result, time.process_time() - start


def radish() -> Path | None:
    """Folder of the public logs."""
    root = os.environ.get("TURTLEBAG_DATA")
    folder = Path(root) / "radish" if root else None
    return folder if folder is not None and folder.is_dir() else None


def picture(result: SlamResult, folder: Path, name: str) -> None:
    """The map as pgm, yaml and png."""
    save_map(result.grid, folder, name)
    Image.open(folder / f"{name}.pgm").save(folder / f"{name}.png")


def public_log(folder: Path, out: Path, name: str) -> Row:
    """Our error on a public log beside the published ones."""
    recording = load_recording(folder / f"{name}.clf.bz2")
    result, spent = timed(recording)
    picture(result, out, name)
    metrics = relations_metrics(result.trajectory, load_relations(folder / f"{name}.relations"))
    matching, rbpf, graph, cartographer = PUBLISHED[name]
    return {
        "log": name,
        "scans": len(recording),
        "ours [m / deg]": _pair(metrics["relations"]),
        "ours, Cartographer's definition": _pair(metrics["relations_cartographer"]),
        "scan matching": matching,
        "RBPF": rbpf,
        "Graph Mapping 2009": graph,
        "Cartographer 2016": cartographer,
        "self-check": result.check.as_metrics()["verdict"],
        "CPU s": f"{spent:.1f}",
    }


def _pair(found: dict[str, Any]) -> str:
    return f"{found['trans_m']['mean']:.4f} / {found['rot_deg']['mean']:.3f}"


def world_row(out: Path, sensors: Sensors, world: str, robot: str, teleop: str, seed: int) -> Row:
    """A drive in a simulated world, against its exact truth."""
    with tempfile.TemporaryDirectory() as scratch:
        drive = Path(scratch) / "drive"
        record(world, robot, teleop, seed, drive, sim=SimConfig(sensors=sensors))
        recording, truth = load_recording(drive), load_tum(drive / "truth" / "trajectory.tum")
        true_map = load_map(drive / "truth" / "map.yaml")
    result, spent = timed(recording)
    picture(result, out, f"{world.replace(':', '_')}-{robot}-{teleop}-{seed}-{sensors}")
    found = map_metrics(result.grid, true_map)
    error: Any = found["occupied_error_m"]
    turned = result.trajectory.poses.yaw - truth.at(result.trajectory.stamps_ns).yaw
    turned = np.degrees(np.abs((turned - turned[0] + np.pi) % (2.0 * np.pi) - np.pi))
    return {
        "sensors": sensors,
        "world": world,
        "robot": robot,
        "teleop": teleop,
        "seed": seed,
        "scans": len(recording),
        "ATE [m]": f"{ate(result.trajectory, truth, align=False)['rmse']:.4f}",
        "aligned [m]": f"{ate(result.trajectory, truth, align=True)['rmse']:.4f}",
        "yaw [deg]": f"{float(np.sqrt(np.mean(turned**2))):.3f}",
        "within one cell": f"{error['within_one_cell']:.4f}",
        "IoU": f"{found['iou']:.2f}",
        "wall cells a true one": f"{thickness(result.grid, true_map):.2f}",
        "self-check": result.check.as_metrics()["verdict"],
        "scans/CPU s": f"{len(recording) / spent:.0f}",
    }


def thickness(grid: OccupancyGrid, true_grid: OccupancyGrid) -> float:
    """Mapped occupied cells for each cell of the true surface that could be seen: walls in cells."""
    return float(occupied(grid).sum() / max(int(visible_surface(true_grid, grid).sum()), 1))


def ablated(folder: Path | None, name: str, settings: dict[str, Any]) -> Row:
    """One cell of the ablation: relations error on a public log, fitted ATE / yaw with exact truth."""
    if name in LOGS:
        log = LOGS[name]()
        result, spent = timed(log.recording, settings)
        found = score(result.trajectory.poses, log.truth)
        return {"found": f"{found.ate_aligned:.4f} / {found.relation_deg:.3f}", "CPU s": f"{spent:.0f}"}
    assert folder is not None
    result, spent = timed(load_recording(folder / f"{name}.clf.bz2"), settings)
    metrics = relations_metrics(result.trajectory, load_relations(folder / f"{name}.relations"))
    return {"found": _pair(metrics["relations"]), "CPU s": f"{spent:.0f}"}


def growth_row(times: int) -> Row:
    """Cost of a drive that goes round the same office several times."""
    recording = office_laps(times).recording
    _, spent = timed(recording)
    n = len(recording)
    return {"laps": times, "scans": n, "CPU s": f"{spent:.1f}", "ms a scan": f"{1e3 * spent / n:.2f}"}


def warm_up() -> Trajectory:
    """Compile the kernels and load the libraries, so that no row pays for it."""
    trajectory = timed(first(LOGS["posts-1"]().recording, 60))[0].trajectory
    timed(first(LOGS["arena-slow-1"]().recording, 60))
    return trajectory


def first(recording: Recording, n: int) -> Recording:
    """The first n scans of a recording."""
    T = recording.T_odom_base
    return replace(
        recording,
        stamps_ns=recording.stamps_ns[:n],
        ranges=recording.ranges[:n],
        T_odom_base=None if T is None else T[:n],
    )


def worlds(cases: Cases, out: Path, drives: Sequence[tuple], sensors: Sequence[Sensors]) -> None:
    """The drives with each set of sensors."""
    rows = [
        cases.row(
            "worlds", "-".join(map(str, (which, *d))), lambda d=d, which=which: world_row(out, which, *d)
        )
        for d in drives
        for which in sensors
    ]
    write(out, "worlds", rows)


def tables(cases: Cases, out: Path, folder: Path | None, parts: list[str], *, quick: bool) -> None:
    """Measure and write the tables asked for, but that of the worlds."""
    public = [] if folder is None else [n for n in PUBLISHED if (folder / f"{n}.clf.bz2").is_file()]
    if "public" in parts and folder is not None:
        names = ["mit-csail"] if quick else public
        rows = [cases.row("public", n, lambda n=n: public_log(folder, out, n)) for n in names]
        write(out, "public", rows)
    if "ablation" in parts:
        rows = []
        for variant, settings in ABLATIONS.items():
            row: Row = {"variant": variant}
            for name in ABLATED:
                if name in LOGS or name in public:
                    case = f"{variant}-{name}"
                    found = cases.row(
                        "ablation", case, lambda name=name, s=settings: ablated(folder, name, s)
                    )
                    row[name] = f"{found['found']} ({found['CPU s']} s)"
            rows.append(row)
        write(out, "ablation", rows)
    if "growth" in parts:
        write(out, "growth", [cases.row("growth", f"{k}", lambda k=k: growth_row(k)) for k in (1, 2, 4)])


def main() -> None:
    """Print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    every = ["public", "worlds", "ablation", "growth"]
    parser.add_argument("--quick", action="store_true", help="one public log and one world only")
    parser.add_argument("--part", nargs="+", choices=every, help="only these tables")
    parser.add_argument("--world", nargs="+", metavar="WORLD", help="only these worlds")
    parser.add_argument("--sensors", nargs="+", choices=["realistic", "clean"], default=["realistic"])
    parser.add_argument("--again", action="store_true", help="measure what was measured before, too")
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks/slam"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    folder = radish()
    if folder is None:
        print("TURTLEBAG_DATA is not set: the public logs are left out")
    warm_up()
    parts = args.part or (["public", "worlds"] if args.quick else every)
    cases = Cases(args.out / "cases", again=args.again)
    if "worlds" in parts:
        drives = [
            d for d in (WORLDS[:1] if args.quick else WORLDS) if args.world is None or d[0] in args.world
        ]
        worlds(cases, args.out, drives, args.sensors)
    tables(cases, args.out, folder, parts, quick=args.quick)


if __name__ == "__main__":
    main()
