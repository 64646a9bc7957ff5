"""Accuracy and cost of 3D mapping, and what each package is worth in it.

python -m benchmarks.slam3d [--quick] [--out DIR]

Simulated worlds with a Waffle Pi that carries a 16-beam lidar (exact truth; errors without alignment), and
drives through a made room and a ring of corridors with everything switched off once. Times are CPU seconds of
one process, reading included.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rows import Row, as_they_come, options, write
from benchmarks.slam3d_drives import Drive3d, changed, make_drive
from benchmarks.slam_cases import picture
from benchmarks.slam_parts import VARIANTS
from turtlebag.datasets import se3
from turtlebag.datasets.bags.clouds import load_clouds
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Recording3D, Trajectory
from turtlebag.pipeline.slam3d.cloud_map import save_ply
from turtlebag.pipeline.slam3d.slam3d import Slam3dConfig, Slam3dResult, run_slam_3d
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.reports.metrics.map import map_metrics
from turtlebag.reports.metrics.trajectory import ate

WORLDS = (("turtlebot3_world", "tour"), ("turtlebot3_house", "tour"), ("office:3", "tour"))


def timed(recording: Recording3D, settings: dict[str, Any]) -> tuple[Slam3dResult, float]:
    """The result and the CPU seconds it took."""
    start = time.process_time()
    result = run_slam_3d(recording, Slam3dConfig.model_validate(settings))
    return result, time.process_time() - start


def placed(result: Slam3dResult, truth: Trajectory, *, from_nothing: bool) -> Trajectory:
    """The trajectory; without odometry its map frame is put at the first true pose."""
    if not from_nothing:
        return result.trajectory
    T = se3.lifted(truth.at(result.trajectory.stamps_ns[:1])) @ result.T_map_base
    return Trajectory(result.trajectory.stamps_ns, se3.planar(T))


def worlds(out: Path, cases: Sequence[tuple[str, str]]) -> Iterator[Row]:
    """One row a drive in a simulated world, with wheels and without."""
    with tempfile.TemporaryDirectory() as scratch:
        for world, teleop in cases:
            name = f"{world.replace(':', '_')}-{teleop}"
            drive = Path(scratch) / name
            record(Scene.load(world, "waffle_pi_3d"), teleop, Output(drive))
            truth, true_map = load_tum(drive / "truth/trajectory.tum"), load_map(drive / "truth/map.yaml")
            for sensors in ("both", "lidar"):
                start = time.process_time()
                recording = load_clouds(drive)
                result, _ = timed(recording, {"sensors": sensors})
                spent = time.process_time() - start
                found = map_metrics(result.grid, true_map)
                errors: Any = found["occupied_error_m"]
                trajectory = placed(result, truth, from_nothing=sensors == "lidar")
                flat = ate(trajectory, truth, align=False)
                yield {
                    "world": world,
                    "sensors": sensors,
                    "clouds": len(recording),
                    "ATE rmse [m]": f"{flat['rmse']:.4f}",
                    "max": f"{flat['max']:.4f}",
                    "fitted": f"{ate(trajectory, truth, align=True)['rmse']:.4f}",
                    "height rms [m]": f"{np.sqrt(np.mean(result.T_map_base[:, 2, 3] ** 2)):.4f}",
                    "within one cell": f"{errors['within_one_cell']:.4f}" if sensors == "both" else "-",
                    "coverage": f"{found['coverage']:.3f}" if sensors == "both" else "-",
                    "loops": sum(loop.accepted for loop in result.loops),
                    "check": "good" if result.check.good else "doubtful",
                    "clouds/CPU s": f"{len(recording) / spent:.0f}",
                }
                if sensors == "both":
                    picture(result.grid, out, name)
                    save_ply(out / f"{name}.ply", result.points)


def worth(drives: dict[str, Drive3d]) -> Iterator[Row]:
    """Each part switched off: ATE of every drive (and CPU seconds)."""
    for label, settings in VARIANTS["space"].items():
        row: Row = {"variant": label}
        for name, drive in drives.items():
            result, spent = timed(drive.recording, settings)
            found = ate(result.trajectory, drive.truth, align=False)["rmse"]
            row[name] = f"{found:.4f} ({spent:.0f} s{'' if result.check.good else ', doubtful'})"
        yield row


def main() -> None:
    """Print and write the tables."""
    args = options(__doc__, "data/benchmarks/slam3d", "the made room only").parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    around = make_drive("room", v=0.6, w=1.2)
    timed(changed(around, lambda k, cloud: cloud if k < 20 else None).recording, {})
    drives = {"room": around}
    if not args.quick:
        drives["corridors"] = make_drive("corridors", v=0.6, w=1.2)
        write(args.out, "worlds", as_they_come(worlds(args.out, WORLDS)))
    write(args.out, "worth", as_they_come(worth(drives)))


if __name__ == "__main__":
    main()
