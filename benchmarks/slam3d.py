"""Accuracy and cost of 3D mapping, and what each package is worth in it.

python -m benchmarks.slam3d [--quick] [--out DIR]

Simulated worlds with a Waffle Pi that carries a 16-beam lidar (exact truth; errors without alignment, those
of clouds alone with the first pose as the only anchor), and drives through a made room and a ring of
corridors with everything switched off once. Times are CPU seconds of one process, reading and writing
included.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import turtlebag as tb
from benchmarks.rows import Row, as_they_come, options, write
from benchmarks.slam3d_drives import Drive3d, changed, make_drive
from benchmarks.slam_parts import VARIANTS
from benchmarks.slam_scores import errors
from turtlebag.pipeline.slam3d.slam3d import Slam3dConfig, run_slam_3d
from turtlebag.reports.metrics.trajectory import ate

WORLDS = ("turtlebot3_world", "turtlebot3_house", "office:3")


def worlds(out: Path) -> Iterator[Row]:
    """One row a tour of a simulated world, with wheels and without; the maps are kept."""
    for world in WORLDS:
        bag = tb.record(world, "waffle_pi_3d")
        for sensors in ("both", "lidar"):
            place, start = out / f"{world.replace(':', '_')}-{sensors}", time.process_time()
            kept = tb.map(
                bag, topic="/points", settings={"sensors": sensors}, truth=bag, out=place, force=True
            )
            spent, found = time.process_time() - start, kept.metrics
            wheels, driven = sensors == "both", kept.trajectory
            off = errors(driven.poses, bag.truth.at(driven.stamps_ns))
            anchored = {"rmse": off["anchored_m"], "max": off["anchored_worst_m"]}
            flat, walls = found["ate_m"] if wheels else anchored, found["map"]
            within = walls["occupied_error_m"]["within_one_cell"]
            yield {
                "world": world,
                "sensors": sensors,
                "clouds": found["scans"],
                "ATE rmse [m]": flat["rmse"],
                "max": flat["max"],
                "fitted": off["m"],
                "height rms [m]": found["out_of_plane"]["z_m"],
                "within one cell": within if wheels else "-",
                "coverage": walls["coverage"] if wheels else "-",
                "loops": found["loops"]["accepted"],
                "check": found["self_check"]["verdict"],
                "clouds/CPU s": round(found["scans"] / spent),
            }


def worth(drives: dict[str, Drive3d]) -> Iterator[Row]:
    """Each part switched off: ATE of every drive (and CPU seconds)."""
    for label, settings in VARIANTS["space"].items():
        row: Row = {"variant": label}
        for name, drive in drives.items():
            start = time.process_time()
            result = run_slam_3d(drive.recording, Slam3dConfig.model_validate(settings))
            spent = time.process_time() - start
            found = ate(result.trajectory, drive.truth, align=False)["rmse"]
            row[name] = f"{found:.4f} ({spent:.0f} s{'' if result.check.good else ', doubtful'})"
        yield row


def main() -> None:
    """Print and write the tables."""
    args = options(__doc__, "data/benchmarks/slam3d", "the made room only").parse_args()
    drives = {"room": make_drive("room", v=0.6, w=1.2)}
    short = changed(drives["room"], lambda k, cloud: cloud if k < 20 else None)
    run_slam_3d(short.recording, Slam3dConfig())  # compiled before anything is timed
    if not args.quick:
        drives["corridors"] = make_drive("corridors", v=0.6, w=1.2)
        write(args.out, "worlds", as_they_come(worlds(args.out)))
    write(args.out, "worth", as_they_come(worth(drives)))


if __name__ == "__main__":
    main()
