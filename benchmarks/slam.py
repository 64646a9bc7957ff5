"""Accuracy and cost of the mapper, beside the published numbers.

python -m benchmarks.slam [--quick] [--out DIR]

Public logs (relations of Kuemmerle et al. 2009), simulated worlds (exact truth), what each part is
worth (switched off one at a time), and how the cost grows with the log. One parameter set throughout.
Public logs are read from the folder in TURTLEBAG_DATA (its `radish` folder); without it they are left
out. Times are CPU seconds of one process, everything included but reading the file.
"""

from __future__ import annotations

import argparse
import csv
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.slam_logs import LOGS
from datasets.maps import load_map, save_map
from datasets.recordings import load_recording
from datasets.relations import load_relations
from datasets.trajectories import load_tum
from datasets.types import Recording, Trajectory
from pipeline.record import record
from pipeline.slam.slam import SlamConfig, SlamResult, run_slam
from reports.metrics.map import map_metrics
from reports.metrics.relations import relations_metrics
from reports.metrics.trajectory import ate

# Mean translational [m] and rotational [deg] error: gmapping (RBPF), Graph Mapping 2009, Cartographer 2016.
PUBLISHED = {
    "intel": ("0.070 / -", "0.031 / 1.3", "0.0229 / 0.453"),
    "fr079": ("0.061 / -", "0.056 / 0.6", "0.0452 / 0.538"),
    "mit-csail": ("0.049 / -", "0.004 / 0.05", "0.0319 / 0.369"),
    "aces": ("0.060 / -", "0.044 / 0.4", "0.0375 / 0.373"),
    "mit-killian": ("0.122 / -", "0.050 / 0.5", "0.0395 / 0.352"),
}
WORLDS = (
    ("turtlebot3_world", "burger", "tour"),
    ("turtlebot3_world", "burger", "fast"),
    ("turtlebot3_world", "burger", "spiral"),
    ("turtlebot3_house", "waffle_pi", "tour"),
    ("turtlebot3_house", "waffle_pi", "fast"),
    ("office:1", "burger", "tour"),
)
ABLATIONS: dict[str, dict[str, Any]] = {
    "everything": {},
    "no KISS-ICP": {"tracking": {"kiss": {"enabled": False}}},
    "no loop closure": {"loops": {"enabled": False}},
    "loops without Open3D": {"loops": {"open3d": False}},
    "graph not robust": {"loops": {"soft": 0.0}, "refine": {"soft": 0.0}},
    "no joint refinement": {"refine": {"rounds": 0}},
    "no re-posing": {"posing": {"enabled": False}},
    "lidar only": {"sensors": "lidar"},
    "odometry only": {"sensors": "odometry"},
}


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


def public_logs(folder: Path, out: Path, names: Sequence[str]) -> list[dict[str, Any]]:
    """One row a log: our error beside the published ones."""
    rows = []
    for name in names:
        log = folder / f"{name}.clf.bz2"
        if not log.is_file():
            continue
        recording = load_recording(log)
        result, spent = timed(recording)
        picture(result, out, name)
        metrics = relations_metrics(result.trajectory, load_relations(folder / f"{name}.relations"))
        rbpf, graph, cartographer = PUBLISHED[name]
        rows.append(
            {
                "log": name,
                "scans": len(recording),
                "ours [m / deg]": _pair(metrics["relations"]),
                "ours, Cartographer's definition": _pair(metrics["relations_cartographer"]),
                "RBPF": rbpf,
                "Graph Mapping 2009": graph,
                "Cartographer 2016": cartographer,
                "self-check": result.check.as_metrics()["verdict"],
                "CPU s": f"{spent:.1f}",
            }
        )
        print("  ", rows[-1], flush=True)
    return rows


def _pair(found: dict[str, Any]) -> str:
    return f"{found['trans_m']['mean']:.4f} / {found['rot_deg']['mean']:.3f}"


def worlds(out: Path, cases: Sequence[tuple[str, str, str]]) -> list[dict[str, Any]]:
    """One row a drive in a simulated world."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for world, robot, teleop in cases:
            drive = Path(scratch) / f"{world.replace(':', '_')}-{teleop}"
            record(world, robot, teleop, 1, drive)
            recording, truth = load_recording(drive), load_tum(drive / "truth" / "trajectory.tum")
            result, spent = timed(recording)
            picture(result, out, f"{world.replace(':', '_')}-{robot}-{teleop}")
            found = map_metrics(result.grid, load_map(drive / "truth" / "map.yaml"))
            error: Any = found["occupied_error_m"]
            rows.append(
                {
                    "world": world,
                    "robot": robot,
                    "teleop": teleop,
                    "scans": len(recording),
                    "ATE rmse [m]": f"{ate(result.trajectory, truth, align=False)['rmse']:.4f}",
                    "fitted": f"{ate(result.trajectory, truth, align=True)['rmse']:.4f}",
                    "IoU": f"{found['iou']:.2f}",
                    "within one cell": f"{error['within_one_cell']:.4f}",
                    "scans/CPU s": f"{len(recording) / spent:.0f}",
                }
            )
            print("  ", rows[-1], flush=True)
    return rows


def ablation(folder: Path | None, names: Sequence[str]) -> list[dict[str, Any]]:
    """Each part switched off: relations error on public logs, fitted ATE on logs with exact truth."""
    rows = []
    for label, settings in ABLATIONS.items():
        row: dict[str, Any] = {"variant": label}
        for name in names:
            if name in LOGS:
                log = LOGS[name]()
                result, spent = timed(log.recording, settings)
                row[name] = f"{ate(result.trajectory, log.truth, align=True)['rmse']:.4f} ({spent:.0f} s)"
            elif folder is not None:
                result, spent = timed(load_recording(folder / f"{name}.clf.bz2"), settings)
                relations = load_relations(folder / f"{name}.relations")
                found = relations_metrics(result.trajectory, relations)["relations"]
                row[name] = f"{_pair(found)} ({spent:.0f} s)"
        rows.append(row)
        print("  ", row, flush=True)
    return rows


def growth(recording: Recording) -> list[dict[str, Any]]:
    """CPU seconds for a quarter, a half and the whole of a log."""
    rows = []
    for share in (0.25, 0.5, 1.0):
        n = round(share * len(recording))
        _, spent = timed(first(recording, n))
        rows.append({"scans": n, "CPU s": f"{spent:.1f}", "ms a scan": f"{1e3 * spent / n:.2f}"})
        print("  ", rows[-1], flush=True)
    return rows


def first(recording: Recording, n: int) -> Recording:
    """The first n scans of a recording."""
    T = recording.T_odom_base
    return replace(
        recording,
        stamps_ns=recording.stamps_ns[:n],
        ranges=recording.ranges[:n],
        T_odom_base=None if T is None else T[:n],
    )


def write(out: Path, name: str, rows: list[dict[str, Any]]) -> None:
    """A CSV file, and the same as a markdown table on the terminal and in a file."""
    if not rows:
        return
    columns = list(rows[0])
    with (out / f"{name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
    lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    lines += ["| " + " | ".join(str(row.get(column, "")) for column in columns) + " |" for row in rows]
    text = "\n".join(lines) + "\n"
    (out / f"{name}.md").write_text(text)
    print(f"\n{name}\n{text}", flush=True)


def warm_up() -> Trajectory:
    """Compile the kernels and load the libraries, so that no row pays for it."""
    log = LOGS["arena-slow-1"]()
    return timed(first(log.recording, 60))[0].trajectory


def main() -> None:
    """Print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one log, one world, no ablation")
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks/slam"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    warm_up()
    folder = radish()
    if folder is None:
        print("TURTLEBAG_DATA is not set: the public logs are left out")
    else:
        write(
            args.out, "public", public_logs(folder, args.out, ["mit-csail"] if args.quick else [*PUBLISHED])
        )
    write(args.out, "worlds", worlds(args.out, WORLDS[:1] if args.quick else WORLDS))
    if args.quick:
        return
    write(args.out, "ablation", ablation(folder, ("mit-csail", "fr079", "aces-1")))
    log = load_recording(folder / "intel.clf.bz2") if folder is not None else LOGS["killian-1"]().recording
    write(args.out, "growth", growth(log))


if __name__ == "__main__":
    main()
